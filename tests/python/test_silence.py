# SPDX-License-Identifier: BSD-3-Clause
"""Readings at the largest range of a log did not return, whatever the format."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

import ndtree
from ndtree.logs.core.log import Log
from ndtree.logs.core.silence import CutOffSearch, noise_around, noise_below, noise_below_alone
from ndtree.logs.ros.messages.laser import NoiseAtLimit

LIMIT = 50.0


def ranges_of(scans: int = 12, beams: int = 180, cut: int = 20, seed: int = 3) -> list[np.ndarray]:
    """Of each scan, in centimetres as lasers measure; some of every second scan at the limit."""
    generator = np.random.default_rng(seed)
    made = [np.round(generator.uniform(1, 30, beams), 2) for _ in range(scans)]
    for ranges in made[1::2]:
        ranges[generator.choice(beams, cut, replace=False)] = LIMIT
    return made


def poses(count: int) -> np.ndarray:
    return np.stack([np.linspace(0, 3, count), np.linspace(1, -2, count), np.linspace(0, 2, count)], axis=1)


def carmen(path: Path, ranges: list[np.ndarray], record: str = "FLASER") -> Path:
    lines = []
    for i, (some, (x, y, yaw)) in enumerate(zip(ranges, poses(len(ranges)))):
        pose = f"{x:.6f} {y:.6f} {yaw:.6f}"
        numbers = " ".join(f"{value:.2f}" for value in some)
        lines.append(f"{record} {len(some)} {numbers} {pose} {pose} {i}.0 host {i}.0\n")
    data = "".join(lines).encode()
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)
    return path


def ends(ranges: np.ndarray, pose: np.ndarray) -> np.ndarray:
    angle = pose[2] - math.pi / 2 + np.arange(len(ranges)) * math.pi / len(ranges)
    return pose[:2] + ranges[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def text(path: Path, ranges: list[np.ndarray]) -> Path:
    lines = []
    for some, pose in zip(ranges, np.round(poses(len(ranges)), 4)):
        lines += [f"{pose[0]:.4f} {pose[1]:.4f} {x:.4f} {y:.4f}\n" for x, y in ends(some, pose)]
    path.write_text("".join(lines))
    return path


def npz(path: Path, ranges: list[np.ndarray], far: float = 0.0, **more: np.ndarray) -> Path:
    np.savez(
        path,
        origins=poses(len(ranges))[:, :2] + far,
        points=np.concatenate([ends(*one) + far for one in zip(ranges, poses(len(ranges)))]).astype("f4"),
        offsets=np.cumsum([0, *map(len, ranges)]),
        **more,
    )
    return path


def kitti(path: Path, ranges: list[np.ndarray]) -> Path:
    scans = path / "velodyne"
    scans.mkdir(parents=True)
    for i, some in enumerate(ranges):
        points = np.zeros((len(some), 4), dtype="<f4")
        points[:, :2] = ends(some, np.zeros(3))
        points.tofile(scans / f"{i:06d}.bin")
    (path / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    row = "1 0 0 {} 0 1 0 0 0 0 1 0"
    (path / "poses.txt").write_text("".join(row.format(0.1 * i) + "\n" for i in range(len(ranges))))
    return path


def made(kind: str, folder: Path, ranges: list[np.ndarray]) -> Log:
    return ndtree.read({
        "carmen": lambda: carmen(folder / "a.log", ranges),
        "packed": lambda: carmen(folder / "a.log.gz", ranges),
        "text": lambda: text(folder / "a.txt", ranges),
        "npz": lambda: npz(folder / "a.npz", ranges),
        "kitti": lambda: kitti(folder / "run", ranges),
    }[kind]())  # fmt: skip


def silent(log: Log) -> list[np.ndarray]:
    return [np.zeros(len(scan), bool) if scan.returned is None else ~scan.returned for scan in log]


KINDS = ("carmen", "packed", "text", "npz", "kitti")


@pytest.mark.parametrize("kind", KINDS)
def test_readings_at_the_largest_range_did_not_return(kind: str, tmp_path: Path) -> None:
    ranges = ranges_of()
    log = made(kind, tmp_path, ranges)
    for _ in range(2):  # Every loop is the same.
        found = silent(log)
        assert len(found) == len(ranges)
        for mine, right in zip(found, ranges):
            np.testing.assert_array_equal(mine, right == LIMIT)
        assert log.cut_off == pytest.approx(LIMIT, abs=1e-3)
    assert log.knows_no_returns and not log.skipped
    half = log.select(every=2)
    assert not np.concatenate(silent(half)).any()


@pytest.mark.parametrize("kind", KINDS)
def test_a_largest_range_that_was_measured_is_a_surface(kind: str, tmp_path: Path) -> None:
    """One reading a scan may be there, and several may be at any other range."""
    ranges = ranges_of(cut=1)
    for some in ranges:
        some[:9] = 17.0
    log = made(kind, tmp_path, ranges)
    assert not np.concatenate(silent(log)).any() and log.cut_off is None


def test_a_round_room_is_not_open_space(tmp_path: Path) -> None:
    log = ndtree.read(npz(tmp_path / "a.npz", [np.full(90, 5.0)] * 3))
    assert not np.concatenate(silent(log)).any()


def test_ranges_in_whole_steps_come_twice_without_being_a_limit(tmp_path: Path) -> None:
    ranges = [2 + 0.01 * ((i * np.arange(60)) % 50) for i in range(20)]
    for log in (carmen(tmp_path / "a.log", ranges), npz(tmp_path / "a.npz", ranges)):
        assert ndtree.read(log).cut_off is None


def noisy(ranges: list[np.ndarray], seed: int = 5, sigma: float = 0.04) -> list[np.ndarray]:
    """Noise on top of all, cut off at the limit: what a simulator makes of it."""
    generator = np.random.default_rng(seed)
    return [np.minimum(some + generator.normal(0, sigma, len(some)), LIMIT) for some in ranges]


@pytest.mark.parametrize("seed", range(8))
def test_noise_at_the_largest_range_is_no_surface_either(seed: int, tmp_path: Path) -> None:
    ranges = ranges_of(scans=40, seed=seed)
    log = ndtree.read(npz(tmp_path / "a.npz", noisy(ranges, seed)))
    found, right = np.concatenate(silent(log)), np.concatenate(ranges) == LIMIT
    assert not found[~right].any() and np.count_nonzero(right & ~found) <= 2


def wall_below(depth: float, count: int, generator: np.random.Generator) -> np.ndarray:
    """How far below the limit a wall is read that is so far below it at right angles [m]."""
    turned = np.tan(generator.uniform(0, math.acos((LIMIT - depth) / LIMIT), count))
    return LIMIT - (LIMIT - depth) * np.hypot(1, turned)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("depth", [0.5, 2.0, 5.0])
def test_a_wall_just_below_the_largest_range_is_no_noise(depth: float, seed: int) -> None:
    """At right angles so far below the limit, or equally dense up to it."""
    generator = np.random.default_rng(seed)
    wall = wall_below(depth, 300, generator)
    for below in (wall, generator.uniform(0, depth, 300)):
        assert all(noise_below(below[:n], there) == 0 for n in (100, 300) for there in (70, 150, 300))


@pytest.mark.parametrize("seed", range(8))
def test_noise_on_one_side_of_range_max_is_no_surface(seed: int) -> None:
    """Readings above it fell out, as +inf or altogether."""
    generator = np.random.default_rng(seed)
    ranges, sigma = ranges_of(scans=240, seed=seed), 10 ** generator.uniform(-2.5, -1)
    for above in (np.inf, np.nan, None):  # None: no noise upwards.
        noise, seen = NoiseAtLimit(), []
        for some in ranges:
            there = some == LIMIT
            error = generator.normal(0, sigma, len(some))
            read = some - np.where(there & (above is None), np.abs(error), error)
            read = np.where(read >= LIMIT, np.nan if above is None else above, read)
            seen.append(np.where(there, read, some))
            reach = noise.add(seen[-1].astype(np.float32), LIMIT)
        below = np.concatenate(seen) < LIMIT
        silent = below & (np.concatenate(seen) >= LIMIT - reach)
        right = below & (np.concatenate(ranges) == LIMIT)
        assert np.count_nonzero(right) > 512 and np.count_nonzero(right & ~silent) <= 2
        assert not (silent & ~right).any()


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("depth", [0.5, 2.0, 5.0])
def test_walls_below_the_largest_range_are_no_noise_on_one_side(depth: float, seed: int) -> None:
    generator = np.random.default_rng(seed)
    wall = wall_below(depth, 3000, generator)
    for below in (wall, generator.uniform(0, depth, 3000), np.abs(depth + generator.normal(0, 0.1, 3000))):
        assert all(noise_below_alone(below[:n], 0.1 * LIMIT) == 0 for n in (600, 3000))


def test_few_readings_do_not_tell_noise_on_one_side_from_surfaces() -> None:
    below = np.abs(np.random.default_rng(0).normal(0, 0.1, 2000))
    assert noise_below_alone(below, 5.0) == pytest.approx(0.4, rel=0.1)
    assert noise_below_alone(below[:511], 5.0) == 0 and noise_below_alone(below, 0.6) == 0


@pytest.mark.parametrize("seed", range(4))
def test_a_bell_around_the_largest_range_is_told_from_surfaces(seed: int) -> None:
    random = np.random.default_rng(seed)
    bell = random.normal(0.3, 0.05, 4000)
    surfaces = random.uniform(1.0, 5.0, 4000)
    assert noise_around(np.r_[bell, surfaces] - bell.min(), 5.0) == pytest.approx(
        (0.3 + 4 * 0.05 - bell.min(), 0.05, True), rel=0.1
    )
    assert noise_around(random.uniform(0.0, 5.0, 8000), 5.0) == (0.0, 0.0, False)
    even = np.round(random.uniform(0.0, 0.1, 8000), 3)
    found = noise_around(np.r_[even, surfaces], 5.0)
    assert found == pytest.approx((0.05 + 4 * 0.029, 0.029, False), rel=0.1)


def test_a_largest_reading_below_range_max_is_no_surface() -> None:
    ranges = ranges_of(scans=40)
    below = [np.minimum(some, 0.99 * LIMIT).astype(np.float32) for some in ranges]
    noise = NoiseAtLimit()
    reach = [noise.add(some, LIMIT) for some in below][-1]
    silent = np.concatenate([np.abs(some - LIMIT) <= reach for some in below])
    np.testing.assert_array_equal(silent, np.concatenate(ranges) >= np.float32(0.99 * LIMIT))
    round_room, steps = NoiseAtLimit(), NoiseAtLimit()
    assert not any(round_room.add(np.full(90, 0.99 * LIMIT, np.float32), LIMIT) for _ in range(3))
    walls = [np.round(0.95 * LIMIT - 0.01 * ((i * np.arange(60)) % 50), 2) for i in range(20)]
    assert not any(steps.add(some.astype(np.float32), LIMIT) for some in walls), "ranges in whole steps"


def test_a_huge_mark_of_silent_beams_rounds_no_readings() -> None:
    """Readings are as exact as their own float32s, however large the mark is."""
    random = np.random.default_rng(1)
    search = CutOffSearch(says_itself=False)
    for _ in range(20):
        ranges = np.append(random.uniform(1, 4, 100), np.full(100, 1e6))
        search.add(ndtree.Scan(ranges[:, None] * [1.0, 0.0], np.zeros(2), returned=ranges < 1e6))
    assert search.found() is None


def test_marks_of_the_file_say_it_all(tmp_path: Path) -> None:
    ranges = ranges_of()
    marks = np.concatenate(ranges) == LIMIT
    marks[np.flatnonzero(marks)[5:]] = False
    log = ndtree.read(npz(tmp_path / "a.npz", ranges, no_return=marks))
    np.testing.assert_array_equal(np.concatenate(silent(log)), marks)


def test_far_from_the_origin_float32_still_tells(tmp_path: Path) -> None:
    ranges = ranges_of()
    log = ndtree.read(npz(tmp_path / "a.npz", ranges, far=2000.0))
    np.testing.assert_array_equal(np.concatenate(silent(log)), np.concatenate(ranges) == LIMIT)


def test_damage_is_told_of_once_and_where_it_is(tmp_path: Path) -> None:
    path = carmen(tmp_path / "a.log", ranges_of())
    lines = path.read_text().splitlines(keepends=True)
    lines[7] = "FLASER 3 1 2\n"
    path.write_text("".join(lines))
    log = ndtree.read(path)
    scans = iter(log)
    for _ in range(7):
        next(scans)
    with pytest.raises(ValueError, match="line 8"):
        next(scans)
    kept = ndtree.read(path, keep_going=True)
    assert len(list(kept)) == 11 and kept.skipped["damaged lines"].count == 1
    assert "line 8" in kept.skipped["damaged lines"].first


def test_ignored_ones_are_left_out_whatever_the_range(tmp_path: Path) -> None:
    """Not even up to `max_range` do they say that space is free."""
    log = made("carmen", tmp_path, ranges_of())
    report = ndtree.compare(log, ["adaptive"], no_return="ignore", max_range=40, held_out=0)
    assert report["beams"]["not_returned"] == 0 and report["beams"]["beyond_max_range"] == 0
