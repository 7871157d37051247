# SPDX-License-Identifier: BSD-3-Clause
"""What goes wrong with a recording: odometry, poses, beams without echo, and what moves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trial.robots import Recording, matrices, planar
from trial.scene import Floats, Scene
from trial.worlds import Random, World


def _composed(first: Floats, step: Floats) -> Floats:
    c, s = np.cos(first[2]), np.sin(first[2])
    return first + np.array([c * step[0] - s * step[1], s * step[0] + c * step[1], step[2]])


def steps_of(poses: Floats) -> Floats:
    """(n - 1, 3) motions between planar poses, each in the frame of the one before."""
    d = np.diff(poses, axis=0)
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    turn = np.angle(np.exp(1j * d[:, 2]))
    return np.c_[c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], turn]


def _chained(start: Floats, steps: Floats) -> Floats:
    poses = [start]
    for step in steps:
        poses.append(_composed(poses[-1], step))
    return np.array(poses)


def _with_steps(r: Recording, change: Callable[[Floats], Floats]) -> Recording:
    start = planar(r.true)
    told = _chained(start[0], change(steps_of(start)))
    r.told = matrices(told[:, :2], told[:, 2], r.true[:, 2, 3])
    return r


def none(r: Recording, rng: Random) -> Recording:
    """All is told as it is."""
    return r


def drift(r: Recording, rng: Random) -> Recording:
    """Odometry of a usual robot: 5 % of the way, 3 % of the turn, and a curve to one side."""
    curve = rng.uniform(-0.02, 0.02)

    def change(steps: Floats) -> Floats:
        way = np.hypot(steps[:, 0], steps[:, 1])
        turn = 0.03 * np.abs(steps[:, 2]) + 0.02 * way
        noise = rng.normal(size=steps.shape) * np.c_[0.05 * way, 0.02 * way, turn]
        return steps + noise + np.c_[0 * way, 0 * way, curve * way]

    return _with_steps(r, change)


def scale(r: Recording, rng: Random) -> Recording:
    """Wheels are larger or smaller than they are said to be."""
    by = rng.choice([rng.uniform(0.85, 0.95), rng.uniform(1.05, 1.15)])
    return _with_steps(r, lambda steps: steps * [by, by, 1.0])


def wrong_sign(r: Recording, rng: Random) -> Recording:
    """Odometry counts backwards."""
    return _with_steps(r, lambda steps: steps * [-1.0, -1.0, 1.0])


def jump(r: Recording, rng: Random) -> Recording:
    """Odometry jumps once."""
    at = int(rng.integers(len(r) // 4, 3 * len(r) // 4))
    by = np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-0.9, 0.9)])

    def change(steps: Floats) -> Floats:
        steps[at] = _composed(steps[at], by)
        return steps

    return _with_steps(r, change)


def stall(r: Recording, rng: Random) -> Recording:
    """Odometry stands still for some scans, and catches up in one step."""
    for _ in range(2):
        long = int(rng.integers(4, 12))
        at = int(rng.integers(2, max(3, len(r) - long - 2)))
        r.told[at : at + long] = r.told[at]
    return r


def slip(r: Recording, rng: Random) -> Recording:
    """Wheels spin: the robot is said to have moved, and did not."""
    at, long = int(rng.integers(len(r) // 3, len(r) // 2)), int(rng.integers(5, 12))

    def change(steps: Floats) -> Floats:
        steps[at : at + long] += [rng.uniform(0.02, 0.06), 0.0, 0.0]
        return steps

    return _with_steps(r, change)


def dropped(r: Recording, rng: Random) -> Recording:
    """A third of the scans is lost, some in a row."""
    keep = rng.random(len(r)) > 0.25
    at = int(rng.integers(5, len(r) - 10))
    keep[at : at + 6] = False
    keep[0] = True
    return r.kept(keep)


def no_odometry(r: Recording, rng: Random) -> Recording:
    """All poses are the same."""
    r.told = np.tile(r.true[:1], (len(r), 1, 1))
    return r


def pitch(r: Recording, rng: Random) -> Recording:
    """Poses whose pitch is wrong by half a degree, another at each scan."""
    by = np.radians(rng.normal(0, 0.5, len(r)))
    turn = matrices(np.zeros((len(r), 2)), np.zeros(len(r)), 0.0, by)
    r.told = r.told @ turn
    return r


ODOMETRY = (none, drift, scale, wrong_sign, jump, stall, slip, dropped, no_odometry)


def person(world: World, rng: Random, scans: int, dim: int) -> Callable[[int], Scene | None]:
    """Someone walks beside the route, then is gone."""
    along, side = world.route[1] - world.route[0], rng.choice([-1, 1])
    way = along / np.linalg.norm(along)
    start = world.route[0] + 0.2 * along + 0.55 * side * np.array([-way[1], way[0]])
    step, last = rng.uniform(0.03, 0.1), int(scans * 0.6)

    def at(i: int) -> Scene | None:
        return None if i >= last else _body(start + way * step * i, dim, 0.2)

    return at


def stood_and_left(world: World, rng: Random, scans: int, dim: int) -> Callable[[int], Scene | None]:
    """A thing stands for a third of the time or less, and then is not there."""
    last = int(scans * rng.uniform(0.15, 0.35))
    middle = len(world.route) // 2
    along = world.route[middle] - world.route[middle - 1]
    way = along / np.linalg.norm(along)
    place = world.route[middle - 1] + 0.6 * along + rng.choice([-1, 1]) * 0.5 * np.array([-way[1], way[0]])

    def at(i: int) -> Scene | None:
        return None if i >= last else _body(place, dim, 0.25)

    return at


def _body(at: Floats, dim: int, radius: float) -> Scene:
    if dim == 2:
        return Scene(2, circles=[(float(at[0]), float(at[1]), radius)])
    return Scene(3, cylinders=[(float(at[0]), float(at[1]), radius, 0.05, 1.75)])
