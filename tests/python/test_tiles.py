# SPDX-License-Identifier: BSD-3-Clause
"""Maps in tiles, against the map that is made of the same scans without them."""

import json
import math
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import ndtree
from ndtree.maps.open import open_map
from ndtree.tiles import MANIFEST, TileGrid, TileMapper, in_order, open_tiles, storage_of
from ndtree.tiles.grid import beams_of

KINDS = {
    "evidence": lambda dim: ndtree.AdaptiveMap(
        dim=dim, min_cell_size=0.1, max_cell_size=0.8, range_sigma=0.02
    ),
    "paper": lambda dim: ndtree.AdaptiveMap(
        dim=dim, min_cell_size=0.1, max_cell_size=0.9, branching=3, refinement="paper"
    ),
    "fixed": lambda dim: ndtree.FixedMap(dim=dim, min_cell_size=0.2),
}


def office(scans: int = 40, seed: int = 1) -> list[ndtree.Scan]:
    return list(ndtree.simulate("office", seed=seed, scans=scans))


def drive(scans: int, dim: int, seed: int = 5) -> list[ndtree.Scan]:
    """From one place to the other, so that the root grows to several sides."""
    random = np.random.default_rng(seed)
    found = []
    for i in range(scans):
        origin = random.uniform(-8.0, 8.0, dim)
        ends = origin + random.normal(0.0, 3.0, (400, dim))
        found.append(ndtree.Scan(ends, origin, random.random(400) < 0.8, stamp=float(i)))
    return found


def serial(m, scans, max_range=math.inf):
    for scan in scans:
        scan.insert_into(m, max_range=max_range)
    return m


def tiled(folder, m, scans, *, max_range=math.inf, **options) -> ndtree.TiledMap:
    mapper = TileMapper(storage_of(folder), m, **options)
    for scan in scans:
        mapper.insert(scan, max_range=max_range)
    mapper.write(complete=True)
    return open_tiles(folder)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", [2, 3])
def test_tiles_are_the_serial_map_to_the_byte(tmp_path, kind, dim):
    scans = drive(12, dim)
    whole = serial(KINDS[kind](dim), scans, max_range=6.0)
    tiles = tiled(
        tmp_path / "a.tiles", KINDS[kind](dim), scans, max_range=6.0, tile_size=3.0, max_resident=1 << 20
    )
    assert len(tiles.manifest.tiles) > 10
    assert tiles.to_map().to_bytes() == whole.to_bytes()
    assert tiles.observed_leaves == whole.stats().observed_leaves
    np.testing.assert_array_equal(tiles.bounds(), whole.bounds())


def test_what_rests_is_written_and_forgotten(tmp_path):
    random = np.random.default_rng(4)
    scans = [  # Far away from where it began, a robot needs nothing of that.
        ndtree.Scan(origin + random.normal(0.0, 1.0, (300, 2)), origin)
        for origin in np.column_stack((np.linspace(0.0, 120.0, 120), np.zeros(120)))
    ]

    def make():
        return ndtree.AdaptiveMap(dim=2, min_cell_size=0.01, max_cell_size=0.64, range_sigma=0.003)

    whole = serial(make(), scans)
    mapper = TileMapper(
        storage_of(tmp_path / "a"), make(), tile_size=2.0, max_resident=3_200_000, checkpoint_seconds=math.inf
    )
    most = 0
    for scan in scans:
        mapper.insert(scan)
        most = max(most, mapper.map.stats().memory_bytes)
    assert len(list((tmp_path / "a" / "tiles").iterdir())) > 10  # Before any state was written.
    mapper.write(complete=True)
    assert most < 3_200_000 < whole.stats().memory_bytes / 1.5
    assert open_tiles(tmp_path / "a").to_map() == whole


def test_a_mapper_made_anew_goes_on_and_a_finished_map_is_replaced(tmp_path):
    scans = drive(12, 2)
    whole = serial(KINDS["evidence"](2), scans)
    for stop in (1, 5, 11):
        folder = tmp_path / f"stopped-{stop}"
        first = TileMapper(storage_of(folder), KINDS["evidence"](2), tile_size=4.0)
        for scan in scans[:stop]:
            first.insert(scan)
        first.write()
        for scan in scans[stop : stop + 1]:  # Which no state has.
            first.insert(scan)
        second = TileMapper(storage_of(folder), KINDS["evidence"](2), tile_size=4.0)
        assert second.done == stop
        assert [second.insert(scan) is None for scan in scans] == [i < stop for i in range(len(scans))]
        second.write(complete=True)
        assert open_tiles(folder).to_map() == whole
        assert second.counts["beams"] == sum(map(len, scans))
        assert tiled(folder, KINDS["evidence"](2), scans[:3], tile_size=2.0).to_map() == serial(
            KINDS["evidence"](2), scans[:3]
        )
        held = {f"tiles/{path.name}" for path in (folder / "tiles").iterdir()}
        assert held == open_tiles(folder).manifest.files()


def test_going_on_with_something_else_is_refused(tmp_path):
    scans = drive(4, 2)
    begun = TileMapper(
        storage_of(tmp_path / "a"), KINDS["evidence"](2), tile_size=4.0, made_from={"log": "x"}
    )
    for scan in scans[:2]:
        begun.insert(scan)
    begun.write()
    before = (tmp_path / "a" / MANIFEST).read_bytes()
    with pytest.raises(ValueError, match=r"unfinished map with another map: branching = 2, now 3"):
        TileMapper(storage_of(tmp_path / "a"), KINDS["paper"](2), tile_size=4.0, made_from={"log": "x"})
    with pytest.raises(ValueError, match=r"another grid: cubes = 8, now 16"):
        TileMapper(storage_of(tmp_path / "a"), KINDS["evidence"](2), tile_size=8.0, made_from={"log": "x"})
    with pytest.raises(ValueError, match=r"another source: log = x, now y"):
        TileMapper(storage_of(tmp_path / "a"), KINDS["evidence"](2), tile_size=4.0, made_from={"log": "y"})
    again = TileMapper(
        storage_of(tmp_path / "a"), KINDS["evidence"](2), tile_size=4.0, made_from={"log": "x"}
    )
    again.insert(scans[0])
    with pytest.raises(ValueError, match="was begun with other scans: the first 2 are not those"):
        again.insert(scans[2])
    assert (tmp_path / "a" / MANIFEST).read_bytes() == before


CHILD = """
import sys, time
import ndtree
from ndtree.tiles import TileMapper, storage_of
m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, max_cell_size=0.8, range_sigma=0.02)
mapper = TileMapper(storage_of(sys.argv[1]), m, tile_size=3.0, max_resident=1 << 20, checkpoint_seconds=0.02)
for scan in ndtree.simulate("office", scans=60):
    mapper.insert(scan)
mapper.write(complete=True)
"""


def test_runs_killed_at_any_time_end_in_the_same_map(tmp_path):
    whole = serial(
        ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, max_cell_size=0.8, range_sigma=0.02), office(60)
    )
    random = np.random.default_rng(3)
    print("seed 3")
    kills = known = 0
    while True:
        child = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path / "a")])
        if kills < 4:
            manifest = tmp_path / "a" / MANIFEST
            before = manifest.stat().st_mtime_ns if manifest.exists() else None
            for _ in range(1000):  # Until it works; then at any time.
                time.sleep(0.01)
                if child.poll() is not None:
                    break
                if manifest.exists() and manifest.stat().st_mtime_ns != before:
                    break
            time.sleep(random.uniform(0.0, 0.1))
            if child.poll() is None:
                os.kill(child.pid, signal.SIGKILL)
                kills += 1
        if child.wait() == 0:
            break
        state = open_tiles(tmp_path / "a")  # What was there is whole, whenever it was killed.
        known = max(known, state.manifest.made_from["progress"]["scans"])
        state.to_map().stats()
    assert kills >= 1 and known >= 1
    assert open_tiles(tmp_path / "a").to_map() == whole


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """A map, and the same in tiles with a cache for few of them."""
    scans = drive(15, 3)
    whole = serial(KINDS["evidence"](3), scans)
    folder = tmp_path_factory.mktemp("both") / "a.tiles"
    tiled(folder, KINDS["evidence"](3), scans, tile_size=3.0)
    return whole, folder


@pytest.mark.parametrize("parts", [4, 1])
def test_answers_are_those_of_the_whole_map(both, parts):
    whole, folder = both
    size = sum(entry.bytes for entry in open_tiles(folder).manifest.tiles.values())
    tiles = open_tiles(folder, cache_bytes=1 << 30 if parts == 1 else size // parts)
    for wrong in (-1, math.nan):
        with pytest.raises(ValueError, match=f"cache_bytes = {wrong}: must be >= 0"):
            open_tiles(folder, cache_bytes=wrong)
    random = np.random.default_rng(1)
    points = random.uniform(-14.0, 14.0, (60, 3))
    points[::7] = np.round(points[::7] / 3.2) * 3.2  # On borders of tiles.
    points[5] = np.nan
    for name in ("state", "probability"):
        np.testing.assert_array_equal(getattr(tiles, name)(points), getattr(whole, name)(points))
    np.testing.assert_array_equal(tiles.probability(points, of="hit"), whole.probability(points, of="hit"))
    for own, other in zip(tiles.probability(points, interval=0.8), whole.probability(points, interval=0.8)):
        np.testing.assert_array_equal(own, other)
    good = points[np.isfinite(points).all(axis=1)]
    np.testing.assert_array_equal(tiles.occupied_within(good, 0.7), whole.occupied_within(good, 0.7))
    np.testing.assert_array_equal(
        tiles.states_in(good - 0.6, good + 0.6), whole.states_in(good - 0.6, good + 0.6)
    )
    for limit in (math.inf, 1.5):
        own, other = (m.nearest_occupied(good, max_distance=limit).distance for m in (tiles, whole))
        np.testing.assert_array_equal(own, other)
    ways = random.normal(size=(len(good), 3))
    for unknown in ("pass", "stop"):
        for limit in (math.inf, 4.0):
            one = tiles.cast_rays(good, ways, max_range=limit, unknown=unknown)
            np.testing.assert_array_equal(one, whole.cast_rays(good, ways, max_range=limit, unknown=unknown))
            at, expected = (
                m.cast_rays(good, ways, max_range=limit, unknown=unknown, at="cell") for m in (tiles, whole)
            )
            np.testing.assert_array_equal(at, expected)
    assert np.isfinite(one).any()
    for scale in (2.0**-1040, 2.0**-600, 2.0**600):  # Their squares are no normal numbers.
        some = np.round(ways * 2**20) * scale  # So that nothing is lost below the smallest numbers.
        expected = whole.cast_rays(good, np.round(ways * 2**20))
        for m in (tiles, whole):
            np.testing.assert_array_equal(m.cast_rays(good, some), expected)
    far = np.array(
        [[1e300, 0, 0], [np.inf, 1, 1], [-np.inf, np.inf, 0], [1e160, -1e200, 3], [np.nan, 1, np.inf]]
    )
    for m in (tiles, whole):
        np.testing.assert_array_equal(m.distance_to_occupied(far), [np.inf] * 4 + [np.nan])
        assert m.distance_to_occupied(far[0]) == np.inf
        assert np.isnan(m.nearest_occupied(far, max_distance=5.0).point).all()
    ends = tiles.cast_rays(good[0], ways, details=True)
    of_whole = whole.cast_rays(good[0], ways, details=True)
    for name in ("distance", "state", "lower", "size"):
        np.testing.assert_array_equal(getattr(ends, name), getattr(of_whole, name))
    if parts > 1:
        assert tiles.loads > 2 * len(tiles.manifest.tiles) and tiles.resident_bytes < 8 * size
    else:
        assert tiles.loads <= len(tiles.manifest.tiles), "none twice"
    assert tiles.loads > 10 and tiles.hits > 0


def test_answers_about_boxes_and_bodies_are_those_of_the_whole_map(both):
    whole, folder = both
    tiles = open_tiles(folder)
    box = [[-4.0, -5.0, -3.0], [5.0, 2.0, 3.2]]
    for states in (["occupied"], ["free", "occupied"]):
        for region in (None, box):
            own, other = (m.leaves(region, states=states) for m in (tiles, whole))
            for name in ("lower", "size", "log_odds", "hits", "misses"):
                np.testing.assert_array_equal(getattr(own, name), getattr(other, name))
    np.testing.assert_array_equal(tiles.to_grid(box, 0.3), whole.to_grid(box, 0.3))
    own, other = (m.distance_field(box, 0.4, max_distance=1.0, unknown="occupied") for m in (tiles, whole))
    np.testing.assert_array_equal(own.values, other.values)
    poses = np.tile(np.eye(4), (200, 1, 1))
    poses[:, :3, 3] = np.random.default_rng(2).uniform(-9.0, 9.0, (200, 3))
    robot = ndtree.Sphere(0.4) | ndtree.Box((0.5, 0.3, 0.2))
    own, other = (m.collides(robot, poses) for m in (tiles, whole))
    np.testing.assert_array_equal(own, other)
    assert 0 < own.sum() < len(own)
    assert tiles.path_collides(robot, poses[:5]) == whole.path_collides(robot, poses[:5])
    own, other = ([f.center for f in m.frontiers(box, min_cells=20)] for m in (tiles, whole))
    np.testing.assert_array_equal(own, other)
    assert tiles.state([0.0, 0.0, 0.0]) == whole.state([0.0, 0.0, 0.0])
    assert tiles.nearest_occupied(np.zeros((2, 3, 3))).distance.shape == (2, 3)
    for wrong in ([[0.0, 1.0]], "abc"):
        with pytest.raises((ValueError, TypeError)) as own:
            tiles.state(wrong)
        with pytest.raises((ValueError, TypeError)) as other:
            whole.state(wrong)
        assert str(own.value) == str(other.value)


@pytest.mark.filterwarnings("ignore::numpy.exceptions.ComplexWarning")
@pytest.mark.parametrize("wrong", [
    "x", math.nan, True, 2**80, {}, 1j, np.zeros((2, 3), complex),
    np.zeros((2, 3), "M8[s]"), np.ma.zeros((2, 3)), np.zeros((2, 5)),
], ids=repr)  # fmt: skip
def test_wrong_arguments_are_refused_as_by_the_whole_map(both, wrong):
    whole, folder = both
    tiles, body = open_tiles(folder), ndtree.Sphere(0.2)
    for ask in (
        lambda m: m.state(wrong),
        lambda m: m.nearest_occupied(wrong),
        lambda m: m.distance_to_occupied(wrong),
        lambda m: m.cast_rays(wrong, np.ones((2, 3))),
        lambda m: m.cast_rays(np.zeros(3), wrong),
        lambda m: m.collides(body, wrong),
        lambda m: m.path_collides(body, wrong),
        lambda m: m.leaves([wrong, wrong]),
        lambda m: m.distance_field(wrong, 0.1),
        lambda m: m.to_grid(wrong),
        lambda m: m.region(wrong) if m is tiles else m.leaves(wrong, states=["occupied"]),
    ):
        said = []
        for m in (whole, tiles):
            with pytest.raises((TypeError, ValueError)) as error:
                ask(m)
            said.append((error.type, str(error.value).rpartition("(): ")[2]))
        assert said[0] == said[1]


def test_far_points_are_asked_where_anything_is(both):
    _, folder = both
    tiles = open_tiles(folder)
    found = tiles.nearest_occupied([[-1e18, 0.0, 1e18], [1e12, 1e12, 0.0], [0.0, 0.0, 0.0]])
    assert np.isfinite(found.point).all()
    assert tiles.hits + tiles.loads < 12 * len(tiles.manifest.tiles), (
        "few times, not once for each power of two"
    )


def test_tiles_that_a_scan_crosses_are_all_that_it_changes():
    """Whatever the scan does, cells outside of the tiles that it is said to cross stay as they are."""
    random = np.random.default_rng(7)
    compared = 0
    for round_ in range(40):
        dim = 2 + round_ % 2
        m = KINDS["evidence"](dim)
        grid = TileGrid.of(m, random.choice([0.8, 1.6, 6.4]))
        origin = random.uniform(-3.0, 3.0, dim)
        if round_ % 3 == 0:
            origin = np.round(origin / 1.6) * 1.6
        ends = origin + random.normal(0.0, 4.0, (50, dim))
        ends[::5] = np.round(ends[::5] / 0.8) * 0.8
        scan = ndtree.Scan(ends, np.tile(origin, (50, 1)) if round_ % 4 == 0 else origin)
        crossed = grid.crossed_by(*beams_of(scan, m.options, 5.0))
        scan.insert_into(m, max_range=5.0)
        leaves = m.leaves(states=["free", "occupied"])
        for tile in {tuple(tile) for tile in grid.tiles_at(leaves.center).tolist()}:
            assert tile in crossed
            compared += 1
    assert compared > 400


def test_damage_is_named(tmp_path):
    tiled(tmp_path / "a", KINDS["evidence"](2), drive(3, 2), tile_size=4.0)
    file = tmp_path / "a" / sorted(open_tiles(tmp_path / "a").manifest.files())[0]
    content = file.read_bytes()
    file.write_bytes(content[:-1] + b"x")
    with pytest.raises(ValueError, match=f"{file.name}: damaged: SHA-256 is not that of the manifest"):
        open_tiles(tmp_path / "a").to_map()
    file.unlink()
    with pytest.raises(ValueError, match=f"{file.name}: is not there, but the manifest counts on it"):
        open_tiles(tmp_path / "a").to_map()
    file.write_bytes(content)
    manifest = json.loads((tmp_path / "a" / MANIFEST).read_text())
    for change, said in (
        ({"version": 9}, "format version 9: this ndtree reads version 1"),
        ({"format": "x"}, "no manifest of a tiled map"),
        ({"lattice": {"unit": 0.1, "cube": 8, "cubes": 5}}, "damaged: the lattice is not that of"),
        ({"tiles": [{"at": [0, 0], "file": "../x"}]}, "must be a name inside the folder"),
        ({"frame": {}}, "damaged: no 'file'"),
    ):
        (tmp_path / "a" / MANIFEST).write_text(json.dumps({**manifest, **change}))
        with pytest.raises(ValueError, match=said) as error:
            open_tiles(tmp_path / "a")
        assert str(tmp_path / "a" / MANIFEST) in str(error.value)
    with pytest.raises(FileNotFoundError):
        open_tiles(tmp_path / "nothing")


@pytest.mark.parametrize("place", ["memory://fleet-test", "file"])
def test_other_places_hold_the_same_files(tmp_path, place):
    if place == "file":
        place = (tmp_path / "remote place").as_uri()
    else:
        pytest.importorskip("fsspec", reason="fsspec is not installed: local folders alone")
    scans = drive(5, 2)
    local = tiled(tmp_path / "a", KINDS["evidence"](2), scans, tile_size=4.0)
    remote = tiled(place, KINDS["evidence"](2), scans, tile_size=4.0)
    assert remote.manifest.as_bytes() == local.manifest.as_bytes()
    assert remote.to_map() == local.to_map()
    storage = storage_of(place)
    assert storage.names("tiles") == remote.manifest.files()
    storage.remove_folder("tiles")
    assert storage.names("tiles") == set() and storage.has(MANIFEST)


def test_logs_are_in_the_order_of_time_then_of_names():
    def at(*stamps):
        return [ndtree.Scan(np.ones((1, 2)), np.zeros(2), stamp=float(stamp)) for stamp in stamps]

    found = [(place.log, place.number) for place, _ in in_order({"b": at(0, 1, 5), "a": at(1, 0, 3)})]
    # The clock of a went back: its second scan does not come before its first.
    assert found == [("b", 0), ("a", 0), ("a", 1), ("b", 1), ("a", 2), ("b", 2)]


def test_tiles_have_the_size_that_was_asked_for():
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, max_cell_size=1.6)
    assert TileGrid.of(m).size == pytest.approx(25.6)
    assert TileGrid.of(m, 1.0).size == pytest.approx(1.6)
    assert TileGrid.of(m, 30.0).size == pytest.approx(51.2)
    for size in (0.0, -1.0, math.nan, math.inf, 1e30):
        with pytest.raises(ValueError, match="tile_size"):
            TileGrid.of(m, size)
    if ndtree.has_octomap:
        with pytest.raises(ValueError, match="an OctoMap has no tiles"):
            TileGrid.of(ndtree.OctoMap())


def test_a_tile_of_one_leaf_is_kept(tmp_path):
    y = np.linspace(0.001, 1.599, 1600)
    points = np.stack((np.full(1600, 1.6), y), axis=1)
    scan = ndtree.Scan(points, points - [2.6, 0], returned=np.zeros(1600, dtype=bool))
    whole = ndtree.AdaptiveMap(dim=2)
    scan.insert_into(whole)
    tiles = tiled(tmp_path / "m.tiles", ndtree.AdaptiveMap(dim=2), [scan], tile_size=1.6)
    at = [[0.4, 0.8], [-0.5, 0.8]]
    assert whole.state(at).tolist() == tiles.state(at).tolist() == [0, 0]
    assert tiles.to_map() == whole


def test_bodies_larger_than_a_tile_are_asked_about_as_a_whole(tmp_path):
    points = np.stack((np.full(400, 6.4), np.linspace(-3, 3, 400)), axis=1)
    scan = ndtree.Scan(points, [0.0, 0.0])
    whole = KINDS["evidence"](2)
    scan.insert_into(whole)
    tiles = tiled(tmp_path / "m.tiles", KINDS["evidence"](2), [scan], tile_size=0.8)
    for body in (ndtree.Box((19.2, 19.2)), ndtree.Sphere(0.3, center=(6.2, 0)), ndtree.Sphere(0.3)):
        assert body.reach >= 0.3
        poses = [[0.0, 0.0, 0.0]]
        np.testing.assert_array_equal(tiles.collides(body, poses), whole.collides(body, poses))
    assert tiles.occupied_within([[0.0, 0.0]], np.inf)[0]
    corners = [[-np.inf, -np.inf]], [[np.inf, np.inf]]
    np.testing.assert_array_equal(tiles.states_in(*corners), whole.states_in(*corners))
    assert tiles.state(points=[[6.4, 0.0]]) == whole.state(points=[[6.4, 0.0]])


def test_what_no_map_takes_is_refused_before_tiles_are_sought(tmp_path):
    mapper = TileMapper(storage_of(tmp_path / "m.tiles"), KINDS["evidence"](2))
    with pytest.raises(ValueError):
        mapper.insert(ndtree.Scan([[1e12, 0.0]], [0.0, 0.0]))
    far = np.stack((np.cos(np.arange(40.0)), np.sin(np.arange(40.0))), axis=1) * 1e4
    m = ndtree.AdaptiveMap(dim=2, range_sigma_quadratic=0.0015)
    mapper = TileMapper(storage_of(tmp_path / "n.tiles"), m)
    mapper.insert(ndtree.Scan(far, [0.0, 0.0], returned=np.zeros(40, dtype=bool)), max_range=30)
    assert len(mapper.write().tiles) < 100


def test_fewer_scans_than_the_state_has_are_others(tmp_path):
    scans = office(4)
    mapper = TileMapper(storage_of(tmp_path / "m.tiles"), KINDS["evidence"](2))
    for scan in scans:
        mapper.insert(scan)
    mapper.write()
    again = TileMapper(storage_of(tmp_path / "m.tiles"), KINDS["evidence"](2))
    again.insert(scans[0])
    with pytest.raises(ValueError, match="was begun with other scans: it holds 4, and there are only 1"):
        again.write(complete=True)


def test_maps_of_other_options_are_not_adopted():
    m = ndtree.FixedMap(dim=2, min_cell_size=0.1)
    other = ndtree.FixedMap(dim=2, min_cell_size=0.1, log_odds_max=20.0)
    with pytest.raises(
        ValueError, match=r"log_odds_max = 20\.0 of a map that is adopted by one with 3\.5: must be the same"
    ):
        m.adopt(other)


@pytest.mark.parametrize("content", [None, b"", b'{"format": 1'])
def test_a_folder_with_a_tiled_maps_name_is_one(tmp_path, content):
    folder = tmp_path / "lost.tiles"
    folder.mkdir()
    if content is not None:
        (folder / "manifest.json").write_bytes(content)
    with pytest.raises((OSError, ValueError), match=r"no tiled map|no manifest"):
        open_map(folder)
