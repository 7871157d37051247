# SPDX-License-Identifier: BSD-3-Clause
"""Where a sensor sits on its base, and how far its clock is off: where the map gets sharpest."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.ros.files.bag import open_bag
from ndtree.logs.ros.messages.beams import stamp_of
from ndtree.logs.ros.messages.sweep import entropy, thinned
from ndtree.logs.ros.rosbag import RosbagLog

Floats = NDArray[np.float64]

#: Scans from all over the log, and beams of each, that are looked at.
SCANS, BEAMS = 400, 400
#: Yaws that are tried first [rad]; then steps of x, y [m], yaw [rad] and time [s], halved this many times.
YAWS = np.radians(np.arange(-180, 180, 10))
STEPS, HALVINGS = (0.04, 0.04, math.radians(4), 0.04), 6
#: Edges of the cells [m], at first and at last.
COARSE, FINE = 0.08, 0.02
#: A planar sensor may hang upside down, if its map is then smaller by this much (in logarithms).
UPSIDE_DOWN, SURELY = np.diag([1.0, -1.0, -1.0]), 0.05
#: Beams that are measured within this time share a pose [s].
TIME_STEP = 0.004
#: So far from the ends of the poses beams are left out, as the clock is not known yet [s].
SLACK = 0.3


@dataclass(frozen=True)
class Mounting:
    """What `find_mount` found: the mount in the plane, and what to add to the times of scans.

    `x`, `y`: [m]
    `others` (float, float, float): z [m], roll and pitch [rad], as they were given.
    """

    x: float
    y: float
    yaw: float  # [rad]
    others: tuple[float, float, float]
    time_offset: float  # [s]
    gain: float  # By what share of its cells the map is smaller than with the mount that was given.

    @property
    def flags(self) -> str:
        """As one would type them."""
        z, roll, pitch = self.others
        yaw = f"{math.degrees(self.yaw):.1f}deg"
        place = f"{self.x:.3f},{self.y:.3f}"
        if any(abs(value) > 1e-9 for value in self.others):
            turns = f"{math.degrees(roll):.1f}deg,{math.degrees(pitch):.1f}deg,{yaw}"
            place, yaw = f"{place},{z:.3f}", turns
        return f"--mount {place},{yaw} --time-offset {self.time_offset:.3f}"

    def figures(self) -> dict[str, Any]:
        """All of it as plain numbers, ready for JSON."""
        return {**vars(self), "others": list(self.others), "flags": self.flags}

    def __str__(self) -> str:
        """In one line."""
        return f"the map is sharpest with {self.flags} ({100 * self.gain:.0f} % fewer cells than as given)"


def find_mount(log: RosbagLog, *, progress: Callable[[str, int, int], None] | None = None) -> Mounting:
    """Find x, y and yaw of a mount, and the offset of the clock, at which scans agree best with each other.

    The end points of 400 scans from all over the log are counted in cells of 8 to 2 cm; the entropy of the
    counts says over how many they spread. First yaws all around are tried, of a planar sensor also upside
    down, then each of the four in turn in ever smaller steps. Where the robot does not turn, x and y cannot
    be found, and stay as given; a log with drift finds what makes the drift look smallest.

    `log`: Opened with a ``mount``.
    `progress`: Called as ``progress(what, done, total)``.
    Raises ValueError if its poses are known at fewer than two scans, or do not move.
    """
    place = log.place
    base, given = place.tree.fixed_parent(place.frame)
    points, stamps, numbers = _sample(log)
    first, last = place.tree.span(place.fixed_frame, base)
    if not math.isfinite(first):
        raise ValueError(f"{log.path}: {base} does not move, expected a log in which it does")
    points, stamps, numbers = _inside(points, stamps, numbers, first + SLACK, last - SLACK)
    if len(stamps) < 2:
        raise ValueError(f"{log.path}: {len(stamps)} scans with poses, expected at least two")
    rotations_given = [given.rotation]
    if log.sensors[0].is_planar:
        rotations_given.append(given.rotation @ UPSIDE_DOWN)
    height = np.array([0, 0, given.position[2]])
    levels = [(points @ rotation.T + height).T.copy() for rotation in rotations_given]
    done = [0]
    total = len(levels) * len(YAWS) + HALVINGS * 16

    def cells(mount: Floats, cell: float, level: Floats) -> float:
        x, y, yaw, offset = mount
        if progress is not None:
            done[0] += 1
            progress("mounts", min(done[0], total), total)
        try:
            rotations, positions = place.tree.poses_at(place.fixed_frame, base, stamps + offset)
        except ValueError:
            return math.inf
        c, s = math.cos(yaw), math.sin(yaw)
        mounted = np.stack([c * level[0] - s * level[1] + x, s * level[0] + c * level[1] + y, level[2]])
        return entropy(np.einsum("nij,jn->ni", rotations[numbers], mounted) + positions[numbers], cell)

    start = np.array([*given.position[:2], 0.0, 0.0])
    as_given = least = cells(start, COARSE, levels[0])
    best, level, rotation = start, levels[0], given.rotation
    for number, turned in enumerate(levels):
        needed = SURELY if number else 0.0
        for yaw in YAWS:
            trial = start + np.array([0, 0, yaw, 0])
            value = cells(trial, COARSE, turned) + needed
            if value < least:
                best, least, level, rotation = trial, value, turned, rotations_given[number]
    best = _refined(best, lambda mount, cell: cells(mount, cell, level))
    yaw, pitch, roll = _angles(rotation)
    turned = (yaw + best[2] + math.pi) % (2 * math.pi) - math.pi
    others = (float(given.position[2]), roll, pitch)
    offset = log.plan.options.time_offset + float(best[3])
    gain = 1 - math.exp(cells(best, COARSE, level) - as_given)
    return Mounting(float(best[0]), float(best[1]), turned, others, offset, gain)


def _refined(best: Floats, cells: Callable[[Floats, float], float]) -> Floats:
    """The mount of fewest cells near one, each of its numbers in turn in ever smaller steps."""
    steps = np.array(STEPS)
    for _ in range(HALVINGS):
        fine = max(COARSE * steps[0] / STEPS[0], FINE)
        least = cells(best, fine)
        improved = True
        while improved:
            improved = False
            for axis in (2, 3, 0, 1):
                for sign in (1, -1):
                    trial = best.copy()
                    trial[axis] += sign * steps[axis]
                    value = cells(trial, fine)
                    if value < least - 1e-6:
                        best, least, improved = trial, value, True
        steps = steps / 2
    return best


def _sample(log: RosbagLog) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """End points in the sensor's frame (n, 3), times of measuring, and the number of each point's time.

    Beams that are measured one after the other have their own times, as where the log is mapped.
    """
    sensor = log.sensors[0]
    step = max(1, sensor.topic.messages // SCANS)
    points: list[Floats] = []
    stamps: list[Floats] = []
    numbers: list[NDArray[np.int64]] = []
    known = 0
    with open_bag(log.path) as bag:
        for number, raw in enumerate(sensor.own_messages(bag)):
            if number % step:
                continue
            try:
                message = bag.decoded(raw)
                stream = (sensor.topic.name, sensor.seen.frame)
                stamp = log.plan.clock.stamp(stream, 1e-9 * raw.received, stamp_of(message))
                beams = thinned(log.plan.sweeps[sensor.topic.name].applied(sensor.beams(message, stamp)))
            except ValueError:
                continue
            stride = max(1, len(beams.points) // BEAMS)
            points.append(np.asarray(beams.points, dtype=np.float64)[::stride])
            times = np.zeros(len(points[-1])) if beams.times is None else beams.times[::stride]
            steps, which = np.unique(np.round(times / TIME_STEP), return_inverse=True)
            begin = log.plan.clock.time(stream, 1e-9 * raw.received, stamp) + log.plan.options.time_offset
            stamps.append(begin + TIME_STEP * steps)
            numbers.append(known + which)
            known += len(steps)
    if not points:
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.int64)
    return np.concatenate(points), np.concatenate(stamps), np.concatenate(numbers)


def _inside(
    points: Floats, stamps: Floats, numbers: NDArray[np.int64], first: float, last: float
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Only beams at times between two."""
    use = (stamps >= first) & (stamps <= last)
    of_point = use[numbers]
    return points[of_point], stamps[use], (np.cumsum(use) - 1)[numbers[of_point]]


def _angles(rotation: Floats) -> tuple[float, float, float]:
    """Yaw, pitch and roll of a rotation [rad]."""
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    pitch = math.asin(min(max(-float(rotation[2, 0]), -1.0), 1.0))
    return yaw, pitch, math.atan2(rotation[2, 1], rotation[2, 2])
