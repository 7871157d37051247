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
from trial.robots import Recording, tilted
from trial.scene import Floats

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "python"))

from bags import Messages, changed, write_bag

_BEGIN = 1_700_000_000.0  # Of the first scan [s].
LEFT_OUT = -1.0  # A reading that a cloud does not have; of a depth image, it is 0.
_LENS = (-0.5, 0.5, -0.5, 0.5)  # Turns a camera's axes, z forward and x to the right, to its robot's.


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
        As the sensor says them; r.ranges has inf for no echo. Clouds, of lidars, or images, of cameras.
    transforms : list of (stamp, received, pose)
        Of the robot in the frame of odometry [s], as x, y, yaw and in space z, pitch; by default those of the
        scans, 10 ms before each.
    hung : bool
        The laser hangs upside down; readings go from right to left, seen from above.
    """
    make = Messages("ros1")

    def transform(stamp: float, parent: str, child: str, pose: Floats) -> object:
        x, y, yaw, z, pitch = (*pose, 0.0, 0.0)[:5]
        a, b, c, d = np.sin(yaw / 2), np.cos(yaw / 2), np.sin(pitch / 2), np.cos(pitch / 2)
        turn = (-a * c, b * c, a * d, b * d)
        return make.tf(make.transform(_BEGIN + stamp, parent, child, (x, y, z), turn))

    poses = tilted(r.told)[:, : 3 if r.dim == 2 else 5]
    if transforms is None:
        transforms = [(stamp, stamp - 0.01, pose) for stamp, pose in zip(r.stamps, poses)]
    entries = [
        ("/tf", _BEGIN + received, transform(stamp, "odom", "base_link", pose))
        for stamp, received, pose in transforms
    ]
    message = {"laser": _laser, "depth": _image}.get(r.sensor.name, _cloud)
    way = bool(np.isfinite(readings).all()) if message is _image else hung
    for stamp, reading in zip(r.stamps, readings):
        entries += [(topic, _BEGIN + stamp, one) for topic, one in message(make, stamp, r, reading, way)]
    seat = _LENS if message is _image else (hung, 0, 0, not hung)
    entries.append(make.fixed(_BEGIN - 1.0, "base_link", "sensor", (0, 0, 0), seat))
    return write_bag(path, make, sorted(entries, key=lambda entry: entry[1]))


_Entries = list[tuple[str, Any]]


def _laser(make: Messages, stamp: float, r: Recording, reading: Floats, hung: bool) -> _Entries:
    angles = -r.sensor.angles[::-1] if hung else r.sensor.angles
    said = {"angle_min": float(angles[0]), "angle_max": float(angles[-1]), "range_min": 0.02}
    said.update(angle_increment=float(angles[1] - angles[0]), range_max=r.sensor.max_range)
    return [("/scan", make.laser(_BEGIN + stamp, "sensor", reading, **said))]


def _cloud(make: Messages, stamp: float, r: Recording, reading: Floats, _: bool) -> _Entries:
    kept = reading != LEFT_OUT
    with np.errstate(invalid="ignore"):  # 0 times infinity.
        points = r.sensor.directions[kept] * reading[kept, None]
    return [("/points", _cloud_of(make, stamp, "sensor", points))]


def _image(make: Messages, stamp: float, r: Recording, reading: Floats, is_whole: bool) -> _Entries:
    """In millimetres where all pixels of the recording are numbers, else in metres."""
    ways = r.sensor.directions / r.sensor.directions[:, :1]
    shape = [len(np.unique(ways[:, k].round(9))) for k in (2, 1)]
    depth = (np.maximum(reading, 0.0) * r.sensor.directions[:, 0]).reshape(shape)
    values = np.rint(1000 * depth) if is_whole else depth
    (fx, cx), (fy, cy) = (
        (n - 1) / (2 * np.abs(ways[:, k]).max()) * np.r_[1, 0] + [0, (n - 1) / 2]
        for k, n in ((1, shape[1]), (2, shape[0]))
    )
    said, name = (_BEGIN + stamp, "sensor"), "/camera/depth"
    return [
        (f"{name}/camera_info", make.camera_info(*said, (shape[0], shape[1]), (fx, fy, cx, cy))),
        (f"{name}/image_raw", make.image(*said, values, "16UC1" if is_whole else "32FC1")),
    ]


def _cloud_of(make: Messages, stamp: float, frame: str, points: Floats) -> Any:
    whole = make.with_times(make.cloud(_BEGIN + stamp, frame, []), points, np.zeros(len(points), "f4"))
    return changed(whole, width=len(points), fields=whole.fields[:3])


def write_clouds(
    path: Path,
    clouds: list[tuple[float, Floats]],
    transforms: list[tuple[float, Floats, Floats]],
) -> Path:
    """Write a bag of clouds (n, 3) with their times, and of poses: their times, places and quaternions."""
    make = Messages("ros1")
    entries = [
        make.moved(_BEGIN + stamp, "odom", "base_link", place, turn, at=_BEGIN + stamp - 0.01)
        for stamp, place, turn in transforms
    ]
    entries += [
        ("/points", _BEGIN + stamp, _cloud_of(make, stamp, "lidar", points)) for stamp, points in clouds
    ]
    entries.append(make.fixed(_BEGIN - 1.0, "base_link", "lidar", (0, 0, 0)))
    return write_bag(path, make, sorted(entries, key=lambda entry: entry[1]))


def mapped(
    r: Recording,
    readings: Floats,
    outcome: Outcome,
    transforms: list[tuple[float, float, Floats]] | None = None,
    *,
    hung: bool = False,
    cell: float | None = None,
) -> tuple[ndtree.OccupancyMap | None, dict[str, Any]]:
    """The map that ``ndtree map`` makes of a bag, None if it refuses, and what it chose.

    Doubts and refusals go to `outcome`.
    """
    with tempfile.TemporaryDirectory() as folder:
        log = write(r, Path(folder) / "log.bag", readings, transforms, hung=hung)
        size = ["--min-cell-size", cell] if cell else []
        done = run("map", log, "-o", Path(folder) / "m.ndt", "--json", Path(folder) / "f.json", *size)
        outcome.words = done.doubts
        if done.status:
            outcome.refused = done.error
            return None, {}
        return ndtree.load(Path(folder) / "m.ndt"), done.figures.get("chosen") or {}
