# SPDX-License-Identifier: BSD-3-Clause
"""A wrong mount, clock or scale of a planar laser is told, also a mirror; right ones are not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import START, Messages, write_bag
from planes import box, ranges_to, rays

from ndtree.alignment.planar import Floats, between, composed, placed
from ndtree.alignment.surfaces import Cloud
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import spread
from ndtree.logs import read
from ndtree.tuning.first_look import first_look
from ndtree.tuning.mismatch import Mismatch, mismatch
from ndtree.tuning.setup import setup_error
from ndtree.tuning.setup_error import APART, SetupError, fits_of, likeliest

CORNERS = np.array([[0, 0], [9, 0], [9, 4], [6, 4], [6, 7], [0, 7]], dtype=float)
#: Walls of a room with a pillar [m].
WALLS = np.concatenate([np.stack([CORNERS, np.roll(CORNERS, -1, axis=0)], axis=1), box(3.0, 3.0, 0.6, 0.8)])
ANGLES = np.radians(np.arange(-135, 135))
EVERY = 0.1  # [s]


def drive(times: Floats) -> Floats:
    """Poses (n, 3): about the pillar in bends, at a speed that changes."""
    at = 0.5 * times + 0.35 * np.sin(0.9 * times)
    x, y = 3.4 + 1.9 * np.sin(0.7 * at), 2.9 + 1.6 * np.sin(1.4 * at + 0.4)
    yaw = 0.9 * np.sin(1.1 * at) + 0.5 * at
    return np.column_stack([x, y, yaw])


def log_of(
    told: Callable[[Floats], Floats] = drive,
    seen: Callable[[Floats], Floats] = lambda readings: readings,
    seed: int = 0,
    sigma: float = 0.01,
) -> list[Scan]:
    """Scans that a robot measures on `drive`, and places as it tells its poses."""
    rng = np.random.default_rng(seed)
    scans = []
    for stamp in EVERY * np.arange(120):
        exact = ranges_to(WALLS, drive(np.array([stamp]))[0], ANGLES)
        points = seen(exact + rng.normal(0, sigma, len(ANGLES)))[:, None] * rays(ANGLES)
        pose = told(np.array([stamp]))[0]
        scans.append(Scan(placed(pose, points), pose[:2], stamp=100 + float(stamp), heading=float(pose[2])))
    return scans


def found_in(scans: list[Scan]) -> SetupError | None:
    runs = spread(scans, None, Cloud.of)[0]
    return setup_error([[one for one in run if one is not None] for run in runs])


def mismatch_in(scans: list[Scan]) -> Mismatch | None:
    return mismatch(spread(scans, keep=Cloud.of)[0])


def mounted(mount: list[float]) -> Callable[[Floats], Floats]:
    """The laser sits at `mount`, as seen from where its poses say."""
    inverse = composed(np.zeros(3), np.array([0, 0, -mount[2]]))
    back = placed(inverse, -np.array([mount[:2]]))[0]
    return lambda times: composed(drive(times), np.append(back, -mount[2]))


@pytest.mark.parametrize("seed, sigma", [(i, 0.02 * (i % 2)) for i in range(6)])
def test_what_is_right_is_not_told_of(seed: int, sigma: float) -> None:
    """Each pose errs by itself, as those of a SLAM system do."""
    noise = ([0.01, 0.01, 0.004], [0.03, 0.03, 0.01], [0.005, 0.005, 0.02])[seed // 2]
    jitter = np.random.default_rng(seed).normal(0, noise, (120, 3))

    def told(times: Floats) -> Floats:
        return drive(times) + jitter[np.rint(times / EVERY).astype(int)]

    assert found_in(log_of(told, seed=seed, sigma=sigma)) is None


@pytest.mark.parametrize("degrees", [-12.0, 4.0])
def test_a_turned_mount(degrees: float) -> None:
    found = found_in(log_of(mounted([0, 0, math.radians(degrees)])))
    assert found is not None and found.kind == "yaw" and found.apart is not None and found.apart > APART
    assert math.degrees(found.values[0]) == pytest.approx(degrees, rel=0.25)
    assert f"further to the {'left' if degrees > 0 else 'right'}" in str(found) and "mount" in str(found)


@pytest.mark.parametrize("degrees", [90, -90, 180])
def test_a_laser_that_looks_aside_or_back(degrees: float) -> None:
    found = found_in(log_of(mounted([0, 0, math.radians(degrees)])))
    assert found is not None and found.kind == "yaw"
    assert abs((math.degrees(found.values[0]) - degrees + 180) % 360 - 180) < 5


def test_a_mount_that_is_turned_and_moved() -> None:
    found = found_in(log_of(mounted([0.2, -0.25, 0.1])))
    assert found is not None and found.kind == "mount"
    assert np.linalg.norm(np.array(found.values) - [0.1, 0.2, -0.25]) < 0.12


def test_a_robot_that_stands_or_slips_is_no_setup() -> None:
    noise = np.random.default_rng(3).normal(0, [0.03, 0.03, 0.01], (120, 3))
    begin = drive(np.zeros(1))[0]
    points = ranges_to(WALLS, begin, ANGLES)[:, None] * rays(ANGLES)
    still = [
        Scan(placed(begin + e, points), (begin + e)[:2], stamp=float(i), heading=float(begin[2] + e[2]))
        for i, e in enumerate(noise)
    ]
    assert found_in(still) is None
    true = drive(EVERY * np.arange(120))
    told = [true[0]]
    for i, step in enumerate(between(true[:-1], true[1:])):
        told.append(composed(told[-1], step * ([0.5, 0.5, 1] if i > 60 else [1, 1, 1])))
    assert found_in(log_of(lambda times: np.array(told)[np.rint(times / EVERY).astype(int)])) is None


def test_without_times_no_late_clock_is_taken_for_a_mount() -> None:
    late = log_of(lambda times: drive(times - 0.15))
    assert found_in([replace(scan, stamp=0.0) for scan in late]) is None


@pytest.mark.parametrize("has_times", [True, False])
@pytest.mark.parametrize("place", [[0.25, 0.0], [-0.1, 0.2], [0.0, -0.3]])
def test_a_moved_mount(place: list[float], has_times: bool) -> None:
    scans = log_of(mounted([*place, 0.0]))
    found = found_in(scans if has_times else [replace(scan, stamp=0.0) for scan in scans])
    assert found is not None and found.kind == "place"
    assert np.linalg.norm(np.array(found.values) - place) < 0.3 * np.linalg.norm(place)


@pytest.mark.parametrize("seconds", [-0.25, 0.1])
def test_a_wrong_clock(seconds: float) -> None:
    """What is told to add to the times of scans mends it."""
    found = found_in(log_of(lambda times: drive(times - seconds)))
    assert found is not None and found.kind == "clock"
    assert found.values[0] == pytest.approx(seconds, rel=0.3)
    assert "time_offset" in str(found)


@pytest.mark.parametrize("share", [-0.1, 0.06])
def test_wrong_units(share: float) -> None:
    found = found_in(log_of(seen=lambda readings: readings * (1 + share)))
    assert found is not None and found.kind == "scale"
    assert found.values[0] == pytest.approx(share, rel=0.25)
    assert f"% {'more' if share > 0 else 'less'} than the poses say" in str(found)


@pytest.mark.parametrize(
    ("told", "ranges", "kind", "values"),
    [
        ([1000, 1000, 1], 1, "unit", (0.001,)),
        ([1, 1, 1], 100, "unit", (100.0,)),
        ([1, 1, math.degrees(1)], 1, "degrees", ()),
    ],
)
def test_numbers_in_other_units(
    told: list[float], ranges: float, kind: str, values: tuple[float, ...]
) -> None:
    found = found_in(log_of(lambda times: drive(times) * told, lambda readings: ranges * readings))
    assert found is not None and (found.kind, found.values) == (kind, values)


def test_turns_that_are_measured_wrongly() -> None:
    """Odometry adds up steps, each of which turns by a share of what it should."""
    true = drive(EVERY * np.arange(120))
    told = [true[0]]
    for step in between(true[:-1], true[1:]):
        told.append(composed(told[-1], step * [1, 1, 0.85]))
    found = found_in(log_of(lambda times: np.array(told)[np.rint(times / EVERY).astype(int)]))
    assert found is not None and found.kind == "turns"
    assert found.values[0] == pytest.approx(1 / 0.85 - 1, rel=0.3)


def test_a_mirrored_laser_and_angles_of_the_other_sign() -> None:
    for kind, words, scans in (
        ("mirrored", "upside down", log_of(seen=lambda readings: readings[::-1])),
        ("mirrored", "upside down", log_of(lambda times: drive(times) * [1, -1, -1], seed=1)),
        ("signs", "to the left", log_of(lambda times: drive(times) * [1, 1, -1])),
    ):
        found = found_in(scans)
        assert found is not None and found.kind == kind and words in str(found)


def test_poses_of_the_map_as_the_robot_sees_it() -> None:
    found = found_in(log_of(lambda times: between(drive(times), np.zeros((len(times), 3)))))
    assert found is not None and found.kind == "inverted"


def test_a_pose_that_jumps_is_told_of_with_the_time() -> None:
    """Poses begin at the frame's origin, as before a robot is localized."""

    def told(times: Floats) -> Floats:
        return np.where((times < 0.25)[:, None], [-7.0, 2.0, 0.0], drive(times))

    found = mismatch_in(log_of(told))
    assert found is not None and found.kind == "jump" and found.since == pytest.approx(0.3)

    def turned(times: Floats) -> Floats:
        return np.where((times < 0.25)[:, None], drive(times) * [1, 1, 0] + [0, 0, 2.0], drive(times))

    found = mismatch_in(log_of(turned))
    assert found is not None and found.kind == "jump" and found.since == pytest.approx(0.3)
    assert mismatch_in(log_of()) is None
    slow = [scan for i, scan in enumerate(log_of()) if i % 10 == 0 or i > 60]
    assert mismatch_in(slow) is None, "the robot did move"


def test_what_tells_too_little_says_nothing() -> None:
    for count in (1, 2, 4, 7):
        assert found_in(log_of()[:count]) is None
    scans = log_of()
    assert found_in([]) is None and found_in(scans[:8]) is None
    assert found_in([scans[0]] * 40) is None
    without = [Scan(scan.endpoints, scan.origin, stamp=scan.stamp) for scan in log_of(mounted([0, 0, 0.2]))]
    assert found_in(without) is None, "mounts are of headings"


def test_causes_that_explain_as_much_are_all_named() -> None:
    slopes = np.zeros((24, 3, 3))
    slopes[:, 0, :2] = 1.0  # Two explain the same, the third one nothing.
    errors = 0.2 * slopes[:, :, 0] + np.random.default_rng(5).normal(0, 0.01, (24, 3))
    fits = fits_of(
        errors, slopes, np.tile(100 * np.eye(3), (24, 1, 1)), {"yaw": [0], "scale": [1], "turns": [2]}
    )
    assert set(likeliest(100 * errors, fits)) == {"yaw", "scale"}
    assert likeliest(0.1 * errors, fits) == [], "no error is to be explained"
    both = str(SetupError("yaw", (0.1,), 0.5, others=(SetupError("scale", (0.1,), 0.5),)))
    assert "6 degrees further to the left, or the way was 10 % more" in both and both.count("check") == 2


@pytest.mark.parametrize("wrong", ["", "/front", "/rear"])
def test_of_several_lasers_the_one_is_named_that_is_turned(wrong: str, tmp_path: Path) -> None:
    make, rng = Messages("mcap"), np.random.default_rng(4)
    sides = {"/front": (0.3, 0.0), "/rear": (-0.3, math.pi)}
    rows = []
    for name, (x, yaw) in sides.items():
        told = yaw + (0.2 if name == wrong else 0.0)
        turn = (0, 0, math.sin(told / 2), math.cos(told / 2))
        rows.append(make.fixed(START, "base_link", name[1:], (x, 0, 0), turn))
    for stamp in EVERY * np.arange(120):
        (pose,) = drive(np.array([stamp]))
        turn = (0, 0, math.sin(pose[2] / 2), math.cos(pose[2] / 2))
        rows.append(make.moved(START + stamp, "odom", "base_link", (*pose[:2], 0), turn))
        for name, (x, yaw) in sides.items():
            readings = ranges_to(WALLS, composed(pose, np.array([x, 0, yaw])), ANGLES)
            readings = readings + rng.normal(0, 0.01, len(ANGLES))
            angles = {"angle_min": ANGLES[0], "angle_increment": ANGLES[1] - ANGLES[0]}
            rows.append((name, START + stamp, make.laser(START + stamp, name[1:], readings, **angles)))
    bag = write_bag(tmp_path / "bag", make, sorted(rows, key=lambda row: row[1]))
    found = first_look(read(bag, topic=list(sides)), with_sigma=False).setup
    if not wrong:
        assert found is None
        return
    assert found is not None and found.kind == "yaw" and f"scans of {wrong} in {wrong[1:]}." in str(found)
    assert found.values[0] == pytest.approx(-0.2, rel=0.25)


@pytest.mark.parametrize(("scale", "causes"), [(-0.85, ["yaw"]), (-0.75, ["scale"])])
def test_that_nothing_moved_is_no_cause(scale: float, causes: list[str]) -> None:
    """A scale that leaves a fifth of the way or less explains the most, and is left out."""
    errors = np.full((40, 3), 5.0)
    fits = {"scale": (np.array([scale]), 0.0 * errors), "yaw": (np.array([0.1, 0.0]), 0.2 * errors)}
    assert likeliest(errors, fits) == causes
