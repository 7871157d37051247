# SPDX-License-Identifier: BSD-3-Clause
"""Random sensors on random ways, and what they record: ranges from true poses, placed by told ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trial.scene import Bools, Floats, Scene
from trial.worlds import Random, World


@dataclass(frozen=True)
class Sensor:
    """Beams in the sensor's own frame, and what a reading is worth.

    Attributes
    ----------
    name : str
    directions : (n, dim) float64
        Unit vectors; of a planar laser in the order of its angles, which are evenly spaced.
    max_range, sigma : float
        [m]
    """

    name: str
    directions: Floats
    max_range: float
    sigma: float

    @property
    def angles(self) -> Floats:
        """Of a planar laser [rad]."""
        return np.unwrap(np.arctan2(self.directions[:, 1], self.directions[:, 0]))


def laser(rng: Random, beams: int | None = None, view: float | None = None) -> Sensor:
    """A planar laser."""
    if beams is None:
        beams = int(rng.choice([90, 180, 360, 720, 1440], p=[0.15, 0.3, 0.35, 0.15, 0.05]))
    view = float(rng.choice([180, 270, 360])) if view is None else view
    around = np.radians(np.linspace(-view / 2, view / 2, beams, endpoint=view < 360))
    far, sigma = float(rng.choice([8, 12, 20, 30])), float(rng.choice([0, 0.003, 0.01, 0.03]))
    return Sensor("laser", np.c_[np.cos(around), np.sin(around)], far, sigma)


def sonar(rng: Random) -> Sensor:
    """Few readings, short and rough."""
    around = np.radians(np.linspace(-180, 180, 24, endpoint=False))
    return Sensor("sonar", np.c_[np.cos(around), np.sin(around)], 4.0, 0.03)


def rings(rng: Random, count: int | None = None) -> Sensor:
    """A lidar of 16 to 128 rings."""
    count = int(rng.choice([16, 32, 64, 128])) if count is None else count
    view = rng.uniform(20, 45)
    columns = {16: 240, 32: 180, 64: 120, 128: 90}[count]
    up = np.radians(np.linspace(-view * 0.65, view * 0.35, count))
    around = np.radians(np.arange(columns) * 360 / columns)
    up, around = (one.ravel() for one in np.meshgrid(up, around))
    directions = np.c_[np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)]
    return Sensor(f"rings {count}", directions, 40.0, float(rng.choice([0, 0.01, 0.03])))


def depth_camera(rng: Random, columns: int = 80) -> Sensor:
    """A small depth image, looking ahead."""
    across, down = np.linspace(-0.6, 0.6, columns), np.linspace(-0.45, 0.45, 3 * columns // 4)
    u, v = (one.ravel() for one in np.meshgrid(across, down))
    directions = np.c_[np.ones_like(u), -u, -v]
    return Sensor("depth", directions / np.linalg.norm(directions, axis=1, keepdims=True), 6.0, 0.01)


def small_sensor_of(rng: Random, dim: int) -> Sensor:
    """One of few beams: a laser, a lidar that may not see far, or a depth camera."""
    if dim == 2:
        return laser(rng, beams=int(rng.choice([180, 360])))
    if rng.random() < 0.5:
        return depth_camera(rng, 40)
    lidar = rings(rng, int(rng.choice([16, 32])))  # Of each ring every third beam.
    return replace(lidar, directions=lidar.directions[::3], max_range=float(rng.choice([10, 20, 40])))


def sensor_of(rng: Random, dim: int) -> Sensor:
    if dim == 2:
        return sonar(rng) if rng.random() < 0.05 else laser(rng)
    return depth_camera(rng) if rng.random() < 0.25 else rings(rng)


def poses_along(world: World, rng: Random, scans: int, motion: str | None = None) -> Floats:
    """(scans, 4, 4) poses of a sensor: driving, standing, turning on the spot, or pushed about by hand."""
    motion = motion or str(rng.choice(["drives", "drives", "drives", "stands", "turns", "pushed"]))
    route = world.route
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))]
    step = min(rng.uniform(0.01, 0.3), length[-1] / scans)
    at = np.arange(scans) * (step if motion in ("drives", "pushed") else 0.0)
    if motion in ("stands", "turns"):
        at += rng.uniform(0, length[-1])
    xy = np.c_[[np.interp(at, length, route[:, k]) for k in (0, 1)]].T
    ahead = np.interp(at + 0.3, length, route[:, 0]), np.interp(at + 0.3, length, route[:, 1])
    yaw = np.arctan2(ahead[1] - xy[:, 1], ahead[0] - xy[:, 0])
    yaw = _smoothed(np.unwrap(yaw), 7) if motion == "drives" else yaw
    if motion == "turns":
        yaw = np.arange(scans) * rng.uniform(0.02, 0.2)
    if motion == "pushed":
        yaw = np.cumsum(rng.normal(0, 0.05, scans)) + yaw[0]
        xy = xy + _smoothed(np.cumsum(rng.normal(0, 0.02, (scans, 2)), axis=0), 5).clip(-0.2, 0.2)
    z, pitch = np.full(scans, world.height), np.zeros(scans)
    if world.ramp is not None:
        rise = world.ramp(xy)
        z, pitch = z + rise[:, 0], -rise[:, 1] * np.cos(yaw - np.arctan2(*(route[-1] - route[0])[::-1]))
    return matrices(xy, yaw, z, pitch)


def _smoothed(values: Floats, width: int) -> Floats:
    """A running mean that keeps the ends."""
    if len(values) <= width:
        return values
    padded = np.concatenate([values[:1].repeat(width // 2, 0), values, values[-1:].repeat(width // 2, 0)])
    sums = np.cumsum(np.concatenate([np.zeros_like(padded[:1]), padded]), axis=0)
    return (sums[width:] - sums[:-width]) / width


def matrices(xy: Floats, yaw: Floats, z: Floats | float = 0.0, pitch: Floats | float = 0.0) -> Floats:
    """(n, 4, 4) of places, headings and pitch."""
    n = len(xy)
    c, s, p, q = np.cos(yaw), np.sin(yaw), np.cos(pitch) + np.zeros(n), np.sin(pitch) + np.zeros(n)
    result = np.tile(np.eye(4), (n, 1, 1))
    result[:, 0, :3] = np.c_[c * p, -s, c * q]
    result[:, 1, :3] = np.c_[s * p, c, s * q]
    result[:, 2, :3] = np.c_[-q, np.zeros(n), p]
    result[:, :2, 3], result[:, 2, 3] = xy, z
    return result


def planar(poses: Floats) -> Floats:
    """(n, 3) x, y, yaw of (n, 4, 4)."""
    return np.c_[poses[:, :2, 3], np.arctan2(poses[:, 1, 0], poses[:, 0, 0])]


def tilted(poses: Floats) -> Floats:
    """(n, 5) x, y, yaw, z, pitch of poses (n, 4, 4) without roll."""
    return np.c_[planar(poses), poses[:, 2, 3], -np.arcsin(poses[:, 2, 0])]


@dataclass
class Recording:
    """What a sensor measured, and where it is said to have been.

    Attributes
    ----------
    sensor : Sensor
    true, told : (s, 4, 4) float64
    ranges : (s, n) float64
        Readings [m]; inf: no echo.
    exact : (s, n) float64
        Without noise.
    moving : (s, n) bool
        Readings of what does not stand.
    stamps : (s,) float64
        [s]
    """

    sensor: Sensor
    true: Floats
    told: Floats
    ranges: Floats
    exact: Floats
    moving: Bools
    stamps: Floats

    @property
    def dim(self) -> int:
        return self.sensor.directions.shape[1]

    def __len__(self) -> int:
        return len(self.true)

    def beams(self, i: int) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """End points and origin of a scan by its told pose, and which beams returned."""
        d = self.dim
        returned = np.isfinite(self.ranges[i])
        length = np.where(returned, self.ranges[i], self.sensor.max_range)
        rotation, origin = self.told[i, :d, :d], self.told[i, :d, 3]
        return origin + (self.sensor.directions * length[:, None]) @ rotation.T, origin, returned

    def points(self, i: int) -> Floats:
        """End points of a scan in the sensor's frame, of beams that returned."""
        returned = np.isfinite(self.ranges[i])
        return self.sensor.directions[returned] * self.ranges[i, returned, None]

    def save(self, path: Path) -> Path:
        """As an archive of scans that the library reads."""
        scans = [self.beams(i) for i in range(len(self))]
        arrays = {
            "points": np.concatenate([points for points, _, _ in scans]),
            "origins": np.array([origin for _, origin, _ in scans]),
            "offsets": self.ranges.shape[1] * np.arange(len(self) + 1),
            "no_return": ~np.concatenate([returned for _, _, returned in scans]),
            "stamps": self.stamps,
        }
        np.savez(path, **arrays)
        return path

    def kept(self, which: NDArray[np.int64] | Bools) -> Recording:
        """Some of its scans."""
        names = ("true", "told", "ranges", "exact", "moving", "stamps")
        return replace(self, **{name: getattr(self, name)[which] for name in names})


def record(
    scene: Scene,
    sensor: Sensor,
    true: Floats,
    rng: Random,
    mover: Callable[[int], Scene | None] = lambda i: None,
) -> Recording:
    """Measure a world from true poses; `mover` gives what else there is at a scan's time."""
    exact = np.full((len(true), len(sensor.directions)), np.inf)
    moving = np.zeros(exact.shape, bool)
    d = sensor.directions.shape[1]
    for i, pose in enumerate(true):
        directions, origin = sensor.directions @ pose[:d, :d].T, pose[:d, 3]
        exact[i] = scene.cast(origin, directions, rng)
        other = mover(i)
        if other is not None:
            met = other.cast(origin, directions)
            moving[i] = met < exact[i]
            exact[i] = np.minimum(exact[i], met)
    exact[exact > sensor.max_range] = np.inf
    moving &= np.isfinite(exact)
    noisy = np.maximum(exact + rng.normal(0, sensor.sigma, exact.shape), 1e-3)
    return Recording(sensor, true, true.copy(), noisy, exact, moving, 0.1 * np.arange(len(true)))
