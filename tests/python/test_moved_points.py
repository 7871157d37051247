# SPDX-License-Identifier: BSD-3-Clause
"""Points are moved by sums in one order: the same bits as Python's own numbers, whatever the processor."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ndtree.logs.core.silence import NEAREST, without_padding
from ndtree.logs.folders.depth_image import Camera, points_of
from ndtree.logs.poses.pose import Pose, multiplied, rotated
from ndtree.logs.poses.transforms import TransformTree
from ndtree.logs.ros.messages.beams import Beams
from ndtree.logs.ros.messages.sweep import BLOCK, in_map

SEED = 11


def some_pose(generator: np.random.Generator) -> Pose:
    quaternion = generator.normal(size=4)
    return Pose.from_quaternion(generator.normal(size=3), quaternion / np.linalg.norm(quaternion))


def by_hand(pose: Pose, point: list[float]) -> list[float]:
    """As IEEE numbers say, each product and each sum rounded."""
    rows, position = pose.rotation.tolist(), pose.position.tolist()
    return [row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + p for row, p in zip(rows, position)]


@pytest.mark.parametrize("n", [0, 1, 7, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK + 5])
def test_points_are_moved_as_by_hand(n: int) -> None:
    generator = np.random.default_rng(SEED)
    pose, points = some_pose(generator), generator.normal(0, 20, (n, 3))
    moved = pose.apply(points)
    assert moved.shape == (n, 3) and moved.dtype == np.float64
    assert moved.tolist() == [by_hand(pose, point) for point in points.tolist()]
    for same in (np.asfortranarray(points), np.repeat(points, 2, axis=0)[::2], points.tolist() or points):
        assert np.array_equal(pose.apply(same), moved)
    single = points.astype(np.float32)
    assert np.array_equal(pose.apply(single), pose.apply(single.astype(np.float64)))


def test_what_is_not_finite_stays_so() -> None:
    pose = some_pose(np.random.default_rng(SEED))
    points = np.array([[np.nan, 1, 2], [np.inf, 0, 0], [1, 2, 3]])
    assert np.isfinite(pose.apply(points)).all(axis=1).tolist() == [False, False, True]


def test_poses_follow_each_other() -> None:
    generator, tried = np.random.default_rng(SEED), 0
    for _ in range(50):
        one, other, points = some_pose(generator), some_pose(generator), generator.normal(size=(9, 3))
        assert np.allclose((one @ other).apply(points), one.apply(other.apply(points)), atol=1e-12)
        assert np.allclose(one.inverse().apply(one.apply(points)), points, atol=1e-12)
        assert (one @ other).position.tolist() == by_hand(one, other.position.tolist())
        many = np.stack([one.rotation, other.rotation])
        assert np.allclose(multiplied(many, other.rotation), many @ other.rotation, atol=1e-15)
        assert np.allclose(rotated(many, points[:2]), np.einsum("nij,nj->ni", many, points[:2]), atol=1e-14)
        tried += 1
    assert tried == 50


@pytest.mark.parametrize("n", [1, 500, BLOCK + 3])
def test_each_beam_has_the_pose_of_its_own_time(n: int) -> None:
    generator = np.random.default_rng(SEED)
    tree = TransformTree()
    for i in range(40):
        half = 0.01 * i
        turn = [0, 0, math.sin(half), math.cos(half)]
        tree.add("map", "sensor", 0.1 * i, [0.3 * i, 0.02 * i * i, 0], turn)
    times = np.round(generator.uniform(0, 0.1, n) / 0.004) * 0.004  # Where nothing is interpolated.
    times[0] = 0.0
    points = generator.normal(0, 5, (n, 3)).astype(np.float32)
    ends, _ = in_map(tree, "map", "sensor", Beams(points, times=times), 2.03)
    which = generator.integers(0, n, 100)
    for i in which.tolist():
        expected = tree.pose_at("map", "sensor", 2.03 + times[i]).apply(points[i : i + 1])[0]
        assert np.allclose(ends[i], expected, atol=1e-9)


@pytest.mark.parametrize("stride", [1, 2, 3])
@pytest.mark.parametrize("kind", ["u2", "f4"])
def test_pixels_become_points_as_by_hand(stride: int, kind: str) -> None:
    generator = np.random.default_rng(SEED)
    camera = Camera(52.5, 51.0, 31.5, 24.25, 1000.0)
    image = generator.uniform(300, 5000, (48, 64)).astype(kind)
    image[generator.random(image.shape) < 0.2] = 0
    points = points_of(image, camera, pixel_stride=stride)
    expected = []
    for v in range(stride // 2, 48, stride):
        for u in range(stride // 2, 64, stride):
            depth = float(image[v, u])
            if depth > 0:
                x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
                expected.append([x / 1000.0 * depth, y / 1000.0 * depth, 1.0 / 1000.0 * depth])
    assert points.tolist() == expected and len(expected) > 200


@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("dim", [2, 3])
def test_padding_is_what_is_near(kind: str, dim: int) -> None:
    generator = np.random.default_rng(SEED)
    for origin in (np.zeros(dim), generator.normal(size=dim), generator.normal(size=(4000, dim))):
        points = origin + generator.normal(size=(4000, dim)) * 10 ** generator.uniform(-5, 1, (4000, 1))
        points = points.astype(kind)
        way = points.astype("f8") - origin.astype(kind).astype("f8")
        far = np.linalg.norm(way, axis=1)
        sure = np.abs(far - NEAREST) > 1e-5  # Of float32 the last digits are lost.
        found = np.isnan(without_padding(points, origin)).all(axis=1)
        assert np.array_equal(found[sure], far[sure] < NEAREST)
        assert 100 < np.count_nonzero(found) < 3900
    assert without_padding(points, origin + 100) is points
