# SPDX-License-Identifier: BSD-3-Clause
"""Answers with an entry for each point, ray or cell."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from typing_extensions import Self


class Answers:
    """Arrays with an entry each; some have an axis of coordinates behind that of the entries."""

    _number: ClassVar[str]  # An array that has none.

    def __len__(self) -> int:
        """Number of entries on the first axis."""
        shape = self.shape
        if not shape:
            raise TypeError(f"{type(self).__name__}: is a single one, and has no length")
        return shape[0]

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the entries, without coordinates: (n,); () of a single one."""
        return np.shape(getattr(self, self._number))

    def __getitem__(self, which: Any) -> Self:
        """One by its number, or some by a mask, a slice or numbers: the same with fewer entries."""
        self._check(which)
        return type(self)(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    def __iter__(self) -> Iterator[Self]:
        """One after the other."""
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._said()})"

    def _said(self) -> str:
        """What they are, in few words."""
        raise NotImplementedError

    def _check(self, which: Any) -> None:
        if not self.shape:
            raise IndexError(f"{type(self).__name__}: is a single one, and has no entries")
        if isinstance(which, (int, np.integer)) and not -len(self) <= which < len(self):
            raise IndexError(f"{type(self).__name__}: entry {which}: there are {len(self)}")


@dataclass(frozen=True, eq=False, repr=False)
class Leaves(Answers):
    """The leaves of a map, one entry each, depth first.

    ``leaves[3]`` is one of them, ``leaves[leaves.state == 1]`` are some; ``len`` and iteration work.

    Attributes
    ----------
    lower : (n, dim) float64
        Lower corners [m].
    size : (n,) float64
        Edge lengths [m].
    log_odds : (n,) float32
        0 where unknown.
    probability : (n,) float32
        0.5 where unknown.
    hits, misses : (n,) uint32
        What the split test weighs: beams that ended in the leaf, and beams that passed through it. In fixed
        and "paper" maps these are counts, both halved whenever one would exceed 32767. In "evidence" maps
        they are a ratio and no census: of a dense scan only the sampled beams count; both are halved at 511,
        divided among children, added when siblings merge, and forgotten with the evidence.
        ``stats().updates`` counts beams.
    observed : (n,) bool
        At least one beam updated it.
    state : (n,) int8
        -1 unknown, 0 free, 1 occupied.
    disputed : (n,) bool
        At least two beams ended in it before at least twelve scans in a row all passed it, or the other way
        round; see `OccupancyMap.disputed`.
    thin : (n,) bool
        Free, but beams have ended in it again and again: it holds something thinner than itself. Of the cells
        that a column of a grid is made of, these count as occupied.
    """

    _number = "size"

    lower: NDArray[np.float64]
    size: NDArray[np.float64]
    log_odds: NDArray[np.float32]
    probability: NDArray[np.float32]
    hits: NDArray[np.uint32]
    misses: NDArray[np.uint32]
    observed: NDArray[np.bool_]
    state: NDArray[np.int8]
    disputed: NDArray[np.bool_]
    thin: NDArray[np.bool_]

    @property
    def center(self) -> NDArray[np.float64]:
        """(n, dim) float64 [m]."""
        return self.lower + 0.5 * np.asarray(self.size)[..., None]

    @property
    def disputed_fraction(self) -> float:
        """float: disputed part of the observed volume; nan where nothing was observed."""
        volume = np.atleast_1d(self.size).astype(np.float64) ** self.lower.shape[-1]
        observed = float(volume[np.atleast_1d(self.observed)].sum())
        return float(volume[np.atleast_1d(self.disputed)].sum()) / observed if observed else math.nan

    def _said(self) -> str:
        if not self.shape:
            state = {-1: "unknown", 0: "free", 1: "occupied"}[int(self.state)]
            return f"one {state} of {self.size:g} m at {_point(self.lower)}, p={self.probability:.3g}"
        unknown, free, occupied = (int(np.count_nonzero(self.state == state)) for state in (-1, 0, 1))
        sizes = f", {self.size.min():g} to {self.size.max():g} m" if len(self) else ""
        return f"{len(self)}: {free} free, {occupied} occupied, {unknown} unknown{sizes}"


@dataclass(frozen=True, eq=False, repr=False)
class NearestOccupied(Answers):
    """What is nearest to each of n points; indexed as `Leaves`.

    Attributes
    ----------
    distance : (n,) float64
        [m]; inf where there is nothing.
    point : (n, dim) float64
        [m]; nan where there is nothing.
    """

    _number = "distance"

    distance: NDArray[np.float64]
    point: NDArray[np.float64]

    def _said(self) -> str:
        if not self.shape:
            return f"distance={self.distance:g}, point={_point(self.point)}"
        return f"{_count(self.shape)}: {_spread(self.distance)}"


@dataclass(frozen=True, eq=False, repr=False)
class RayEnds(Answers):
    """What each of n rays ends at; indexed as `Leaves`.

    Attributes
    ----------
    distance : (n,) float64
        [m]; nan where nothing ends it.
    state : (n,) int8
        Of what ends it: -1 unknown, 1 occupied; 0 where nothing does.
    lower : (n, dim) float64
        Lower corner of the cell [m]; nan where there is none.
    size : (n,) float64
        Its edge [m]; nan where there is none.
    """

    _number = "distance"

    distance: NDArray[np.float64]
    state: NDArray[np.int8]
    lower: NDArray[np.float64]
    size: NDArray[np.float64]

    def _said(self) -> str:
        if not self.shape:
            return f"distance={self.distance:g}, state={self.state}, lower={_point(self.lower)}"
        occupied, unknown = (int(np.count_nonzero(self.state == state)) for state in (1, -1))
        return f"{_count(self.shape)}: {occupied} occupied, {unknown} unknown, {_spread(self.distance)}"


@dataclass(frozen=True, eq=False, repr=False)
class InformationGain(Answers):
    """What a scan from each of n poses is expected to see anew; indexed as `Leaves`.

    Attributes
    ----------
    volume : (n,) float64
        Of unknown space [m^dim].
    bits : (n,) float64
        What one more look at each smallest cell says about its hit rate, by the cell's Beta posterior.
    """

    _number = "volume"

    volume: NDArray[np.float64]
    bits: NDArray[np.float64]

    def _said(self) -> str:
        if not self.shape:
            return f"volume={self.volume:g}, bits={self.bits:g}"
        return f"{_count(self.shape)}: volume up to {self.volume.max(initial=0.0):g}"


@dataclass(frozen=True, eq=False, repr=False)
class Changes(Answers):
    """Regions whose state or cell has changed, one entry each; indexed as `Leaves`.

    Attributes
    ----------
    lower : (n, dim) float64
        Lower corners [m].
    size : (n,) float64
        Edge lengths [m].
    before : (n,) int8
        -1 unknown, 0 free, 1 occupied; of columns also 2, occupied in a cell larger than the smallest.
    after : (n,) int8
        The same, now.
    """

    _number = "size"

    lower: NDArray[np.float64]
    size: NDArray[np.float64]
    before: NDArray[np.int8]
    after: NDArray[np.int8]

    def _said(self) -> str:
        if not self.shape:
            return f"from {self.before} to {self.after}, {self.size:g} m at {_point(self.lower)}"
        return f"{len(self)} regions"


@dataclass(frozen=True, eq=False, repr=False)
class Frontier:
    """Free cells beside each other that border on unknown space.

    Attributes
    ----------
    center : (dim,) float64
        Mean of the border [m], which need not lie on it; see `goal`.
    direction : (dim,) float64
        Into the unknown, of length 1; 0 if it is on all sides alike.
    area : float
        Of the border: [m] in 2-D, [m2] in 3-D.
    cells : (k, dim) float64
        Lower corners of the cells [m].
    size : (k,) float64
        Their edges [m].
    """

    center: NDArray[np.float64]
    direction: NDArray[np.float64]
    area: float
    cells: NDArray[np.float64]
    size: NDArray[np.float64]

    @property
    def cell_centers(self) -> NDArray[np.float64]:
        """(k, dim) float64: centres of the cells [m]."""
        return self.cells + 0.5 * self.size[:, None]

    @property
    def goal(self) -> NDArray[np.float64]:
        """(dim,) float64: where to drive, the cell nearest to `center`, of several the lowest [m].

        `center` need not be on the border: of one that surrounds the robot it is where the robot is.
        """
        centers = self.cell_centers
        away = np.round(np.linalg.norm(centers - self.center, axis=1), 6)  # The order of cells is no reason.
        nearest: NDArray[np.float64] = centers[np.lexsort((*centers.T, away))[0]]
        return nearest

    def __len__(self) -> int:
        """Number of cells."""
        return len(self.size)

    def __repr__(self) -> str:
        return f"Frontier(center={_point(self.center)}, area={self.area:g}, cells={len(self)})"


def _point(point: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in point) + ")"


def _count(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def _spread(distances: NDArray[np.float64]) -> str:
    finite = distances[np.isfinite(distances)]
    return f"{finite.min():g} to {finite.max():g} m" if finite.size else "nothing in reach"
