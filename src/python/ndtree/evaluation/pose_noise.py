# SPDX-License-Identifier: BSD-3-Clause
"""By how much poses err between scans of a place, from the surfaces that these share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ndtree.alignment.planar import Floats
from ndtree.alignment.surfaces import Cloud
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import spread

_MOST_PAIRS, _LEAST_PAIRS = 64, 5
_WRONG = 20  # One match in this many may be wrong, as where surfaces repeat.
#: What is tried [m, rad].
_PLACES = [0.0, *np.geomspace(0.005, 1.0, 33)]
_TURNS = [0.0, *np.radians(np.geomspace(0.02, 5.0, 33))]
_ROUNDS = 2  # Over the axes.
_NEAR = 0.5  # Of the usual range: scans whose places, and whose surfaces' middles, are no farther apart.
#: Errors below these are within those of maps and sensors [m, rad]: nothing is said of them.
_NOTABLE = 0.02, np.radians(0.1)


@dataclass(frozen=True)
class PoseNoise:
    """How wrong poses tell how a scan of a place lies to another one, as standard deviations."""

    place: float = 0.0  # On each axis [m].
    turn: float = 0.0  # About each axis [rad].

    @property
    def is_notable(self) -> bool:
        return self.place > _NOTABLE[0] or self.turn > _NOTABLE[1]

    def figures(self) -> dict[str, float]:
        return {"place": self.place, "turn_degrees": float(np.degrees(self.turn))}

    def __str__(self) -> str:
        sizes = {f"{self.place:.2f} m": self.place, f"{np.degrees(self.turn):.1f} degrees": self.turn}
        by = " and ".join(words for words, size in sizes.items() if size)
        return f"poses err by about {by} between scans of the same place: points that this explains are kept"

    @classmethod
    def of(cls, scans: Iterable[Scan]) -> PoseNoise:
        """Measure it: by how much scans have to be moved so that their surfaces lie on each other.

        Any two scans of a place count alike, whether they follow each other or not, as they do where one
        tells what of the other moved: so do jitter, jumps and drift. The largest of all directions counts.

        `scans`: In the order of their times. With too few of a place: no noise.
        """
        runs, _, _ = spread(scans, keep=_cloud)
        clouds = [one for run in runs for one in run if one is not None and one.reach > 0.0]
        reach = np.array([one.reach for one in clouds])
        places = np.array([one.pose[:3, 3] for one in clouds]).reshape(-1, 3)
        middles = np.array([one.middle for one in clouds]).reshape(-1, 3)
        first, second = np.triu_indices(len(clouds), 1)
        apart = sum(np.linalg.norm(one[first] - one[second], axis=1) for one in (places, middles))
        near = np.flatnonzero(apart < _NEAR * np.minimum(reach[first], reach[second]))
        near = near[np.unique(np.linspace(0, len(near) - 1, min(len(near), _MOST_PAIRS)).astype(int))]
        found = [clouds[i].displacement(clouds[k]) for i, k in zip(first[near], second[near])]
        known = [one for one in found if one is not None]
        if len(known) < _LEAST_PAIRS:
            return cls()
        return cls(*_likeliest(*map(np.array, zip(*known))))


def _cloud(scan: Scan) -> Cloud | None:
    """With the axes of the map, whatever its log says of its own."""
    return Cloud.of(replace(scan, rotation=np.eye(3), heading=0.0))


def _likeliest(errors: Floats, covariances: Floats) -> tuple[float, float]:
    """Standard deviations with which errors (n, 6) are likeliest, beside their covariances (n, 6, 6).

    Of the axes, each by itself, the largest counts. One pair in `_WRONG` may be wrong.
    """

    def likely(sigmas: Floats) -> float:
        all_of = covariances + np.diag(sigmas**2)
        squared = np.einsum("ni,ni->n", errors, np.linalg.solve(all_of, errors[:, :, None])[:, :, 0])
        each = np.sort(-0.5 * (squared + np.linalg.slogdet(all_of)[1]))
        return float(each[len(each) // _WRONG :].sum())

    best = max((np.repeat([place, turn], 3) for place in _PLACES[::4] for turn in _TURNS[::4]), key=likely)
    for _ in range(_ROUNDS):
        for axis in range(6):
            tried = np.tile(best, (len(_PLACES), 1))
            tried[:, axis] = _PLACES if axis < 3 else _TURNS
            best = max((best, *tried), key=likely)
    return float(best[:3].max()), float(best[3:].max())
