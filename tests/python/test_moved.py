# SPDX-License-Identifier: BSD-3-Clause
"""What moved: evidence, scores, cleaned logs of each kind, static maps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from calling import cli as run
from conftest import there

import ndtree
from ndtree.evaluation.moved import MovedPoints, moved_scores
from ndtree.evaluation.pose_noise import PoseNoise
from ndtree.logs.folders.cloud_files import points_of_file
from ndtree.logs.folders.cloud_rows import write_cloud, write_rows


@pytest.fixture(scope="module")
def office() -> Any:
    return ndtree.simulate("office", seed=7, scans=150, people=6, doors=3)


@pytest.fixture(scope="module")
def log(office: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("moved") / "office.npz"
    office.save(path)
    return path


@pytest.mark.parametrize(
    "world, wrong, said",
    [
        ("office", {"cars": 1}, r"cars = 1: must be 0 in the office"),
        ("street", {"doors": 2}, r"doors = 2: must be 0 in the street"),
        ("office", {"doors": 13}, r"doors = 13: must be at most 12"),
        ("office", {"people": -1}, r"people = -1: must be in \[0, 1000\]"),
    ],
)
def test_what_a_world_has_not_is_refused(world, wrong, said):
    with pytest.raises(ValueError, match=said):
        ndtree.simulate(world, scans=2, **wrong)


def test_a_log_with_what_moves_keeps_its_truth(office, log):
    arrays = np.load(log)
    truth = np.concatenate([office.moved(i) for i in range(len(office))])
    assert np.array_equal(arrays["moving"], truth)
    assert 0.02 < truth.mean() < 0.3
    assert (np.diff(arrays["stamps"]) > 0).all()


def test_evidence_finds_what_moves_and_one_scan_finds_nothing(office):
    points = MovedPoints(office, {"range_sigma": 0.02}, np.inf, "free").look()
    removed, truth = [], []
    for i, scan in enumerate(points.again):
        probability = points.probability(scan)
        assert probability.shape == (len(scan),)
        assert ((probability >= 0) & (probability <= 1)).all()
        assert (probability[~scan.returned] == 0.5).all()
        returned = scan.hits(points.max_range)
        removed.append((probability > 0.5)[returned])
        truth.append(office.moved(i)[returned])
    scores = moved_scores(np.concatenate(removed), np.concatenate(truth))
    assert scores.static_accuracy > 0.99
    assert scores.dynamic_accuracy > 0.72
    alone = ndtree.MovedEvidence(dim=2, range_sigma=0.02)
    scan = office[20]
    for use in (alone.add, alone.look):
        use(scan.endpoints, scan.origin, returned=scan.returned)
    answers = alone.probability(scan.endpoints[scan.returned])
    assert (answers > 0.5).mean() < 0.01  # Beams that returned from nowhere.


@pytest.mark.parametrize("after", [10, 200])
def test_scans_are_judged_when_later_ones_have_come(office, after):
    delayed = ndtree.DelayedMoved(dim=2, after=after, range_sigma=0.02)
    told = []
    for number, scan in enumerate(office):
        told += delayed.add(scan)
        assert number + 1 - 2 * after < len(told) <= max(0, number + 1 - after)
    told += delayed.finish()
    assert len(told) == len(office) and list(delayed.finish()) == []
    assert all(np.array_equal(one.endpoints, scan.endpoints) for (one, _), scan in zip(told, office))
    truth = [office.moved(i)[scan.returned] for i, scan in enumerate(office)]
    said = [probability[scan.returned] > 0.5 for scan, probability in told]
    scores = moved_scores(np.concatenate(said), np.concatenate(truth))
    assert scores.static_accuracy > 0.99
    assert scores.dynamic_accuracy > 0.7
    if after > len(office):  # Then all is judged by all.
        whole = MovedPoints(office, {"range_sigma": 0.02}, np.inf, "free").look()
        for scan, probability in told:
            np.testing.assert_array_equal(probability, whole.probability(scan))


def test_a_delay_of_no_scan_is_refused():
    with pytest.raises(ValueError, match="after = 0"):
        ndtree.DelayedMoved(dim=2, after=0)
    with pytest.raises(ValueError, match="cell_size"):
        ndtree.DelayedMoved(dim=2, cell_size=-1.0)
    with pytest.raises(TypeError, match=r"cell_size = 'x': must be a number"):
        ndtree.DelayedMoved(dim=2, cell_size="x")


def _room(rng, fault, scans=40):
    """Scans of a laser that drives in a room with a pillar, and poses with a fault."""
    angle = np.radians(0.5 + np.arange(360.0))
    way = np.stack([np.cos(angle), np.sin(angle)], 1)
    for i in range(scans):
        origin = np.array([-1.0 + 0.05 * i, 0.3])
        far = ((np.sign(way) * [5.0, 3.0] - origin) / way).min(axis=1)
        to = np.array([2.0, -1.5]) - origin
        along = way @ to
        inside = along**2 - to @ to + 0.3**2
        near = np.where((inside > 0) & (along > 0), along - np.sqrt(np.maximum(inside, 0)), np.inf)
        far = np.minimum(far, near) + rng.normal(0, 0.01, len(far))
        shift, turn = fault(i, rng)
        c, s = np.cos(turn), np.sin(turn)
        yield ndtree.Scan(origin + shift + (far[:, None] * way) @ np.array([[c, s], [-s, c]]), origin + shift)


def _removed(scans, noise):
    evidence = ndtree.MovedEvidence(dim=2, range_sigma=0.01, place_sigma=noise.place, turn_sigma=noise.turn)
    for use in (evidence.add, evidence.look):
        for scan in scans:
            use(scan.endpoints, scan.origin)
    return np.mean([evidence.probability(scan.endpoints) > 0.5 for scan in scans])


@pytest.mark.parametrize(
    "fault, place, turn",
    [
        (lambda i, rng: (np.zeros(2), 0.0), 0.0, 0.0),
        (lambda i, rng: (np.zeros(2), np.radians(rng.normal(0, 2.0))), 0.0, 2.83),
        (lambda i, rng: (rng.normal(0, 0.1, 2), 0.0), 0.141, 0.0),
        (lambda i, rng: (np.array([0.3 * (i > 15), 0.0]), 0.0), 0.147, 0.0),
        (lambda i, rng: (np.array([0.0, 0.005 * i]), 0.0), 0.082, 0.0),
    ],
    ids=["exact", "yaw", "place", "jump", "drift"],
)
def test_the_noise_of_poses_is_measured_on_shared_surfaces(fault, place, turn):
    scans = list(_room(np.random.default_rng(3), fault))
    noise = PoseNoise.of(scans)
    assert noise.place == pytest.approx(place, abs=0.02 + 0.3 * place)
    assert np.degrees(noise.turn) == pytest.approx(turn, abs=0.08 + 0.3 * turn)
    assert noise.is_notable == (place + turn > 0)
    assert PoseNoise.of(scans[:3]) == PoseNoise()
    removed = [_removed(scans, noise) for noise in (PoseNoise(), noise)]
    assert removed[1] <= 0.002
    assert removed[0] > 0.01 or place + turn == 0


@pytest.mark.parametrize("degrees", [0.0, 0.3, 1.0])
def test_the_tilt_of_poses_is_measured_in_space(degrees):
    rng = np.random.default_rng(3)
    down, around = (
        x.ravel() for x in np.meshgrid(np.radians(np.arange(3.0, 40, 1)), np.radians(np.arange(0, 360, 2)))
    )
    way = np.stack([np.cos(down) * np.cos(around), np.cos(down) * np.sin(around), -np.sin(down)], 1)
    scans = []
    for i in range(40):
        origin = np.array([0.2 * i, 0.0, 1.5])
        to_wall = np.where(way[:, 0] > 0, (12.0 - origin[0]) / np.where(way[:, 0] > 0, way[:, 0], 1.0), 99.0)
        points = way * np.minimum(1.5 / -way[:, 2], to_wall)[:, None]
        angle = np.radians(degrees) * rng.normal()
        c, s = np.cos(angle), np.sin(angle)
        turned = np.stack(
            [c * points[:, 0] + s * points[:, 2], points[:, 1], c * points[:, 2] - s * points[:, 0]], 1
        )
        scans.append(ndtree.Scan(origin + turned + rng.normal(0, 0.005, turned.shape), origin))
    noise = PoseNoise.of(scans)
    assert np.degrees(noise.turn) == pytest.approx(1.41 * degrees, abs=0.02 + 0.35 * degrees)
    assert noise.is_notable == (degrees > 0)
    assert noise.place < 0.03


def test_insert_tells_what_moved_by_the_map_before(office):
    options = {"dim": 2, "range_sigma": 0.02}
    m, plain, one_thread = (ndtree.AdaptiveMap(**options) for _ in range(3))
    said, truth = [], []
    for i, scan in enumerate(office):
        inside = np.linalg.norm(scan.endpoints - scan.origin, axis=1) <= 8.0
        counts = scan.returned & inside
        expected = np.where(counts, m.moved(scan.endpoints), np.float32(0.5))
        report = scan.insert_into(m, max_range=8.0, moved=True)
        assert report.moved.dtype == np.float32
        np.testing.assert_array_equal(report.moved, expected)
        again = scan.insert_into(one_thread, max_range=8.0, moved=True, threads=1)
        np.testing.assert_array_equal(again.moved, expected)
        assert scan.insert_into(plain, max_range=8.0).moved is None
        said.append(report.moved[counts] > 0.5)
        truth.append(office.moved(i)[counts])
    assert m == plain == one_thread
    scores = moved_scores(np.concatenate(said), np.concatenate(truth))
    assert scores.static_accuracy > 0.98
    assert scores.dynamic_accuracy > 0.4  # Without the future: where it was seen free before.
    for kind in (ndtree.FixedMap(dim=2), *([ndtree.OctoMap(dim=2)] if ndtree.has_octomap else [])):
        scan.insert_into(kind)
        expected = kind.moved(scan.endpoints.reshape(1, -1, 2))
        told = kind.insert(scan.endpoints.reshape(1, -1, 2), scan.origin, moved=True).moved
        assert told.shape == (1, len(scan))  # As the points.
        np.testing.assert_array_equal(told, expected)


def test_what_is_disputed_is_where_something_moved(office, tmp_path):
    still = ndtree.simulate("office", seed=7, scans=150)
    fractions = []
    for log in (still, office):
        m = ndtree.AdaptiveMap(dim=2, range_sigma=0.02)
        for scan in log:
            scan.insert_into(m)
        leaves = m.leaves()
        area = leaves.size**2
        assert not leaves.disputed[~leaves.observed].any()
        expected = area[leaves.disputed].sum() / area[leaves.observed].sum()
        for told in (m.disputed, leaves.disputed_fraction):
            assert told == pytest.approx(expected, rel=1e-12)
        fractions.append(m.disputed)
    assert fractions[0] < 0.005
    assert fractions[1] > max(0.0015, 10 * fractions[0])
    m.save(tmp_path / "m.ndt")
    result = run("info", tmp_path / "m.ndt", "--json", tmp_path / "f.json")
    assert result.exit_code == 0
    assert (
        f"disputed (inconsistent over time): {100 * m.disputed:.2g} % of the observed area" in result.output
    )
    assert json.loads((tmp_path / "f.json").read_text())["disputed"] == m.disputed
    empty, fixed = ndtree.AdaptiveMap(dim=3), ndtree.FixedMap(dim=2)
    scan.insert_into(fixed)
    assert np.isnan(empty.disputed) and np.isnan(fixed.disputed)
    fixed.save(tmp_path / "f.ndt")
    result = run("info", tmp_path / "f.ndt", "--json", tmp_path / "f.json")
    assert "disputed (" not in result.output
    assert json.loads((tmp_path / "f.json").read_text())["disputed"] is None


@pytest.mark.parametrize("there, is_kept", [((30, 60), True), ((30, 48), False), ((54, 60), False)])
def test_what_came_and_stands_is_kept(there, is_kept):
    """A post in a round room, from a scan on to before another of 60."""
    way = np.radians(np.arange(720) / 2)
    way = np.stack([np.cos(way), np.sin(way)], 1)

    def to_circle(middle, radius, side):
        along = way @ middle
        return along + side * np.sqrt(radius**2 - middle @ middle + along**2)

    scans, posts = [], []
    for i in range(60):
        origin = np.array([0.01 * i, -0.3])
        length = to_circle(-origin, 4.0, 1)
        with np.errstate(invalid="ignore"):
            post = to_circle(np.array([1.5, 0.5]) - origin, 0.2, -1)
        posts.append((post > 0) & (there[0] <= i < there[1]))
        scans.append((origin + way * np.where(posts[-1], post, length)[:, None], origin))
    evidence = ndtree.MovedEvidence(dim=2, range_sigma=0.01)
    for use in (evidence.add, evidence.look):
        for points, origin in scans:
            use(points, origin)
    ends, is_post = np.concatenate([points for points, _ in scans]), np.concatenate(posts)
    removed = np.asarray(evidence.probability(ends)) > 0.5
    assert not removed[~is_post].any()
    assert np.mean(removed[is_post]) == pytest.approx(0.0 if is_kept else 1.0, abs=0.1)


def test_scans_without_what_moved_say_nothing_of_its_place(office):
    points = MovedPoints(office, {"range_sigma": 0.02}, np.inf, "free").look()
    changed = 0
    for scan in office:
        moved = points.probability(scan) > 0.5
        cut = points.without(scan)
        if not moved.any():
            assert cut is scan
            continue
        changed += 1
        assert not cut.returned[moved].any()
        assert np.array_equal(cut.returned[~moved], scan.returned[~moved])
        assert np.array_equal(cut.endpoints[~moved], scan.endpoints[~moved], equal_nan=True)
        before, after = (np.linalg.norm(one.endpoints[moved] - one.origin, axis=1) for one in (scan, cut))
        whole = np.isfinite(after)
        assert np.allclose(before[whole] - after[whole], 0.05 + 2 * 0.02)
    assert changed > 20


def test_scores_are_those_of_the_field():
    truth = np.array([True] * 4 + [False] * 10)
    removed = np.array([True, True, True, False] + [True] + [False] * 9)
    scores = moved_scores(removed, truth)
    assert (scores.static_accuracy, scores.dynamic_accuracy) == (0.9, 0.75)
    assert scores.associated_accuracy == pytest.approx(np.sqrt(0.9 * 0.75))
    assert scores.harmonic_accuracy == pytest.approx(2 / (1 / 0.9 + 1 / 0.75))
    assert moved_scores(removed, truth, ~truth).moving_points == 0
    with pytest.raises(ValueError, match="must be the same"):
        moved_scores(removed[1:], truth)


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="dim = 4: must be 2 or 3"):
        ndtree.MovedEvidence(dim=4)
    for wrong in (0.7, 1e-300):  # As many scans as 1 / error_rate are looked at.
        with pytest.raises(ValueError, match=f"error_rate = {wrong:g}: must be in"):
            ndtree.MovedEvidence(dim=2, error_rate=wrong)
    evidence = ndtree.MovedEvidence(dim=2)
    evidence.look(np.zeros((0, 2)), [0, 0])
    with pytest.raises(ValueError, match="add all scans before"):
        evidence.add([[1, 1]], [0, 0])
    with pytest.raises(ValueError, match=r"shape \(1, 3\)"):
        evidence.probability([[1, 2, 3]])


def test_clean_writes_the_log_without_what_moved(log, tmp_path):
    np.savez(tmp_path / "in.npz", **np.load(log), intensity=np.arange(len(np.load(log)["points"])))
    out = tmp_path / "out.npz"
    figures, picture = tmp_path / "f.json", tmp_path / "p.png"
    call = ["clean", tmp_path / "in.npz", "--range-sigma", 0.02]
    result = run(*call, "-o", out, "--json", figures, "--picture", picture)
    assert result.exit_code == 0, result.output
    assert "compared with the log's array 'moving': SA" in result.output
    figures = json.loads(figures.read_text())
    before, after = np.load(tmp_path / "in.npz"), np.load(out)
    assert sorted(after.files) == sorted(before.files)
    assert len(after["points"]) == len(before["points"]) - figures["moved"]
    assert len(after["offsets"]) == len(before["offsets"])
    assert np.array_equal(after["points"], before["points"][after["intensity"]], equal_nan=True)
    assert figures["scores"]["HA"] > 0.84
    assert after["moving"].sum() < 0.3 * before["moving"].sum()
    assert picture.stat().st_size > 10_000
    assert len(list(ndtree.read(out))) == 150
    marked = tmp_path / "marked.npz"
    assert run(*call, "-o", marked, "--mark").exit_code == 0
    both = np.load(marked)
    assert len(both["moved"]) == len(before["points"])
    assert np.array_equal(both["intensity"][~(both["moved"] > 0.5)], after["intensity"])


def test_clean_writes_one_cloud(log, tmp_path):
    for ending in ("ply", "pcd"):
        out = tmp_path / f"cloud.{ending}"
        assert run("clean", log, "-o", out, "--mark", "--range-sigma", 0.02).exit_code == 0
        arrays = np.load(log)
        returned = ~arrays["no_return"] & np.isfinite(arrays["points"]).all(axis=1)
        points = points_of_file(str(out))
        assert np.allclose(points[:, :2], arrays["points"][returned], atol=1e-5)
        head = out.read_bytes()[:600]
        assert b"moved" in head
        assert b"scan" in head


@pytest.fixture(scope="module")
def clouds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of PCD files with a trajectory: a room, and a box in it that is there for half of the time."""
    folder = tmp_path_factory.mktemp("clouds") / "in"
    folder.mkdir()
    random = np.random.default_rng(5)
    lines = []
    for i in range(12):
        way = random.normal(size=(6000, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        origin = np.array([0.05 * i, 0.0, 0.0])
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.where(way > 0, (3 - origin) / way, (-3 - origin) / way).min(axis=1)
            lower, upper = np.array([1.2, -0.5, -0.5]) - origin, np.array([1.8, 0.5, 0.5]) - origin
            slabs = np.stack([lower / way, upper / way])
            enter, leave = slabs.min(0).max(1), slabs.max(0).min(1)
        box = (enter > 0) & (enter < leave) & (i < 6)
        points = way * np.where(box, enter, ends)[:, None] + random.normal(0, 0.005, (6000, 3))
        write_cloud(
            folder / f"{i:06}.pcd",
            {
                **{axis: points[:, k].astype(np.float32) for k, axis in enumerate("xyz")},
                "ring": box.astype(np.uint16),
                "number": np.arange(6000, dtype=np.int32),
            },
        )
        lines.append(f"1 0 0 {origin[0]} 0 1 0 0 0 0 1 0")
    (folder / "poses.txt").write_text("\n".join(lines) + "\n")
    return folder


def columns_of(path: Path) -> np.ndarray:
    head, data = path.read_bytes().split(b"DATA binary\n")
    words = {line.split()[0]: line.split()[1:] for line in head.decode().splitlines()}
    kinds = [f"<{kind.lower()}{size}" for kind, size in zip(words["TYPE"], words["SIZE"])]
    table = np.frombuffer(data, np.dtype(list(zip(words["FIELDS"], kinds))))
    assert int(words["POINTS"][0]) == int(words["WIDTH"][0]) == len(table)
    return table


def test_clean_keeps_a_folder_of_clouds_with_all_fields(clouds, tmp_path):
    out = tmp_path / "out"
    result = run("clean", clouds, "-o", out, "--range-sigma", 0.01)
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in out.iterdir()) == sorted(path.name for path in clouds.iterdir())
    kept = removed = wrong = 0
    for path in sorted(clouds.glob("*.pcd")):
        before, after = columns_of(path), columns_of(out / path.name)
        assert before.dtype == after.dtype
        assert np.array_equal(before[after["number"]], after)
        removed += before["ring"].sum() - after["ring"].sum()
        kept += after["ring"].sum()
        wrong += (before["ring"] == 0).sum() - (after["ring"] == 0).sum()
    assert removed > 10 * kept
    assert wrong < 0.01 * 12 * 6000
    assert len(list(ndtree.read(out))) == 12
    assert run("clean", clouds, "-o", tmp_path / "marked", "--mark", "--range-sigma", 0.01).exit_code == 0
    marked = columns_of(tmp_path / "marked" / "000000.pcd")
    assert len(marked) == 6000
    assert (marked["moved"][marked["ring"] == 1] > 0.5).mean() > 0.95
    own = run("clean", clouds, "-o", clouds)
    assert own.exit_code == 2
    assert "which is read" in own.output


@pytest.mark.parametrize("text", [False, True], ids=["binary", "ascii"])
@pytest.mark.parametrize("ending", ["ply", "pcd"])
def test_rows_of_files_keep_their_fields(ending, text, tmp_path):
    columns = {axis: np.arange(6, dtype=np.float32) + k for k, axis in enumerate("xyz")}
    columns["t"] = np.arange(6).astype(np.int32)
    source = tmp_path / f"a.{ending}"
    write_cloud(source, columns)
    if text:
        head, _, _ = source.read_bytes().partition(b"end_header\n" if ending == "ply" else b"DATA binary\n")
        rows = "".join(f"{i} {i + 1} {i + 2} {i}\n" for i in range(6)).encode()
        ends = {"ply": b"end_header\n", "pcd": b"DATA ascii\n"}[ending]
        source.write_bytes(head.replace(b"binary_little_endian", b"ascii") + ends + rows)
    keep = np.array([True, False, True, True, False, True])
    write_rows(str(source), str(tmp_path / f"b.{ending}"), keep)
    assert np.array_equal(points_of_file(str(tmp_path / f"b.{ending}"))[:, 0], [0, 2, 3, 5])
    moved = np.linspace(0, 1, 6).astype(np.float32)
    write_rows(str(source), str(tmp_path / f"c.{ending}"), np.ones(6, bool), moved)
    assert np.array_equal(points_of_file(str(tmp_path / f"c.{ending}"))[:, 2], columns["z"])
    assert b"moved" in (tmp_path / f"c.{ending}").read_bytes()
    with pytest.raises(ValueError, match="has 6 points, expected 3"):
        write_rows(str(source), str(tmp_path / f"d.{ending}"), keep[:3])


def test_rows_of_las_keep_their_fields(tmp_path):
    laspy = pytest.importorskip("laspy")
    cloud = laspy.create(point_format=1)
    cloud.header.scales = [0.001] * 3
    cloud.x = cloud.y = cloud.z = np.arange(5.0)
    cloud.intensity = np.arange(5) * 10
    cloud.write(tmp_path / "a.las")
    keep = np.array([True, False, True, True, False])
    write_rows(str(tmp_path / "a.las"), str(tmp_path / "b.las"), keep)
    assert np.array_equal(laspy.read(tmp_path / "b.las").intensity, [0, 20, 30])
    moved = np.linspace(0, 1, 5).astype(np.float32)
    write_rows(str(tmp_path / "a.las"), str(tmp_path / "c.las"), np.ones(5, bool), moved)
    assert np.array_equal(laspy.read(tmp_path / "c.las").moved, moved)


def test_a_static_map_has_neither_people_nor_less_of_what_stands(office, log, tmp_path):
    for name, more in (("all", ()), ("static", ("--static",))):
        result = run("map", log, "-o", tmp_path / f"{name}.ndt", "--range-sigma", 0.02, *more)
        assert result.exit_code == 0, result.output
    assert "points moved and were left out" in result.output
    everything, static = (ndtree.load(tmp_path / f"{name}.ndt") for name in ("all", "static"))
    still = ndtree.simulate("office", seed=7, scans=150, doors=3)
    stands = [scan.returned & ~still.moved(i) for i, scan in enumerate(still)]
    ends = np.concatenate([scan.endpoints[one] for scan, one in zip(still, stands)])
    walls = [m.occupied_within(ends, 0.05).mean() for m in (everything, static)]
    assert walls[1] > walls[0] - 0.01, "no static surface is lost"
    points = MovedPoints(ndtree.read(log), {"range_sigma": 0.02}, np.inf, "free").look()
    went = np.concatenate(
        [s.endpoints[office.moved(i) & (points.probability(s) > 0.5)] for i, s in enumerate(office)]
    )
    went = went[~office.contains(went)]
    left = [(m.state(went) == 1).mean() for m in (everything, static)]
    assert len(went) > 1000
    assert left[0] > 0.04
    assert left[1] < 0.02, "nor their trails"
    free = [(m.state(went) == 0).mean() for m in (everything, static)]
    assert free[1] > free[0]


def test_a_static_map_keeps_rods_that_most_beams_pass(tmp_path):
    rods = np.c_[np.arange(-3, 3.01, 0.25), np.full(25, 2.0)]
    angles = np.radians(np.linspace(0, 180, 181))
    ways = np.c_[np.cos(angles), np.sin(angles)]
    scans = []
    for x in np.linspace(-1.5, 1.5, 50):
        along = (rods - [x, 0.0]) @ ways.T
        aside = np.abs((rods - [x, 0.0]) @ np.c_[-ways[:, 1], ways[:, 0]].T)
        ranges = np.where(aside < 0.015, along, np.inf).min(0)
        ranges = np.minimum(ranges, 3.5 / np.maximum(ways[:, 1], 1e-3)).clip(max=8)
        scans.append(ndtree.Scan([x, 0.0] + ways * ranges[:, None], np.array([x, 0.0]), returned=ranges < 8))
    np.savez(
        tmp_path / "fence.npz",
        points=np.concatenate([scan.endpoints for scan in scans]),
        origins=np.array([scan.origin for scan in scans]),
        offsets=181 * np.arange(len(scans) + 1),
        no_return=~np.concatenate([scan.returned for scan in scans]),
    )
    lost = []
    for more in ((), ("--static",)):
        target = tmp_path / f"map{len(more)}.ndt"
        result = run(
            "map", tmp_path / "fence.npz", "-o", target, "--range-sigma", 0.01, "--min-cell-size", 0.1, *more
        )
        assert result.exit_code == 0, result.output
        near = ndtree.load(target).nearest_occupied(rods[4:-4], max_distance=1.0).distance
        lost.append(np.count_nonzero(~(near < 0.15)))
    assert lost[0] > 0, "else this tests nothing"
    assert lost[1] == 0


def test_wrong_calls_end_with_one_line(log, tmp_path):
    folder = run("clean", log, "-o", tmp_path / "folder")
    assert folder.exit_code == 2
    assert "a folder is for a folder of PCD, PLY, LAS or LAZ files" in " ".join(folder.output.split())
    missing = run("clean", tmp_path / "no.npz", "-o", tmp_path / "x.npz")
    assert missing.exit_code == 1
    tiles = run("map", log, "-o", tmp_path / "a.tiles", "--static")
    assert tiles.exit_code == 2
    assert "--static" in tiles.output
    cars = run("simulate", "office", "--cars", 2, "-o", tmp_path / "x.npz")
    assert cars.exit_code == 2
    assert "--cars 2: must be 0 in the office" in cars.output


def test_people_before_a_real_camera(recordings, tmp_path):
    images = dict(np.load(there(recordings / "kinect2_gallery_p1" / "kinect2_gallery_p1.npz")))
    lengths = np.diff(images.pop("offsets"))
    chosen = np.arange(len(lengths)) % 10 == 0  # Every tenth shows the same.
    points = np.repeat(chosen, lengths)
    images = {name: rows[points if len(rows) == len(points) else chosen] for name, rows in images.items()}
    log = tmp_path / "some.npz"
    np.savez(log, offsets=np.cumsum([0, *lengths[chosen]]), **images)
    result = run("clean", log, "-o", tmp_path / "clean.npz", "--json", tmp_path / "figures.json")
    assert result.exit_code == 0, result.output
    scores = json.loads((tmp_path / "figures.json").read_text())["scores"]
    assert scores["HA"] > 0.89  # Labels are rough: from body tracking.
    assert scores["SA"] > 0.95
