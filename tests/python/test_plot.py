# SPDX-License-Identifier: BSD-3-Clause
"""Pictures show what the map says at each pixel, in front what is in front, and in seconds."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ndtree

pytest.importorskip("matplotlib")

from conftest import with_room
from matplotlib import colormaps
from matplotlib.collections import LineCollection, PolyCollection

from ndtree import plot
from ndtree.cells.lattice import Cells
from ndtree.plot import cubes
from ndtree.plot.close_ups import close_up_region
from ndtree.plot.colors import round_length
from ndtree.plot.images import MAX_IMAGE_CELLS


@pytest.fixture(scope="module")
def flat() -> Any:
    return with_room(ndtree.AdaptiveMap(dim=2, max_cell_size=0.8), 8)


@pytest.fixture(scope="module")
def solid() -> Any:
    return with_room(ndtree.AdaptiveMap(dim=3, max_cell_size=0.8), 40)


def shown_image(ax: Any) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    image = ax.images[0]
    return np.asarray(image.get_array()), image.get_extent()


def centres(image: np.ndarray, extent: tuple[float, float, float, float]) -> np.ndarray:
    height, width = image.shape
    x = extent[0] + (np.arange(width) + 0.5) * (extent[1] - extent[0]) / width
    y = extent[2] + (np.arange(height) + 0.5) * (extent[3] - extent[2]) / height
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def states_of(image: np.ndarray) -> np.ndarray:
    return np.where(image > 0.5, 1, np.where(image < 0.5, 0, -1)).ravel()


# --- 2-D --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("branching", [2, 3])
@pytest.mark.parametrize("kind", ["adaptive", "fixed"])
def test_each_pixel_has_the_state_of_the_map_there(kind: str, branching: int) -> None:
    if kind == "adaptive":
        m = with_room(ndtree.AdaptiveMap(dim=2, branching=branching, max_cell_size=1.5), 8)
    else:
        m = with_room(ndtree.FixedMap(dim=2, branching=branching, min_cell_size=0.1), 8)
    image, extent = shown_image(plot.occupancy(m))
    np.testing.assert_array_equal(states_of(image), m.state(centres(image, extent)))
    assert image.size > 1000
    assert {0, 1} <= set(states_of(image))


def test_vast_maps_become_images_of_bounded_size() -> None:
    m = ndtree.AdaptiveMap(dim=2, refinement="paper", min_cell_size=0.01, max_cell_size=5.12)
    m.insert(np.array([[3000.0, 2000.0]]), np.zeros(2), max_range=4000.0)
    image, _ = shown_image(plot.occupancy(m, region=(0, 3000, 0, 2000)))
    assert image.size <= 2 * MAX_IMAGE_CELLS
    assert (image > 0.5).any()


def test_an_occupied_cell_marks_its_pixel_however_small(tmp_path: Path) -> None:
    generator = np.random.default_rng(5)
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, max_cell_size=51.2)
    ends = generator.uniform(40, 860, (40, 2))
    for _ in range(4):
        m.insert(ends, ends + np.array([3.0, 0.0]))
    is_occupied = m.state(ends) == 1
    assert np.count_nonzero(is_occupied) > 30
    from matplotlib.figure import Figure
    from matplotlib.image import imread

    ax = Figure(figsize=(4, 4)).add_axes((0, 0, 1, 1))
    ax.set_axis_off()
    plot.occupancy(m, ax, region=(0, 900, 0, 900))
    assert ax.images[0].get_array().size > 4_000_000
    for size in (171, 64):
        ax.figure.savefig(tmp_path / "vast.png", dpi=size / 4)
        shown = imread(tmp_path / "vast.png")[::-1, :, 0]
        for x, y in ends[is_occupied]:
            column, row = (np.array([x, y]) / 900 * size).astype(int)
            assert shown[row - 1 : row + 2, column - 1 : column + 2].min() < 0.5, (size, x, y)
        assert np.count_nonzero(shown < 0.7) < 9 * len(ends)
    ax.figure.savefig(tmp_path / "vast.pdf")
    assert (tmp_path / "vast.pdf").stat().st_size < 1_000_000
    assert ax.images[0].get_array().size > 4_000_000, "drawing changed the image"


def test_sizes_of_cells_are_shown(flat: Any) -> None:
    ax = plot.cell_sizes(flat)
    (image,) = ax.images
    sizes = np.ma.filled(image.get_array(), np.nan)
    points = centres(sizes, image.get_extent())
    leaves = flat.leaves()
    seen = np.zeros(len(points), dtype=np.bool_)
    for lower, size in zip(leaves.lower[leaves.observed], leaves.size[leaves.observed]):
        seen |= ((points >= lower) & (points < lower + size)).all(axis=1)
    np.testing.assert_array_equal(np.isnan(sizes.ravel()), ~seen)
    np.testing.assert_allclose(sizes.ravel()[seen], flat.cell_size(points[seen]), rtol=1e-6)
    assert len(np.unique(sizes[~np.isnan(sizes)])) > 2


def drawn_border(ax: Any, horizontal: bool) -> set[tuple[int, int]]:
    """Unit segments along one axis that the lines cover, in cells of 0.05 m."""
    units: list[tuple[int, int]] = []
    along, across = (0, 1) if horizontal else (1, 0)
    for collection in ax.collections:
        assert isinstance(collection, LineCollection)
        for (x0, y0), (x1, y1) in collection.get_segments():
            a, b = np.rint(np.array([[x0, y0], [x1, y1]]) / 0.05).astype(int)
            if a[across] == b[across]:
                units += [(int(a[across]), k) for k in range(a[along], b[along])]
    assert len(units) == len(set(units)), "a border is drawn twice"
    return set(units)


def test_borders_are_the_leaves_sides_each_once(flat: Any) -> None:
    leaves = flat.leaves()
    whole = (-100.0, 100.0, -100.0, 100.0)
    ax = plot.cells(flat, region=whole)
    lower = np.rint(leaves.lower / 0.05).astype(int)
    size = np.rint(leaves.size / 0.05).astype(int)
    expected: tuple[set[tuple[int, int]], set[tuple[int, int]]] = (set(), set())
    for (x, y), s in zip(lower, size):
        for k in range(s):
            expected[0].update(((y, x + k), (y + s, x + k)))
            expected[1].update(((x, y + k), (x + s, y + k)))
    assert drawn_border(ax, horizontal=True) == {(int(a), int(b)) for a, b in expected[0]}
    assert drawn_border(ax, horizontal=False) == {(int(a), int(b)) for a, b in expected[1]}
    assert len(leaves.size) > 300


@pytest.mark.parametrize("axis, held", [("x", 0), ("y", 1), ("z", 2), (2, 2)])
def test_slice_has_the_states_of_its_plane(solid: Any, axis: Any, held: int) -> None:
    image, extent = shown_image(plot.slice(solid, axis, 0.31, borders=True))
    points = np.insert(centres(image, extent), held, 0.31, axis=1)
    np.testing.assert_array_equal(states_of(image), solid.state(points))


# --- 3-D --------------------------------------------------------------------------------------------


def faces_of(ax: Any) -> tuple[np.ndarray, np.ndarray]:
    (collection,) = ax.collections
    assert isinstance(collection, PolyCollection)
    quads = np.array([path.vertices[:4] for path in collection.get_paths()])
    return quads, collection.get_facecolors()[:, :3]


@pytest.mark.parametrize("branching, azimuth, elevation", [(2, 215.0, -30.0), (3, 130.0, 60.0)])
def test_what_is_in_front_is_drawn_last(branching: int, azimuth: float, elevation: float) -> None:
    m = with_room(ndtree.AdaptiveMap(dim=3, branching=branching, max_cell_size=0.9, min_cell_size=0.1), 30)
    region = (-5.0, 5.0) * 3
    heights = (-2.0, 2.0)
    view: dict[str, Any] = {"azimuth": azimuth, "elevation": elevation, "cut_above": None, "heights": heights}
    quads, colors = faces_of(plot.occupied(m, region=region, **view))

    a, e = np.radians([azimuth, elevation])
    to_viewer = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    up = np.cross(to_viewer, right)
    leaves = m.leaves()
    chosen = leaves.state == 1
    lower, size = leaves.lower[chosen], leaves.size[chosen]
    generator = np.random.default_rng(2)
    checked = 0
    for _ in range(100):
        # Of the cubes on a line of sight, the nearest one is seen.
        inside = lower[(i := generator.integers(len(size)))] + generator.uniform(0.2, 0.8, 3) * size[i]
        with np.errstate(divide="ignore"):
            one = (lower - inside) / to_viewer
            two = (lower + size[:, None] - inside) / to_viewer
        enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
        met = np.flatnonzero(enter < leave - 1e-9)
        nearest = met[leave[met].argmax()]
        level = np.clip((lower[nearest, 2] + 0.5 * size[nearest] + 2.0) / 4.0, 0, 1)
        expected = np.array(colormaps["viridis"](level)[:3])

        point = np.array([inside @ right, inside @ up])
        edges = np.roll(quads, -1, axis=1) - quads
        side = edges[:, :, 0] * (point[1] - quads[:, :, 1]) - edges[:, :, 1] * (point[0] - quads[:, :, 0])
        hit = np.flatnonzero((side > 1e-9).all(axis=1) | (side < -1e-9).all(axis=1))
        if not len(hit):
            continue  # On an edge.
        shown = colors[hit[-1]]
        ratio = shown / np.maximum(expected, 1e-9)
        np.testing.assert_allclose(ratio[expected > 0.05], ratio[expected > 0.05].mean(), rtol=1e-6)
        assert 0.6 < ratio[expected > 0.05].mean() <= 1.0 + 1e-9
        checked += 1
    assert checked > 80


@pytest.mark.parametrize("color", plot.COLORS)
def test_colors_say_what_they_should(solid: Any, color: str) -> None:
    some = Cells.of(solid)
    some = some.where(some.occupied)
    colors = plot.coloring(some, color)
    values = {
        "height": (some.lower[:, 2] + 0.5 * some.size) * some.unit,
        "size": some.size * some.unit,
        "probability": some.probability,
    }[color]
    shown = colors(some)
    legend = colors.legend()
    expected = legend.cmap(legend.norm(np.clip(values, legend.norm.vmin, legend.norm.vmax)))[:, :3]
    assert np.abs(shown - expected).max() < 0.05
    assert len(np.unique(shown, axis=0)) > 1
    quads, _ = faces_of(plot.occupied(solid, color=color, region=(-3.0, 0.0, -3.0, 0.0, -3.0, 3.0)))
    assert len(quads) > 100


def test_ceiling_is_cut_away_in_a_room_and_only_there() -> None:
    def room(with_ceiling: bool) -> Any:
        m = ndtree.FixedMap(dim=3, min_cell_size=0.1)
        generator = np.random.default_rng(4)
        n = 40_000
        wall = generator.uniform((-2, -2, 0), (2, 2, 2.5), (n, 3))
        side = generator.integers(0, 6 if with_ceiling else 5, n)
        for axis in range(3):
            wall[side == 2 * axis, axis] = (-2, -2, 0)[axis]
            wall[side == 2 * axis + 1, axis] = (2, 2, 2.5)[axis]
        m.insert(wall, np.array([0.1, 0.2, 1.2]))
        return m

    def top(m: Any, **more: Any) -> float:
        quads, _ = faces_of(plot.occupied(m, azimuth=0.0, elevation=0.0, **more))
        return float(quads[:, :, 1].max())

    assert 2.2 < top(room(True)) <= 2.5
    assert top(room(True), cut_above=None) > 2.5
    assert top(room(True), cut_above=1.0) == pytest.approx(1.0)
    assert top(room(False)) > 2.4


def test_many_faces_are_an_image_in_vector_graphics(tmp_path: Path, monkeypatch: Any) -> None:
    few = with_room(ndtree.AdaptiveMap(dim=3, max_cell_size=0.8), 6)
    sizes = []
    for most in (10**9, 0):
        monkeypatch.setattr(cubes, "MAX_VECTOR_FACES", most)
        path = tmp_path / f"{most}.svg"
        plot.occupied(few).figure.savefig(path)
        sizes.append((path.stat().st_size, path.read_text().count("<image")))
    assert sizes[1][0] < 0.5 * sizes[0][0] and [count for _, count in sizes] == [0, 1]


# --- Files, errors, speed ---------------------------------------------------------------------------


def test_side_by_side_is_written(flat: Any, solid: Any, tmp_path: Path) -> None:
    fixed = with_room(ndtree.FixedMap(dim=2, min_cell_size=0.1), 8)
    fixed_3d = with_room(ndtree.FixedMap(dim=3, min_cell_size=0.2), 8)
    plot.side_by_side(flat, fixed, tmp_path / "2d.png", dpi=60)
    plot.side_by_side(flat, fixed, tmp_path / "column.png", dpi=60, row=False)
    plot.side_by_side_3d(solid, fixed_3d, tmp_path / "3d.png", dpi=60)
    for name, figure in (
        ("overview.svg", plot.overview_3d(solid, color="size", slice_axis="x", slice_at=0.2, dpi=20)),
        ("overview.pdf", plot.overview(flat, color="size")),
    ):
        figure.savefig(tmp_path / name)
        assert (tmp_path / name).stat().st_size > 5000
        (tmp_path / name).unlink()
    from matplotlib.image import imread

    pictures = {path.name: imread(path) for path in tmp_path.iterdir()}
    for name, picture in pictures.items():
        assert picture.std() > 0.05, f"{name} is blank"
    assert pictures["column.png"].shape[0] > pictures["2d.png"].shape[0]


def test_an_axes_that_is_given_is_used(flat: Any, solid: Any) -> None:
    from matplotlib.figure import Figure

    axes = Figure().subplots(2, 2).ravel()
    assert plot.cells(flat, axes[0]) is axes[0]
    assert plot.occupancy(flat, axes[1]) is axes[1]
    assert plot.occupied(solid, axes[2]) is axes[2]
    assert plot.slice(solid, "z", 0.0, axes[3]) is axes[3]


def test_wrong_maps_are_refused(flat: Any, solid: Any, tmp_path: Path) -> None:
    with pytest.raises(
        ValueError,
        match=r"the map is 3-D: this picture needs a 2-D map; .*\n  ndtree\.plot\.slice\(m, z=1\.0\)",
    ):
        plot.occupancy(solid)
    with pytest.raises(
        ValueError, match=r"the map is 2-D: this picture needs a 3-D map; .*\n  ndtree\.plot\.occupancy\(m\)"
    ):
        plot.occupied(flat)
    with pytest.raises(ValueError, match="the map is empty"):
        plot.cells(ndtree.AdaptiveMap(dim=2))
    with pytest.raises(ValueError, match="axis = 'w': must be x, y, z, 0, 1 or 2"):
        plot.slice(solid, "w", 0.0)
    with pytest.raises(ValueError, match="color = 'taste': must be one of height, size, probability"):
        plot.occupied(solid, color="taste")
    with pytest.raises(ValueError, match=r"color = .height.: must be state, probability or size"):
        plot.overview(flat, tmp_path / "a.png", color="height")
    with pytest.raises(ValueError, match=r"[Ff]ormat"):
        plot.overview(flat, tmp_path / "a.doc")
    assert not list(tmp_path.iterdir()), "something was half written"
    with pytest.raises(ValueError, match="z = 90 m: the map was not observed there"):
        plot.slice(solid, "z", 90.0)
    with pytest.raises(ValueError, match="no occupied cell is in it"):
        plot.occupied(solid, cut_above=-9.0)
    with pytest.raises(ValueError, match="cut_above = 'roof': must be a height in metres, 'auto' or None"):
        plot.occupied(solid, cut_above="roof")


@pytest.mark.long
def test_the_gallery_is_drawn_by_its_script(tmp_path: Path) -> None:
    gallery = Path(__file__).resolve().parents[2] / "tools" / "gallery"
    if not gallery.exists():
        pytest.skip(f"{gallery} is not there")

    def drawn(*names: str) -> Any:
        command = [sys.executable, str(gallery), *names, "--data", str(tmp_path), "--output", str(tmp_path)]
        return subprocess.run(command, capture_output=True, text=True)

    assert drawn("truth").returncode == 0
    assert 1000 < (tmp_path / "truth.png").stat().st_size < 200_000
    done = drawn("kinect")
    assert done.returncode == 1
    assert "kinect is left out" in done.stderr and "is not there" in done.stderr
    assert drawn("nothing").returncode == 2


def test_a_close_up_shows_both_maps_alike_and_counts_their_cells(flat: Any, tmp_path: Path) -> None:
    fixed = with_room(ndtree.FixedMap(dim=2, min_cell_size=0.1), 8)
    figure = plot.close_up(flat, fixed, tmp_path / "a.png", dpi=60)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    whole_fixed, whole, near_fixed, near = figure.axes
    counts = [int(Cells.of(m).observed.sum()) for m in (fixed, flat)]
    assert f"fixed, {counts[0]:,} cells" in whole_fixed.get_title(loc="left")
    assert f"adaptive, {counts[1]:,} cells" in whole.get_title(loc="left")
    ratio = counts[0] / counts[1]
    said = f"{max(ratio, 1 / ratio):.1f} times {'fewer' if ratio >= 1 else 'more'}"
    assert said in whole.get_title(loc="left")
    for one, other in ((whole, whole_fixed), (near, near_fixed)):
        assert (one.get_xlim(), one.get_ylim()) == (other.get_xlim(), other.get_ylim())
    assert whole.get_xlim()[0] <= near.get_xlim()[0] < near.get_xlim()[1] <= whole.get_xlim()[1]
    assert whole.get_ylim()[0] <= near.get_ylim()[0] < near.get_ylim()[1] <= whole.get_ylim()[1] + 0.05
    # Borders are drawn from close by only.
    assert [bool(ax.collections) for ax in figure.axes] == [False, False, True, True]
    chosen = plot.close_up(flat, fixed, region=(0.0, 1.0, 0.0, 0.5)).axes[3]
    assert (*chosen.get_xlim(), *chosen.get_ylim()) == (0.0, 1.0, 0.0, 0.5)


def test_a_close_up_is_where_surfaces_are() -> None:
    m = ndtree.FixedMap(dim=2, min_cell_size=0.1)
    across = np.linspace(-0.2, 0.2, 40)
    for _ in range(4):  # A corridor of 60 m, with a wall at its far end alone.
        ends = np.stack([np.full(40, 60.0), 3 * across], axis=1)
        m.insert(ends, np.zeros(2))
    x_min, x_max, y_min, y_max = close_up_region(Cells.of(m))
    assert x_min < 60.0 <= x_max and y_min < 0.5 and y_max > -0.5
    assert x_max - x_min < 12.0


def test_a_scale_bar_is_as_long_as_it_says(flat: Any, solid: Any) -> None:
    for figure in (plot.overview(flat), plot.overview_3d(solid), plot.side_by_side(flat, flat)):
        ax = figure.axes[0]
        (bar,) = (line for line in ax.lines if line.get_label() == "_scale")
        (said,) = (text.get_text() for text in ax.texts)
        begin, end = bar.get_xdata()
        assert said == f"{end - begin:g} m"
        wide = np.ptp(ax.get_xlim())
        assert 0.08 * wide < end - begin <= 0.25 * wide


@pytest.mark.parametrize("most", [1e-3, 0.0199, 0.02, 1.0, 4.999, 5.0, 7.3, 99.0, 12345.0])
def test_round_lengths_are_the_largest_that_fit(most: float) -> None:
    length = round_length(most)
    rounds = [step * 10.0**power for power in range(-5, 6) for step in (1, 2, 5)]
    assert length == pytest.approx(max(one for one in rounds if one <= most * (1 + 1e-9)), rel=1e-12)


def test_overviews_say_what_axes_and_greys_mean(flat: Any, solid: Any) -> None:
    for ax, names in ((plot.overview(flat).axes[0], "xy"), (plot.overview_3d(solid).axes[1], "xy")):
        assert (ax.get_xlabel(), ax.get_ylabel()) == tuple(f"{name} [m]" for name in names)
        legend = ax.get_legend()
        shown = {
            text.get_text(): patch.get_facecolor()[0]
            for text, patch in zip(legend.get_texts(), legend.get_patches())
        }
        assert shown == {"occupied": 0.0, "free": 254 / 255, "unknown": 205 / 255}
    assert plot.overview(flat).axes[0].get_title("left").startswith("adaptive, ")


# --- What is in the frame ---------------------------------------------------------------------------


def beside_a_wall(length: float = 4.0, scans: int = 10) -> Any:
    """One straight wall, seen from a place where beams meet nothing else for 5 m."""
    m = ndtree.AdaptiveMap(dim=2)
    angle = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for _ in range(scans):
        with np.errstate(divide="ignore"):
            to_wall = np.where(way[:, 1] > 0, 1.02 / way[:, 1], np.inf)
        returned = (to_wall < 5) & (np.abs(to_wall * way[:, 0]) < length / 2)
        m.insert(np.where(returned, to_wall, 5.0)[:, None] * way, np.zeros(2), returned=returned)
    return m


def test_all_that_was_observed_is_in_the_frame() -> None:
    m = beside_a_wall()
    leaves = m.leaves()
    seen = leaves.lower[leaves.observed], (leaves.lower + leaves.size[:, None])[leaves.observed]
    assert np.ptp(leaves.lower[leaves.state == 1][:, 1]) < 0.2, "the wall is straight"
    for ax in (plot.overview(m).axes[0], plot.occupancy(m), plot.cells(m), plot.cell_sizes(m)):
        (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
        assert (seen[0] >= (left, bottom)).all() and (seen[1] <= (right, top)).all()
    ax = plot.overview(m, track=[(0.0, 0.0), (60.0, 1.0)]).axes[0]
    assert ax.get_xlim()[1] > 60 and ax.get_xlim()[0] < seen[0][:, 0].min()


def test_single_beams_that_went_far_do_not_shrink_the_rest() -> None:
    m = beside_a_wall()
    whole = plot.overview(m).axes[0]
    for far in ((900.0, 3.0), (3.0, -900.0), (-400.0, -400.0)):
        m.insert(np.array([far]), np.zeros(2), returned=np.zeros(1, dtype=bool))
        ax = plot.overview(m).axes[0]
        for few, many in ((whole.get_xlim(), ax.get_xlim()), (whole.get_ylim(), ax.get_ylim())):
            assert many[0] < few[0] + 0.5 and many[1] > few[1] - 0.5 and np.ptp(many) < 20
    track = [(0.0, 0.0), (300.0, 1.0)]
    assert plot.overview(m, track=track).axes[0].get_xlim()[1] > 300


@pytest.mark.parametrize("length", [1.0, 100.0, pytest.param(20_000.0, marks=pytest.mark.long)])
def test_nothing_but_a_wall_is_a_picture_of_bounded_size(length: float, tmp_path: Path) -> None:
    m = ndtree.FixedMap(dim=2, min_cell_size=0.1)
    ends = np.stack([np.full(4, 0.02), np.array([-0.5, -0.25, 0.25, 0.5]) * length], axis=1)
    for _ in range(3):
        m.insert(ends, ends * (0, 1) - (0.03, 0))
        m.insert(ends, ends * (0, 0.99))
    figure = plot.overview(m, tmp_path / "a.png")
    shape = np.array(figure.get_size_inches()) * figure.dpi
    assert shape.max() < 8000 and shape.min() > 400
    assert (tmp_path / "a.png").stat().st_size > 3000


def test_occupancy_has_the_colors_of_map_server(flat: Any, tmp_path: Path) -> None:
    """Each pixel is black, 254 or 205 as the map's state there is, whatever the probability."""
    ax = plot.occupancy(flat)
    image, extent = shown_image(ax)
    states = flat.state(centres(image, extent)).reshape(image.shape)
    drawn = ax.images[0].to_rgba(image, bytes=True)[..., :3]
    for state, grey in ((1, 0), (0, 254), (-1, 205)):
        assert (states == state).any() and (drawn[states == state] == grey).all()
    levels, extent = shown_image(plot.occupancy(flat, color="probability"))
    between = (levels > 0) & (levels < 1) & (levels != 0.5)
    np.testing.assert_array_equal(states_of(levels), flat.state(centres(levels, extent)))
    assert between.any() and levels.min() == 0 and levels.max() == 1
    with pytest.raises(ValueError, match="color = 'size': must be state or probability"):
        plot.occupancy(flat, color="size")


def test_notebooks_show_what_is_drawn() -> None:
    """All functions give what has a PNG of itself, of some size, and pyplot holds none of the figures."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1)
    m.insert(np.array([[2.0, 1.0], [2.0, 1.1]]), [0.0, 0.0])
    m3 = ndtree.AdaptiveMap(dim=3, min_cell_size=0.1)
    m3.insert(np.array([[2.0, 1.0, 0.0], [2.0, 1.1, 0.0]]), [0.0, 0.0, 0.0])
    drawn = [
        ndtree.plot.occupancy(m), ndtree.plot.cells(m), ndtree.plot.cell_sizes(m),
        ndtree.plot.slice(m3, z=0.05),        ndtree.plot.overview(m), ndtree.plot.side_by_side(m, m),
    ]  # fmt: skip
    for one in drawn:
        png = one._repr_png_()
        assert png.startswith(b"\x89PNG") and len(png) > 1000
        width, height = struct.unpack(">II", png[16:24])
        assert 300 <= width <= 1200 and 100 <= height <= 1200
    assert not pyplot.get_fignums()
    own = pyplot.figure().add_subplot()
    assert ndtree.plot.occupancy(m, ax=own) is own
    pyplot.close("all")


def test_truth_by_cell_size_is_what_the_comparison_says() -> None:
    comparison = ndtree.compare(ndtree.simulate("office", scans=60), ["adaptive", "fixed"])
    rows = [row for row in comparison["truth_by_cell_size"]["sizes"] if row["size"] and row["endpoints"]]
    ax = plot.truth_by_cell_size(comparison, of="endpoints")
    lines = {line.get_label(): line.get_xydata() for line in ax.lines}
    assert set(lines) == {"adaptive", "fixed"}
    for name, line in lines.items():
        expected = [(row["size"], row["endpoints_near"][name] / row["endpoints"]) for row in rows]
        np.testing.assert_allclose(line, expected)
    assert len(rows) > 1
    with pytest.raises(ValueError, match="of = 'walls': must be free or endpoints"):
        plot.truth_by_cell_size(comparison, of="walls")
    comparison["truth_by_cell_size"] = None
    with pytest.raises(ValueError, match="needs scans held out and an adaptive map"):
        plot.truth_by_cell_size(comparison)
