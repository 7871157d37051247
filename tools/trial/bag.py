# SPDX-License-Identifier: BSD-3-Clause
"""Recordings as ROS 1 bags: readings as sensors say them, transforms as they come."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import ndtree
from trial.command import run
from trial.outcome import Outcome
from trial.robots import Recording, planar
from trial.scene import Floats

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "python"))

from bags import Messages, changed, write_bag

_BEGIN = 1_700_000_000.0  # Of the first scan [s].


def write(
    r: Recording,
    path: Path,
    readings: Floats,
    transforms: list[tuple[float, float, Floats]] | None = None,
    *,
    hung: bool = False,
) -> Path:
    """Write a bag.

    Parameters
    ----------
    readings : (s, n)
        As the sensor says them; r.ranges has inf for no echo.
    transforms : list of (stamp, received, pose)
        Of the robot in the frame of odometry [s]; by default those of the scans, 10 ms before each.
    hung : bool
        The laser hangs upside down; readings go from right to left, seen from above.
    """
    make = Messages("ros1")

    def transform(stamp: float, parent: str, child: str, pose: Floats) -> object:
        x, y, yaw = pose
        turn = (0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
        return make.tf(make.transform(_BEGIN + stamp, parent, child, (x, y, 0.0), turn))

    poses = planar(r.told)
    angles = -r.sensor.angles[::-1] if hung else r.sensor.angles
    if transforms is None:
        transforms = [(stamp, stamp - 0.01, pose) for stamp, pose in zip(r.stamps, poses)]
    entries = [
        ("/tf", _BEGIN + received, transform(stamp, "odom", "base_link", pose))
        for stamp, received, pose in transforms
    ]
    said = {"angle_min": float(angles[0]), "angle_max": float(angles[-1]), "range_min": 0.02}
    said.update(angle_increment=float(angles[1] - angles[0]), range_max=r.sensor.max_range)
    entries += [
        ("/scan", _BEGIN + stamp, make.laser(_BEGIN + stamp, "laser", readings[i], **said))
        for i, stamp in enumerate(r.stamps)
    ]
    entries.append(make.fixed(_BEGIN - 1.0, "base_link", "laser", (0, 0, 0), (hung, 0, 0, not hung)))
    return write_bag(path, make, sorted(entries, key=lambda entry: entry[1]))


def write_clouds(
    path: Path,
    clouds: list[tuple[float, Floats]],
    transforms: list[tuple[float, Floats, Floats]],
) -> Path:
    """Write a bag of clouds (n, 3) with their times, and of poses: their times, places and quaternions."""
    make = Messages("ros1")

    def cloud(stamp: float, points: Floats) -> object:
        whole = make.with_times(make.cloud(_BEGIN + stamp, "lidar", []), points, np.zeros(len(points), "f4"))
        return changed(whole, width=len(points), fields=whole.fields[:3])

    entries = [
        make.moved(_BEGIN + stamp, "odom", "base_link", place, turn, at=_BEGIN + stamp - 0.01)
        for stamp, place, turn in transforms
    ]
    entries += [("/points", _BEGIN + stamp, cloud(stamp, points)) for stamp, points in clouds]
    entries.append(make.fixed(_BEGIN - 1.0, "base_link", "lidar", (0, 0, 0)))
    return write_bag(path, make, sorted(entries, key=lambda entry: entry[1]))


def mapped(
    r: Recording,
    readings: Floats,
    outcome: Outcome,
    transforms: list[tuple[float, float, Floats]] | None = None,
    *,
    hung: bool = False,
) -> tuple[ndtree.OccupancyMap | None, dict[str, Any]]:
    """The map that ``ndtree map`` makes of a bag, None if it refuses, and what it chose.

    Doubts and refusals go to `outcome`.
    """
    with tempfile.TemporaryDirectory() as folder:
        log = write(r, Path(folder) / "log.bag", readings, transforms, hung=hung)
        done = run("map", log, "-o", Path(folder) / "m.ndt", "--json", Path(folder) / "f.json")
        outcome.words = done.doubts
        if done.status:
            outcome.refused = done.error
            return None, {}
        return ndtree.load(Path(folder) / "m.ndt"), done.figures.get("chosen") or {}
