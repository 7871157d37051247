# SPDX-License-Identifier: BSD-3-Clause
"""What cells carry beside their occupancy: colours, labels, times."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import ndtree

LAYERS = {"color": "mean3", "height": "mean", "label": "majority", "stamp": "latest"}


def told(points: np.ndarray, stamp: float) -> dict[str, np.ndarray]:
    """The values of beams for LAYERS: red to the left, and blue to the right."""
    left = points[:, 1] < 0
    return {
        "color": np.where(left[:, None], [200.0, 0, 10], [0, 0, 250]),
        "height": points[:, -1],
        "label": np.where(left, 3, 7),
        "stamp": np.full(len(points), stamp),
    }


def walls(dim: int, n: int = 400, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2, 2, (n, dim))
    points[:, 0] = 2.0
    return points


def mapped(dim: int = 3, **options: float) -> ndtree.AdaptiveMap:
    m = ndtree.AdaptiveMap(dim=dim, layers=LAYERS, min_cell_size=0.1, max_cell_size=0.8, **options)
    for i in range(8):
        points = walls(dim, seed=i)
        m.insert(points, np.zeros(dim), layers=told(points, 10.0 + i))
    return m


@pytest.mark.parametrize("dim", [2, 3])
def test_leaves_carry_what_was_measured_in_them(dim: int) -> None:
    m = mapped(dim)
    assert m.layers == LAYERS
    leaves = m.leaves(states=["occupied"])
    labels = m.layer("label", leaves.center)
    # A surface is as thick as a smallest cell: cells behind end points are occupied, too.
    assert np.mean(labels >= 0) > 0.5
    leaves, labels = leaves[labels >= 0], labels[labels >= 0]
    sides = np.abs(leaves.center[:, 1]) > leaves.size
    assert sides.sum() > 10
    left = leaves.center[:, 1] < 0
    assert labels.dtype == np.int64
    np.testing.assert_array_equal(labels[sides], np.where(left, 3, 7)[sides])
    color = m.layer("color", leaves.center)
    assert color.shape == (len(leaves), 3)
    np.testing.assert_allclose(
        color[sides & left], np.broadcast_to([200.0, 0, 10], (int((sides & left).sum()), 3))
    )
    height = m.layer("height", leaves.center)
    assert np.all(np.abs(height - leaves.center[:, -1]) <= leaves.size)
    stamp = m.layer("stamp", leaves.center)
    assert np.all((stamp >= 10) & (stamp <= 17)) and stamp.max() == 17


def test_beams_without_return_say_nothing() -> None:
    m = ndtree.FixedMap(dim=2, min_cell_size=0.1, layers={"label": "majority"})
    m.insert(
        [[1.05, 0.05], [1.05, 0.05], [0.05, 1.05]],
        [0, 0],
        returned=[True, True, False],
        layers={"label": [4, 4, -9]},
    )
    np.testing.assert_array_equal(m.layer("label", [[1.05, 0.05], [0.05, 1.05]]), [4, -1])


def test_one_point_and_a_grid() -> None:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, layers={"color": "mean3", "label": "majority"})
    m.insert([1.0, 0.5], [0, 0], layers={"color": [1, 2, 3], "label": [5]})
    np.testing.assert_array_equal(m.layer("color", [1.0, 0.5]), [1, 2, 3])
    assert m.layer("label", [1.0, 0.5]) == 5
    grid = np.stack(np.meshgrid([1.0, 1.5], [0.5, 1.0], indexing="ij"), axis=-1)
    m.insert(grid, [0, 0], layers={"color": np.ones((2, 2, 3)), "label": np.full((2, 2), 5)})
    assert m.layer("color", grid).shape == (2, 2, 3)
    assert m.layer("label", grid).shape == (2, 2)


def test_files_snapshots_and_copies_carry_them(tmp_path: Path) -> None:
    m = mapped()
    points = m.leaves(states=["occupied"]).center
    m.save(tmp_path / "m.ndt")
    for other in (
        ndtree.load(tmp_path / "m.ndt"),
        pickle.loads(pickle.dumps(m)),
        ndtree.from_bytes(m.to_bytes()),
        m.snapshot(),
    ):
        assert other.layers == LAYERS
        assert other.to_bytes() == m.to_bytes()
        np.testing.assert_array_equal(other.layer("color", points), m.layer("color", points))
    snapshot = m.snapshot()
    m.insert(walls(3), np.zeros(3), layers=told(walls(3), 99.0))
    assert np.nanmax(snapshot.layer("stamp", points)) == 17


def test_motions_of_the_lattice_take_them_along() -> None:
    m = mapped()
    assert m.transformed(np.eye(4)).to_bytes() == m.to_bytes()
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    pose[:3, 3] = [0.8, -1.6, 2.4]
    moved = m.transformed(pose)
    leaves = m.leaves()
    there = leaves.center @ pose[:3, :3].T + pose[:3, 3]
    for name in m.layers:
        here, values = m.layer(name, leaves.center), moved.layer(name, there)
        if here.dtype.kind == "f":  # Means of several cells are sums in the order of the tree.
            np.testing.assert_allclose(values, here, rtol=2e-7, atol=0)
        else:
            np.testing.assert_array_equal(values, here)


def test_a_map_that_is_too_large_while_it_is_empty_is_not_made() -> None:
    layers = {"color": "mean3", "label": "majority"}
    plain, layered = (ndtree.AdaptiveMap(dim=2, layers=some).stats().memory_bytes for some in (None, layers))
    assert (
        ndtree.AdaptiveMap(dim=2, layers=layers, max_memory=layered).stats().memory_bytes == layered > plain
    )
    with pytest.raises(
        ValueError, match=rf"max_memory = {layered - 1} bytes: must be at least {layered}, what"
    ):
        ndtree.AdaptiveMap(dim=2, layers=layers, max_memory=layered - 1)
    with pytest.raises(ValueError, match=rf"max_memory = {plain - 1} bytes: must be at least {plain}, what"):
        ndtree.AdaptiveMap(dim=2, max_memory=plain - 1)


def test_a_ply_file_has_them(tmp_path: Path) -> None:
    m = mapped()
    m.save_ply(tmp_path / "m.ply")
    head, _, body = (tmp_path / "m.ply").read_bytes().partition(b"end_header\n")
    names = [line.split()[-1].decode() for line in head.splitlines() if line.startswith(b"property")]
    assert names[6:] == ["red", "green", "blue", "height", "label", "stamp"]
    leaves = m.leaves(states=["occupied"])
    row = np.dtype(
        [
            ("xyz", "<f8", 3),
            ("size", "<f4"),
            ("p", "<f4"),
            ("state", "<i4"),
            ("rgb", "u1", 3),
            ("height", "<f4"),
            ("label", "<i4"),
            ("stamp", "<f8"),
        ]
    )
    cells = np.frombuffer(body, row)
    np.testing.assert_array_equal(cells["xyz"], leaves.center)
    np.testing.assert_array_equal(cells["label"], m.layer("label", leaves.center))
    np.testing.assert_array_equal(cells["stamp"], m.layer("stamp", leaves.center))
    color = np.nan_to_num(m.layer("color", leaves.center))
    np.testing.assert_allclose(cells["rgb"], color, atol=0.51)


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ({"color": "mean4"}, "layers: 'color': 'mean4': must be 'mean', 'mean3', 'majority' or 'latest'"),
        ({"a b": "mean"}, "layers: 'a b': a name must be letters, digits and _, at most 64, no digit first"),
        ({"": "mean"}, "layers: '': a name must be letters, digits and _, at most 64, no digit first"),
        ({"a": 3}, "layers: 'a': 3: must be 'mean', 'mean3', 'majority' or 'latest'"),
        (["a"], "layers = ['a']: must be a dict of str and str"),
    ],
)
def test_layers_that_there_are_not(layers: object, message: str) -> None:
    with pytest.raises((ValueError, TypeError)) as error:
        ndtree.AdaptiveMap(dim=2, layers=layers)  # type: ignore[arg-type]
    assert str(error.value) == message


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ({"colour": [[1, 2, 3]] * 2}, "layers: 'colour': the map has 'color', 'height', 'label', 'stamp'"),
        ({"color": [1, 2]}, "layers: 'color': 1 numbers a beam: must be 3"),
        ({"height": [[1, 2, 3]] * 2}, "layers: 'height': 3 numbers a beam: must be 1"),
        ({"label": [1.5, 2]},
            "layers: 'label': 'majority' of beam 0 = 1.5: must be a whole number in [0, 65535]"),
        ({"label": [1, 70000]},
            "layers: 'label': 'majority' of beam 1 = 70000: must be a whole number in [0, 65535]"),
        ({"stamp": [1, np.inf]}, "layers: 'stamp': 'latest' of beam 1 = inf: must be finite"),
        ({"stamp": [1, 2, 3]}, "layers['stamp'] has shape (3,): must have one entry for each of 2 points"),
        ({"stamp": 1}, "layers['stamp'] has shape (): must have one entry for each of 2 points"),
    ],
)  # fmt: skip
def test_a_refused_call_changes_nothing(layers: dict[str, object], message: str) -> None:
    m = ndtree.AdaptiveMap(dim=3, layers=LAYERS)
    m.insert(walls(3), np.zeros(3), layers=told(walls(3), 1.0))
    before = m.to_bytes()
    with pytest.raises(ValueError) as error:
        m.insert(walls(3)[:2], np.zeros(3), layers=layers)
    assert str(error.value) == message
    assert m.to_bytes() == before


def test_masked_arrays_are_refused() -> None:
    m = mapped()
    with pytest.raises(TypeError, match=r"layers\['stamp'\] is a masked array"):
        m.insert(walls(3)[:2], np.zeros(3), layers={"stamp": np.ma.masked_array([1.0, 2], [True, False])})


def test_tiles_hold_no_layers(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="layers: color, height, label, stamp: must be none"):
        ndtree.TileMapper(ndtree.tiles.storage_of(tmp_path / "m.tiles"), mapped())


def test_no_two_columns_of_a_ply_file_have_one_name(tmp_path: Path) -> None:
    m = ndtree.FixedMap(
        dim=2, min_cell_size=0.1, layers={"state": "majority", "red": "mean", "color": "mean3"}
    )
    m.insert([[1.05, 0.05]], [0, 0], layers={"state": [2], "red": [1], "color": [[1, 2, 3]]})
    m.save_ply(tmp_path / "m.ply")
    head = (tmp_path / "m.ply").read_bytes().partition(b"end_header")[0]
    names = [line.split()[-1] for line in head.splitlines() if line.startswith(b"property")]
    assert names[6:] == [b"state_", b"red", b"red_", b"green", b"blue"]


def test_changes_of_cells_see_values_of_layers() -> None:
    """A cell whose value alone is another one is reported, once; one that stays is not."""
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, layers={"label": "majority", "stamp": "latest"})
    points = np.array([[1.05, 0.05], [1.05, 0.75]])
    for i in range(400):  # Until cells are saturated, so that nothing else of them changes.
        m.insert(points, [0.0, 0.0], layers={"label": [1, 2], "stamp": [float(i), 0.0]})
    before = m.snapshot()
    assert not len(m.changes(since=before, of="cells").lower)
    other = ndtree.from_bytes(m.to_bytes())  # Shares nothing, and is the same.
    assert not len(other.changes(since=before, of="cells").lower)
    m.insert(points, [0.0, 0.0], layers={"label": [1, 2], "stamp": [1000.0, 0.0]})
    changes = m.changes(since=before, of="cells")
    assert len(np.unique(changes.lower, axis=0)) == len(changes.lower)
    (seen,) = np.flatnonzero((np.abs(changes.lower - [1.0, 0.0]) < 1e-9).all(axis=1))
    assert changes.before[seen] == changes.after[seen] == 1
    back = before.changes(since=m, of="cells")
    assert {tuple(one) for one in back.lower} == {tuple(one) for one in changes.lower}
    assert not len(m.changes(since=before).lower)


@pytest.mark.parametrize("box", [[[0, 0], [np.nan, 1]], [[np.nan, 0], [1, 1]], [[1, 0], [0, 1]]])
def test_leaves_of_no_box_are_refused(box: list[list[float]]) -> None:
    with pytest.raises(ValueError, match=r"box: axis 0 is from .* must be from low to high"):
        ndtree.AdaptiveMap(dim=2).leaves(box)
    assert len(ndtree.AdaptiveMap(dim=2).leaves([[0, -np.inf], [0, np.inf]]).size)
