# SPDX-License-Identifier: BSD-3-Clause
"""What a live mapper costs per message, in processor time: a laser, a depth camera and a lidar in rooms.

    OPENBLAS_NUM_THREADS=1 python tools/bench/live.py [--scans 60]

Messages of ROS 2 are made once, as they are on the wire, and given to the mapper as fast as it takes them.
Times are those of the threads themselves, so that other work on the machine changes them little; medians.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "python"))

from bags import Messages

from ndtree.live import GridFollower, LiveMapper, MessagesIntake, play
from ndtree.live.passing import STAYS, Passing
from ndtree.logs.ros.storage import Connection, Raw
from ndtree.tuning.config import Config

MAKE = Messages("mcap")
BEGIN = 1000.0
Item = tuple[Raw, float]


def packed(topic: str, stamp: float, message: Any) -> Item:
    """A message as it is on the wire."""
    type_ = message.__msgtype__
    data = bytes(MAKE.store.serialize_cdr(message, type_))
    return Raw(Connection(0, topic, type_, "cdr"), round(stamp * 1e9), data), stamp


def ranges(ways: np.ndarray, origin: np.ndarray, box: np.ndarray) -> np.ndarray:
    """How far it is from inside a box to its walls."""
    with np.errstate(divide="ignore"):
        to = np.where(ways > 0, (box[1] - origin) / ways, (box[0] - origin) / ways)
    return np.where(ways == 0, np.inf, to).min(axis=1)


def turned(angle: float, axis: int) -> tuple[np.ndarray, list[float]]:
    """A rotation about y (1) or z (2), as a matrix and a quaternion."""
    c, s = math.cos(angle), math.sin(angle)
    quaternion = [0.0, 0.0, 0.0, math.cos(angle / 2)]
    quaternion[axis] = math.sin(angle / 2)
    if axis == 1:
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), quaternion
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), quaternion


def messages(kind: str, scans: int) -> list[Item]:
    """Of a sensor that drives and turns in a room, with its transforms."""
    generator = np.random.default_rng(0)
    rate, box = {
        "laser": (40, [[-8, -6, -1], [8, 6, 2]]),
        "camera": (30, [[-3, -1.5, -3], [3, 1.2, 3]]),
        "lidar": (10, [[-30, -12, -1.8], [30, 12, 6]]),
    }[kind]
    if kind == "laser":
        angles = np.linspace(-2.356, 2.356, 1081)
        ways = np.stack([np.cos(angles), np.sin(angles), np.zeros(1081)], axis=1)
    elif kind == "camera":
        v, u = np.mgrid[:480, :640]
        ways = np.stack([(u - 320) / 525, (v - 240) / 525, np.ones((480, 640))], axis=-1).reshape(-1, 3)
    else:
        up = np.linspace(-0.39, 0.39, 128)[:, None]
        around = np.linspace(-np.pi, np.pi, 1024, endpoint=False)[None]
        parts = np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up) + 0 * around
        ways = np.stack(parts, axis=-1).reshape(-1, 3)
    items = []
    for i in range(scans):
        t, stamp = i / rate, BEGIN + i / rate
        origin = np.array([1.5 * math.sin(0.3 * t), 0.5 * math.sin(0.2 * t), 0.0])
        matrix, quaternion = turned(0.2 * math.sin(0.5 * t), 1 if kind == "camera" else 2)
        length = ranges(ways @ matrix.T, origin, np.array(box))
        items.append(
            packed("/tf", stamp, MAKE.tf(MAKE.transform(stamp, "map", "sensor", origin, quaternion)))
        )
        if kind == "laser":
            length += generator.normal(0, 0.01, len(length))
            turn = {"angle_min": -2.356, "angle_increment": 4.712 / 1080, "range_max": 30.0}
            items.append(packed("/scan", stamp, MAKE.laser(stamp, "sensor", length, **turn)))
        elif kind == "camera":
            depths = 1000 * length * (1 + generator.normal(0, 0.003, len(length)))
            info = MAKE.camera_info(stamp, "sensor", (480, 640), (525.0, 525.0, 320.0, 240.0))
            items.append(packed("/info", stamp, info))
            image = depths.astype("u2").reshape(480, 640)
            items.append(packed("/depth", stamp, MAKE.image(stamp, "sensor", image, "16UC1")))
        else:
            points = ways * (length + generator.normal(0, 0.02, len(length)))[:, None]
            rows = np.zeros((len(points), 4), dtype="f4")
            rows[:, :3] = points
            cloud = MAKE.cloud(stamp, "sensor", np.zeros((0, 3)))
            cloud.height, cloud.width, cloud.row_step = 128, 1024, 16 * 1024
            cloud.data = rows.view("u1").ravel()
            items.append(packed("/points", stamp, cloud))
    return items


class Grid:
    """A sink that keeps a grid."""

    period = 0.0

    def __init__(self, took: list[float]) -> None:
        self._grid, self._took = GridFollower(None, (-1.0, 1.0)), took

    def update(self, m: Any, stamp: float) -> None:
        begin = time.thread_time()
        self._grid.follow(m)
        self._took.append(time.thread_time() - begin)


def timed(owner: Any, name: str, took: list[float]) -> None:
    """Note how long the thread takes for each call of a method."""
    method = getattr(owner, name)

    def call(*arguments: Any, **keywords: Any) -> Any:
        begin = time.thread_time()
        try:
            return method(*arguments, **keywords)
        finally:
            took.append(time.thread_time() - begin)

    setattr(owner, name, call)


def measured(kind: str, scans: int) -> dict[str, list[float]]:
    """Times of the parts of the work [s]."""
    options = {
        "laser": {"range_sigma": 0.02},
        "camera": {"range_sigma": 0.005, "range_sigma_quadratic": 0.0015},
        "lidar": {"range_sigma": 0.03, "min_cell_size": 0.1, "max_cell_size": 3.2},
    }[kind]
    took: dict[str, list[float]] = defaultdict(list)
    intake = MessagesIntake(kind, Config.of(**options, no_return="free"), look=0.5)
    timed(intake, "scan", took["read and placed"])
    passing = Passing(lambda: STAYS, lambda: (-1.0, 1.0))
    timed(passing, "note", took["what moves"])
    mapper = LiveMapper(intake, threads=1, sinks=[Grid(took["grid"])], passing=passing)
    timed(mapper._target, "_inserted", took["inserted"])
    with mapper:
        play(messages(kind, scans), mapper, rate=0)
    assert mapper.figures.is_complete and mapper.figures.mapped == scans
    return took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scans", type=int, default=60)
    scans = parser.parse_args().scans
    for kind in ("laser", "camera", "lidar"):
        for what, took in measured(kind, scans).items():
            some = 1e3 * np.array(took[len(took) // 4 :])
            low, middle, high = np.quantile(some, (0.1, 0.5, 0.9))
            print(f"{kind:7} {what:16} {middle:7.2f} ms  (80 % from {low:.2f} to {high:.2f})")


if __name__ == "__main__":
    main()
