# SPDX-License-Identifier: BSD-3-Clause
"""Measurements in the frames of sensors, and transforms between frames, as arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree.base.scan import Scan
from ndtree.live.corrections import Correction, Motion
from ndtree.live.figures import LiveFigures
from ndtree.live.intake import PosedIntake, Times, Verdict, motion_in
from ndtree.live.queue import Entry
from ndtree.logs.poses.following import FollowedTree
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.transforms import TransformTree, is_transform
from ndtree.logs.ros.messages.beams import Beams
from ndtree.logs.ros.messages.sweep import in_map
from ndtree.tuning.config import Config


@dataclass(frozen=True)
class Transform:
    """``T_parent_child`` at a time [s], or with no stamp at all times.

    Raises ValueError if a number is not finite, or the quaternion not of length 1.
    """

    parent: str
    child: str
    position: ArrayLike
    quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0)
    stamp: float | None = None

    def __post_init__(self) -> None:
        name = f"transform from {self.parent} to {self.child}"
        if np.shape(self.position) != (3,) or np.shape(self.quaternion) != (4,):
            raise ValueError(
                f"{name}: position and quaternion have shapes {np.shape(self.position)} and "
                f"{np.shape(self.quaternion)}: must be (3,) and (4,)"
            )
        if not is_transform(self.position, self.quaternion):
            raise ValueError(
                f"{name}: position {self.position}, quaternion {self.quaternion}: must be finite, and the "
                "quaternion x, y, z, w of length 1"
            )
        if self.stamp is not None and not math.isfinite(self.stamp):
            raise ValueError(f"{name}: stamp = {self.stamp} s: must be finite")


@dataclass(frozen=True, eq=False)
class Reading:
    """What a sensor measured, in its own frame.

    `points` (n, 3) or (n, 2): End points [m]; NaN says nothing.
    `stamp`: Time of the reading [s].
    `frame`: Of the sensor.
    `returned` (n,): False where nothing was hit up to the end point.
    `times` (n,): When each beam was measured, from the stamp on [s], of a sensor that moves meanwhile.
    """

    points: ArrayLike
    stamp: float
    frame: str
    returned: ArrayLike | None = None
    times: ArrayLike | None = None

    def beams(self) -> Beams:
        """As arrays; ValueError if shapes do not fit together."""
        points = np.asarray(self.points)
        points = points if points.dtype == np.float32 else np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] not in (2, 3):
            raise ValueError(f"points has shape {points.shape}: must be (n, 3) or (n, 2)")
        if not math.isfinite(self.stamp):
            raise ValueError(f"stamp = {self.stamp} s: must be finite")
        n = len(points)
        points = np.concatenate([points, np.zeros((n, 3 - points.shape[1]), points.dtype)], axis=1)
        returned = None if self.returned is None else np.asarray(self.returned, dtype=bool)
        times = None if self.times is None else np.asarray(self.times, dtype=np.float64)
        for name, values in (("returned", returned), ("times", times)):
            if values is not None and values.shape != (n,):
                raise ValueError(f"{name} has shape {values.shape}: must be ({n},) for {n} points")
        if times is not None and not np.isfinite(times).all():
            raise ValueError("times: must be finite")
        return Beams(points, returned, times)


class FramesIntake(PosedIntake):
    """Takes `Reading` and `Transform`, and of a mapper that follows corrections `Correction`.

    Parameters
    ----------
    config : Config
    dim : int
        Of the map; 2 for lasers in a level plane, whose height is then left out.
    fixed_frame : str
        Of the map.
    """

    def __init__(self, config: Config, dim: int, fixed_frame: str = "map") -> None:
        super().__init__()
        self.config, self.dim, self._fixed_frame = config, dim, fixed_frame
        self._tree = FollowedTree(TransformTree())
        self._entry: Entry | None = None
        self._beams: Beams | None = None

    def is_pose(self, item: Any) -> bool:
        return isinstance(item, (Transform, Correction))

    def pose(self, item: Any, figures: LiveFigures) -> None:
        if isinstance(item, Correction):
            self._corrections.append(item)
            return
        if item.stamp is None:
            pose = Pose.from_quaternion(item.position, item.quaternion)
            self._tree.tree.add_fixed(item.parent, item.child, pose)
            return
        self._tree.add(item.parent, item.child, item.stamp, item.position, item.quaternion)
        figures.late_poses = self._tree.late

    def motion(self) -> Motion | None:
        assert self._entry is not None
        reading = self._entry.item
        return motion_in(self._tree.tree, self._fixed_frame, reading.frame, reading.stamp)

    def scan(self, entry: Entry, give_up: bool, figures: LiveFigures) -> Scan | Verdict:
        reading = entry.item
        if not isinstance(reading, Reading):
            raise TypeError(f"found {type(reading).__name__}, expected Reading or Transform")
        if entry is not self._entry:
            self._entry = entry
            try:
                self._beams = reading.beams()
            except ValueError:
                figures.leave_out("damaged readings")
                return Verdict.left_out
        beams = self._beams
        assert beams is not None
        has_times = beams.times is not None and len(beams.times) > 0
        last = reading.stamp + (float(np.max(beams.times)) if has_times else 0.0)  # type: ignore[arg-type]
        until = self._tree.until(self._fixed_frame, reading.frame)
        if until == -math.inf and give_up:
            figures.leave_out("readings in unknown frames")
            return Verdict.left_out

        def place() -> Scan:
            self._tree.asked(last)
            ends, origins = in_map(self._tree.tree, self._fixed_frame, reading.frame, beams, reading.stamp)
            return Scan(ends[:, : self.dim], origins[..., : self.dim], beams.returned, reading.stamp)

        return self._posed(reading.frame, Times(reading.stamp, last, until), give_up, place, figures)
