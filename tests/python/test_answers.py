# SPDX-License-Identifier: BSD-3-Clause
"""Answers have the shape of the question, and can be indexed, shown, compared and pickled."""

from __future__ import annotations

import copy
import gc
import pickle
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from conftest import room_scan, with_room

import ndtree
from ndtree._native import _core, results

KINDS = {"adaptive": ndtree.AdaptiveMap, "fixed": ndtree.FixedMap}


def mapped(dim: int, kind: str = "adaptive") -> Any:
    return with_room(KINDS[kind](dim=dim), 4)


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Of each test its own, so that none depends on which ran before."""
    return np.random.default_rng(list(request.node.nodeid.rpartition("::")[2].encode()))


ROOMS = {dim: mapped(dim) for dim in (2, 3)}
POINTWISE: dict[str, Callable[[Any, Any], Any]] = {
    "state": lambda m, p: m.state(p),
    "probability": lambda m, p: m.probability(p),
    "hit": lambda m, p: m.probability(p, of="hit"),
    "upper bound": lambda m, p: m.probability(p, interval=0.9)[2],
    "cell_size": lambda m, p: m.cell_size(p),
    "occupied_within": lambda m, p: m.occupied_within(p, 0.3),
    "distance_to_occupied": lambda m, p: m.distance_to_occupied(p),
    "nearest distance": lambda m, p: m.nearest_occupied(p).distance,
    "nearest point": lambda m, p: m.nearest_occupied(p).point,
    "cast_rays": lambda m, p: m.cast_rays(np.full(m.dim, 0.1), p),
    "cells": lambda m, p: m.cast_rays(np.full(m.dim, 0.1), p, at="cell"),
    "cast_rays from each": lambda m, p: m.cast_rays(0.1 * np.asarray(p), p),
    "ends": lambda m, p: m.cast_rays(np.full(m.dim, 0.1), p, details=True, unknown="stop").lower,
    "states_in": lambda m, p: m.states_in(p, np.asarray(p) + 0.2),
    "field": lambda m, p: m.distance_field([[-3.0] * m.dim, [3.0] * m.dim], 0.5).distance(p),
    "gradient": lambda m, p: m.distance_field([[-3.0] * m.dim, [3.0] * m.dim], 0.5).gradient(p),
}


@pytest.mark.parametrize("dim", ROOMS)
@pytest.mark.parametrize("question", POINTWISE)
def test_answers_have_the_shape_of_the_question(question: str, dim: int, rng: np.random.Generator) -> None:
    m, ask = ROOMS[dim], POINTWISE[question]
    grid = rng.uniform(-2.5, 2.5, (3, 4, 25, dim))
    flat = ask(m, grid.reshape(-1, dim))
    assert flat.shape[0] == 300 and len(np.unique(flat[np.isfinite(flat)])) > 1
    whole = ask(m, grid)
    np.testing.assert_array_equal(whole, flat.reshape(3, 4, 25, *flat.shape[1:]))
    assert whole.dtype == flat.dtype
    for i in range(5):
        one = ask(m, grid[0, 0, i].tolist())
        assert np.shape(one) == flat.shape[1:]
        np.testing.assert_array_equal(one, flat[i])
    assert ask(m, np.zeros((2, 0, dim))).shape == (2, 0, *flat.shape[1:])
    for wrong in (np.zeros(dim + 1), np.zeros((2, 2, dim + 1)), 1.0):
        with pytest.raises(ValueError, match="has shape"):
            ask(m, wrong)


def test_organised_clouds_are_inserted_as_their_points_are(rng: np.random.Generator) -> None:
    points, origin = room_scan(3, 7, 600)
    returned, sigma = rng.random(600) < 0.8, rng.uniform(0.01, 0.05, 600)
    each = np.tile(origin, (600, 1))
    one, other, single = (ndtree.AdaptiveMap(dim=3) for _ in range(3))
    one.insert(points, each, returned=returned, range_sigma=sigma)
    report = other.insert(
        points.reshape(20, 30, 3),
        each.reshape(20, 30, 3),
        returned=returned.reshape(20, 30),
        range_sigma=sigma.reshape(20, 30),
    )
    assert report.beams == 600 and other == one
    assert single.insert(points[0], origin).returned == 1
    again = ndtree.AdaptiveMap(dim=3)
    again.insert(points[:1], origin)
    assert single == again
    assert one.evaluate(points.reshape(20, 30, 3), origin).samples == one.evaluate(points, origin).samples > 0
    with pytest.raises(ValueError, match="returned has shape"):
        other.insert(points.reshape(20, 30, 3), origin, returned=returned.reshape(30, 20))
    assert other == one


@pytest.mark.parametrize("dim", ROOMS)
def test_one_pose_and_grids_of_poses_are_taken(dim: int, rng: np.random.Generator) -> None:
    m, body = ROOMS[dim], ndtree.Sphere(0.3)
    poses = np.tile(np.eye(dim + 1), (4, 6, 1, 1))
    poses[..., :dim, dim] = rng.uniform(-2.2, 2.2, (4, 6, dim))
    flat = m.collides(body, poses.reshape(24, dim + 1, dim + 1))
    assert 0 < flat.sum() < 24
    np.testing.assert_array_equal(m.collides(body, poses), flat.reshape(4, 6))
    if dim == 3:
        assert [bool(m.collides(body, pose)) for pose in poses[0]] == flat[:6].tolist()
    else:
        planar = [[*pose[:2, 2], 0.0] for pose in poses[0]]
        assert [bool(m.collides(body, pose)) for pose in planar] == flat[:6].tolist()
    with pytest.raises(ValueError, match="poses has shape"):
        m.collides(body, np.zeros((2, 2, 2, 5)))


def test_masked_arrays_are_refused_in_one_line() -> None:
    m = ROOMS[2]
    before = m.to_bytes()
    masked = np.ma.array(np.zeros((5, 2)), mask=True)
    for call in (
        lambda: m.insert(masked, [0.0, 0.0]),
        lambda: m.insert(np.zeros((5, 2)), [0.0, 0.0], range_sigma=masked[:, 0]),
        lambda: m.state(points=masked),
        lambda: m.leaves(masked[:2]),
        lambda: ndtree.from_grid(masked.astype(np.int8), [0.0, 0.0], 0.1),
        lambda: ndtree.Scan(masked, [0.0, 0.0]),
    ):
        with pytest.raises(
            TypeError, match=r"is a masked array of shape \(\d.*\): must be a plain one"
        ) as said:
            call()
        assert "\n" not in str(said.value)
    assert m.to_bytes() == before


# --- Results ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", ROOMS)
def test_leaves_are_indexed_as_their_arrays(dim: int) -> None:
    leaves = ROOMS[dim].leaves()
    names = list(type(leaves).__dataclass_fields__)
    assert isinstance(leaves, ndtree.Leaves) and len(leaves) == len(leaves.size) > 100
    for which in (leaves.state == 1, slice(3, 40, 2), np.array([5, 2, 2]), [7], 3, -1, np.int64(4)):
        some = leaves[which]
        for name in names:
            np.testing.assert_array_equal(getattr(some, name), getattr(leaves, name)[which])
    assert len(leaves[leaves.state == 1]) == (leaves.state == 1).sum() > 0
    assert [leaf.size for leaf in leaves[:20]] == leaves.size[:20].tolist()
    assert list(leaves[:0]) == [] and len(leaves[:0]) == 0
    with pytest.raises(IndexError, match=f"entry {len(leaves)}: there are {len(leaves)}"):
        leaves[len(leaves)]
    with pytest.raises(IndexError):
        leaves[np.ones(3, dtype=bool)]
    with pytest.raises(IndexError, match="a single one"):
        leaves[0][0]
    with pytest.raises(TypeError, match="a single one"):
        len(leaves[0])


def answers() -> dict[str, Any]:
    m = mapped(2)
    points = np.random.default_rng(5).uniform(-2.0, 2.0, (6, 2))
    before = m.snapshot()
    report = m.insert(*room_scan(2, 9))
    scan = ndtree.simulate("office", scans=2)[0]
    space = ndtree.SeenSpace([scan], samples=100)
    return {
        "InsertReport": report,
        "MapStats": m.stats(),
        "Leaves": m.leaves(),
        "one of Leaves": m.leaves()[3],
        "NearestOccupied": m.nearest_occupied(points),
        "one of NearestOccupied": m.nearest_occupied(points[0]),
        "RayEnds": m.cast_rays([0.0, 0.0], points.reshape(2, 3, 2), details=True),
        "one of RayEnds": m.cast_rays([0.0, 0.0], points[0], details=True),
        "InformationGain": m.information_gain(points, ndtree.RangeSensor.laser(max_range=3.0, beams=90)),
        "one of InformationGain": m.information_gain(
            points[0], ndtree.RangeSensor.laser(max_range=3.0, beams=90)
        ),
        "RangeSensor": ndtree.RangeSensor.laser(max_range=3.0, beams=90),
        "Frontier": m.frontiers(min_cells=0)[0],
        "Changes": m.changes(since=before),
        "one of Changes": m.changes(since=before)[0],
        "HeldOutTruth": m.evaluate(*room_scan(2, 10)),
        "Reliability": m.reliability(*room_scan(2, 10)),
        "Certificate": m.certify([scan]),
        "Claims": m.claims(space),
        "CompressReport": m.compress(max_loss=10.0),
        "DistanceField": m.distance_field([[-2, -2], [2, 1]], 0.1),
        "Shape": ndtree.Sphere(0.2, (0.0, 0.1))
        | ndtree.Capsule((0, 0), (1, 0), 0.1)
        | ndtree.Box((1, 2), rotation=[[0, -1], [1, 0]]),
        "AdaptiveMap": m,
        "FixedMap": mapped(3, "fixed"),
    }


ANSWERS = answers()


@pytest.mark.parametrize("name", ANSWERS)
def test_answers_are_shown_and_pickled(name: str, rng: np.random.Generator) -> None:
    answer = ANSWERS[name]
    shown = repr(answer)
    assert shown.startswith("Sphere(" if name == "Shape" else f"{name.split()[-1]}(")
    assert "object at 0x" not in shown and "\n" not in shown and len(shown) < 300
    again = pickle.loads(pickle.dumps(answer))
    assert type(again) is type(answer)
    if isinstance(answer, ndtree.OccupancyMap):
        assert again == answer and copy.deepcopy(answer) == answer
        again.clear([[-0.5] * answer.dim, [0.5] * answer.dim])
        assert again != answer
        return
    assert repr(again) == shown
    for member in (n for n in dir(answer) if not n.startswith("_")):
        value = getattr(answer, member)
        if not callable(value):
            np.testing.assert_array_equal(getattr(again, member), value)
    if name == "DistanceField":
        points = rng.uniform(-2, 1, (50, 2))
        np.testing.assert_array_equal(again.distance(points), answer.distance(points))
    if name == "Shape":
        poses = np.column_stack((rng.uniform(-2, 2, (200, 2)), rng.uniform(-3, 3, 200)))
        expected = ROOMS[2].collides(answer, poses)
        assert 0 < expected.sum() < 200
        np.testing.assert_array_equal(ROOMS[2].collides(again, poses), expected)


def test_reports_are_equal_if_their_numbers_are() -> None:
    assert ROOMS[2].stats() == ROOMS[2].stats() != ROOMS[3].stats()
    assert len({ROOMS[2].stats(), ROOMS[2].stats()}) == 1


# --- Objects that were never made -------------------------------------------------------------------


COMPILED = sorted(
    name for name, held in vars(_core).items() if isinstance(held, type) and name not in results.__all__
)


@pytest.mark.parametrize("name", COMPILED)
def test_what_was_never_made_is_refused_and_does_not_crash(name: str) -> None:
    type_ = getattr(_core, name)
    unmade = type_.__new__(type_)
    used = 0
    for member in [*(n for n in vars(type_) if n not in ("__new__", "__init__", "__setstate__")), "__eq__"]:
        try:
            value = getattr(unmade, member)
            if callable(value):
                value()
        except (TypeError, AttributeError, ValueError) as error:
            used += "never made" in str(error)
        except Exception as error:
            raise AssertionError(f"{name}.{member}") from error
    assert used > 0 or name == "OccupancyMap", f"{name}: nothing of it was asked"
    for call in (repr, str, pickle.dumps, copy.copy):
        try:
            call(unmade)
        except TypeError:
            pass
    del unmade
    gc.collect()


def test_a_map_whose_constructor_failed_is_refused() -> None:
    class Own(ndtree.AdaptiveMap):
        def __init__(self) -> None:
            try:
                super().__init__(dim=17)
            except ValueError:
                failed.append(self)
            raise RuntimeError("no")

    failed: list[Any] = []
    with pytest.raises(RuntimeError, match="no"):
        Own()
    for ask in (repr, lambda m: m.stats(), lambda m: m.state([[0, 0]]), lambda m: m._repr_html_()):
        with pytest.raises(TypeError, match="never made: its __init__"):
            ask(failed[0])
    with pytest.raises(TypeError, match="never made"):
        ROOMS[2].collides(_core.Shape.__new__(_core.Shape), [0.0, 0.0, 0.0])


# --- Files by their ending --------------------------------------------------------------------------


def test_maps_are_saved_as_the_ending_says(tmp_path: Path) -> None:
    flat, solid = ROOMS[2], ROOMS[3]
    for name in ("a.ndt", "plain", "a.NDT"):
        flat.save(tmp_path / name)
        assert ndtree.load(tmp_path / name) == flat
    for name, m in (
        ("a.bt", solid),
        ("a.ot", solid),
        ("a.pgm", flat),
        ("a.yaml", flat),
        ("a.npz", flat),
        ("a.ply", solid),
    ):
        saved, converted = tmp_path / "saved" / name, tmp_path / "converted" / name
        for path in (saved, converted):
            path.parent.mkdir(exist_ok=True)
        m.save(str(saved))
        ndtree.convert(m, converted)
        assert saved.read_bytes() == converted.read_bytes()
    assert ndtree.load_octomap(tmp_path / "saved" / "a.ot").dim == 3
    assert (tmp_path / "saved" / "a.pgm").read_bytes().startswith(b"P5")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ValueError, match=r"a\.xyz: no format has this ending, expected one of \.ndt, \.bt, "):
        flat.save(tmp_path / "a.xyz")
    with pytest.raises(ValueError, match="dim"):
        flat.save(tmp_path / "flat.bt")
    assert sorted(tmp_path.rglob("*")) == before
    if _core.has_octomap:
        octomap = ndtree.OctoMap(dim=3)
        octomap.insert(*room_scan(3, 0))
        octomap.save(tmp_path / "own.ot")
        assert (tmp_path / "own.ot").read_bytes().startswith(b"# Octomap OcTree file")
        with pytest.raises(ValueError, match=r"own\.ndt: an OctoMap cannot be written"):
            octomap.save(tmp_path / "own.ndt")
