# SPDX-License-Identifier: BSD-3-Clause
"""Judge of what is said of a robot with a lidar of many rings whose setup or poses are wrong."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

import ndtree
from ndtree import Scan
from ndtree.alignment.surfaces import Cloud
from ndtree.evaluation.sampling import spread
from ndtree.tuning.mismatch import Mismatch, mismatch
from ndtree.tuning.setup import setup_error
from ndtree.tuning.setup_error import SetupError
from trial import bag
from trial.outcome import Case, Outcome, limit
from trial.robots import Recording, matrices, rings
from trial.scene import Floats, Scene
from trial.worlds import Random, World

_CELL, _SCANS, _EVERY, _STEP = 0.05, 60, 0.1, 0.02  # [m], of clouds and of poses that are told [s].
_WHEELS = 0.4  # Before and behind the robot's middle [m].
_POINTS = 2500  # That are compared with the world.
_STILL = 2e-3  # What they are moved by when they lie nearest [m].
#: Axes of a camera: z forward, x to the right.
_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])

#: What may be said of a fault; any other cause leads astray.
_SAID = {
    "turned": {"yaw", "mount"},
    "tilted": {"tilt"},
    "moved": {"place", "mount"},
    "late": {"clock"},
    "swept": {"clock"},
    "scaled": {"scale"},
    "mirrored": {"mirrored"},
    "inverted": {"inverted"},
    "wxyz": {"wxyz"},
    "camera_axes": {"axes"},
    "millimetres": {"unit"},
    "degrees": {"degrees"},
}

#: Of poses that are wrong here and there, no cause is known.
_WRONG_POSES = ("shuffled", "jump", "carried", "seconds_late")

Poses = Callable[[Floats], Floats]  # Of times: (n, 4, 4).


def driven(world: World, rng: Random) -> Poses:
    """A drive along the route that sways, at a speed that changes, with all wheels on the ground."""
    route, own = world.route, (rng.uniform(0.5, 1.0), rng.uniform(0, 6))  # How the speed changes.
    ends = [2 * (a - b) / np.linalg.norm(a - b) + a for a, b in (route[:2], route[:-3:-1])]
    route = np.array([ends[0], *route, ends[1]])
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))] - 2
    speed = min(rng.uniform(0.4, 2.5), (length[-1] - 2) / (_SCANS * _EVERY + 1.2 / own[0]))
    sway, wave = rng.choice([0.0, 1.0], p=[0.25, 0.75]) * rng.uniform(0.1, 0.35), rng.uniform(3, 6)

    def places(at: Floats) -> Floats:
        xy = np.c_[[np.interp(at, length, route[:, k]) for k in (0, 1)]].T
        around = [np.c_[[np.interp(at + by, length, route[:, k]) for k in (0, 1)]].T for by in (-0.7, 0.7)]
        ahead = around[1] - around[0]
        ahead /= np.linalg.norm(ahead, axis=1)[:, None]
        xy = 0.25 * (around[0] + around[1]) + 0.5 * xy  # Rounds corners.
        return xy + sway * np.sin(2 * np.pi * at / wave)[:, None] * np.c_[-ahead[:, 1], ahead[:, 0]]

    def poses(times: Floats) -> Floats:
        at = speed * (times + 0.6 / own[0] * (np.sin(own[0] * times + own[1]) - np.sin(own[1])))
        xy = places(at)
        way = places(at + 0.02) - places(at - 0.02)
        yaw = np.arctan2(way[:, 1], way[:, 0])
        rise = [xy, *(xy + _WHEELS * side for side in _sides(yaw))]
        z = [np.zeros(len(xy)) if world.ramp is None else world.ramp(one)[:, 0] for one in rise]
        front, back, left, right = z[1:]
        result = matrices(xy, yaw, world.height + (front + back) / 2)
        slope, roll = (front - back) / (2 * _WHEELS), (left - right) / (2 * _WHEELS)
        up = result[:, :3, 2] - slope[:, None] * result[:, :3, 0] - roll[:, None] * result[:, :3, 1]
        up /= np.linalg.norm(up, axis=1)[:, None]
        left_way = np.cross(up, result[:, :3, 0])
        left_way /= np.linalg.norm(left_way, axis=1)[:, None]
        result[:, :3, :3] = np.stack([np.cross(left_way, up), left_way, up], axis=2)
        return result

    return poses


def _sides(yaw: Floats) -> list[Floats]:
    ahead, left = np.c_[np.cos(yaw), np.sin(yaw)], np.c_[-np.sin(yaw), np.cos(yaw)]
    return [ahead, -ahead, left, -left]


def _turned(roll: float, pitch: float, yaw: float) -> Floats:
    a, b, c, d = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    about_x = np.array([[1, 0, 0], [0, a, -b], [0, b, a]])
    about_y = np.array([[c, 0, d], [0, 1, 0], [-d, 0, c]])
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    result = np.eye(4)
    result[:3, :3] = about_z @ about_y @ about_x
    return result


def _mount(fault: str, rng: Random) -> Floats:
    """Where the sensor sits on its robot, which is told to be its middle."""
    side = rng.choice([-1, 1])
    if fault == "turned":
        return _turned(0, 0, side * np.radians(rng.uniform(3, 12)))
    if fault == "tilted":
        about, by = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(1, 10))
        return _turned(by * np.cos(about), by * np.sin(about), 0)
    result = np.eye(4)
    if fault == "moved":
        result[:3, 3] = *rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.2, 0.2)
    return result


def _told(true: Poses, fault: str, rng: Random) -> Poses:
    """Poses of the robot at times, as one with a fault tells them."""
    late = rng.choice([-1, 1]) * rng.uniform(0.02, 0.3)
    noise = rng.normal(0, 1, (_SCANS + 2, 6)) * [*(3 * [rng.uniform(0.01, 0.03)]), 0.0087, 0.0087, 0.005]
    turns = np.array([_turned(*one[3:]) for one in noise])

    def noisy(times: Floats) -> Floats:
        at = np.rint(times / _EVERY).astype(int).clip(0, len(noise) - 1)
        poses = true(times) @ turns[at]
        poses[:, :3, 3] += noise[at, :3]
        return poses

    def in_millimetres(times: Floats) -> Floats:
        poses = true(times)
        poses[:, :3, 3] *= 1000
        return poses

    def in_degrees(times: Floats) -> Floats:
        poses = true(times)
        yaw = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
        turns = matrices(np.zeros((len(yaw), 2)), np.degrees(yaw) - yaw)
        poses[:, :3, :3] = turns[:, :3, :3] @ poses[:, :3, :3]
        return poses

    told: dict[str, Poses] = {
        "noisy": noisy,
        "late": lambda times: true(times + late),
        "millimetres": in_millimetres,
        "degrees": in_degrees,
        "inverted": lambda times: np.linalg.inv(true(times)),
        "camera_axes": lambda times: _CAMERA @ true(times) @ _CAMERA.T,
    }
    return told.get(fault, true)


def _true_and_told(drive: Poses, fault: str, rng: Random) -> tuple[Poses, Poses]:
    """True poses of the robot, and its log's, wrong from some time on or all along."""
    begin, by = rng.uniform(1.5, 4.0), rng.uniform(1.5, 3.0)
    turn = _turned(*rng.normal(0, 0.02, 2), rng.choice([-1, 1]) * rng.uniform(0.2, 1.5))
    leap = turn.copy()
    leap[:3, 3] = *rng.uniform(-1.5, 1.5, 2), rng.choice([0.0, rng.uniform(0.5, 2.0)])
    before, behind = drive(np.array([begin, begin + by]))

    def leaping(times: Floats) -> Floats:
        poses = drive(times)
        poses[times > begin] = before @ leap @ np.linalg.inv(before) @ poses[times > begin]
        return poses

    def set_down(times: Floats) -> Floats:
        """Farther on along its way, and turned."""
        poses = drive(times + by * (times > begin))
        poses[times > begin] = behind @ turn @ np.linalg.inv(behind) @ poses[times > begin]
        return poses

    def going_on(times: Floats) -> Floats:
        poses = set_down(times)
        poses[times > begin] = before @ np.linalg.inv(behind @ turn) @ poses[times > begin]
        return poses

    told = {"jump": leaping, "carried": going_on, "seconds_late": lambda times: drive(times + by)}
    return set_down if fault == "carried" else drive, told.get(fault, drive)


def setup_trial(case: Case) -> tuple[Recording, Outcome]:
    """Whether the map of a bag is said to be doubtful where surfaces lie beside their places in it."""
    rng, outcome, scene = case.rng, Outcome(), case.world.scene
    sensor = rings(rng)
    while sensor.name == "rings 128":
        sensor = rings(rng)
    true, mount = driven(case.world, rng), _mount(case.fault, rng)
    told = None
    if case.fault in _WRONG_POSES:
        true, told = _true_and_told(true, case.fault, rng)
    stamps = _EVERY * np.arange(_SCANS)
    # A sweep begins at its stamp.
    around = np.arctan2(sensor.directions[:, 1], sensor.directions[:, 0]) % (2 * np.pi)
    columns, which = np.unique(np.rint(around / 2e-3), return_inverse=True)
    during = _EVERY * columns / columns.max() if case.fault == "swept" else 0 * columns[:1]
    which = which if case.fault == "swept" else 0 * which
    exact = np.empty((_SCANS, len(sensor.directions)))
    for i, stamp in enumerate(stamps):
        poses = (true(stamp + during) @ mount)[which]
        directions = np.einsum("nij,nj->ni", poses[:, :3, :3], sensor.directions)
        exact[i] = scene.cast(poses[:, :3, 3], directions)
    exact[exact > sensor.max_range] = np.inf
    noisy = np.maximum(exact + rng.normal(0, sensor.sigma, exact.shape), 1e-3)
    told = told or _told(true, case.fault, rng)
    still = np.zeros(exact.shape, bool)
    r = Recording(sensor, true(stamps) @ mount, told(stamps), noisy, exact, still, stamps)
    times = np.arange(-2 * _STEP, stamps[-1] + 2 * _STEP, _STEP)
    poses = told(times)
    quaternions = _quaternions(poses[:, :3, :3])
    if case.fault == "wxyz":
        quaternions = quaternions[:, [3, 0, 1, 2]]
    transforms = list(zip(times.tolist(), poses[:, :3, 3], quaternions))
    by = rng.choice([0.3048, 0.97, 1.03, 0.9, 1.1]) if case.fault == "scaled" else 1.0
    flip = np.array([1.0, -1.0 if case.fault == "mirrored" else 1.0, 1.0])
    order = rng.permutation(_SCANS) if case.fault == "shuffled" else np.arange(_SCANS)
    clouds = [(float(stamp), by * r.points(i) * flip) for i, stamp in zip(order, stamps)]
    with tempfile.TemporaryDirectory() as folder:
        log = ndtree.read(bag.write_clouds(Path(folder) / "log.bag", clouds, transforms))
        scans = list(log.ruled(cut_off=None))
    said = found_in(scans)
    outcome.words = [str(said)] if said else []
    ends = np.concatenate([scan.endpoints[:: max(1, len(scan) // 3000)] for scan in scans])
    ends = ends[np.isfinite(ends).all(axis=1)]  # A robot that was set down in a wall has others.
    cells = np.floor(ends / _CELL).astype(int)
    keys = np.ravel_multi_index(tuple((cells - cells.min(axis=0)).T), tuple(np.ptp(cells, axis=0) + 1))
    _, first = np.unique(keys, return_index=True)
    ends = ends[rng.permutation(first)[:_POINTS]]
    # Straight on, the world is as in a mirror, and yaws in degrees are as a mount that is turned. Of noisy
    # poses walls are as rough, and no cause is named.
    is_straight = np.ptp(np.unwrap(np.arctan2(r.true[:, 1, 0], r.true[:, 0, 0]))) <= 0.5
    if case.fault != "noisy" and not (case.fault == "mirrored" and is_straight):
        away = _aligned(ends, scene, r.true @ np.linalg.inv(r.told))
        away = away > limit("beside a surface") * _CELL + 3 * sensor.sigma
        outcome.expect("displaced walls", 100 * float(away.mean()))
    outcome.may_doubt = case.fault in (*_SAID, *_WRONG_POSES)
    kinds = {one.kind for one in (said, *said.others)} if isinstance(said, SetupError) else set()
    may_say = _SAID.get(case.fault, set()) | ({"yaw"} if case.fault == "degrees" and is_straight else set())
    if case.fault in _SAID and kinds and not kinds & may_say:
        outcome.faults.append(f"said to be {' or '.join(sorted(kinds))}")
        outcome.words = []
    return r, outcome


def found_in(scans: Iterable[Scan]) -> SetupError | Mismatch | None:
    """What `ndtree.first_look` says of the setup and the poses, without all else that it looks at."""
    runs = [[one for one in run if one is not None] for run in spread(scans, None, Cloud.of)[0]]
    return setup_error(runs) or mismatch(runs)


def _quaternions(rotations: Floats) -> Floats:
    """(n, 4) x, y, z, w, by the longest of four ways to find them."""
    found = []
    for m in rotations:
        k = np.array([
            [m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
            [0, m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]],
            [0, 0, m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
            [0, 0, 0, m.trace()],
        ])  # fmt: skip
        found.append(np.linalg.eigh(k, UPLO="U")[1][:, -1])
    return np.array(found)


def _aligned(points: Floats, scene: Scene, guesses: Floats) -> Floats:
    """(n,) distance of points to surfaces, moved as a whole to where they lie nearest.

    A map that is elsewhere as a whole is right: that only shows where poses are asked of others.
    """
    best = np.full(len(points), np.inf)
    for guess in guesses[:: len(guesses) // 4]:
        moved = points @ guess[:3, :3].T + guess[:3, 3]
        for _ in range(10):
            nearest = scene.nearest(moved)
            found = np.linalg.norm(moved - nearest, axis=1)
            best = min(best, found, key=lambda one: np.sort(one)[len(one) * 4 // 5])
            use = found <= max(np.quantile(found, 0.8), 1e-9)
            at, to = moved[use], nearest[use]
            u, _, v = np.linalg.svd((at - at.mean(0)).T @ (to - to.mean(0)))
            turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
            before, moved = moved, (moved - at.mean(0)) @ turn + to.mean(0)
            if np.abs(moved - before).max() < _STILL:
                break
    return best
