# SPDX-License-Identifier: BSD-3-Clause
"""Answers of counts and numbers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class MapStats:
    """The size of a map, and what happened to it since it was made.

    Attributes
    ----------
    leaves : int
        All leaves, unknown space included.
    observed_leaves : int
        Leaves that at least one beam updated: the cells that results count.
    nodes : int
        Leaves and inner nodes.
    scans : int
        Scans inserted; the number of the next one. 0 for OctoMap.
    updates, splits, merges : int
        As in `InsertReport`, over the map's life.
    memory_bytes : int
        Bytes that the map holds, used or not.
    pruned_leaves : int or None
        Leaves after OctoMap's prune(); None for our own maps.
    """

    leaves: int
    observed_leaves: int
    nodes: int
    scans: int
    updates: int
    splits: int
    merges: int
    memory_bytes: int
    pruned_leaves: int | None


@dataclass(frozen=True)
class InsertReport:
    """What one call of insert() did.

    Attributes
    ----------
    beams : int
        All beams of the call: the sum of the next four.
    returned : int
        Beams with a surface at the end point.
    not_returned : int
        Beams that found free space only.
    beyond_max_range : int
        Beams that returned from beyond max_range: free space up to there.
    invalid : int
        Beams not finite or of zero length: skipped.
    updates : int
        (beam, leaf) pairs that were added. Fixed maps and the paper's count all; others count the beams that
        a cell sampled, if the scan changed it, and at most scan_beams where all passed.
    splits : int
        Leaves that were split.
    merges : int
        Parents that took the place of their children.
    seconds : float
        Wall time of the insertion itself [s].
    moved : (n,) float32, or None
        Where ``insert(moved=True)`` asked for it: of each point the probability that it returned from what
        moves, by the map as it was before the call; in the shape of the points.
    """

    beams: int
    returned: int
    not_returned: int
    beyond_max_range: int
    invalid: int
    updates: int
    splits: int
    merges: int
    seconds: float
    moved: NDArray[np.float32] | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True)
class CompressReport:
    """What compress() did.

    Attributes
    ----------
    leaves_before, leaves : int
        Observed leaves before and after.
    bytes_before, bytes : int
        Bytes that the map held before and after.
    merges : int
        Parents that took the place of their children.
    loss : float
        Information lost [bits].
    """

    leaves_before: int
    leaves: int
    bytes_before: int
    bytes: int
    merges: int
    loss: float


@dataclass(frozen=True)
class HistoryReport:
    """What a change of poses cost.

    Attributes
    ----------
    moved : int
        Scans whose poses changed, or that were removed.
    replayed : int
        Scans that were mapped again, in some cubes.
    cubes : int
        Cubes of max_cell_size that were made anew.
    cube_scans, all_cube_scans : int
        Pairs of a scan and a cube that it crosses: that were mapped again, and all of them.
    seconds : float
        Wall time [s].
    """

    moved: int
    replayed: int
    cubes: int
    cube_scans: int
    all_cube_scans: int
    seconds: float


@dataclass(frozen=True)
class Claims:
    """How much of the space that scans saw, or did not see, a map calls free, occupied or unknown.

    Counts of points that were drawn uniformly, so that shares of them are shares of volume.

    Attributes
    ----------
    points : int
        All.
    seen : int
        Points that some scan saw.
    free : int
        Points that the map calls free.
    free_and_unseen : int
        Points that the map calls free, but no scan saw.
    unknown_and_seen : int
        Points that a scan saw, but the map calls unknown.
    free_unseen : float
        Of the space called free, the share in [0, 1] that was not seen; nan of none.
    seen_unknown : float
        Of the space seen, the share in [0, 1] that is called unknown; nan of none.
    wrong_volume : float
        Both volumes over the volume seen; may exceed 1; nan if nothing was seen.
    """

    points: int
    seen: int
    free: int
    free_and_unseen: int
    unknown_and_seen: int
    free_unseen: float
    seen_unknown: float
    wrong_volume: float


@dataclass(frozen=True)
class NoReturns:
    """What beams without return say in a log.

    `choice` ({"free", "ignore"}): Free space, or nothing.
    `expected`: The share that would if they were right: beams that returned cross surfaces as well, by errors
        of poses and by what moves.
    """

    choice: str
    beams: int  # Beams without return that tell whether they are right.
    crossing: float  # The share of them that crosses surfaces which other scans found.
    expected: float
    share: float  # Of beams without return among all.
    surfaces: int  # Pieces of surface that beams had to meet again.
    erased: float  # The share of them from which fewer beams returned than did not.
    are_judged: bool  # Whether enough of them could be checked.
    text: str  # What was chosen and why, in one line.

    def __str__(self) -> str:
        """What was chosen and why, in one line."""
        is_unknown = self.choice == "ignore" and self.share > 0
        return self.text + ("; what they alone crossed stays unknown" if is_unknown else "")


_NEARLY = 0.9  # A pose that explains so much of what the best does is another explanation.


@dataclass(frozen=True, eq=False, repr=False)
class Match:
    """The pose of a scan that was found.

    Attributes
    ----------
    pose : (dim + 1, dim + 1) float64
        Of the sensor in the map.
    covariance : (3, 3) or (6, 6) float64
        Of x, y, yaw, or of x, y, z, roll, pitch, yaw, along and about the map's axes [m, rad].
    score : float
        Mean likelihood of the end points at the best pose of the window's grid, 0 to 1.
    second : float
        The same of the best pose elsewhere in the window; 0 if there is none, or it was not looked for.
    inliers : float
        Fraction of the points that lie on a surface at the refined pose.
    """

    pose: NDArray[np.float64]
    covariance: NDArray[np.float64]
    score: float
    second: float
    inliers: float

    @property
    def is_unique(self) -> bool:
        """bool: whether no other pose of the window explains the scan nearly (nine tenths) as well."""
        return self.score > 0 and self.second < _NEARLY * self.score

    def __repr__(self) -> str:
        place = ", ".join(f"{x:.3f}" for x in self.pose[:-1, -1])
        others = "unique" if self.is_unique else f"second={self.second:.2f}"
        return f"Match(at ({place}), score={self.score:.2f}, {others}, inliers={self.inliers:.2f})"


@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """A path from a start to a goal; true if one was found.

    Attributes
    ----------
    points : (n, dim) float64
        From start to goal [m], straight between them; (0, dim) without one. Of a body that turns (n, 3): x, y
        [m] and yaw [rad], not wrapped; between two of them it moves or turns, not both.
    status : {"found", "none", "out of time"}
        Whether there is one; or the search had no time left.
    reason : str
        Why there is none, and whether that is proved; empty if there is one.
    length : float
        [m]; inf without one.
    clearance : float
        Least distance of the body to an obstacle on the way [m]; nan without one.
    expanded : int
        Cells that the search looked at.
    """

    points: NDArray[np.float64]
    status: Literal["found", "none", "out of time"]
    reason: str
    length: float
    clearance: float
    expanded: int

    def __bool__(self) -> bool:
        return self.status == "found"

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        if not self:
            return f"Path({self.status}: {self.reason})"
        return f"Path({len(self)} points, {self.length:.3f} m, clearance {self.clearance:.3f} m)"
