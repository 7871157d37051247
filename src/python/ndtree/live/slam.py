# SPDX-License-Identifier: BSD-3-Clause
"""Where a planar laser is, from what it sees and odometry, in a map that is made meanwhile.

Strategy: `OnlineAlignment` places scans; `Corrections` maps them, and moves those that loops move. An earlier
drive is gone on with as soon as `Localizer` has found the sensor in its map.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree.alignment.online import OnlineAlignment
from ndtree.alignment.planar import Floats, between, composed, in_space, pose_of, seen_from
from ndtree.alignment.result import Alignment
from ndtree.alignment.sensor_scans import moved, pose_in_log
from ndtree.base.scan import Scan
from ndtree.live.corrections import Correction, Corrections, Motion
from ndtree.live.following import matrix_of
from ndtree.live.localizing import Localization, Localizer
from ndtree.live.session import Session
from ndtree.logs.poses.pose import Pose

#: Added to the covariance of where a drive goes on: the map of the earlier one is bent a little [m, m, rad].
_BENT = np.diag([0.1, 0.1, 0.02]) ** 2
#: What scans are called that come before the sensor was found in the earlier map.
NOT_FOUND = "not found in the saved map yet"


class Slam:
    """Makes the poses of a mapper's scans.

    `odometry`: Whether poses of scans say how the sensor moved; left out, what the mapper's intake says.
    `earlier`: A drive that is gone on with.
    `guess` (3,): Where the sensor is in the map of that: x, y [m] and yaw [rad]; else it is looked for
        everywhere.
    """

    def __init__(
        self,
        *,
        odometry: bool | None = None,
        earlier: Session | None = None,
        guess: ArrayLike | None = None,
    ) -> None:
        self._says = odometry
        self._earlier, self._guess = earlier, guess
        self._online: OnlineAlignment | None = None
        self._localizer: Localizer | None = None
        self._offset: Floats | None = None  # Of the earlier map to the frame of the odometry.
        self._motion: Motion | None = None
        self._located: Localization | None = None

    def begin(self, corrections: Corrections) -> None:
        """Begin with an empty map, or that of the earlier drive."""
        self._online = self._localizer = self._offset = self._motion = None
        if self._earlier is not None:
            max_range = self._earlier.options.get("max_range", math.inf)
            for motion, scan in self._earlier.scans():
                corrections.insert(scan, motion, max_range)
            self._localizer = Localizer(corrections.map, self._guess)

    @property
    def options(self) -> dict[str, float]:
        """Of the earlier map, and of how its scans were mapped."""
        return {} if self._earlier is None else self._earlier.options

    def forget(self) -> None:
        """Let no earlier drive be gone on with."""
        self._earlier = None

    def placed(self, scan: Scan, motion: Motion | None) -> Scan | None:
        """A scan where its sensor was in the map; None until that is found in the earlier one.

        `scan`: 2-D, in the frame of the odometry.
        `motion`: Of its sensor there; None where nothing moves, or poses are of the map alone.
        Raises ValueError if the scan is not 2-D, or nothing says where its sensor was.
        """
        if scan.dim != 2:
            raise ValueError(f"a scan is {scan.dim}-D, expected those of a planar laser")
        scan.require_sensor("slam")
        at = pose_in_log(scan)
        covariance = None
        if self._localizer is not None:
            covariance = self._found(scan, at)
            if covariance is None:
                return None
        if self._online is None:
            says = motion is not None if self._says is None else self._says
            earlier = None if self._earlier is None else self._earlier.drive
            self._online = OnlineAlignment(odometry=says, earlier=earlier)
        begun = scan if self._offset is None else moved(scan, composed(self._offset, at))
        pose = self._online.add(begun, covariance)
        self._note(scan.stamp, pose, at, motion)
        return moved(scan, pose)

    def _found(self, scan: Scan, at: Floats) -> Floats | None:
        """The covariance of where the sensor is in the earlier map, if it is found there."""
        assert self._localizer is not None
        ends = scan.returned_only().endpoints.astype(np.float64)
        found = self._localizer.track(seen_from(at, ends), at, scan.stamp)
        if found.is_lost:
            return None
        self._localizer, self._offset = None, pose_of(found.map_odometry)
        return found.covariance + _BENT

    def _note(self, stamp: float, pose: Floats, at: Floats, motion: Motion | None) -> None:
        assert self._online is not None
        number = float(len(self._online.track.poses) - 1)
        map_odometry = composed(pose, between(at, np.zeros(3)))
        sensor, body = Pose.planar(*pose), Pose.identity()
        if motion is not None:
            body = (Pose.planar(*map_odometry) @ motion.odometry).inverse() @ sensor
        self._motion = Motion(number, sensor, sensor, body)
        robot = (sensor @ body.inverse()).level()
        self._located = Localization(
            stamp,
            False,
            matrix_of(pose),
            robot.matrix(2),
            matrix_of(map_odometry),
            self._online.covariance,
            0.0,
            0.0,
        )

    def motion(self) -> Motion | None:
        """Of the last scan's sensor in the map; its stamp is the number of the scan."""
        return self._motion

    def located(self) -> Localization:
        """Where the robot was at the last scan."""
        assert self._located is not None
        return self._located

    def corrections(self) -> list[Correction]:
        """Poses of all scans, if those of earlier ones have changed since the last call."""
        poses = None if self._online is None else self._online.corrected()
        if poses is None:
            return []
        return [Correction(np.arange(len(poses)), *in_space(poses), of="sensor")]

    def finish(self) -> None:
        """Look for the last loops: nothing more comes."""
        if self._online is not None and self._online.track.poses:
            self._online.finish()

    @property
    def poses(self) -> Floats:
        """(n, 3) float64: x, y [m] and yaw [rad] of the sensors of all scans."""
        drive = self._drive()
        return np.zeros((0, 3)) if drive is None else np.array(drive.track.poses).reshape(-1, 3)

    @property
    def doubts(self) -> list[str]:
        """Why not to trust the poses; empty if no reason to doubt them."""
        if self._localizer is not None:
            return [f"{NOT_FOUND}: nothing is mapped"]
        return [] if self._state is None else list(self._state.doubts)

    @property
    def verdict(self) -> str:
        """Whether poses are to be trusted: "sure", "doubtful", or "too early" to tell."""
        return "doubtful" if self.doubts else "sure" if self._state is not None else "too early"

    def summary(self) -> str:
        """The verdict and its reasons, in one line."""
        said = {"sure": "no reason to doubt the poses", "too early": "too early to judge the poses"}
        return said.get(self.verdict) or f"poses are doubtful: {'; '.join(self.doubts)}"

    def figures(self) -> dict[str, Any]:
        """For a script: the verdict, and what it stands on."""
        found = {} if self._state is None else self._state.figures()
        found.pop("seconds", None)
        return {"verdict": self.verdict, **found, "doubts": self.doubts}

    @property
    def _state(self) -> Alignment | None:
        return None if self._online is None else self._online.state

    def _drive(self) -> Any:
        if self._online is not None:
            return self._online.drive()
        return None if self._earlier is None else self._earlier.drive

    def session(self, corrections: Corrections, options: dict[str, float]) -> Session:
        """What can be gone on with, mapped with these options; RuntimeError if nothing was placed."""
        drive = self._drive()
        if drive is None:
            raise RuntimeError("no scan was placed yet: there is nothing to go on with")
        return Session.of(drive, corrections, options)


def scans_beside(path: str | os.PathLike[str]) -> Path:
    """The file with the scans of a map in a file: office.scans.npz of office.ndt."""
    return Path(path).with_suffix(".scans.npz")
