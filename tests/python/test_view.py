# SPDX-License-Identifier: BSD-3-Clause
"""The page shows the map: its cells where they are, the one that is clicked, and as it grows."""

from __future__ import annotations

import itertools
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("rich")
pytest.importorskip("viser", reason="viser is not installed")

import pytest
from browser import Browser, coloured
from calling import cli
from conftest import room_log, room_scan, with_room

import ndtree
from ndtree import viewer as view
from ndtree.cells.regions import MAX_TRACK, Track
from ndtree.viewer import Look, snapshot
from ndtree.viewer.frame import framed
from ndtree.viewer.look import KINDS, shown_kinds
from ndtree.viewer.snapshot import Snapshot
from ndtree.viewer.visitor import Visitor
from ndtree.viewer.ways import Ways, place_on_plane


@pytest.fixture(scope="module")
def flat() -> Any:
    return with_room(ndtree.AdaptiveMap(dim=2, max_cell_size=0.8), 8)


@pytest.fixture(scope="module")
def solid() -> Any:
    return with_room(ndtree.AdaptiveMap(dim=3, min_cell_size=0.2, max_cell_size=0.8), 30)


@pytest.fixture(scope="module")
def map_file(solid: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("maps") / "room.ndt"
    solid.save(path)
    return path


# --- What is drawn ----------------------------------------------------------------------------------


def boxes(some: Snapshot, kind: str, look: Look) -> tuple[np.ndarray, np.ndarray]:
    """All boxes of a layer in the map's frame."""
    lower, upper = some.layer(kind, look).boxes
    return lower + some.origin, upper + some.origin


@pytest.mark.parametrize("far", [0.0, 512_000.0])
def test_boxes_are_the_cells_of_their_state(far: float) -> None:
    m = with_room(ndtree.AdaptiveMap(dim=3, min_cell_size=0.125, max_cell_size=1.0), 20, far=far)
    seen = Snapshot(m)
    for kind, state in (("occupied", 1), ("free", 0), ("unknown", -1)):
        lower, upper = boxes(seen, kind, Look())
        assert len(lower) > 100
        np.testing.assert_array_equal(m.state(0.5 * (lower + upper)), state)
    lower, upper = boxes(seen, "occupied", Look())
    shown = {tuple(row) for row in np.rint((0.5 * (lower + upper) - far) / 0.03125).astype(int).tolist()}
    leaves = m.leaves()
    there = leaves.state == 1
    middles = leaves.lower[there] + 0.5 * leaves.size[there, None]
    step = np.zeros(3)
    left_out = 0
    for middle, size in zip(middles, leaves.size[there]):
        if tuple(np.rint((middle - far) / 0.03125).astype(int).tolist()) in shown:
            continue
        left_out += 1
        for axis in range(3):  # Hidden: at each face is an occupied cell.
            for side in (-1, 1):
                step[:] = 0
                step[axis] = side * (0.5 * size + 0.01)
                assert m.state((middle + step)[None])[0] == 1
    assert left_out < len(middles)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slice_cuts_and_shows_what_it_goes_through(solid: Any, axis: int) -> None:
    seen = Snapshot(solid)
    at = 0.33
    look = Look(axis=axis, slice_at=at, free=True)
    assert shown_kinds(look) == ["occupied", "free", "plane_occupied", "plane_free"]
    for kind in ("occupied", "free"):
        lower, upper = boxes(seen, kind, look)
        assert upper[:, axis].max() == pytest.approx(at, abs=1e-6)
        assert (lower < upper).all()
    for kind, state in (("plane_occupied", 1), ("plane_free", 0)):
        lower, upper = boxes(seen, kind, look)
        np.testing.assert_allclose(lower[:, axis], at, atol=1e-6)
        np.testing.assert_array_equal(solid.state(0.5 * (lower + upper)), state)
        assert len(lower) > 20
    whole = boxes(seen, "occupied", Look(axis=axis, slice_at=at, cut=False))[1]
    np.testing.assert_array_equal(whole, boxes(seen, "occupied", Look())[1])
    cut_cells = seen.layer("occupied", look).cells
    touched = seen.cells.where(seen.cells.occupied).through(axis, at)
    rows = {tuple(row) for row in cut_cells.lower.tolist()}
    assert all(tuple(row) in rows for row in touched.lower.tolist()), "what the cut lays open is left out"


@pytest.mark.parametrize("dim", [2, 3])
def test_the_cell_that_is_picked_is_the_first_on_the_ray(dim: int, flat: Any, solid: Any) -> None:
    m = flat if dim == 2 else solid
    seen = Snapshot(m)
    generator = np.random.default_rng(6)
    look = Look.of(dim, free=False)
    picked = 0
    for _ in range(60):
        if dim == 2:
            origin, direction = np.array([*generator.uniform(-2.1, 2.1, 2), 5.0]), np.array([0.0, 0.0, -1.0])
            point = origin[:2]
            expected = point if m.state(point[None])[0] == 1 else None
        else:
            origin = generator.uniform(-0.5, 0.5, 3)
            direction = generator.normal(size=3)
            direction /= np.linalg.norm(direction)
            (far,) = m.cast_rays(origin[None], direction[None], max_range=10.0, at="cell")
            expected = origin + (far + 1e-6) * direction if np.isfinite(far) else None
        found = seen.picked(origin - seen.origin, direction, look)
        assert (found is None) == (expected is None)
        if found is None or expected is None:
            continue
        cells, number = found
        lower, upper = cells.lower[number] * cells.unit, cells.upper[number] * cells.unit
        assert (lower - 1e-6 <= expected).all() and (expected <= upper + 1e-6).all()
        text = snapshot.numbers_of(cells, number)
        assert f"{m.probability(0.5 * (lower + upper)[None])[0]:.3f}" in text
        assert "occupied" in text
        picked += 1
    assert picked > (3 if dim == 2 else 40)


def test_more_boxes_than_the_budget_are_never_sent(solid: Any) -> None:
    layer = Snapshot(solid).layer("occupied", Look())
    for budget in (30, 300, 3000):
        chosen = layer.pyramid.chosen(np.array([9.0, 0.0, 2.0]), budget)
        assert len(chosen) <= budget
        assert layer.pyramid.weight[chosen].sum() == len(layer.cells)


def test_layers_are_kept_but_not_all(solid: Any) -> None:
    seen = Snapshot(solid)
    first = seen.layer("occupied", Look())
    assert seen.layer("occupied", Look(free=True)) is first
    for i in range(snapshot.MAX_LAYERS):
        seen.layer("occupied", Look(slice_at=0.1 * i))
    assert seen.layer("occupied", Look()) is not first


def test_a_map_that_grows_stays_in_the_frame_of_its_page() -> None:
    """Whatever the map: also where no wall was seen at first, and where the next map is of another kind."""
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=0.1)
    points, origin = room_scan(3, 0)
    m.insert(points, origin, returned=np.zeros(len(points), dtype=bool))
    look = Look(color="size")
    with view.Viewer(m, port=0, look=look) as page:
        first = page.snapshot
        assert first is not None and first.layer("occupied", look).coloring is None
        for later in (with_room(m, 3, far=40.0), with_room(ndtree.FixedMap(dim=3, min_cell_size=0.2), 2)):
            page.show(later)
            now, new = page.snapshot, Snapshot(later)
            assert now is not None
            np.testing.assert_array_equal(now.origin, first.origin)
            for kind in KINDS[:3]:
                np.testing.assert_allclose(boxes(now, kind, look), boxes(new, kind, look), atol=1e-4)
            assert now.layer("occupied", look).coloring is not None


def test_a_track_stays_bounded() -> None:
    track = Track()
    for i in range(3 * MAX_TRACK):
        track.add(ndtree.Scan(np.zeros((1, 2)), np.array([float(i), 1.0])))
    points = np.asarray(track)
    assert MAX_TRACK // 2 <= len(points) <= MAX_TRACK
    assert points.shape[1] == 3
    assert points[0, 0] == 0 and points[-1, 0] > 2.9 * MAX_TRACK
    assert len(np.unique(np.diff(points[:, 0]))) == 1


# --- The page ---------------------------------------------------------------------------------------


@pytest.fixture(scope="class")
def page(solid: Any) -> Iterator[Browser]:
    with view.Viewer(solid, port=0, look=Look(track=False)) as viewer, Browser(viewer.url) as browser:
        browser.until(lambda b: np.count_nonzero(coloured(b.picture())) > 5000)
        yield browser


def number_after(text: str, name: str) -> str:
    return re.search(rf"{name}\s+(.+)", text)[1]  # type: ignore[index]


class TestOnePage:
    """One page for all of them, closed after the last: it draws as long as it is open."""

    def test_the_page_shows_the_map(self, page: Browser, solid: Any) -> None:
        picture = page.picture()
        seen = coloured(picture)
        rows, columns = np.nonzero(seen)
        assert 0.02 < seen.mean() < 0.9
        assert np.ptp(rows) > 150 and np.ptp(columns) > 200, "the map fills no good part of the page"
        hues = np.unique(picture[200:, :930][seen] // 32, axis=0)
        assert len(hues) > 10, "heights are not told apart"
        text = page.text()
        assert f"{solid.stats().observed_leaves:,} cells" in text
        assert f"for {np.count_nonzero(solid.leaves().state == 1):,} occupied cells" in text
        assert page.errors == []

    def test_a_click_picks_the_cell_there(self, page: Browser, solid: Any) -> None:
        seen = np.argwhere(coloured(page.picture()))
        row, column = seen[len(seen) // 2]
        page.click(int(column), int(row) + 200)
        page.until(lambda b: "hits" in b.text())
        text = page.text()
        centre = np.array([float(c) for c in re.findall(r"-?\d+\.\d+", number_after(text, "centre"))])
        assert solid.state(centre[None])[0] == 1
        leaves = solid.leaves()
        distance = np.abs(leaves.lower + 0.5 * leaves.size[:, None] - centre).max(axis=1)
        i = int(distance.argmin())
        assert distance[i] < 1e-3
        assert float(number_after(text, "probability")) == pytest.approx(leaves.probability[i], abs=6e-4)
        assert number_after(text, "hits") == f"{leaves.hits[i]:,}"
        assert number_after(text, "misses") == f"{leaves.misses[i]:,}"
        assert number_after(text, "size") == f"{leaves.size[i]:g} m"
        page.click(30, 780)
        page.until(lambda b: "no cell there" in b.text())

    def test_what_is_switched_off_is_not_seen(self, page: Browser) -> None:
        before = np.count_nonzero(coloured(page.picture()))
        page.click_label("Occupied")
        page.until(lambda b: np.count_nonzero(coloured(b.picture())) < 50)
        page.click_label("Unknown by free")
        page.until(lambda b: np.count_nonzero(coloured(b.picture())) > 1000)
        page.click_label("Unknown by free")
        page.click_label("Occupied")
        page.until(lambda b: np.count_nonzero(coloured(b.picture())) > 0.9 * before)

    def test_a_grid_and_a_scale_bar_say_how_large_it_is(self, page: Browser) -> None:
        def greys(b: Browser) -> int:
            shown = b.picture()[200:, :930].astype(int)
            return int(np.count_nonzero((np.ptp(shown, axis=2) < 4) & (shown[..., 0] < 250)))

        with_grid = greys(page)
        page.click_label("Grid and scale")
        page.until(lambda b: greys(b) < 0.7 * with_grid)
        page.click_label("Grid and scale")
        page.until(lambda b: greys(b) > 0.9 * with_grid)
        assert page.errors == []


def test_rooms_are_cut_below_their_ceiling() -> None:
    m = ndtree.AdaptiveMap(dim=3, max_cell_size=0.4)
    generator = np.random.default_rng(3)
    for _ in range(30):  # A room of 6 x 4 x 2.5 m.
        way = generator.normal(size=(3000, 3))
        way /= np.linalg.norm(way, axis=1)[:, None]
        origin = np.array([*generator.uniform(-1, 1, 2), 1.2])
        with np.errstate(divide="ignore"):
            to = np.where(way > 0, [3, 2, 2.5] - origin, [-3, -2, 0] - origin) / way
        m.insert(origin + way * to.min(axis=1)[:, None], origin)
    look = Look.below_ceiling(m)
    assert look.axis == 2 and look.cut and not look.plane
    assert 2.1 < look.slice_at < 2.5
    assert boxes(Snapshot(m), "occupied", look)[1][:, 2].max() <= look.slice_at + 1e-6
    chosen = Look.below_ceiling(m, axis=0, slice_at=0.5)
    assert (chosen.axis, chosen.slice_at) == (0, 0.5)
    open_ = ndtree.AdaptiveMap(dim=3)
    points, origin = room_scan(3, 0)
    open_.insert(points[points[:, 2] < points[:, 2].mean()], origin)
    assert Look.below_ceiling(open_).slice_at is None


@pytest.mark.long
def test_a_growing_map_grows_on_the_page(flat: Any) -> None:
    with view.Viewer(port=0) as viewer, Browser(viewer.url) as browser:
        browser.until(lambda b: "ndtree" in b.text())
        m = ndtree.AdaptiveMap(dim=2, max_cell_size=0.8)
        counts = []
        for seed in range(2):
            points, origin = room_scan(2, seed)
            m.insert(points, origin)
            viewer.update(m, ndtree.Scan(points, origin))
            viewer.show(m)
            cells = f"{m.stats().observed_leaves:,} cells"
            browser.until(lambda b, cells=cells: cells in b.text())
            browser.until(lambda b: np.count_nonzero(coloured(b.picture())) > 300)
            counts.append(cells)
        assert len(set(counts)) == 2
        angle = np.linspace(0, 2 * np.pi, 2000)
        m.insert(30 * np.stack([np.cos(angle), np.sin(angle)], axis=1), np.zeros(2))
        viewer.show(m)  # The page was not turned: it steps back to show all, the ring's ends, too.
        browser.until(lambda b: np.ptp(np.nonzero(coloured(b.picture()))[0]) > 350)
        seen = coloured(browser.picture())
        assert not seen[-20:].any() and not seen[:, :20].any()
        assert browser.errors == []


# --- The command line -------------------------------------------------------------------------------


def ended(*arguments: object) -> tuple[int, str]:
    done = cli(*arguments)
    return done.exit_code, done.stderr.strip()


def test_interrupted_it_ends_well(map_file: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    log.write_text("".join(f"{i / 10} 0 0 {i / 10} {end} 0\n" for i in range(20) for end in (1, 2)))
    command = [sys.executable, "-m", "ndtree", "view", str(map_file), "--port", "0", "--log", str(log)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None and program.stderr is not None
        url = re.search(r"http://127\.0\.0\.1:\d+", program.stdout.readline())
        assert url is not None
        with urllib.request.urlopen(url[0], timeout=10) as answer:
            assert b"<html" in answer.read()
        program.send_signal(signal.SIGINT)
        assert program.wait(20) == 0
        assert program.stdout.read() == ""
        assert program.stderr.read() == ""


def test_a_busy_port_is_refused(map_file: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        status, line = ended("view", map_file, "--port", port)
    assert (status, line.count("\n")) == (1, 0)
    assert f"127.0.0.1:{port}: port {port} is in use by another program, expected a free one" in line


def test_a_page_frames_all_of_a_map() -> None:
    """Each corner of its box and of what is beside it is seen, also in a window that is as high as wide."""
    rng = np.random.default_rng(5)
    fills = []
    for number in range(200):
        size = 10 ** rng.uniform(-1, 3, 3)
        low = rng.uniform(-50, 50, 3)
        region = np.stack([low, low + size], axis=1)
        flat = number % 4 == 0
        if flat:
            region[2] = 0.0
        shown = SimpleNamespace(region=region, origin=np.round(region.mean(axis=1)), dim=2 if flat else 3)
        camera = view.first_camera(shown)  # type: ignore[arg-type]
        eye, middle = camera["position"], camera["look_at"]
        toward = (middle - eye) / np.linalg.norm(middle - eye)
        right = np.cross(toward, camera["up"])
        right /= np.linalg.norm(right)
        box = framed(*(region.T - shown.origin))
        corners = np.array(list(itertools.product(*np.transpose(box)))) - eye
        depth = corners @ toward
        beside = np.abs([corners @ right, corners @ np.cross(right, toward)]) / depth
        assert (depth > camera["near"]).all() and (depth < camera["far"]).all(), number
        fills.append(beside.max() / np.tan(camera["fov"] / 2))
    assert max(fills) < 1 and min(fills) > 0.6, (min(fills), max(fills))


def test_what_cannot_be_shown_is_refused(flat: Any, tmp_path: Path) -> None:
    flat.save(tmp_path / "flat.ndt")
    for arguments, message in (
        (("--slice", "z=1"), "--slice: the map is 2-D, only 3-D maps can be cut"),
        (("--color", "height"), "--color height: the map is 2-D and has none"),
    ):
        for more in ((), ("--png", tmp_path / "a.png")):
            status, line = ended("view", tmp_path / "flat.ndt", *arguments, *more)
            assert (status, line.count("\n")) == (2, 0)
            assert message in line
    (tmp_path / "no.ndt").write_text("0 0 1 1\n")
    ndtree.AdaptiveMap(dim=2).save(tmp_path / "empty.ndt")
    for name, message in (
        ("no.ndt", "no.ndt"),
        ("none.ndt", "none.ndt: No such file"),
        ("empty.ndt", "the map is empty"),
    ):
        status, text = ended("view", tmp_path / name, "--port", 0)
        assert (status, text.count("ndtree: ")) == (1, 1)
        assert message in " ".join(text.split())
    with pytest.raises(ValueError, match=r"color = 'height': must be one of size, probability for a 2-D map"):
        view.Viewer(flat, port=0, look=Look())
    with pytest.raises(ValueError, match="only 2-D and 3-D maps can be seen"):
        view.Viewer(with_room(ndtree.AdaptiveMap(dim=4, min_cell_size=0.5), 1), port=0)


@pytest.mark.parametrize("more", [("--color", "size", "--slice", "y=0.2"), ("--slice", "z=0.5")])
def test_a_picture_is_drawn_off_screen(map_file: Path, more: tuple[str, ...], tmp_path: Path) -> None:
    from matplotlib.image import imread

    target = tmp_path / "room.png"
    done = cli("view", map_file, "--png", target, *more)
    assert (done.exit_code, done.output.strip()) == (0, f"wrote {target}")
    picture = imread(target)[:, :, :3]
    assert np.count_nonzero(np.ptp(picture, axis=2) > 0.15) > 10_000
    assert [path.name for path in tmp_path.iterdir()] == ["room.png"]


def test_watching_ends_with_the_map_written(tmp_path: Path) -> None:
    log = room_log(tmp_path / "log.txt", 12)
    command = [sys.executable, "-m", "ndtree", "map", str(log), "-o", str(tmp_path / "a.ndt")]
    with subprocess.Popen(
        [*command, "--watch", "--port", "0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None and program.stderr is not None
        assert re.match(r"http://127\.0\.0\.1:\d+ shows the map as it grows", program.stderr.readline())
        for line in program.stdout:
            if "until Ctrl-C" in line:
                break
        program.send_signal(signal.SIGINT)
        assert program.wait(20) == 0
        assert program.stderr.read() == ""
    without = cli("map", log, "-o", tmp_path / "b.ndt")
    assert without.exit_code == 0
    assert (tmp_path / "a.ndt").read_bytes() == (tmp_path / "b.ndt").read_bytes()
    status, line = ended("map", log, "-o", tmp_path / "c.ndt", "--port", 0)
    assert (status, line) == (2, "ndtree: --port: is for the page of --watch")


def test_kinds_are_all_drawn() -> None:
    look = Look(free=True, unknown=True, slice_at=0.0)
    assert shown_kinds(look) == list(KINDS)
    assert shown_kinds(Look(occupied=False)) == []


def rooms() -> Any:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, max_cell_size=1.6)
    m.mark([[-2.0, -2.0], [2.0, 2.0]], "free")
    m.mark([[0.0, -2.0], [0.2, 1.0]], "occupied")
    return m


def test_a_ray_meets_the_plane_ahead_of_it_alone() -> None:
    down, up = np.array([0.5, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(place_on_plane(np.array([0.0, 1.0, 3.0]), down, 1.0), [1.0, 1.0, 1.0])
    assert place_on_plane(np.array([0.0, 1.0, 3.0]), up, 1.0) is None
    assert place_on_plane(np.zeros(3), np.array([1.0, 0.0, 0.0]), 1.0) is None


def test_every_second_click_ends_a_way() -> None:
    m, ways = rooms(), Ways()
    said, points = ways.clicked(m, np.array([-1.0, 0.0, 0.0]), 0.2)
    assert said == "from (-1.00, 0.00): click where to" and points.tolist() == [[-1.0, 0.0]]
    said, points = ways.clicked(m, np.array([1.0, 0.0, 0.0]), 0.2)
    assert len(points) > 2 and said.endswith("from obstacles")
    ways.clicked(m, np.array([-1.0, 0.0, 0.0]), 0.2)
    said, points = ways.clicked(m, np.array([0.1, 0.0, 0.0]), 0.2)
    assert "goal = (0.1, 0.0)" in said and len(points) == 0
    ways.clicked(m, np.array([-1.0, 0.0, 0.0]), 0.6)
    said, points = ways.clicked(m, np.array([1.0, 0.0, 0.0]), 0.6)
    assert "no path: the goal is in another part" in said and len(points) == 0
    assert "OctoMap" in ways.clicked(None, np.zeros(3), 0.2)[0]


def test_the_page_draws_the_way_that_two_clicks_ask_for() -> None:
    drawn: dict[str, Any] = {}

    def add(name: str, points: Any, *_: Any, **__: Any) -> Any:
        drawn[name] = points
        return SimpleNamespace(remove=lambda: drawn.pop(name, None))

    texts: list[str] = []
    visitor = Visitor.__new__(Visitor)
    snapshot = Snapshot(rooms())
    scene = SimpleNamespace(add_line_segments=add, add_point_cloud=add)
    visitor._client, visitor._drawn, visitor._ways = SimpleNamespace(scene=scene), {}, Ways()  # type: ignore
    visitor._viewer = SimpleNamespace(snapshot=snapshot)  # type: ignore
    visitor._controls = SimpleNamespace(way=(0.2, 0.0), say_cell=texts.append)  # type: ignore
    for x in (-1.0, 1.0):
        eye = np.array([x, 0.0, 5.0]) - snapshot.origin
        visitor._pick(SimpleNamespace(ray_origin=eye, ray_direction=(0.0, 0.0, -1.0)))
    assert "click where to" in texts[0] and "from obstacles" in texts[1]
    ends = np.array([drawn["/way"][0][0], drawn["/way"][-1][1]]) + snapshot.origin
    np.testing.assert_allclose(ends[:, :2], [[-1.0, 0.0], [1.0, 0.0]], atol=1e-5)


def test_two_clicks_on_the_page_draw_a_way() -> None:
    """On both sides of the wall, which is seen from above."""
    with view.Viewer(rooms(), port=0) as viewer, Browser(viewer.url) as browser:
        browser.until(lambda b: np.count_nonzero(coloured(b.picture())) > 300)
        browser.until(lambda b: "Click on one." in b.text())
        browser.click_label("Between two clicks")
        browser.until(lambda b: "Radius" in b.text())
        rows, columns = np.nonzero(coloured(browser.picture()))
        low, high, row = int(columns.min()), int(columns.max()), int(np.median(rows)) + 200
        before = np.count_nonzero(coloured(browser.picture()))
        browser.click(low - 150, row)
        browser.until(lambda b: "click where to" in b.text())
        browser.click(high + 150, row)
        browser.until(lambda b: "from obstacles" in b.text())
        browser.until(lambda b: np.count_nonzero(coloured(b.picture())) > before + 200)
        assert browser.errors == []
