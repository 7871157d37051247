# SPDX-License-Identifier: BSD-3-Clause
"""Noise around the largest range is no echo where other scans see that nothing is there, and only there."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from planes import box, ranges_to, rays

import ndtree
from ndtree.base.scan import Scan
from ndtree.logs.core.log import Log
from ndtree.logs.core.silence import CutOff
from ndtree.tuning.range_end import RangeEnd, range_end

LIMIT = 5.0
Floats = np.ndarray[Any, Any]
Poses = list[tuple[float, float, float]]
NOTHING = box(1e6, 1e6, 1.0, 1.0)


def exact(segments: Floats, circle: float, pose: tuple[float, float, float], angles: Floats) -> Floats:
    """Ranges to segments and to a circle around (0, 0) with this radius; +inf to nothing."""
    found = ranges_to(segments, np.array(pose), angles)
    if circle:
        origin = np.array(pose[:2])
        middle = rays(pose[2] + angles) @ origin
        found = np.minimum(found, -middle + np.sqrt(middle**2 - origin @ origin + circle**2))
    return found


class Drive:
    """Ranges of a laser with noise on all of them, also where nothing was hit."""

    def __init__(
        self, rng: np.random.Generator, segments: Floats, poses: Poses, angles: Floats,
        *, circle: float = 0.0, sigma: float = 0.02, jitter: float = 0.0, is_closed: bool = False,
    ) -> None:  # fmt: skip
        self.poses, self.angles = poses, angles
        true = np.array([exact(segments, circle, pose, angles) for pose in poses])
        self.is_silent = np.zeros(true.shape, dtype=bool) if is_closed else true > LIMIT
        self.ranges = np.where(self.is_silent, LIMIT, true) + rng.normal(0, sigma, true.shape)
        self.told = [(x + rng.normal(0, jitter), y + rng.normal(0, jitter), yaw) for x, y, yaw in poses]

    def ends(self, i: int) -> Floats:
        x, y, yaw = self.told[i]
        return np.array([x, y]) + self.ranges[i][:, None] * rays(yaw + self.angles)

    def npz(self, folder: Path) -> Path:
        ends, origins = [self.ends(i) for i in range(len(self.told))], np.array(self.told)[:, :2]
        offsets = len(self.angles) * np.arange(len(ends) + 1)
        np.savez(folder / "a.npz", origins=origins, points=np.concatenate(ends), offsets=offsets)
        return folder / "a.npz"

    def carmen(self, folder: Path) -> Path:
        """Angles are as there: half a turn, or a whole one."""
        lines = []
        for i, (x, y, yaw) in enumerate(self.told):
            numbers = " ".join(f"{value:.3f}" for value in self.ranges[i])
            step = self.angles[1] - self.angles[0]
            head = f"ROBOTLASER1 0 {self.angles[0]:.6f} {step * len(self.angles):.6f} {step:.6f} 81.9 0.01 0"
            pose = f"{x:.6f} {y:.6f} {yaw:.6f}"
            lines.append(f"{head} {len(self.angles)} {numbers} 0 {pose} {pose} 0 0 0 0 0 {i}.0 host {i}.0\n")
        (folder / "a.log").write_text("".join(lines))
        return folder / "a.log"

    def clouds(self, folder: Path) -> Path:
        way = np.stack([np.cos(self.angles), np.sin(self.angles), np.zeros(len(self.angles))], axis=1)
        return self._bag(
            folder, lambda make, stamp, i: make.cloud(stamp, "lidar", self.ranges[i][:, None] * way)
        )

    def lasers(self, folder: Path) -> Path:
        """Their largest range is said to be another one."""
        first, second, last = self.angles[[0, 1, -1]]
        angles = {"angle_min": first, "angle_max": last, "angle_increment": second - first, "range_max": 30.0}
        return self._bag(
            folder,
            lambda make, stamp, i: make.laser(stamp, "lidar", self.ranges[i].astype(np.float32), **angles),
        )

    def _bag(self, folder: Path, measured: Callable[[Any, float, int], Any]) -> Path:
        bags = pytest.importorskip("bags")
        make, content = bags.Messages("mcap"), []
        for i, (x, y, yaw) in enumerate(self.told):
            stamp = bags.START + 0.1 * i
            turn = [0, 0, math.sin(yaw / 2), math.cos(yaw / 2)]
            transform = make.transform(stamp, "map", "lidar", [x, y, 0], turn)
            content += [("/tf", stamp, make.tf(transform))]
            content += [("/measured", stamp, measured(make, stamp, i))]
        return Path(bags.write_bag(folder / "bag", make, content))


def line(length: float, count: int = 60) -> Poses:
    return [(x, 0.0, 0.0) for x in np.linspace(0, length, count)]


def turns(radius: float, count: int = 60) -> Poses:
    return [(radius * math.cos(a), radius * math.sin(a), a) for a in np.linspace(0, 6, count)]


AROUND = np.linspace(-math.pi, math.pi, 360, endpoint=False)
SIDES = np.concatenate([np.linspace(-0.1, 0.1, 15) + side * math.pi / 2 for side in (-1, 1)])


def field(rng: np.random.Generator) -> Floats:
    """Six boxes beside the way."""
    boxes = []
    for _ in range(6):
        x, y, half = rng.uniform(-3, 13), rng.choice([-1, 1]) * rng.uniform(1.5, 6), rng.uniform(0.2, 0.6)
        boxes.append(box(x - half, y - half, 2 * half, 2 * half))
    return np.concatenate(boxes)


def silent(log: Iterable[Scan]) -> Floats:
    return np.stack([~scan.did_return for scan in log])


def looked(path: Path, **given: Any) -> tuple[Log, ndtree.Config]:
    config = ndtree.inspect(path, **given)
    return config.read(path), config


@pytest.mark.parametrize(
    "kind, jitter, seed",
    [("npz", 0.0, 0), ("carmen", 0.0, 1), ("carmen", 0.03, 3), ("clouds", 0.03, 4), ("lasers", 0.0, 5)],
)
def test_a_circle_around_the_robot_is_open_space(kind: str, jitter: float, seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    poses = [line(10), line(3), turns(4)][seed % 3]
    drive = Drive(rng, field(rng), poses, AROUND, sigma=rng.uniform(0.01, 0.03), jitter=jitter)
    log, config = looked(getattr(drive, kind)(tmp_path))
    found = silent(log)
    assert (
        drive.is_silent.mean() > 0.5 and np.count_nonzero(drive.is_silent & ~found) <= 2 + found.size // 5000
    )
    is_wall = (drive.ranges > 0.5) & (drive.ranges < LIMIT - 0.4)
    assert not found[is_wall].any(), "walls nearer than the noise reaches are kept"
    assert any("are beams without return" in note for note in config.notes)
    assert jitter or config.no_return == "free"
    m = config.new_map(log.dim)
    for scan in log:
        config.usable(scan).insert_into(m, max_range=config.max_range)
    ends = np.concatenate([drive.ends(i)[drive.is_silent[i]] for i in range(len(poses))])
    if log.dim == 3:
        ends = np.column_stack([ends, np.zeros(len(ends))])
    assert np.mean(m.state(ends) == 1) < 0.02


@pytest.mark.parametrize("shape", ["even", "one side", "drift", "even and a surface"])
def test_a_circle_of_another_shape_is_open_space_if_it_is_seen_so(shape: str, tmp_path: Path) -> None:
    rng, is_surface = np.random.default_rng(30), "surface" in shape
    circle = LIMIT if is_surface else 0.0
    drive = Drive(rng, field(rng), turns(0.0) if is_surface else line(10), AROUND, circle=circle, sigma=0.0)
    odd = (drive.ranges > LIMIT - 0.01) if is_surface else drive.is_silent
    noise = {
        "one side": lambda: -rng.exponential(0.01, odd.shape),
        "drift": lambda: np.linspace(0, 0.06, len(odd))[:, None] + rng.normal(0, 0.002, odd.shape),
    }.get(shape, lambda: rng.uniform(-0.03, 0, odd.shape))()
    drive.ranges = np.where(odd, LIMIT + noise, drive.ranges)
    log, config = looked(drive.npz(tmp_path))
    assert odd.mean() > 0.3
    assert silent(log)[odd].mean() < 0.01 if is_surface else silent(log)[odd].mean() > 0.98
    assert not silent(log)[drive.ranges < LIMIT - 0.4].any()
    assert not any("cannot tell" in note for note in config.notes)


@pytest.mark.parametrize("where", ["corridor", "round", "about", "wall", "standing", "turning"])
def test_surfaces_that_stay_as_far_away_are_kept(where: str, tmp_path: Path) -> None:
    """Along the middle of a corridor or in that of a round room; with a word where no other scan looks."""
    rng, kind = np.random.default_rng(100), "clouds" if where in ("about", "standing") else "npz"
    long = np.array([[(-50.0, side * LIMIT), (60.0, side * LIMIT)] for side in (-1, 1)])
    drive = {
        "corridor": lambda: Drive(rng, long, line(12), SIDES, jitter=0.03, is_closed=True),
        "round": lambda: Drive(rng, NOTHING, turns(0.0), AROUND, circle=LIMIT, is_closed=True),
        "about": lambda: Drive(rng, NOTHING, turns(0.5), AROUND, circle=LIMIT, is_closed=True),
        "wall": lambda: Drive(rng, long[1:], line(20, 200), np.array([math.pi / 2]), is_closed=True),
        "standing": lambda: Drive(rng, field(rng), line(0.0), AROUND),
        "turning": lambda: Drive(rng, field(rng), turns(0.0), AROUND),
    }[where]()
    log, config = looked(getattr(drive, kind)(tmp_path))
    assert not silent(log).any() and log.cut_off is None
    if where in ("standing", "turning"):
        assert any("cannot tell whether something is there" in note for note in config.notes)


def test_a_pipe_around_a_profiler_is_kept(tmp_path: Path) -> None:
    rng, angle = np.random.default_rng(200), np.linspace(-math.pi, math.pi, 54, endpoint=False)
    scans, points = 200, []
    for x in np.linspace(0, 10, scans):
        tilt, ranges = rng.normal(0, 0.02), 1.0 + rng.normal(0, 0.004, len(angle))
        way = np.stack([-np.sin(tilt) * np.cos(angle), np.cos(tilt) * np.cos(angle), np.sin(angle)], axis=1)
        points.append(np.array([x, 0, 0]) + ranges[:, None] * way)
    origins = np.stack([np.linspace(0, 10, scans), np.zeros(scans), np.zeros(scans)], axis=1)
    path = tmp_path / "pipe.npz"
    np.savez(path, origins=origins, points=np.concatenate(points), offsets=54 * np.arange(scans + 1))
    log, config = looked(path)
    assert not silent(log).any() and any("cannot tell" in note for note in config.notes)


def rings(elevations: Floats, poses: Poses, rng: np.random.Generator, end: float) -> tuple[Floats, Floats]:
    """A lidar's origins 0.8 m above flat ground, and where beams end (scans, beams, 3); no echo at `end`."""
    turn, up = np.meshgrid(AROUND[::6], elevations)
    way = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], axis=-1).reshape(-1, 3)
    down = np.maximum(-way[:, 2], 1e-9)
    ranges = np.minimum(0.8 / down, end) + rng.normal(0, 0.01, (len(poses), len(way)))
    origins = np.array([[x, y, 0.8] for x, y, _ in poses])
    return origins, origins[:, None] + ranges[..., None] * way


@pytest.mark.parametrize(
    "lowest, highest, poses, is_unsure",
    [
        (-0.5, -0.03, line(1.5, 20), False),
        (-0.3, 0.2, line(0.0, 20), True),
        (-0.3, 0.05, line(0.2, 20), True),
    ],
)
def test_the_farthest_ring_on_the_ground_is_ground(
    lowest: float, highest: float, poses: Poses, is_unsure: bool, tmp_path: Path
) -> None:
    """And rings above it that end at the largest range are doubted where the robot hardly moves."""
    rng = np.random.default_rng(21)
    high_up = np.array([0.0, 0.0, 500.0])
    origins, points = (one + high_up for one in rings(np.linspace(lowest, highest, 8), poses, rng, end=30.0))
    points[:, 0] = np.nan  # No beam at all.
    np.savez(tmp_path / "a.npz", origins=origins, points=points.reshape(-1, 3),
             offsets=points.shape[1] * np.arange(len(points) + 1))  # fmt: skip
    log, config = looked(tmp_path / "a.npz")
    assert not silent(log).any()
    assert any("cannot tell" in note for note in config.notes) == is_unsure


def test_what_a_beam_meets_beside_the_way_is_met_by_others(tmp_path: Path) -> None:
    """A corridor's walls: the last beam that reaches them does so at the same range all along."""
    rng = np.random.default_rng(22)
    walls = np.array([[(-50.0, side), (60.0, side)] for side in (-1.0, 1.0)])
    ahead = np.linspace(-1.36, 1.36, 40)  # No beam goes along.
    angles = np.concatenate([ahead[np.abs(ahead) > 0.2], [-0.2, 0.2]])
    drive = Drive(rng, walls, line(8, 80), np.sort(angles), sigma=0.005, is_closed=True)
    log, config = looked(drive.npz(tmp_path))
    assert not silent(log).any() and not any("cannot tell" in note for note in config.notes)


@pytest.mark.parametrize("kind", ["npz", "clouds"])
def test_it_is_looked_for_if_all_else_is_given(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    drive = Drive(rng, field(rng), line(10), AROUND)
    log, config = looked(getattr(drive, kind)(tmp_path), range_sigma=0.02)
    assert silent(log).mean() > 0.5 and config.no_return == "free"
    few = Drive(rng, field(rng), line(1.0, 5), AROUND[:9])
    _, config = looked(few.clouds(tmp_path / "few"), range_sigma=0.02)
    assert config.notes == (), "nothing was chosen"


def test_a_join_of_logs_obeys_it_too(tmp_path: Path) -> None:
    from ndtree.logs.core.joined import JoinedLog

    logs = []
    for seed in (8, 9):
        rng = np.random.default_rng(seed)
        (tmp_path / str(seed)).mkdir()
        logs.append(ndtree.read(Drive(rng, field(rng), line(10), AROUND).clouds(tmp_path / str(seed))))
    joined = JoinedLog(logs)
    config = ndtree.inspect(joined)
    assert silent(config.ruled(joined)).mean() > 0.5 and config.no_return == "free"


def test_beams_far_apart_tell_of_larger_cells(tmp_path: Path) -> None:
    """No scan sees through a cell that its beams pass on both sides."""
    rng = np.random.default_rng(11)
    drive = Drive(rng, field(rng), line(10), AROUND[::9])
    log, _ = looked(drive.npz(tmp_path))
    assert np.count_nonzero(drive.is_silent & ~silent(log)) <= 2


@pytest.mark.parametrize(
    "at, tolerance, said",
    [(200.0, 1e-4, "readings of 200 m, .*max_range 199$"), (4.056, 0.126, "from 3.93 to .*max_range 3.92$")],
)
def test_what_is_to_be_typed_leaves_these_readings_out(at: float, tolerance: float, said: str) -> None:
    assert re.search(said, str(RangeEnd(CutOff(at, tolerance), is_empty=False)))


@pytest.mark.parametrize("is_wall", [False, True])
def test_depths_end_in_a_plane_before_the_camera(is_wall: bool) -> None:
    """Not on a sphere around it, and not if a wall stands there."""
    u, v = (one.ravel() for one in np.meshgrid(np.linspace(-0.6, 0.6, 40), np.linspace(-0.45, 0.45, 30)))
    scans, silent = [], []
    for i in range(12):
        yaw = 0.0 if is_wall else 0.08 * i - 0.43
        c, s = math.cos(yaw), math.sin(yaw)
        turn = np.array([[s, 0, c], [-c, 0, s], [0, -1, 0]])  # Of x to the right, y down, z forward.
        ways = np.stack([u, v, np.ones(len(u))], axis=1) @ turn.T
        with np.errstate(divide="ignore"):
            far = np.minimum(np.where(v > 0, 1 / v, np.inf), np.where(ways[:, 1] > 0, 3 / ways[:, 1], np.inf))
        silent.append(far > LIMIT)
        origin = np.array([0.0, -0.1 * i, 0.0]) if is_wall else np.array([0.15 * i, 0.0, 0.0])
        ends = origin + np.minimum(far, LIMIT)[:, None] * ways
        scans.append(Scan(ends, origin, rotation=turn, by_depth=True))
    assert 1000 < np.sum(silent) < 12 * len(u) - 1000
    end = range_end(scans)
    if is_wall:
        assert end is None or not end.is_empty
    else:
        assert end is not None and end.is_empty
        assert all((~end.limit.applied(scan).did_return == one).all() for scan, one in zip(scans, silent))


def test_equal_readings_are_no_surface_where_noise_has_larger_ones() -> None:
    rng, scans = np.random.default_rng(23), []
    angles = np.linspace(-3, 3, 360)
    for i in range(20):
        ranges = np.where(np.arange(360) % 3 == 0, LIMIT, 0.4 * LIMIT + rng.normal(0, 0.01, 360))
        ranges[3] += 0.003 * (i % 4 == 0) * rng.random()
        scans.append(Scan((ranges[:, None] * rays(angles)).astype(np.float32), np.zeros(2)))
    assert range_end(scans) is not None
