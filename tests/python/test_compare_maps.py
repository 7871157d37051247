# SPDX-License-Identifier: BSD-3-Clause
"""Two maps are compared as a plain count over every cell does it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import room_scan

import ndtree
from ndtree.maps.open import PlacedMap

NAMES = ("unknown", "free", "occupied")
BOX = 2.4


def room(dim: int, branching: int = 2, cell_size: float = 0.1, seeds: tuple[int, ...] = (0, 1)) -> Any:
    m = ndtree.AdaptiveMap(
        dim=dim, branching=branching, min_cell_size=cell_size, max_cell_size=16 * cell_size
    )
    for seed in seeds:
        m.insert(*room_scan(dim, seed, 400))
    return m


def plain_count(a: Any, b: Any, cell_size: float) -> dict[str, dict[str, int]]:
    """Of what both say at the centres of cells. A grid of larger cells than a map's says more than that."""
    reach = round(4.8 / cell_size)  # Coarse cells go on beyond the room.
    along = (np.arange(-reach, reach) + 0.5) * cell_size
    centres = np.stack(np.meshgrid(*[along] * a.dim), axis=-1).reshape(-1, a.dim)
    one, other = a.state(centres) + 1, b.state(centres) + 1
    return {
        x: {y: int(np.count_nonzero((one == i) & (other == j))) for j, y in enumerate(NAMES) if i or j}
        for i, x in enumerate(NAMES)
    }


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("branching, cell_size", [(2, 0.1), (3, 0.1), (2, 0.3)])
def test_cells_are_those_of_a_plain_count(dim: int, branching: int, cell_size: float) -> None:
    a, b = room(dim), room(dim, branching, cell_size, (1, 2))
    result = ndtree.compare_maps(a, b)
    assert result["cell_size"] == 0.1
    expected = plain_count(a, b, 0.1)
    assert result["cells"] == expected
    assert ndtree.compare_maps(b, a)["cells"] == {
        x: {y: expected[y][x] for y in NAMES if (x, y) != ("unknown", "unknown")} for x in NAMES
    }
    both = [expected[x][y] for x in NAMES[1:] for y in NAMES[1:]]
    assert result["agreement"] == (expected["free"]["free"] + expected["occupied"]["occupied"]) / sum(both)
    assert 0.5 < result["agreement"] < 1
    known = sum(sum(row.values()) for row in expected.values())
    assert result["known_in_both"] == sum(both) / known
    occupied = sum(expected["occupied"].values()) + sum(expected[x]["occupied"] for x in NAMES[:2])
    assert result["occupied_overlap"] == expected["occupied"]["occupied"] / occupied
    coarse = ndtree.compare_maps(a, b, cell_size=0.37)
    assert coarse["cell_size"] == 0.37 and coarse["cells"] == plain_count(a, b, 0.37)


def test_a_map_agrees_with_itself() -> None:
    a = room(3)
    result = ndtree.compare_maps(a, a)
    assert (result["agreement"], result["known_in_both"], result["occupied_overlap"]) == (1, 1, 1)
    assert result["distances"]["hausdorff"] == 0


def test_distances_are_those_of_a_plain_search() -> None:
    a, b = room(2), room(2, seeds=(5,))
    result = ndtree.compare_maps(a, b)["distances"]

    def plain(one: Any, other: Any) -> np.ndarray:
        box = [[-BOX] * 2, [BOX] * 2]
        points = -BOX + (np.argwhere(one.to_grid(box) == 1) + 0.5) * 0.1
        lower = -BOX + np.argwhere(other.to_grid(box) == 1) * 0.1
        gap = np.maximum(np.maximum(lower - points[:, None], points[:, None] - lower - 0.1), 0)
        return np.linalg.norm(gap, axis=2).min(axis=1)

    for key, distance in (("a_to_b", plain(a, b)), ("b_to_a", plain(b, a))):
        assert result[key]["points"] == len(distance) > 50
        expected = [distance.mean(), np.median(distance), np.percentile(distance, 95), distance.max()]
        found = [result[key][name] for name in ("mean", "median", "p95", "max")]
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert result["hausdorff"] == max(result["a_to_b"]["max"], result["b_to_a"]["max"]) > 0


def test_large_occupied_cells_are_measured_at_their_border() -> None:
    block = np.ones((8, 8, 8), dtype=int)
    a = ndtree.from_grid(block, [0, 0, 0], 0.1)
    assert sorted(a.leaves().size[a.leaves().state == 1]) == pytest.approx([0.8])
    b = ndtree.from_grid(block[:1, :1, :1], [0, 0, 0], 0.1, refinement="fixed")
    result = ndtree.compare_maps(a, b)["distances"]
    assert result["a_to_b"]["points"] == 8**3 - 6**3
    assert result["a_to_b"]["max"] == pytest.approx(0.65 * 3**0.5)  # From the far cell's centre.
    assert result["b_to_a"]["max"] == 0
    few = ndtree.compare_maps(a, b, max_points=100)["distances"]["a_to_b"]
    assert 50 < few["points"] < 150 and few["mean"] == pytest.approx(result["a_to_b"]["mean"], rel=0.2)


def test_shifted_frames_are_compared_where_they_lie() -> None:
    random = np.random.default_rng(3)
    grid = random.integers(-1, 2, (20, 30))
    m = ndtree.from_grid(grid, [0, 0], 0.2)
    moved = PlacedMap(m, np.array([0.73, -1.19]), "moved")
    result = ndtree.compare_maps(moved, moved)
    assert result["agreement"] == 1 and result["distances"]["hausdorff"] == 0
    assert result["cells"]["free"]["free"] == np.count_nonzero(grid == 0)
    by_one = PlacedMap(ndtree.from_grid(grid, [-0.2, 0], 0.2), np.array([0.93, -1.19]), "the same")
    assert ndtree.compare_maps(moved, by_one)["cells"] == result["cells"]
    coarser = ndtree.from_grid(np.ones((6, 9), dtype=int), [-1, -2], 1.0)
    other = ndtree.compare_maps(moved, coarser)["cells"]
    assert other["free"]["occupied"] == np.count_nonzero(grid == 0)
    cell = ndtree.from_grid([[1]], [0, 0], 0.2)
    apart = ndtree.compare_maps(PlacedMap(cell, np.array([1.0, 0.0]), "right"), cell)["distances"]
    assert [apart[way]["max"] for way in ("a_to_b", "b_to_a")] == pytest.approx([0.9, 0.9])


def test_files_of_every_kind_are_compared(tmp_path: Path) -> None:
    m = room(3)
    for name in ("room.ndt", "room.bt", "room.ot"):
        ndtree.convert(m, tmp_path / name)
    for name in ("room.bt", "room.ot"):
        result = ndtree.compare_maps(tmp_path / "room.ndt", tmp_path / name)
        assert result["agreement"] == result["known_in_both"] == result["occupied_overlap"] == 1
        assert result["b"]["map"] == str(tmp_path / name)
    pytest.importorskip("yaml")
    pytest.importorskip("PIL")
    flat = room(2)
    ndtree.convert(flat, tmp_path / "flat.yaml", wall_depth=np.inf)
    result = ndtree.compare_maps(flat, tmp_path / "flat.yaml")
    assert result["agreement"] == result["known_in_both"] == 1
    with pytest.raises(ValueError, match=r"flat\.yaml is 2-D and .*room\.bt 3-D"):
        ndtree.compare_maps(tmp_path / "flat.yaml", tmp_path / "room.bt")


def test_octomap_itself_is_compared() -> None:
    if not ndtree.has_octomap:
        pytest.skip("the module was built without OctoMap")
    o, m = ndtree.OctoMap(min_cell_size=0.1), ndtree.FixedMap(dim=3, min_cell_size=0.1)
    for seed in range(3):
        o.insert(*room_scan(3, seed))
        m.insert(*room_scan(3, seed))
    result = ndtree.compare_maps(o, m)
    assert result["a"]["cells"] > 1000 and result["agreement"] > 0.9
    with pytest.raises(ValueError, match="a: an OctoMap with dim = 2"):
        ndtree.compare_maps(ndtree.OctoMap(min_cell_size=0.1, dim=2), m)


def test_cells_much_smaller_than_those_of_the_maps_are_refused() -> None:
    """They say nothing more, and the call would never end."""
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.64)
    m.insert(*room_scan(2, 0))
    assert ndtree.compare_maps(m, m, cell_size=0.01)["agreement"] == 1.0
    with pytest.raises(ValueError, match=r"cell_size = 1e-09 m: must be >= 0\.01 m, a 64th of the finer"):
        ndtree.compare_maps(m, m, cell_size=1e-9)


def test_empty_maps_have_nothing_to_compare(tmp_path: Path) -> None:
    empty = ndtree.AdaptiveMap(dim=2)
    result = ndtree.compare_maps(empty, empty)
    assert result["agreement"] is None and result["distances"]["hausdorff"] is None
    one_sided = ndtree.compare_maps(empty, room(2))
    assert one_sided["known_in_both"] == 0 and one_sided["agreement"] is None
    assert sum(one_sided["cells"]["unknown"].values()) > 100
    assert "there are none" in str(one_sided)
    pytest.importorskip("matplotlib")
    with pytest.raises(ValueError, match="neither map knows anything"):
        result.draw(tmp_path / "none.png")


def test_figures_are_in_json_and_tables() -> None:
    result = ndtree.compare_maps(room(2), room(2, seeds=(5,)))
    assert json.loads(result.to_json()) == result
    table = str(result)
    for row in result["cells"].values():
        for count in row.values():
            assert f"{count:,}" in table
    assert f"{100 * result['agreement']:.2f} %" in table
    assert f"{result['distances']['hausdorff']:.3f}" in table


@pytest.mark.parametrize("dim", [2, 3])
def test_pictures_show_where_the_maps_differ(tmp_path: Path, dim: int) -> None:
    pytest.importorskip("matplotlib")
    pil = pytest.importorskip("PIL.Image")
    grid = np.zeros((30, 20, 5)[:dim], dtype=int)
    changed = grid.copy()
    changed[3:9, 10] = 1
    a = ndtree.from_grid(grid, [0] * dim, 0.1)
    b = ndtree.from_grid(changed, [0] * dim, 0.1)
    only_b = np.array([0x1F, 0x4F, 0xB4])
    shares = {}
    for name, (one, other) in {"same": (a, a), "b": (a, b), "a": (b, a)}.items():
        ndtree.compare_maps(one, other).draw(tmp_path / f"{name}.png")
        with pil.open(tmp_path / f"{name}.png") as image:
            pixels = np.asarray(image.convert("RGB")).astype(int)
        shares[name] = np.mean(np.abs(pixels - only_b).max(axis=2) < 10)
    assert shares["same"] == shares["a"] == 0
    assert 0.002 < shares["b"] < 0.03  # 6 of 600 cells, within the frame.
    with pytest.raises(ValueError, match=r"must end in"):
        ndtree.compare_maps(a, b).draw(tmp_path / "a.doc")


@pytest.mark.parametrize(
    "options, message",
    [
        ({"cell_size": 0}, "cell_size = 0 m"),
        ({"cell_size": float("nan")}, "cell_size = nan"),
        ({"max_points": 0}, "max_points = 0"),
    ],
)
def test_wrong_calls_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ndtree.compare_maps(room(2), room(2), **options)


# --- Commands -------------------------------------------------------------------------------------


def run(*arguments: object) -> Any:
    pytest.importorskip("typer")
    from calling import cli

    return cli(*arguments)


def test_the_command_compares_and_converts(tmp_path: Path) -> None:
    m = room(3)
    m.save(tmp_path / "room.ndt")
    done = run("convert", tmp_path / "room.ndt", tmp_path / "room.bt", "--cell-size", 0.3)
    assert done.exit_code == 0, done.stderr
    assert ndtree.load_octomap(tmp_path / "room.bt").options["min_cell_size"] == 0.3
    done = run("convert", tmp_path / "room.bt", tmp_path / "room.yaml", "--height", -0.5, 0.5)
    assert done.exit_code == 0 and (tmp_path / "room.pgm").exists(), done.stderr
    done = run("convert", tmp_path / "room.ndt", tmp_path / "room.ply", "--states", "occupied,frontier")
    assert done.exit_code == 0 and (tmp_path / "room.ply").exists(), done.stderr
    done = run("info", tmp_path / "room.bt", "--json", tmp_path / "info.json")
    assert done.exit_code == 0, done.stderr
    assert json.loads((tmp_path / "info.json").read_text())["options"]["min_cell_size"] == 0.3
    both = tmp_path / "room.ndt", tmp_path / "room.bt"
    done = run("compare", *both, "--json", tmp_path / "figures.json")
    assert done.exit_code == 0, done.stderr
    assert json.loads((tmp_path / "figures.json").read_text()) == ndtree.compare_maps(*both)
    assert done.stdout == f"{ndtree.compare_maps(*both)}\n"
