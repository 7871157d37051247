# SPDX-License-Identifier: BSD-3-Clause
"""A laser in the simulated office, by its own poses, by odometry that drifts, and a SLAM's path of it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from bags import START, Messages, write_bag

import ndtree


def yaw(angle: float) -> list[float]:
    return [0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)]


def office(n: int) -> list[tuple[float, np.ndarray, float, np.ndarray, np.ndarray]]:
    """Stamp, place and heading of a laser, and its beams in its own frame."""
    rows = []
    for i, scan in enumerate(ndtree.simulate("office", scans=n)):
        way = scan.endpoints - scan.origin
        turn = 0.07 * i
        back = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        returned = np.ones(len(way), bool) if scan.returned is None else scan.returned
        rows.append((START + 0.1 * i, np.array(scan.origin), turn, way @ back.T, returned))
    return rows


def drifted(i: int, place: np.ndarray, turn: float) -> tuple[np.ndarray, float]:
    """What odometry makes of a pose, which drifts."""
    angle = 0.004 * i
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * place[0] - s * place[1] + 0.01 * i, s * place[0] + c * place[1]]), turn + angle


def bag_of(
    folder: Path,
    poses: Any,
    rows: Any,
    paths: dict[int, Any],
    kind: str = "ros2",
    *,
    fixed_frame: str = "map",
    mount: tuple[float, float, float] = (0.2, 0.1, 0.3),
) -> Path:
    """A recording of a laser whose tf are some poses; `paths` are published after some scans."""
    make: Messages = Messages(kind)
    content: list[tuple[str, float, Any]] = []
    content.append(make.fixed(START - 1, "base", "laser", [*mount[:2], 0.3], yaw(mount[2])))
    for i, ((stamp, _, _, beams, returned), (place, turn)) in enumerate(zip(rows, poses)):
        moved = make.transform(stamp, fixed_frame, "base", [*place, 0.0], yaw(turn))
        ranges = np.hypot(*beams.T)
        ranges[~returned] = np.inf
        angles = np.unwrap(np.arctan2(beams[:, 1], beams[:, 0]))
        step = float(angles[-1] - angles[0]) / (len(angles) - 1)
        laser = make.laser(
            stamp, "laser", ranges, angle_min=float(angles[0]), angle_increment=step, range_max=30.0
        )
        content += [("/tf", stamp, make.tf(moved)), ("/scan", stamp + 0.001, laser)]
        if i in paths:
            content.append(("/slam/path", stamp + 0.002, paths[i](make)))
    return write_bag(folder, make, content)


def path_message(rows: Any, poses: Any, upto: int) -> Any:
    def made(make: Messages) -> Any:
        stamped = []
        for i in range(upto + 1):
            pose = make.pose((*poses[i][0], 0.0), yaw(poses[i][1]))
            header = make.header(rows[i][0], "map")
            stamped.append(make.of("geometry_msgs/msg/PoseStamped", header=header, pose=pose))
        return make.of("nav_msgs/msg/Path", header=make.header(rows[upto][0], "map"), poses=stamped)

    return made
