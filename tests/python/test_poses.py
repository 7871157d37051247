# SPDX-License-Identifier: BSD-3-Clause
"""Poses mean the same in every call that takes some; what is none is refused in one line that names it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import room_scan, turned, with_room

import ndtree
from ndtree._native import _core
from ndtree.tiles import TileMapper, open_tiles
from ndtree.tiles.storage import storage_of

BODY = ndtree.Sphere(0.1)


ROOMS = {dim: with_room(ndtree.AdaptiveMap(dim=dim), 3) for dim in (2, 3)}
CALLS: dict[str, Callable[[ndtree.OccupancyMap, Any], Any]] = {
    "transformed": lambda m, pose: m.transformed(pose),
    "collides": lambda m, pose: m.collides(BODY, np.asarray(pose)[None]),
    "path_collides": lambda m, pose: m.path_collides(BODY, np.asarray(pose)[None]),
    "pose_matrix": lambda m, pose: _core.pose_matrix(pose, dim=m.dim),  # With which scans are moved.
}


@pytest.mark.parametrize("dim", ROOMS)
@pytest.mark.parametrize("name", CALLS)
def test_what_is_no_pose_is_refused(name: str, dim: int) -> None:
    call, m = CALLS[name], ROOMS[dim]
    pose = turned(dim, 0.3, [1.0, 2.0, 3.0][:dim])
    call(m, pose)
    mirror = np.eye(dim + 1)
    mirror[0, 0] = -1.0
    point = -np.eye(dim + 1)
    point[dim, dim] = 1.0
    perspective = pose.copy()
    perspective[dim, 0] = 0.01
    wrong: dict[str, tuple[Any, str]] = {
        "transposed": (pose.T, r"its last row has 1\.0 in column 0: must be 0; is it transposed\?"),
        "all negative": (-np.eye(dim + 1), "its last row has -0.0|its rotation is not one|must be 1"),
        "a mirror": (mirror, "its rotation is not one: it mirrors"),
        "scaled below": (np.diag([1.0] * dim + [2.0]), rf"has 2\.0 in column {dim}: must be 1"),
        "perspective": (perspective, r"has 0\.01 in column 0: must be 0"),
        "scaled": (2 * pose, "its rotation is not one: rows must have length 1"),
        "nan": (np.full((dim + 1, dim + 1), np.nan), "must be finite"),
    }
    if dim == 3:
        wrong["through the origin"] = (point, "it mirrors")
        wrong["no quaternion"] = (np.array([0, 0, 0, 0.5, 0, 0, 0.5]), r"its quaternion has length 0\.707")
        wrong["zero quaternion"] = (np.zeros(7), r"its quaternion has length 0\.0: must be 1")
    for what, (bad, said) in wrong.items():
        with pytest.raises(ValueError, match=said) as refused:
            call(m, bad)
        assert str(refused.value).startswith("pose"), what
        assert "\n" not in str(refused.value), what


def test_forms_of_a_pose_mean_the_same() -> None:
    m = ROOMS[2]
    angle, shift = 0.4, [0.3, -0.2]
    matrix = turned(2, angle, shift)
    assert m.transformed(matrix) == m.transformed([*shift, angle])
    np.testing.assert_allclose(_core.pose_matrix([*shift, angle], dim=2), matrix)
    m = ROOMS[3]
    shift = [0.3, -0.2, 0.5]
    matrix = turned(3, angle, shift)
    seven = [*shift, 0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2)]
    np.testing.assert_allclose(_core.pose_matrix(seven, dim=3), matrix, atol=1e-15)
    np.testing.assert_allclose(
        _core.pose_matrix([0.0, 0, 0, *(0.5 * np.ones(4))], dim=3)[:3, :3] @ [1, 2, 3], [3, 1, 2]
    )
    moved, expected = m.transformed(seven), m.transformed(matrix)
    points = np.random.default_rng(1).uniform(-3, 3, (1000, 3))
    assert np.mean(moved.state(points) == expected.state(points)) > 0.999
    poses = np.random.default_rng(2).normal(size=(4, 6, 7))
    poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    matrices = np.array([[_core.pose_matrix(one, dim=3) for one in row] for row in poses])
    body = ndtree.Box((1.0, 0.4, 0.2))
    found = m.collides(body, matrices)
    assert 0 < found.sum() < 24
    np.testing.assert_array_equal(m.collides(body, poses), found)
    assert m.collides(body, poses[1, 2]) == found[1, 2]
    assert m.path_collides(body, poses[0]) == m.path_collides(body, matrices[0])


def test_tiles_take_the_same_forms(tmp_path: Path) -> None:
    mapper = TileMapper(storage_of(tmp_path), ndtree.AdaptiveMap(dim=3), tile_size=1.6)
    for seed in range(3):
        mapper.insert(ndtree.Scan(*room_scan(3, seed)))
    mapper.write(complete=True)
    tiles = open_tiles(tmp_path)
    poses = np.random.default_rng(2).normal(size=(40, 7))
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=-1, keepdims=True)
    body = ndtree.Box((1.0, 0.4, 0.2))
    expected = ROOMS[3].collides(body, poses)
    assert 0 < expected.sum() < 40
    np.testing.assert_array_equal(tiles.collides(body, poses), expected)
    with pytest.raises(ValueError, match=r"pose 0: its last row has"):
        tiles.collides(body, turned(3, 0.3, [1.0, 2.0, 3.0]).T[None])
