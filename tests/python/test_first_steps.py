# SPDX-License-Identifier: BSD-3-Clause
"""What a new user types first: names that are there, hints that name what was meant, poses of every kind."""

from __future__ import annotations

import math
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import ndtree


def room() -> ndtree.AdaptiveMap:
    """A wall at x = 2 m, seen from the origin."""
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, range_sigma=0.01)
    y = np.linspace(-2, 2, 400)
    for _ in range(5):
        m.insert(np.column_stack((np.full_like(y, 2.05), y)), [0.0, 0.0])
    return m


def room_3d() -> ndtree.AdaptiveMap:
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=0.2, range_sigma=0.01)
    y, z = (grid.ravel() for grid in np.meshgrid(np.linspace(-2, 2, 60), np.linspace(-2, 2, 60)))
    for _ in range(5):
        m.insert(np.column_stack((np.full_like(y, 2.1), y, z)), [0.0, 0.0, 0.0])
    return m


# --- Names ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ndtree._FOLDERS)
def test_a_folder_needs_no_import_of_its_own(name: str) -> None:
    for extra in {"plot": ["matplotlib"], "viewer": ["viser", "matplotlib"]}.get(name, []):
        pytest.importorskip(extra)
    code = f"import ndtree, sys; assert 'ndtree.{name}' not in sys.modules; print(ndtree.{name}.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == f"ndtree.{name}\n", done.stderr


# --- Maps -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["AdaptiveMap", "FixedMap"])
def test_a_map_asks_for_its_dimension(kind: str) -> None:
    with pytest.raises(TypeError, match=rf"{kind}\(\): dim is missing, expected dim=2 or dim=3"):
        getattr(ndtree, kind)()


@pytest.mark.parametrize(
    "kind, given, meant",
    [
        ("AdaptiveMap", "resolution", "min_cell_size"),
        ("AdaptiveMap", "voxel_size", "min_cell_size"),
        ("AdaptiveMap", "cell_size", "min_cell_size"),
        ("AdaptiveMap", "min_cell_sise", "min_cell_size"),
        ("AdaptiveMap", "max_cell", "max_cell_size"),
        ("AdaptiveMap", "sigma", "range_sigma"),
        ("FixedMap", "resolution", "min_cell_size"),
        ("FixedMap", "max_sigma", "range_sigma"),
    ],
)
def test_the_option_that_was_meant_is_named(kind: str, given: str, meant: str) -> None:
    for more in ({"dim": 2}, {}):
        with pytest.raises(TypeError) as caught:
            getattr(ndtree, kind)(**more, **{given: 0.1})
        said = str(caught.value)
        assert said.startswith(f"{kind}(): no option {given}: did you mean {meant}? "), said
    with pytest.raises(TypeError) as caught:
        getattr(ndtree, kind)(dim=2, qwertz=1)
    assert "did you mean" not in str(caught.value)


@pytest.mark.parametrize("branching", [2, 3])
@pytest.mark.parametrize("asked", [0.1, 0.25, 0.3, 1.0, 1.6, 2.7, 5.0])
def test_sizes_are_those_of_cells_and_repr_says_what_was_rounded(branching: int, asked: float) -> None:
    m = ndtree.AdaptiveMap(dim=2, branching=branching, min_cell_size=0.1, max_cell_size=asked)
    for scan in ndtree.simulate("office", scans=4):
        scan.insert_into(m)
    leaves = m.leaves()
    sizes = leaves.size[leaves.observed]
    assert m.min_cell_size == pytest.approx(sizes.min())
    assert sizes.max() <= m.max_cell_size * (1 + 1e-9) <= asked * (1 + 2e-9) < m.max_cell_size * branching
    if asked <= 1.6:
        assert m.max_cell_size == pytest.approx(sizes.max())
    assert f"max_cell_size={m.max_cell_size:.6g}" in repr(m)
    assert (f"(rounded from {asked:g})" in repr(m)) == (abs(m.max_cell_size - asked) > 1e-6)


def test_a_fixed_map_has_one_size() -> None:
    m = ndtree.FixedMap(dim=2, min_cell_size=0.3)
    assert m.min_cell_size == m.max_cell_size == 0.3


# --- Poses ------------------------------------------------------------------------------------------


def test_positions_are_poses_without_a_turn() -> None:
    rng = np.random.default_rng(3)
    for m, turn in ((room(), [0.0]), (room_3d(), [0.0, 0.0, 0.0, 1.0])):
        dim = m.dim
        body = ndtree.Box([0.5, 0.1, 0.2][:dim], center=[0.3, 0.0, 0.1][:dim])
        places = rng.uniform(-0.5, 2.6, (200, dim))
        whole = np.column_stack((places, np.tile(turn, (len(places), 1))))
        matrices = np.tile(np.eye(dim + 1), (len(places), 1, 1))
        matrices[:, :dim, dim] = places
        expected = m.collides(body, matrices)
        assert 20 < expected.sum() < 180
        assert np.array_equal(m.collides(body, places), expected)
        assert np.array_equal(m.collides(body, whole), expected)
        assert np.array_equal(m.collides(body, places.reshape(10, 20, dim)), expected.reshape(10, 20))
        assert [m.collides(body, list(place)) for place in places[:20]] == list(expected[:20])
        assert m.path_collides(body, places) == m.path_collides(body, matrices)


# --- Pictures ---------------------------------------------------------------------------------------


def test_a_slice_is_named_by_its_coordinate() -> None:
    pytest.importorskip("matplotlib")
    m = room_3d()
    drawn = []
    for ax in (ndtree.plot.slice(m, z=0.1), ndtree.plot.slice(m, "z", 0.1), ndtree.plot.slice(m, z=1.1)):
        ax.figure.canvas.draw()
        drawn.append(bytes(ax.figure.canvas.buffer_rgba()))
    assert drawn[0] == drawn[1]
    for wrong in ({}, {"x": 1.0, "y": 1.0}, {"axis": "z"}, {"axis": "z", "value": 1.0, "z": 1.0}):
        with pytest.raises(ValueError, match="expected one of x, y and z, or axis and value"):
            ndtree.plot.slice(m, **wrong)


# --- What is no map ---------------------------------------------------------------------------------


def test_load_says_what_a_log_is_and_which_call_reads_it(tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    log.write_text("FLASER 2 1.0 2.0 0 0 0 0 0 0 0.0 host 0.0\n")
    with pytest.raises(ValueError, match="a CARMEN log, expected a map of ndtree's or OctoMap's") as caught:
        ndtree.load(log)
    first, typed, in_python = str(caught.value).splitlines()
    assert first.startswith(f"{log}: ") and typed == f"  ndtree map {log}"
    m = ndtree.AdaptiveMap(dim=2)
    exec(in_python.removeprefix("  in Python: "), {"ndtree": ndtree, "m": m})
    assert m.state([0.0, -0.5]) == -1 or m.state([0.5, 0.0]) == -1 or m.stats().observed_leaves > 0
    (tmp_path / "page.pdf").write_bytes(b"%PDF-1.4\n")
    (tmp_path / "empty").mkdir()
    (tmp_path / "noise.bin").write_bytes(bytes(range(256)) * 9)
    for name, kind in (("page.pdf", "a PDF, expected a map of ndtree's"), ("noise.bin", "not an ndtree map")):
        with pytest.raises(ValueError, match=rf"^{tmp_path / name}: {kind}"):
            ndtree.load(tmp_path / name)
    with pytest.raises(IsADirectoryError):
        ndtree.load(tmp_path / "empty")
    with pytest.raises(FileNotFoundError):
        ndtree.load(tmp_path / "none.ndt")


def test_load_names_the_call_for_maps_of_other_kinds(tmp_path: Path) -> None:
    from ndtree.maps.open import is_map

    m = room()
    m.save(tmp_path / "whole.ndt")
    cut = tmp_path / "cut.ndt"
    cut.write_bytes((tmp_path / "whole.ndt").read_bytes()[:-9])
    with pytest.raises(ValueError, match="truncated or overlong"):
        ndtree.load(cut)
    pytest.importorskip("PIL", reason="no Pillow: no images")
    pytest.importorskip("yaml", reason="no PyYAML: no map_server")
    m.save(tmp_path / "plan.pgm")
    assert is_map(tmp_path / "plan.yaml")
    with pytest.raises(ValueError, match="a map of map_server's, expected one of ndtree's") as caught:
        ndtree.load(tmp_path / "plan.yaml")
    call = str(caught.value).splitlines()[1].replace("'plan.ndt'", repr(str(tmp_path / "plan.ndt")))
    exec(call.strip(), {"ndtree": ndtree})
    assert ndtree.load(tmp_path / "plan.ndt").state([2.05, 0.0]) == 1


@pytest.mark.parametrize("name", ["compare", "calibrate", "first_look"])
def test_a_name_in_the_place_of_a_log_is_to_be_read(name: str) -> None:
    with pytest.raises(
        TypeError, match=r"log = 'drive\.bag': expected a Log, as of:\n  ndtree\.read\('drive"
    ):
        getattr(ndtree, name)("drive.bag")
    with pytest.raises(TypeError, match=r"expected a Log"):
        getattr(ndtree, name)(Path("drive.bag"))


def test_a_yaw_of_degrees_is_warned_of() -> None:
    """It may be the angle of a robot that has turned often: it is taken as it is."""
    h = ndtree.ScanHistory(dim=2)
    with pytest.warns(UserWarning, match=r"pose: a yaw of 90(\.0)? rad: is it in degrees\?"):
        h.insert(0, [[1.0, 0.0]], (0, 0, 90))
    np.testing.assert_allclose(h.pose(0)[:2, 0], [math.cos(90), math.sin(90)])
    planner = ndtree.Planner(h.map, ndtree.Sphere(0.1), unknown="free")
    with pytest.warns(UserWarning, match=r"goal: a yaw of 90(\.0)? rad: is it in degrees\?"):
        planner.plan((0.2, 0.0, 0.0), (0.5, 0.0, 90.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        h.insert(1, [[1.0, 0.0]], (0, 0, -2 * math.pi))
        with pytest.raises(UserWarning, match="degrees"):
            h.insert(2, [[1.0, 0.0]], (0, 0, 45))
    assert h.keys() == [0, 1]
