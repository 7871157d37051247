# SPDX-License-Identifier: BSD-3-Clause
"""Poses of scans in maps: the best of the window, with any number of threads."""

from __future__ import annotations

import copy
import math
import pickle
import subprocess
import sys

import numpy as np
import pytest

import ndtree

RNG = np.random.default_rng(3)


def room(spacing: float) -> np.ndarray:
    """Walls of a room that looks different from everywhere."""
    corners = (-4, 3.5), (-4, -3), (5, -3), (5, 3.5)
    lines = [*zip(corners, corners[1:]), ((-4, 3.5), (1, 3.5)), ((2, 1.5), (2, 3.5))]
    return np.concatenate([np.linspace(a, b, int(math.dist(a, b) / spacing) + 1) for a, b in lines])


def seen_from(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return (points - pose[:2]) @ np.array([[c, -s], [s, c]])


def pose_of(match: ndtree.Match) -> np.ndarray:
    return np.array([match.pose[0, 2], match.pose[1, 2], math.atan2(match.pose[1, 0], match.pose[0, 0])])


def room_map() -> ndtree.AdaptiveMap:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, max_cell_size=0.8, range_sigma=0.01)
    for origin in ((0.5, -0.5), (-2.0, 1.0), (3.5, 0.0)):
        m.insert(room(0.02), origin)
    return m


@pytest.mark.parametrize("cell, beams", [(0.025, 90), (0.1, 720)])
def test_errors_are_as_large_as_told(cell, beams):
    rng, ratios = np.random.default_rng(8), []
    for _ in range(15):  # Walls are anywhere in the cells.
        corner, size = rng.uniform(-0.1, 0.1, 2), rng.uniform((5, 4), (7, 6))
        m = ndtree.AdaptiveMap(dim=2, min_cell_size=cell, range_sigma=0.01)
        for _ in range(15):
            pose = rng.uniform((0.5, 0.5, -3), (4.5, 3.5, 3))
            m.insert(seen_from(box_scan(pose, corner, size, 360, rng), inverse(pose)), pose[:2])
        matcher = m.matcher()
        for _ in range(3):
            pose = rng.uniform((0.5, 0.5, -3), (4.5, 3.5, 3))
            guess = pose + np.array([0.05, -0.05, 0.02])
            found = matcher.match(box_scan(pose, corner, size, beams, rng), guess, window=(0.2, 0.2, 0.1))
            ratios.append((pose_of(found) - pose) / np.sqrt(np.diag(found.covariance)))
    assert (np.sqrt(np.mean(np.square(ratios), axis=0)) < 1.5).all()
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.3


def box_scan(pose, corner, size, beams, rng):
    """What a laser in a room of four walls sees, with noise."""
    angles = np.linspace(-math.pi, math.pi, beams, endpoint=False)
    ways = np.column_stack((np.cos(angles + pose[2]), np.sin(angles + pose[2])))
    ranges = (np.where(ways > 0, corner + size, corner) - pose[:2]) / ways
    ranges = ranges.min(axis=1) + rng.normal(0, 0.01, beams)
    return ranges[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))


def inverse(pose):
    return np.array([*seen_from(np.zeros((1, 2)), pose)[0], -pose[2]])


def test_a_corridor_keeps_what_was_known_before():
    x = np.arange(-20, 20, 0.02)
    walls = np.concatenate([np.column_stack((x, np.full(len(x), y))) for y in (-1.01, 1.02)])
    c, s = math.cos(0.4), math.sin(0.4)
    turn = np.array([[c, s], [-s, c]])
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, range_sigma=0.01)
    for way in range(-15, 16):
        m.insert(walls[np.abs(walls[:, 0] - way) < 5] @ turn, np.array([way, 0.0]) @ turn)
    scan = walls[np.abs(walls[:, 0]) < 5][::9] + np.array([0.003, -0.2])  # From (0, 0.2).
    sigma = 0.1
    prior = np.diag(np.array([sigma, sigma, 0.02]) ** -2.0)
    guess = np.array([*(np.array([0.3, 0.25]) @ turn), 0.4])
    found = m.matcher().match(scan, guess, window=(0.3, 0.3, 0.06), information=prior)
    off = (pose_of(found)[:2] - guess[:2]) @ turn.T
    told = turn @ found.covariance[:2, :2] @ turn.T
    assert abs(off[0]) < 0.3 * sigma and abs(off[1] + 0.05) < 0.02
    assert 0.8 * sigma < math.sqrt(told[0, 0]) < 1.5 * sigma and math.sqrt(told[1, 1]) < 0.02


def test_a_map_finds_scans_as_its_matcher_does():
    m, pose = room_map(), np.array([0.4, -0.3, 1.2])
    points, guess = seen_from(room(0.09), pose), pose + np.array([0.5, -0.4, 0.2])
    found = m.match(points, guess, window=(1, 1, 0.35))
    assert np.abs(pose_of(found) - pose).max() < 0.03 and found.is_unique
    again = m.matcher().match(points, guess, window=(1, 1, 0.35))
    np.testing.assert_array_equal(again.pose, found.pose)
    np.testing.assert_array_equal(again.covariance, found.covariance)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_many_scans_are_the_same_with_any_threads(threads):
    matcher = ndtree.Matcher(room(0.03))
    poses = RNG.uniform((-1, -1, -3), (1, 1, 3), (12, 3))
    scans = [seen_from(room(0.2), pose) for pose in poses]
    guesses = poses + 0.1
    many = matcher.match_all(scans, guesses, window=(0.3, 0.3, 0.2), threads=threads)
    for scan, guess, found in zip(scans, guesses, many):
        alone = matcher.match(scan, guess, window=(0.3, 0.3, 0.2))
        np.testing.assert_array_equal(alone.pose, found.pose)
        np.testing.assert_array_equal(alone.covariance, found.covariance)
        assert (alone.score, alone.second, alone.inliers) == (found.score, found.second, found.inliers)


@pytest.mark.parametrize("option", ["cell_size", "sigma", "radius"])
def test_an_option_that_is_no_number_is_named(option: str):
    make = room_map().matcher
    with pytest.raises(TypeError, match=rf"{option} = 'x': must be a number$"):
        make(**{option: "x"})
    if option == "cell_size":
        with pytest.raises(TypeError, match=r"cell_size = 'x': must be a number$"):
            room_map().match(room(0.5), (0, 0, 0), window=(1, 1, 1), cell_size="x")


def test_a_far_point_is_named_and_not_the_window():
    points = np.concatenate([room(0.5), [[3e7, 0]]])
    matcher = ndtree.Matcher(room(0.5))
    for match in (room_map().match, matcher.match, matcher.modes):
        with pytest.raises(ValueError, match=r"points: the farthest is 30000000(\.0)? m away"):
            match(points, (0, 0, 0), window=(1, 1, 1))


def test_modes_are_the_best_poses_apart_from_each_other():
    """Two rooms that are the same, but for a box in one of them."""
    one, box = room(0.05), np.column_stack((np.linspace(1, 1.5, 11), np.full(11, 1.0)))
    matcher = ndtree.Matcher(np.concatenate([one, box, one + np.array([20, 0])]))
    scan = np.concatenate([one, box]) - (0.4, 0.3)
    found = matcher.modes(scan, (10, 0, 0), window=(12, 1, 0.1), most=3, apart=2.0)
    assert len(found) >= 2 and min(found[0].score, found[1].score) > 2 * found[2].score
    np.testing.assert_allclose(found[0].pose[:2, 2], (0.4, 0.3), atol=0.02)
    np.testing.assert_allclose(found[1].pose[:2, 2], (20.4, 0.3), atol=0.02)
    both = matcher.match(scan, (10, 0, 0), window=(12, 1, 0.1), apart=2.0)
    assert both.score == found[0].score and both.second == pytest.approx(found[1].score)
    assert matcher.score(scan, (0.4, 0.3, 0)) > 0.7 > 2 * matcher.score(scan, (0.6, 0.2, 0))
    assert matcher.score(np.zeros((0, 2)), (0, 0, 0)) == 0.0
    assert matcher.modes(np.zeros((0, 2)), (0, 0, 0), window=(1, 1, 0)) == []


def test_matches_can_be_shown_copied_and_pickled():
    found = ndtree.Matcher(room(0.05)).match(room(0.3), (0, 0, 0), window=(0.1, 0.1, 0.1))
    for again in (copy.deepcopy(found), pickle.loads(pickle.dumps(found))):
        np.testing.assert_array_equal(again.pose, found.pose)
        assert again.score == found.score
    assert "unique" in repr(found) and ndtree.Matcher(room(0.5)).dim == 2


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: ndtree.Matcher(np.zeros((3, 4))), "points has shape"),
        (lambda: ndtree.Matcher(room(0.5)).modes(room(0.5), (0, 0, 0), window=(1, 1, 1), most=0), "most = 0"),
        (lambda: ndtree.Matcher(room(0.5)).score(room(0.5), (0, 0)), "pose"),
        (lambda: ndtree.Matcher(room(0.5), cell_size=0), "cell_size = 0"),
        (lambda: ndtree.Matcher(room(0.5)).match(room(0.5), (0, 0, 0), window=(1, 1)), "window has shape"),
        (lambda: ndtree.Matcher(room(0.5)).match(room(0.5), (0, 0, 0), window=(-1, 1, 1)), "window = -1"),
        (lambda: ndtree.Matcher(room(0.5)).match(room(0.5), (0, 0), window=(1, 1, 1)), "guess"),
        (
            lambda: ndtree.Matcher(room(0.5)).match(room(0.5), (0, 0, 0), window=(1, 1, 1), apart=0),
            "apart = 0",
        ),
        (lambda: ndtree.Matcher(room(0.5)).match_all([room(0.5)], [], window=(1, 1, 1)), "guesses"),
        (lambda: room_map().match(room(0.5), (0, 0, 0), window=(math.inf, 1, 1)), "window = inf"),
        (lambda: ndtree.AdaptiveMap(dim=4).match(room(0.5), (0, 0, 0), window=(1, 1, 1)), "dim = 4"),
    ],
)
def test_wrong_calls_are_named(call, says):
    with pytest.raises(ValueError, match=says.replace("(", r"\(")):
        call()


def test_far_points_take_memory_of_their_surface_alone() -> None:
    """Two points 87 m apart in space are a box of 10^9 cells; what is near them is thousands."""
    code = (
        "import resource, numpy as np, ndtree\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "before = peak()\n"
        "m = ndtree.Matcher(np.array([[0.0, 0.0, 0.0], [50.0, 50.0, 50.0]]))\n"
        "assert m.score(np.array([[50.0, 50.0, 50.0]]), np.eye(4)) > 0.5\n"
        "print(peak() - before)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 150_000  # KiB
