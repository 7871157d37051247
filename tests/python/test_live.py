# SPDX-License-Identifier: BSD-3-Clause
"""A live mapper: the map of a recording byte for byte, and every scan that is not in it is counted."""

from __future__ import annotations

import math
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import START, Messages, write_bag
from calling import cli
from conftest import there
from drives import Drive

import ndtree
from ndtree.live import LiveMapper, MessagesIntake, Saver, ScansIntake, Window, play
from ndtree.live.figures import LiveFigures
from ndtree.live.frames import FramesIntake, Reading, Transform
from ndtree.live.intake import Verdict
from ndtree.live.playing import messages_of
from ndtree.live.queue import Entry, ScanQueue
from ndtree.logs.poses.following import FollowedTree
from ndtree.logs.poses.transforms import TransformTree
from ndtree.logs.ros.files.bag import open_bag
from ndtree.tuning.config import Config

SETTINGS = Config.of(no_return="free")
PATIENCE = 60.0


def same_as_map(log: Path, folder: Path, *options: object) -> Any:
    """Whether a recording that is played makes the map of `ndtree map`, by the same options."""
    one, other = folder / "live.ndt", folder / "map.ndt"
    lived = cli("live", log, "-o", one, "--rate", 0, *options)
    assert lived.exit_code == 0, lived.stderr
    options = tuple(word for i, word in enumerate(options) if "--look" not in options[max(i - 1, 0) : i + 1])
    mapped = cli("map", log, "-o", other, *options)
    assert mapped.exit_code == 0, mapped.stderr
    assert one.read_bytes() == other.read_bytes()
    return lived


def drive_bag(folder: Path, kind: str, *, topics: tuple[str, ...] = ("/scan",), n: int = 50) -> Path:
    """A robot with lasers in a round room, whose transforms come after the scans of their time."""
    make, drive = Messages(kind), Drive(planar=True, n=n)
    generator = np.random.default_rng(5)
    content = []
    for topic, stamp, message in drive.transforms(make):
        content.append((topic, stamp + 0.03 if topic == "/tf" else stamp, message))
    for number, topic in enumerate(topics):
        for stamp in np.arange(START + 0.02 * number, START + 0.1 * (n - 2), 0.05):
            ranges = 4 + 0.5 * np.sin(np.arange(60) / 9) + generator.normal(0, 0.01, 60)
            ranges[::17] = np.inf
            message = make.laser(stamp, "sensor", ranges, time_increment=1e-4)
            content.append((topic, stamp + 0.01 + 0.2 * number, message))
    content.sort(key=lambda row: row[1])
    return write_bag(folder / f"drive_{kind}", make, content)


FIXED = ["--range-sigma", "0.02", "--no-return", "free", "--sweep", "said"]


@pytest.mark.parametrize("kind, options", [("ros1", FIXED), ("sqlite3", FIXED), ("mcap", ["--look", "1e9"])])
def test_bags_give_the_map_of_the_recording(kind: str, options: list[str], tmp_path: Path) -> None:
    """Of two lasers, and of one."""
    topics = ("/front", "/rear") if kind != "ros1" else ("/scan",)
    bag = drive_bag(tmp_path, kind, topics=topics, n=30)
    named = [word for topic in topics for word in ("--topic", topic)]
    assert "0 dropped" in same_as_map(bag, tmp_path, *named, *options).stdout


@pytest.mark.parametrize("world, scans", [("office", 30), ("apartment", 2), ("street", 1)])
def test_simulated_logs_give_the_map_of_the_log(world: str, scans: int, tmp_path: Path) -> None:
    log = tmp_path / f"{world}.npz"
    ndtree.simulate(world, scans=scans).save(log)  # type: ignore[arg-type]
    assert "  chosen: --dim " in same_as_map(log, tmp_path).stdout


#: Bags, and options by which what is decided of their first two seconds is what all of them say.
REAL = {
    "ros2_scan_tf_odom_mac_take_2": ["--sweep", "reversed-end"],
    "ros1_scan_tf_turtlebot_kinect/test_turtlebot.bag": [],
    "ros1_scan_tf_gmapping_replay_crash/test_replay_crash.bag": [],
    "jackal_mocap/test_2026-02-17-16-26-34.bag": [
        "--poses", "/vrpn_client_node/jackal/pose", "--mount", "0.013,0,-1.6deg", "--time-offset", "-0.049",
    ],
    "ros1_scan_tf_hrp_rplidar/mylaserdata3.bag": ["--mount", "0,0,0", "--sweep", "stamp"],
    "ros2_scan_only_db3/mydata": ["--still", "--look", "1e9"],  # Two sensors share a topic, one is dead.
    "ros1_pointcloud2_embag/test.bag": ["--odometry", "/base_pose_ground_truth", "--topic", "/base_scan"],
    "mcap_pointcloud2_pointcloudset/test.mcap": ["--still"],
}  # fmt: skip


@pytest.mark.parametrize("name", REAL)
def test_real_bags_give_the_map_of_the_recording(name: str, recordings: Path, tmp_path: Path) -> None:
    bag = there(recordings / "bags" / name)
    same_as_map(bag, tmp_path, "--range-sigma", "0.02", "--no-return", "ignore", *REAL[name])


def scans(n: int = 40) -> list[ndtree.Scan]:
    return list(ndtree.simulate("office", scans=n))


def mapped(some: list[ndtree.Scan]) -> bytes:
    m = ndtree.AdaptiveMap(dim=2)
    for scan in some:
        scan.insert_into(m)
    return m.to_bytes()


class Slow(ScansIntake):
    """Takes its time for each scan until it is let go."""

    def __init__(self) -> None:
        super().__init__(SETTINGS, 2)
        self.go = threading.Event()

    def scan(self, entry: Entry, give_up: bool, figures: Any) -> Any:
        assert self.go.wait(PATIENCE)
        return super().scan(entry, give_up, figures)


def test_a_full_queue_drops_the_oldest_and_counts() -> None:
    some, intake = scans(30), Slow()
    mapper = LiveMapper(intake, queue=5)
    mapper.put(some[0], 0.0)
    deadline = time.monotonic() + PATIENCE
    while mapper.figures.waiting != 1:  # It has taken the first out of the queue.
        assert time.monotonic() < deadline
        time.sleep(0.01)
    for number, scan in enumerate(some[1:], start=1):
        mapper.put(scan, float(number))
    intake.go.set()
    mapper.close()
    figures = mapper.figures
    assert (figures.received, figures.mapped, figures.dropped, figures.waiting) == (30, 6, 24, 0)
    assert not figures.is_complete
    assert mapper.snapshot().to_bytes() == mapped([some[0], *some[-5:]])


def test_what_was_looked_at_before_mapping_is_not_dropped(tmp_path: Path) -> None:
    """Of a laser of 20 Hz two seconds are more than the queue holds; what comes then is bounded by it."""
    bag = drive_bag(tmp_path, "mcap")
    intake = MessagesIntake(str(bag), Config.of(range_sigma=0.02, no_return="free"))
    with open_bag(str(bag)) as opened:
        items = list(messages_of(opened))
    looked = [item for item in items if item[1] <= items[0][1] + 50 + 2.5]
    with LiveMapper(intake, queue=5) as mapper:
        for item in looked:  # All at once.
            mapper.put(*item)
        deadline = time.monotonic() + PATIENCE
        while mapper.figures.waiting > 2 or not mapper.figures.mapped:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert mapper.figures.dropped == 0 and mapper.figures.mapped > 30
        for item in items[len(looked) :]:
            mapper.put(*item)
    figures = mapper.figures
    assert figures.received == figures.mapped + figures.dropped + sum(figures.left_out.values())


def test_who_waits_drops_nothing() -> None:
    some = scans(30)
    with LiveMapper(ScansIntake(SETTINGS, 2), queue=2) as mapper:
        play([(scan, 0.1 * i) for i, scan in enumerate(some)], mapper, rate=0)
    assert mapper.figures.is_complete and mapper.figures.mapped == 30
    assert mapper.snapshot().to_bytes() == mapped(some)


def test_a_recording_is_played_at_its_pace() -> None:
    clock = [100.0]
    times: list[float] = []

    class Watch(ScansIntake):
        def begin(self, received: float) -> None:
            times.append(clock[0])

    def sleep(seconds: float) -> None:
        clock[0] += seconds

    stamps = [5.0, 5.5, 5.5, 4.0, 4.2, 90.0, 91.0]  # Back, and far ahead: these are no pauses.
    with LiveMapper(Watch(SETTINGS, 2)) as mapper:
        play(zip(scans(7), stamps), mapper, rate=2.0, now=lambda: clock[0], sleep=sleep)
    assert np.allclose(np.array(times) - 100, [0, 0.25, 0.25, 0.25, 0.35, 0.35, 0.85])
    for rate in (-1.0, math.inf, math.nan):
        with pytest.raises(ValueError, match=f"rate = {rate:g}"):
            play([], mapper, rate=rate)


def robot(stamp: float) -> Transform:
    half = 0.1 * stamp
    turn = (0.0, 0.0, math.sin(half), math.cos(half))
    return Transform("map", "base", (0.5 * stamp, 0.1 * stamp, 0.0), turn, stamp)


MOUNT = Transform("base", "laser", (0.2, 0.0, 0.3))
POINTS = np.stack([np.linspace(1, 4, 50), np.linspace(-2, 2, 50)], axis=1)


def test_scans_wait_for_their_poses_and_no_longer_than_they_may() -> None:
    intake = FramesIntake(SETTINGS, 2)
    mapper = LiveMapper(intake, patience=0.5)
    mapper.put(MOUNT, 0.0)
    mapper.put(robot(0.0), 0.0)
    mapper.put(Reading(POINTS, 0.15, "laser"), 0.15)
    mapper.put(Reading(POINTS, 0.16, "laser"), 0.16)
    time.sleep(0.2)
    assert mapper.figures.mapped == 0
    mapper.put(robot(0.1), 0.2)
    time.sleep(0.2)
    assert mapper.figures.mapped == 0  # 0.15 is between no poses.
    mapper.put(robot(0.2), 0.3)
    mapper.put(Reading(POINTS, 0.205, "laser"), 0.31)  # Little later than the last pose, which has to do.
    mapper.put(Reading(POINTS, 0.3, "laser"), 0.32)  # Later.
    mapper.put(Reading(POINTS, 0.3, "nowhere"), 0.33)
    mapper.put(Reading(POINTS, -0.5, "laser"), 0.34)
    mapper.put(Reading(np.zeros(3), 0.2, "laser"), 0.35)
    mapper.advance(0.9)
    deadline = time.monotonic() + PATIENCE
    while mapper.figures.waiting or mapper.figures.mapped < 3:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    mapper.put(robot(0.25), 1.0)  # Too late.
    mapper.close()
    figures = mapper.figures
    assert (figures.mapped, figures.unsure, figures.late_poses, figures.dropped) == (3, 1, 1, 0)
    assert figures.left_out == {
        "no pose in time": 1, "readings in unknown frames": 1, "before the first pose": 1,
        "damaged readings": 1,
    }  # fmt: skip
    assert figures.received == figures.mapped + sum(figures.left_out.values())


def test_frames_are_resolved_as_by_hand() -> None:
    with LiveMapper(FramesIntake(SETTINGS, 2), patience=5.0) as mapper:
        for i in range(40):
            mapper.put(Reading(POINTS, 0.05 * i + 0.025, "laser"), 0.05 * i)
            mapper.put(robot(0.05 * i), 0.05 * i)
        mapper.put(MOUNT, 2.0)  # Now all is known.
        mapper.put(robot(2.0), 2.0)
    assert mapper.figures.is_complete and mapper.figures.mapped == 40
    expected = ndtree.AdaptiveMap(dim=2)
    for i in range(40):
        stamp = 0.05 * i + 0.025
        yaw = 0.2 * stamp
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        origin = np.array([0.5, 0.1]) * stamp + turn @ [0.2, 0.0]
        expected.insert(POINTS @ turn.T + origin, origin)
    one, other = mapper.snapshot(), expected
    ends = np.random.default_rng(0).uniform(-1, 5, (2000, 2))
    assert np.mean(one.state(ends) == other.state(ends)) > 0.999  # But for the last bits of sines.


@pytest.mark.parametrize(
    "wrong, said",
    [
        ({"queue": 0}, "queue = 0"),
        ({"patience": -1.0}, "patience = -1 s"),
        ({"patience": "x"}, r"LiveMapper\(\): patience = 'x': must be a number"),
        ({"patient": 1}, r"LiveMapper\(\): no argument patient, expected target, make, queue, patience"),
    ],
)
def test_wrong_numbers_are_refused(wrong: Any, said: str) -> None:
    with pytest.raises((TypeError, ValueError), match=said):
        LiveMapper(ScansIntake(SETTINGS, 2), **wrong)


def test_what_is_no_transform_is_refused() -> None:
    for bad in ((0, 0, 0, 0.5), (0, 0, math.nan, 1)):
        with pytest.raises(ValueError, match="transform from map to base"):
            Transform("map", "base", (0, 0, 0), bad, 1.0)
    with pytest.raises(ValueError, match=r"shapes \(2,\) and \(4,\)"):
        Transform("map", "base", (0, 0))
    with pytest.raises(ValueError, match="stamp = nan s"):
        Transform("map", "base", (0, 0, 0), stamp=math.nan)


def test_an_error_ends_the_mapper_and_is_told() -> None:
    mapper = LiveMapper(ScansIntake(SETTINGS, 2))
    mapper.put("no scan", 0.0)
    with pytest.raises(TypeError, match="found str, expected Scan"):
        mapper.close()
    with pytest.raises(TypeError, match="found str, expected Scan"):
        mapper.put(scans(1)[0], 0.0)


def test_several_sensors_are_in_the_order_of_their_stamps() -> None:
    """Whatever order they come in: as sorted, if none is more than a second late."""
    generator = np.random.default_rng(3)
    tried = 0
    for begin in [0.0, 1e6] * 25:
        queue = ScanQueue(1000)
        queue.order_by(lambda item: item, "012")
        lags = generator.uniform(0, 0.45, 3)
        steps = [(s, generator.uniform(0.02, 0.3)) for s in range(3)]
        items = [(str(s), begin + t) for s, step in steps for t in np.arange(0.01 * s, 3, step)]
        arriving = sorted(items, key=lambda item: item[1] + lags[int(item[0])])
        out = []
        for item in arriving:
            queue.put(Entry(item, 0.0, 0.0))
            while (entry := queue.take()) is not None:
                out.append(entry.item)
        assert len(out) > 0.5 * len(items)  # It does not wait for the end.
        while (entry := queue.take(everything=True)) is not None:
            out.append(entry.item)
        assert out == sorted(items, key=lambda item: item[1])
        tried += len(items)
    assert tried > 2000
    # A sensor that is silent holds the others up for a second, and no longer.
    queue = ScanQueue(1000)
    queue.order_by(lambda item: item, ["dead", "alive"])
    queue.put(Entry(("dead", 0.0), 0.0, 0.0))
    took = []
    for stamp in np.arange(0.1, 3.0, 0.1):
        queue.put(Entry(("alive", stamp), 0.0, 0.0))
        while (entry := queue.take()) is not None:
            took.append(stamp - entry.item[1])
    assert max(took) < 1.11 and took[-1] == 0


def test_what_is_forgotten_of_transforms_is_not_needed() -> None:
    generator = np.random.default_rng(7)
    whole, followed = TransformTree(), FollowedTree(TransformTree())
    asked = 0
    for i in range(5000):
        stamp = 0.02 * i + generator.uniform(0, 0.01)
        half = generator.uniform(-1.5, 1.5)
        turn = [0, 0, math.sin(half), math.cos(half)]
        row = ("map", "base", stamp, generator.normal(size=3), turn)
        whole.add(*row)
        followed.add(*row)
        if i % 50 == 49:
            stamp -= generator.uniform(0, 1.0)
            assert followed.until("map", "base") >= stamp
            one, other = (tree.pose_at("map", "base", stamp) for tree in (whole, followed.tree))
            assert np.array_equal(one.position, other.position)
            assert np.array_equal(one.rotation, other.rotation)
            assert len(followed.tree._rows["map", "base"]) < 600
            followed.asked(stamp)
            asked += 1
    assert asked == 100 and followed.late == followed.fallen == 0
    followed.add("map", "base", stamp - 0.5, np.zeros(3), [0, 0, 0, 1])
    followed.add("map", "base", stamp + 2.0, np.zeros(3), [0, 0, 0, 1])
    assert (followed.late, followed.fallen) == (1, 0)


def test_a_clock_that_begins_again_forgets_what_was() -> None:
    tree = FollowedTree(TransformTree())
    for i in range(100):
        tree.add("map", "base", 50 + 0.1 * i, [1.0 * i, 0, 0], [0, 0, 0, 1])
    tree.add("map", "base", 20.0, [0, 0, 0], [0, 0, 0, 1])
    tree.add("map", "base", 60.0, [100.0, 0, 0], [0, 0, 0, 1])
    assert (tree.fallen, tree.late) == (0, 1)  # One alone is late.
    for i in range(10):
        tree.add("map", "base", 0.1 * i, [-1.0 * i, 0, 0], [0, 0, 0, 1])
    assert tree.fallen == 1 and tree.until("map", "base") == pytest.approx(0.9)
    assert tree.tree.pose_at("map", "base", 0.45).position[0] == pytest.approx(-4.5)


def test_a_simulator_that_is_reset_is_mapped_on() -> None:
    with LiveMapper(FramesIntake(SETTINGS, 2), patience=5.0) as mapper:
        mapper.put(MOUNT, 0.0)
        received = 0.0
        for begin in (100.0, 3.0):
            for i in range(60):
                received += 0.05
                mapper.put(Reading(POINTS, begin + 0.05 * i, "laser"), received, wait=True)
                mapper.put(robot(begin + 0.05 * i), received)
    assert mapper.figures.mapped == 120 and not mapper.figures.left_out


class Watcher:
    period = 0.0

    def __init__(self) -> None:
        self.maps: list[bytes] = []
        self.stamps: list[float] = []
        self.go = threading.Event()

    def update(self, m: Any, stamp: float) -> None:
        assert self.go.wait(PATIENCE)
        self.maps.append(m.to_bytes())
        self.stamps.append(stamp)


class Broken(Watcher):
    def update(self, m: Any, stamp: float) -> None:
        raise OSError("no space left")


def test_a_slow_sink_holds_nobody_up_and_a_broken_one_is_told_of() -> None:
    some, slow, rare, broken = scans(30), Watcher(), Watcher(), Broken()
    rare.period = 1e3
    rare.go.set()
    mapper = LiveMapper(ScansIntake(SETTINGS, 2), sinks=[broken, rare, slow])
    play([(scan, scan.stamp) for scan in some], mapper, rate=0)
    deadline = time.monotonic() + PATIENCE
    while mapper.figures.mapped < 30:
        assert time.monotonic() < deadline, "the slow sink holds up the map"
        time.sleep(0.01)
    slow.go.set()
    mapper.close()
    assert slow.maps[-1] == rare.maps[-1] == mapped(some) and slow.stamps[-1] == some[-1].stamp
    assert len(slow.maps) < 10  # It has missed what was between.
    assert mapper.failures == {"Broken": "OSError: no space left"}
    assert mapper.figures.delay(0.99, of="published") > 0


def test_a_sink_that_works_again_has_not_failed() -> None:
    class Shaky:
        period, said = 0.0, iter([OSError("no space left")])

        def update(self, m: Any, stamp: float) -> None:
            for error in self.said:
                raise error

    with LiveMapper(ScansIntake(SETTINGS, 2), sinks=[Shaky()]) as mapper:
        for failures in ({"Shaky": "OSError: no space left"}, {}):
            mapper.put(scans(1)[0])
            deadline = time.monotonic() + PATIENCE
            while mapper.failures != failures:
                assert time.monotonic() < deadline
                time.sleep(0.01)


def test_a_map_is_saved_meanwhile_and_gone_on_with(tmp_path: Path) -> None:
    some, file = scans(30), tmp_path / "part.ndt"
    with LiveMapper(ScansIntake(SETTINGS, 2), sinks=[Saver(file, 1e-3)]) as mapper:
        play([(scan, 0.0) for scan in some[:10]], mapper, rate=0)
        deadline = time.monotonic() + PATIENCE
        while not file.exists():
            assert time.monotonic() < deadline
            time.sleep(0.01)
    assert file.read_bytes() == mapped(some[:10])
    with LiveMapper(ScansIntake(SETTINGS, 2), target=ndtree.load(file)) as mapper:
        play([(scan, 0.0) for scan in some[10:]], mapper, rate=0)
    assert mapper.snapshot().to_bytes() == mapped(some)
    with pytest.raises(ValueError, match="save_every = 0 s"):
        Saver(file, 0.0)


def test_a_window_keeps_what_is_near() -> None:
    some = scans(200)
    with LiveMapper(ScansIntake(SETTINGS, 2), window=Window(4.0)) as mapper:
        play([(scan, 0.0) for scan in some], mapper, rate=0)
    leaves = mapper.snapshot().leaves()
    seen = leaves[leaves.observed]
    away = np.linalg.norm(seen.center - np.asarray(some[-1].origin), axis=1)
    whole = ndtree.from_bytes(mapped(some)).leaves()
    assert len(seen) < 0.8 * np.count_nonzero(whole.observed)
    reach = max(np.linalg.norm(scan.endpoints - scan.origin, axis=1).max() for scan in some[-5:])
    assert away.max() <= max(4.0 * 1.05 + 2, reach + 2)
    near = np.random.default_rng(1).uniform(-0.5, 0.5, (500, 2)) + some[-1].origin
    assert np.array_equal(mapper.snapshot().state(near), ndtree.from_bytes(mapped(some)).state(near))
    for radius in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="window = "):
            Window(radius)


def test_a_map_that_is_full_leaves_scans_out() -> None:
    some = scans(40)
    options = {"max_memory": 200_000.0}
    with LiveMapper(ScansIntake(Config.of(**options, no_return="free"), 2)) as mapper:
        play([(scan, 0.0) for scan in some], mapper, rate=0)
    figures = mapper.figures
    assert 0 < figures.mapped < 40
    assert figures.left_out == {"no memory left for the map": 40 - figures.mapped}


def test_without_poses_it_says_what_is_missing(tmp_path: Path) -> None:
    make = Messages("mcap")
    content = [("/scan", START + 0.1 * i, make.laser(START + 0.1 * i, "laser", [2.0] * 9)) for i in range(60)]
    bag = write_bag(tmp_path / "alone", make, content)
    done = cli("live", bag, "--rate", 0)
    assert done.exit_code == 1 and "no transform to laser" in done.stderr
    assert cli("live", bag, "--rate", 0, "--still", "--json", "-").exit_code == 0


def test_poses_that_stop_for_a_while_are_counted(tmp_path: Path) -> None:
    make, drive = Messages("mcap"), Drive(planar=True, n=100)
    content = [row for row in drive.transforms(make) if not START + 4 < row[1] < START + 7]
    stamps = START + 0.05 + 0.1 * np.arange(98)
    content += [("/scan", t, make.laser(t, "sensor", 3 + np.zeros(30))) for t in stamps]
    content.sort(key=lambda row: row[1])
    bag = write_bag(tmp_path / "gap", make, content)
    intake = MessagesIntake(str(bag), Config.of(range_sigma=0.02, no_return="free"))
    with open_bag(str(bag)) as opened, LiveMapper(intake, patience=0.5) as mapper:
        play(messages_of(opened), mapper, rate=0)
    figures = mapper.figures
    assert figures.received == 98 == figures.mapped + sum(figures.left_out.values())
    assert 25 <= sum(figures.left_out.values()) <= 31
    assert set(figures.left_out) <= {"no pose in time", "in a gap of the poses", "before the first pose"}


def test_a_recording_goes_on_with_a_saved_map(tmp_path: Path) -> None:
    log, part = tmp_path / "office.npz", tmp_path / "part.ndt"
    ndtree.simulate("office", scans=20).save(log)
    options = ("--no-return", "free", "--range-sigma", 0.03)
    assert cli("live", log, "--rate", 0, "-o", part, *options).exit_code == 0
    twice = tmp_path / "twice.ndt"
    done = cli("live", log, "--rate", 0, "--resume", part, "-o", twice, "--no-return", "free")
    assert done.exit_code == 0, done.stderr
    m = ndtree.AdaptiveMap(dim=2)
    for scan in 2 * list(ndtree.read(log)):
        scan.insert_into(m)
    assert twice.read_bytes() == m.to_bytes()
    done = cli("live", log, "--resume", part, "--min-cell-size", 0.1)
    assert done.exit_code == 2 and "--min-cell-size: the map of --resume has its own options" in done.stderr


@pytest.mark.parametrize(
    "moved, said",
    [
        ((0.0, 0.0, 0.0), None),
        ((0.4, 1.0, -0.7), r"do not fit the saved map: [5-9]\d % of their end points lie where it is free"),
        ((0.0, 80.0, 0.0), "do not fit the saved map: none ends where it was observed"),
    ],
)
@pytest.mark.parametrize("replaces", [False, True])
def test_a_saved_map_of_another_frame_is_doubted(
    moved: tuple[float, ...], said: str | None, replaces: bool
) -> None:
    """The second drive sees other things than the first, and others move in it."""
    drives = [list(ndtree.simulate("office", scans=60, seed=3, people=n)) for n in (0, 4)]
    saved = ndtree.AdaptiveMap(dim=2)
    for scan in drives[0][:40]:
        scan.insert_into(saved)
    turn = np.array([[math.cos(moved[0]), -math.sin(moved[0])], [math.sin(moved[0]), math.cos(moved[0])]])
    intake = ScansIntake(Config.of(range_sigma=0.03, no_return="free"), 2)
    with LiveMapper(intake, target=None if replaces else saved) as mapper:
        if replaces:
            mapper.replace(saved)
        for scan in drives[1][20:]:
            origin = scan.origin @ turn.T + moved[1:]
            mapper.put(
                ndtree.Scan(scan.endpoints @ turn.T + moved[1:], origin, returned=scan.returned), wait=True
            )
    notes = [note for note in intake.said() if "saved map" in note]
    assert len(notes) == bool(said) and (said is None or re.search(said, notes[0])), notes


def test_no_ros_is_imported_by_the_package() -> None:
    code = (
        "import sys, ndtree, ndtree.live; "
        "print([name for name in sys.modules if name.split('.')[0] in ('rclpy', 'rospy', 'rosbags')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "arguments, status, said",
    [
        (["--every", "0"], 2, "--every 0: must be a whole number >= 1"),
        (["--rate", "-1"], 2, "--rate -1: must be a number >= 0"),
        (["--window", "0"], 2, "--window 0: must be a number > 0 m"),
        (["--save-every", "3"], 2, "--save-every: expected -o MAP"),
        (["--port", "3"], 2, "--port: is for the page of --watch"),
        (["--resume", "nothing.ndt"], 1, "nothing.ndt: No such file"),
    ],
)
def test_wrong_calls_say_what_is_wrong(arguments: list[str], status: int, said: str, tmp_path: Path) -> None:
    log = tmp_path / "office.npz"
    ndtree.simulate("office", scans=3).save(log)
    done = cli("live", log, *arguments)
    assert done.exit_code == status and said in done.stderr


def test_a_reading_waits_for_the_pose_of_its_last_beam() -> None:
    intake, figures = FramesIntake(Config.of(range_sigma=0.02), 2), LiveFigures()
    reading = Reading([[1.0, 0.0], [1.0, 0.0]], START, "laser", times=[0.0, 0.5])
    entry = Entry(reading, START, 0.0)
    for after in (0.0, 0.2):
        intake.pose(Transform("map", "laser", (after, 0.0, 0.0), stamp=START + after), figures)
        assert intake.scan(entry, False, figures) is Verdict.wait
    intake.pose(Transform("map", "laser", (0.5, 0.0, 0.0), stamp=START + 0.5), figures)
    scan = intake.scan(entry, False, figures)
    assert isinstance(scan, ndtree.Scan)
    np.testing.assert_allclose(scan.endpoints, [[1.0, 0.0], [1.5, 0.0]], atol=1e-6)
