# SPDX-License-Identifier: BSD-3-Clause
"""The nearest obstacles around a robot, as autopilots take them: MAVLink's OBSTACLE_DISTANCE, from ray casts.

Strategy: rays in level planes, so close beside and above each other that no smallest cell is between two of
them at the largest distance. A sector has the shortest of its rays.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree._errors import WrongValue
from ndtree._native import _core
from ndtree._native._core import OccupancyMap

#: Of the message: sectors, and their values where nothing is known [cm].
SECTORS, NOT_KNOWN = 72, 65535
#: The largest distance that fits, with the value above it that says that there is no obstacle [m].
FARTHEST = 655.33
#: MAV_FRAME_BODY_FRD: the first sector is ahead, the next ones are clockwise, seen from above.
BODY_FRD = 12

Unknown = Literal["tell", "free", "occupied"]


@dataclass(frozen=True, eq=False)
class ObstacleDistance:
    """What the message of this name holds.

    `distances` (72,) uint16: Of the nearest obstacle in each sector [cm]; `max_distance` + 1 where there is
        none, 65535 where that is unknown. The middle of the first sector is ahead.
    `min_distance`, `max_distance`: [cm]
    `increment_f`: From one sector to the next, clockwise [deg].
    `angle_offset`: Of the first sector from ahead [deg].
    `frame`: 12, MAV_FRAME_BODY_FRD.
    """

    distances: NDArray[np.uint16]
    min_distance: int
    max_distance: int
    increment_f: float = 360.0 / SECTORS
    angle_offset: float = 0.0
    frame: int = BODY_FRD

    def as_dict(self) -> dict[str, Any]:
        """The message's fields but for time and type of sensor, as plain numbers."""
        return {
            "distances": self.distances.tolist(),
            "increment": round(self.increment_f),
            "min_distance": self.min_distance,
            "max_distance": self.max_distance,
            "increment_f": self.increment_f,
            "angle_offset": self.angle_offset,
            "frame": self.frame,
        }


def obstacle_distance(
    m: OccupancyMap,
    pose: ArrayLike,
    *,
    max_distance: float = 10.0,
    min_distance: float = 0.0,
    height: tuple[float, float] = (-0.3, 0.3),
    unknown: Unknown = "tell",
) -> ObstacleDistance:
    """The nearest obstacles around a robot, level, in 72 sectors of 5 degrees.

    `pose`: From the robot's frame (x ahead, y left, z up) to the map's: a homogeneous matrix; x, y and yaw of
        a 2-D map; x, y, z and a quaternion qx, qy, qz, qw of a 3-D one [m, rad]. Roll and pitch do not count.
    `max_distance`: How far to look [m], up to 655.33.
    `min_distance`: What is nearer is told as being that far: autopilots pass over what is less [m].
    `height` (low, high): Of a 3-D map: obstacles between these heights, from the robot's own [m].
    `unknown`: "tell": a sector without an obstacle, part of which is unknown up to `max_distance`, says so.
        "free", or "occupied": what unknown space is taken for, that outside the map, too.
    Raises ValueError if a number is out of its limits, or the robot's x axis points up or down.
    """
    if not 0 < max_distance <= FARTHEST:
        raise ValueError(f"max_distance = {max_distance:g} m: must be > 0 and <= {FARTHEST}")
    if not 0 <= min_distance <= max_distance:
        raise ValueError(
            f"min_distance = {min_distance:g} m: must be from 0 to max_distance = {max_distance:g} m"
        )
    if not height[0] <= height[1] or not all(map(math.isfinite, height)):
        raise WrongValue.of("height", f"{height[0]:g} to {height[1]:g} m", "from low to high, and finite")
    if unknown not in ("tell", "free", "occupied"):
        raise ValueError(f"unknown = {unknown!r}: must be 'tell', 'free' or 'occupied'")
    matrix = _core.pose_matrix(pose, dim=m.dim)
    ahead, position = matrix[:2, 0], matrix[: m.dim, m.dim]
    if np.hypot(*ahead) < 1e-6:
        raise ValueError("pose: its x axis points up or down, expected one that points somewhere ahead")
    yaw = math.atan2(ahead[1], ahead[0])
    rows = 1 if m.dim == 2 else math.ceil((height[1] - height[0]) / m.min_cell_size - 1e-9) + 1
    around = _Around(position, yaw, max_distance, height, rows)
    origins, ways = _rays(m, around)
    stops = "stop" if unknown == "occupied" else "pass"
    ends = m.cast_rays(origins, ways, max_range=max_distance, unknown=stops, at="cell")
    by_sector = (around.rows, SECTORS, -1)
    nearest = np.fmin.reduce(ends.reshape(by_sector), axis=(0, 2))
    nearest = np.fmin(nearest, _thin_things(m, around))
    found = np.isfinite(nearest)
    limits = tuple(min(math.floor(100 * one + 1e-6), NOT_KNOWN - 2) for one in (min_distance, max_distance))
    distances = np.full(SECTORS, limits[1] + 1, dtype=np.int64)
    # Rounded down: an obstacle is never told to be farther than it is.
    distances[found] = np.clip(np.floor(100 * nearest[found]), *limits)
    if unknown == "tell":
        stopped = m.cast_rays(origins, ways, max_range=max_distance, unknown="stop", details=True)
        is_unknown = (stopped.state == -1).reshape(by_sector).any(axis=(0, 2))
        distances[~found & is_unknown] = NOT_KNOWN
    return ObstacleDistance(distances.astype(np.uint16), *limits)


class ObstacleSink:
    """A sink of a live mapper that tells someone the nearest obstacles.

    `pose`: Where the robot is, as for `obstacle_distance`; None while that is unknown.
    `send`: Is given each ObstacleDistance, and the time of the map's last scan [s].
    `period`: From one time to the next [s].
    `**options`: Of `obstacle_distance`.
    """

    def __init__(
        self,
        pose: Callable[[], ArrayLike | None],
        send: Callable[[ObstacleDistance, float], None],
        *,
        period: float = 0.1,
        **options: Any,
    ) -> None:
        if not 0 <= period < math.inf:
            raise ValueError(f"period = {period:g} s: must be >= 0 and finite")
        self.period = period
        self._pose, self._send, self._options = pose, send, options

    def update(self, m: OccupancyMap, stamp: float) -> None:
        """Tell what is around the robot."""
        pose = self._pose()
        if pose is not None:
            self._send(obstacle_distance(m, pose, **self._options), stamp)


class _Around(NamedTuple):
    """Where the robot is and looks, how far, between which heights from its own, and in how many planes."""

    position: NDArray[np.float64]
    yaw: float
    far: float
    height: tuple[float, float]
    rows: int


def _thin_things(m: OccupancyMap, around: _Around) -> NDArray[np.float64]:
    """(72,) distances to free cells that hold something thin, which rays pass; inf where there is none."""
    reach = np.full((2, m.dim), around.far) * [[-1.0], [1.0]]
    reach[:, 2:] = np.reshape(around.height, (2, 1))
    cells = m.leaves(around.position + reach, states=("free",))
    lower, size = cells.lower[cells.thin, :2] - around.position[:2], cells.size[cells.thin, None]
    away = np.linalg.norm(np.maximum(0.0, np.maximum(lower, -lower - size)), axis=1)
    middle = lower + 0.5 * size
    far = np.maximum(np.linalg.norm(middle, axis=1), 1e-9)
    half = np.arcsin(np.minimum(1.0, math.sqrt(0.5) * size[:, 0] / far))
    angles = (around.yaw - np.arctan2(middle[:, 1], middle[:, 0]))[:, None]
    off = np.abs((angles - 2 * math.pi / SECTORS * np.arange(SECTORS) + math.pi) % (2 * math.pi) - math.pi)
    met = (off < half[:, None] + math.pi / SECTORS) & (away < around.far)[:, None]
    least: NDArray[np.float64] = np.where(met, away[:, None], np.inf).min(axis=0, initial=np.inf)
    return least


def _rays(m: OccupancyMap, around: _Around) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Origins and directions of rays: plane by plane, sector by sector, and in each clockwise."""
    width = 2 * math.pi / SECTORS
    n = math.ceil(width * around.far / m.min_cell_size) + 1
    angles = (width * np.arange(SECTORS)[:, None] + np.linspace(-0.5, 0.5, n) * width).ravel()
    ways = np.stack([np.cos(around.yaw - angles), np.sin(around.yaw - angles)], axis=1)
    if m.dim == 2:
        return around.position, ways
    rows, height = around.rows, around.height
    up = np.repeat(np.linspace(*height, rows) if rows > 1 else [np.mean(height)], len(ways))
    origins = around.position + np.stack([np.zeros_like(up), np.zeros_like(up), up], axis=1)
    return origins, np.tile(np.column_stack([ways, np.zeros(len(ways))]), (rows, 1))
