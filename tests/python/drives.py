# SPDX-License-Identifier: BSD-3-Clause
"""Robots on made-up ways, for the bags of the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("scipy")

from bags import LEVEL, START, Messages, write_bag
from scipy.spatial import transform as spatial

from ndtree.logs import read

Rotation = spatial.Rotation


class Drive:
    """A robot on a winding way, with its transforms at 10 Hz and a sensor mounted on it."""

    def __init__(self, *, planar: bool, seed: int = 2, n: int = 25) -> None:
        generator = np.random.default_rng(seed)
        self.stamps = START + 0.1 * np.arange(n)
        self.positions = np.cumsum(generator.normal(0, 0.2, (n, 3)), axis=0)
        turns = generator.normal(0, 0.15, (n, 3))
        if planar:
            self.positions[:, 2] = 0.0
            turns[:, :2] = 0.0
        self.rotations = Rotation.from_rotvec(np.cumsum(turns, axis=0))
        self.mount_position = np.array([0.3, -0.1, 0.5])
        self.mount = Rotation.from_euler("z", 0.4) if planar else Rotation.random(random_state=seed)
        self.localised = np.array([3.0, -2.0, 0.0])

    def transforms(self, make: Messages, *, static: bool = True) -> list[tuple[str, float, Any]]:
        fixed = make.transform(START - 50, "base", "/sensor", self.mount_position, self.mount.as_quat())
        content = [("/tf_static", START - 50, make.tf(fixed))] if static else []
        for stamp, position, turn in zip(self.stamps, self.positions, self.rotations):
            moved = make.transform(stamp, "odom", "base", position, turn.as_quat())
            corrected = make.transform(stamp, "map", "odom", self.localised, LEVEL)
            content.append(("/tf", stamp, make.tf(moved, corrected)))
        return content

    def body(self, stamp: float) -> tuple[np.ndarray, Any]:
        """Where the robot is in the odometry's frame."""
        turn = spatial.Slerp(self.stamps - START, self.rotations)(stamp - START)
        position = [np.interp(stamp, self.stamps, self.positions[:, axis]) for axis in range(3)]
        return np.array(position), turn

    def sensor(self, stamp: float) -> tuple[np.ndarray, Any]:
        position, turn = self.body(stamp)
        return position + turn.apply(self.mount_position), turn * self.mount

    def in_map(self, stamp: float, points: np.ndarray) -> np.ndarray:
        position, turn = self.sensor(stamp)
        return turn.apply(points) + position + self.localised


SCAN_TIMES = START + np.array([0.0, 0.13, 0.77, 1.05, 2.4])


def laser_points(message: Any) -> np.ndarray:
    angles = [message.angle_min + i * message.angle_increment for i in range(len(message.ranges))]
    return np.array([[r * np.cos(a), r * np.sin(a), 0] for r, a in zip(message.ranges.astype(float), angles)])


def standing(make: Messages, topic: str, messages: list[Any], path: Path, **options: Any) -> list[Any]:
    """Scans of a sensor that stands in the map's origin."""
    content = [make.fixed(START, "map", "sensor", [0, 0, 0])]
    content += [(topic, START + 1 + i, message) for i, message in enumerate(messages)]
    return list(read(write_bag(path / "standing", make, content), **options))
