# SPDX-License-Identifier: BSD-3-Clause
"""What is far from the sensor, or was not seen for some seconds, becomes unknown again.

Strategy of fading: a cube of the map's largest cells is seen when a beam passes it or ends in it, and a table
keeps when that was last so. From time to time, cubes that were not seen for too long are cleared. A cube that
holds something and is not in the table yet, as of a map that was loaded, counts as seen then. So the map
depends on scans, their stamps and their order alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree._errors import WrongValue
from ndtree._native._core import AdaptiveMap, OccupancyMap
from ndtree.base.scan import Scan
from ndtree.live.way import last_origin
from ndtree.logs.poses.following import FALL

#: It is looked for cubes to forget after this part of the time that they are kept.
LOOKS = 0.1
#: Beams of a scan that are followed at most, others the next time; where they end is seen by all.
MOST_BEAMS = 512
#: Smallest cells along a cube's edge in a map whose cells have one size.
FIXED_CELLS = 16

Keys = NDArray[np.int64]
#: A window follows when the sensor has moved by this share of its radius.
FOLLOWS = 0.05


class Window:
    """Keeps what is within a radius of the sensor.

    `radius`: Cells farther than that from where the sensor is are forgotten [m]; those that it sees beyond
        are forgotten with the next step of the window, after at most 5 % of the radius.
    Raises ValueError if it is not > 0 and finite.
    """

    def __init__(self, radius: float) -> None:
        if not 0 < radius < math.inf:
            raise WrongValue.of("window", f"{radius:g} m", "> 0 and finite")
        self.radius = radius
        self.begin()

    def begin(self) -> None:
        """Begin with an empty map."""
        self._center: np.ndarray | None = None

    def moved(self, m: OccupancyMap, scan: Scan) -> None:
        """Forget what is far from a scan's sensor, if that has moved enough."""
        center = last_origin(scan)
        if center is None:
            return
        if self._center is None or np.linalg.norm(center - self._center) >= FOLLOWS * self.radius:
            self._center = center
            m.keep_near(center, self.radius)


class Fading:
    """Forgets what no beam has crossed for a time.

    `seconds`: By the stamps of scans: a cube of the largest cells that was not seen for longer is unknown
        again, after at most a tenth of this more.
    `box` (2, dim): Only cubes whose centre is in this box fade [m]; else all.
    Raises ValueError if the time is not > 0 and finite, or the box has no volume.
    """

    def __init__(self, seconds: float, box: ArrayLike | None = None) -> None:
        if not 0 < seconds < math.inf:
            raise ValueError(f"fade = {seconds:g} s: must be > 0 and finite")
        self.seconds = seconds
        self._box = None if box is None else np.asarray(box, dtype=np.float64)
        if self._box is not None and not (
            self._box.ndim == 2 and len(self._box) == 2 and (self._box[0] < self._box[1]).all()
        ):
            raise WrongValue.of("box", self._box.tolist(), "two corners, the lower one first")
        self.begin()

    def begin(self) -> None:
        """Begin with an empty map."""
        self._keys: Keys = np.zeros(0, np.int64)
        self._last = np.zeros(0)
        self._newest = self._looked = -math.inf
        self._scans = 0

    def follow(self, m: OccupancyMap, scan: Scan, max_range: float = math.inf) -> int:
        """Forget what has faded by the time of a scan that was mapped.

        `scan`: As it was mapped.
        `max_range`: As for `OccupancyMap.insert` [m].
        Returns int: Cubes that were cleared.
        """
        if self._box is not None and self._box.shape[1] != m.dim:
            raise ValueError(f"box has shape {self._box.shape}: must be (2, {m.dim}) for a {m.dim}-D map")
        now = scan.stamp
        if now < self._newest - FALL:  # The clock has begun again.
            self._last[:] = self._looked = now
            self._newest = now
        self._newest = max(self._newest, now)
        self._scans += 1
        edge = m.max_cell_size if isinstance(m, AdaptiveMap) else FIXED_CELLS * m.min_cell_size
        self._see(_keys_of(_points_in_cubes(scan, max_range, edge, self._scans), edge, m.dim), self._newest)
        if self._newest - self._looked < LOOKS * self.seconds:
            return 0
        self._looked = self._newest
        return self._forget(m, edge)

    def _see(self, keys: Keys, stamp: float) -> None:
        at = np.searchsorted(self._keys, keys)
        known = np.zeros(len(keys), dtype=bool)
        inside = at < len(self._keys)
        known[inside] = self._keys[at[inside]] == keys[inside]
        self._last[at[known]] = stamp
        self._keys = np.insert(self._keys, at[~known], keys[~known])
        self._last = np.insert(self._last, at[~known], stamp)

    def _forget(self, m: OccupancyMap, edge: float) -> int:
        leaves = m.leaves()
        held = _keys_of(leaves.center[leaves.observed], edge, m.dim)
        self._see(held[~np.isin(held, self._keys)], self._newest)
        is_old = self._last < self._newest - self.seconds
        cleared = 0
        for lower in _lowest(self._keys[is_old], m.dim) * edge:
            center = lower + 0.5 * edge
            if self._box is None or ((center >= self._box[0]) & (center <= self._box[1])).all():
                m.clear(np.stack([lower, lower + edge]))
                cleared += 1
        self._keys, self._last = self._keys[~is_old], self._last[~is_old]
        return cleared


def _points_in_cubes(scan: Scan, max_range: float, edge: float, number: int) -> NDArray[np.float64]:
    """A point in each cube that some beams cross, and all end points; of other beams with each number."""
    ends = np.asarray(scan.endpoints, dtype=np.float64)
    origins = np.broadcast_to(np.asarray(scan.origin, dtype=np.float64), ends.shape)
    is_finite = np.isfinite(ends).all(axis=1) & np.isfinite(origins).all(axis=1)
    ends, origins = ends[is_finite], origins[is_finite]
    ways = ends - origins
    lengths = np.linalg.norm(ways, axis=1)
    ways = ways * np.minimum(1.0, max_range / np.maximum(lengths, 1e-9))[:, None]
    ends = origins + ways
    stride = -(-len(ends) // MOST_BEAMS) or 1
    origins, ways = origins[number % stride :: stride], ways[number % stride :: stride]
    n = len(ways)
    beams = [np.arange(n), np.arange(n)]
    times = [np.zeros(n), np.ones(n)]
    for axis in range(scan.dim):  # Where beams cross borders of cubes, from 0 at the origin to 1 at the end.
        start, way = origins[:, axis] / edge, ways[:, axis] / edge
        first, last = np.floor(start), np.floor(start + way)
        counts = np.abs(last - first).astype(int)
        beam = np.repeat(np.arange(n), counts)
        step = np.arange(len(beam)) - np.repeat(np.cumsum(counts) - counts, counts)
        border = np.minimum(first, last)[beam] + 1 + step
        beams.append(beam)
        times.append((border - start[beam]) / way[beam])
    beam, time = np.concatenate(beams), np.clip(np.concatenate(times), 0.0, 1.0)
    order = np.lexsort((time, beam))
    beam, time = beam[order], time[order]
    middle = 0.5 * (time[:-1] + time[1:])[beam[:-1] == beam[1:]]
    beam = beam[:-1][beam[:-1] == beam[1:]]
    return np.concatenate([origins[beam] + middle[:, None] * ways[beam], ends])


def _bits(dim: int) -> int:
    """Of one coordinate in a key."""
    return 62 // dim


def _keys_of(points: NDArray[np.float64], edge: float, dim: int) -> Keys:
    """Keys of the cubes that points are in, each once, in their order."""
    bits = _bits(dim)
    cubes = np.clip(np.floor(points / edge).astype(np.int64) + (1 << (bits - 1)), 0, (1 << bits) - 1)
    keys = np.zeros(len(points), dtype=np.int64)
    for axis in range(dim):
        keys = (keys << bits) | cubes[:, axis]
    return np.unique(keys)


def _lowest(keys: Keys, dim: int) -> NDArray[np.int64]:
    """The lowest corners of cubes [edges]."""
    bits = _bits(dim)
    corners = [(keys >> (bits * (dim - 1 - axis))) & ((1 << bits) - 1) for axis in range(dim)]
    return np.stack(corners, axis=1) - (1 << (bits - 1))
