# SPDX-License-Identifier: BSD-3-Clause
"""What is decided of the first seconds is withdrawn where later messages say otherwise."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import START, Messages, write_bag
from calling import cli
from slams import bag_of, drifted, office, path_message, yaw
from test_live import FIXED, same_as_map

import ndtree
from ndtree._errors import key
from ndtree.live import FramesIntake, LiveMapper, MessagesIntake, Reading, Transform
from ndtree.live.playing import messages_of
from ndtree.live.ros.parameters import in_parameters
from ndtree.logs.poses.following import FollowedTree
from ndtree.logs.poses.transforms import TransformTree
from ndtree.logs.ros.files.bag import open_bag
from ndtree.tuning.config import Config

PATIENCE = 60.0
#: Half the edge of a room, one of whose walls swallows beams but where they meet it nearly at right angles:
#: from one place nothing contradicts them.
ROOM = 4.0


def ranges_at(place: np.ndarray, turn: float, generator: np.random.Generator) -> np.ndarray:
    angles = np.linspace(-1.5, 1.5, 120) + turn + 1e-3
    way = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    with np.errstate(divide="ignore"):
        length = np.min(np.where(way > 0, ROOM - place, -ROOM - place) / way, axis=1)
    ends = place + length[:, None] * way
    ranges = length + generator.normal(0, 0.01, 120)
    swallowed = (ends[:, 1] > ROOM - 0.01) & (np.abs(way[:, 1]) < 0.85)
    return np.where(swallowed, np.inf, ranges)


def robot(
    folder: Path,
    kind: str,
    *,
    stands: float,
    first_pose: float = -0.1,
    rate: float = 0.1,
    back: float = math.inf,
) -> Path:
    """A laser that stands for a while and then drives on a circle; odometry may begin later.

    From a time `back` on, stamps are those of 20 s before.
    """

    def stamp(at: float) -> float:
        return START + at - (1e8 if at >= back else 0.0)

    make, generator = Messages(kind), np.random.default_rng(4)
    content: list[tuple[str, float, Any]] = []
    content.append(make.fixed(START - 1, "base", "laser", [0.1, 0, 0.3], yaw(0.0)))

    def pose(at: float) -> tuple[np.ndarray, float]:
        moves = max(at - stands, 0.0)
        return 1.5 * np.array([math.sin(0.5 * moves), 1 - math.cos(0.5 * moves)]), 0.5 * moves

    for at in np.arange(first_pose, 9.0, 0.05):
        place, turn = pose(at)
        content.append(make.moved(stamp(at), "odom", "base", [*place, 0.0], yaw(turn), at=START + at + 0.002))
    for at in np.arange(0.0, 8.8, rate):
        place, turn = pose(at)
        sensor = place + 0.1 * np.array([math.cos(turn), math.sin(turn)])
        message = make.laser(stamp(at), "laser", ranges_at(sensor, turn, generator), range_max=12.0)
        content.append(("/scan", START + at + 0.01, message))
    content.sort(key=lambda row: row[1])
    return write_bag(folder / f"robot_{kind}", make, content)


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Stands for three seconds, and has many scans."""
    return robot(tmp_path_factory.mktemp("standing"), "ros1", stands=3.0, rate=0.04)


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return robot(tmp_path_factory.mktemp("moving"), "mcap", stands=1.0)


def test_walls_are_not_erased_by_what_two_seconds_say(standing: Path, tmp_path: Path) -> None:
    said = same_as_map(standing, tmp_path).stdout
    assert "chosen anew after " in said and " mapped again" in said and "--no-return ignore" in said, said
    m = ndtree.load(tmp_path / "live.ndt")
    wall = np.stack([np.linspace(-2, 3, 60), np.full(60, ROOM)], axis=1)
    near = np.min([m.probability(wall + np.array([0, by])) < 0.5 for by in (-0.04, 0.0, 0.04)], axis=0)
    assert np.mean(near) < 0.1


def test_poses_that_come_while_it_is_decided_wait_for_their_scans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that jumps back meanwhile takes no pose from the scans before."""
    bag = robot(tmp_path, "mcap", stands=0.0, back=5.0)
    looks, has_come, looked = threading.Event(), threading.Event(), MessagesIntake._looked

    def slowly(intake: MessagesIntake, *of: Any) -> Any:
        looks.set()
        assert has_come.wait(PATIENCE)
        return looked(intake, *of)

    monkeypatch.setattr(MessagesIntake, "_looked", slowly)
    options = {"range_sigma": 0.02, "no_return": "free", "sweep": "said"}
    with open_bag(str(bag)) as opened:
        with LiveMapper(MessagesIntake(str(bag), Config.of(**options)), queue=1000) as mapper:
            for item in messages_of(opened):
                mapper.put(*item)
            assert looks.wait(PATIENCE)
            has_come.set()
            while not (mapper.figures.mapped or mapper.figures.left_out):
                time.sleep(0.01)
    assert mapper.figures.mapped == 88 and mapper.figures.is_complete
    assert cli("map", bag, "-o", tmp_path / "map.ndt", *FIXED).exit_code == 0
    assert mapper.snapshot().to_bytes() == (tmp_path / "map.ndt").read_bytes()


def test_odometry_that_comes_later_is_no_standing_robot(tmp_path: Path) -> None:
    """Laser first, odometry 1.2 s later while the robot stands, and it drives after 2.6 s."""
    bag = robot(tmp_path, "mcap", stands=2.6, first_pose=1.2)
    said = same_as_map(bag, tmp_path, *FIXED).stdout
    assert "12 left out (before the first pose)" in said and "taken as fixed" not in said
    intake = MessagesIntake(str(bag), Config.of(range_sigma=0.02, no_return="free", sweep="said"))
    with open_bag(str(bag)) as opened:
        items = list(messages_of(opened))
    with LiveMapper(intake, queue=1000) as mapper:
        for item in items:
            if item[1] < START + 4.0:  # Before the next look.
                mapper.put(*item)
        deadline = time.monotonic() + PATIENCE
        while mapper.figures.left_out != {"before the first pose": 12}:
            assert time.monotonic() < deadline, mapper.figures.summary()
            time.sleep(0.01)
        assert "chosen anew after 3 s" in str(intake.notes) and not intake.log.place.stands


def test_what_never_moved_is_released_when_it_does() -> None:
    """Also after all looks: what follows is placed as it moves."""
    tree = TransformTree()
    for stamp in (10.0, 10.5):
        tree.add("odom", "base", stamp, [1.0, 0, 0], yaw(0.0))
    assert tree.fix_constant("odom", "base") == ["odom to base"]
    followed = FollowedTree(tree)
    followed.add("odom", "base", 11.0, [1.0, 0, 0], yaw(0.0))
    assert followed.released == 0 and followed.until("odom", "base") == math.inf
    followed.add("odom", "base", 12.0, [2.0, 0, 0], yaw(0.0))
    assert followed.released == 1 and followed.until("odom", "base") == 12.0
    assert tree.pose_at("odom", "base", 11.25).position[0] == pytest.approx(1.25)
    assert not tree.release(("odom", "base"), [3.0, 0, 0], yaw(0.0))


def test_a_recording_of_more_bytes_than_are_kept_is_decided_of_these(
    standing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ndtree.live.messages.KEPT", 40_000)
    done = cli("live", standing, "--rate", 0)
    assert done.exit_code == 0, done.stderr
    assert "220 mapped" in done.stdout and "chosen anew after 9 s" not in done.stdout


def test_a_map_that_was_changed_by_hand_is_not_mapped_again(tmp_path: Path) -> None:
    bag = robot(tmp_path, "mcap", stands=2.6, first_pose=1.2)
    intake = MessagesIntake(str(bag))
    with open_bag(str(bag)) as opened:
        items = list(messages_of(opened))
    with LiveMapper(intake, queue=1000) as mapper:
        for item in items:
            if item[1] < START + 2.4:
                mapper.put(*item)
        deadline = time.monotonic() + PATIENCE
        while not mapper.figures.mapped:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        with mapper.locked() as m:
            m.mark(np.array([[20.0, 20.0], [21.0, 21.0]]), "occupied")
        for item in items:
            if item[1] >= START + 2.4:
                mapper.put(*item)
    assert mapper.figures.again == 0
    assert any("stay as they were mapped" in line for line in intake.said())
    assert mapper.snapshot().state([[20.5, 20.5]])[0] == 1


@pytest.mark.parametrize("poses_first", [False, True])
def test_a_clock_that_jumps_back_by_a_second_is_as_one_that_jumps_far(poses_first: bool) -> None:
    """Stamps fall on the way; the robot goes on as before, and so does the map."""
    maps = []
    for back in (1.0, 10.0):
        intake = FramesIntake(Config.of(no_return="free"), 2)
        with LiveMapper(intake, patience=30.0, queue=1000) as mapper:
            mapper.put(Transform("base", "laser", (0.2, 0.0, 0.3)), 0.0)
            for i in range(200):
                now, stamp = 0.05 * i, 50 + 0.05 * i - (back if i >= 100 else 0.0)
                points = np.stack([np.full(40, 6.0) - 0.02 * i, np.linspace(-2, 2, 40)], axis=1)
                pose = Transform("map", "base", (0.02 * i, 0.0, 0.0), stamp=stamp)
                reading = Reading(points, stamp, "laser")
                for item in (pose, reading) if poses_first else (reading, pose):
                    mapper.put(item, now)
        figures = mapper.figures
        assert (figures.mapped, figures.unsure, figures.late_poses) == (200, 0, 0) and not figures.left_out
        maps.append(mapper.snapshot().to_bytes())
    assert maps[0] == maps[1]


def test_a_source_whose_clock_is_set_back_is_still_waited_for() -> None:
    """Not only stamps fall, but also when something came: poses come a little later than scans, as before."""
    intake = FramesIntake(Config.of(no_return="free"), 2)
    with LiveMapper(intake, patience=1.0) as mapper:
        mapper.put(Transform("base", "laser", (0.2, 0.0, 0.3)), 0.0)
        for i in range(60):
            now = 100 + 0.05 * i - (10.0 if i >= 30 else 0.0)
            mapper.put(Reading(np.array([[6.0, 0.0], [6.0, 0.1]]), now, "laser"), now)
            time.sleep(0.003)
            mapper.put(Transform("map", "base", (0.02 * i, 0.0, 0.0), stamp=now), now + 0.02)
    figures = mapper.figures
    assert figures.mapped == 60 and figures.is_complete, figures.summary()


N = 60


def slam_bag(folder: Path, *, jumps: bool) -> Path:
    """Odometry that drifts, and a SLAM that says so: as jumps of map to odom, or as a Path."""
    rows = office(N)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    if not jumps:
        return bag_of(folder / "path", wrong, rows, {N - 1: path_message(rows, true, N - 1)}, "mcap")
    plain = bag_of(folder / "plain", wrong, rows, {}, "mcap", fixed_frame="odom")
    make = Messages("mcap")
    content: list[tuple[str, float, Any]] = []
    with open_bag(str(plain)) as opened:
        for raw, received in messages_of(opened):
            content.append((raw.connection.topic, received, opened.decoded(raw)))
    for i, row in enumerate(rows):
        place = [0.0, 0.0, 0.0] if i < N // 2 else [0.3, -0.1, 0.0]
        content.append(make.moved(row[0], "map", "odom", place, yaw(0.0), at=row[0] + 0.0005))
    content.sort(key=lambda row: row[1])
    return write_bag(folder / "jumps", make, content)


def test_jumps_of_tf_in_a_bag_are_followed(tmp_path: Path) -> None:
    bag = slam_bag(tmp_path, jumps=True)
    done = cli("live", bag, "--rate", 0, "--follow", "tf", "--patience", 60, *FIXED)
    assert done.exit_code == 0, done.stderr
    assert f"{N} mapped" in done.stdout and " correction" in done.stdout


def test_what_is_no_path_is_not_followed(tmp_path: Path) -> None:
    bag = slam_bag(tmp_path, jumps=False)
    for follow, said in (("/nothing", "is not there"), ("/scan", "is of type LaserScan")):
        done = cli("live", bag, "--rate", 0, "--follow", follow)
        said = f"--follow {follow}: {said}, expected tf, or a Path as one of /slam/path (Path)"
        assert done.exit_code == 2 and said in " ".join(done.stderr.split())
    intake = MessagesIntake(str(bag), follow="/scan")
    with open_bag(str(bag)) as opened, LiveMapper(intake) as mapper:
        for item in messages_of(opened):
            mapper.put(*item, wait=True)
    assert any("follow = /scan: no nav_msgs/msg/Path came on it" in line for line in intake.said())
    assert cli("live", bag, "--rate", 0, "--follow", "/slam/path").exit_code == 0


@pytest.mark.parametrize("options", [
    ["--from", 2, "--to", 6, *FIXED], ["--from", 1.05, "--every", 2, "--stride", 3, *FIXED],
    ["--origin", "1,1", "--box", "0,0,3,3", "--min-range", 1],
], ids=str)  # fmt: skip
def test_parts_of_a_recording_are_those_of_map(options: list[Any], moving: Path, tmp_path: Path) -> None:
    same_as_map(moving, tmp_path, *options)
    if "--from" not in options:  # Its scans have no times.
        log = tmp_path / "office.npz"
        ndtree.simulate("office", scans=20).save(log)
        same_as_map(log, tmp_path, *options)


@pytest.mark.parametrize("flag", [
    ["--fov", "60"], ["--pixel-sigma", "1"], ["--points-in", "map"], ["--origin-of-scan", "0,0,0"],
    ["--points-only"], ["--every", "0"], ["--box", "1,2,3"],
], ids=lambda flag: flag[0])  # fmt: skip
def test_wrong_options_are_refused_as_by_map(flag: list[str], moving: Path, tmp_path: Path) -> None:
    lived = cli("live", moving, "--rate", 0, *flag)
    mapped = cli("map", moving, "-o", tmp_path / "map.ndt", *flag)
    assert lived.exit_code == mapped.exit_code != 0
    assert lived.stderr.replace("ndtree live", "ndtree map") == mapped.stderr


def test_what_cannot_be_read_of_a_bag_is_said_as_by_map(tmp_path: Path) -> None:
    make = Messages("ros1")
    ranges = np.random.default_rng(1).uniform(1, 7, (80, 9000))  # Chunks are of 1 MiB.
    rows = [make.fixed(START, "map", "sensor", [0, 0, 0])]
    rows += [("/scan", START + i, make.laser(START + i, "sensor", row)) for i, row in enumerate(ranges)]
    whole = write_bag(tmp_path / "whole", make, rows, packed=True).read_bytes()
    nothing = write_bag(tmp_path / "nothing", make, rows[:1])
    part, holed = tmp_path / "part.bag", tmp_path / "holed.bag"
    place = len(whole) * 2 // 3
    holed.write_bytes(whole[:place] + bytes(100) + whole[place + 100 :])
    part.write_bytes(whole[:-100])
    for bag in (holed, nothing):
        lived, mapped = cli("live", bag, "--rate", 0), cli("map", bag, "-o", tmp_path / "map.ndt")
        assert lived.exit_code == mapped.exit_code == 1 and mapped.stderr.endswith(lived.stderr)
    for bag, options, status in ((part, [], 0), (part, ["--strict"], 1), (holed, ["--keep-going"], 0)):
        done = cli("live", bag, "--rate", 0, "--stride", 100, *options)
        assert done.exit_code == status and bag.name in done.stderr


def test_an_interrupt_loses_nothing_that_has_come(moving: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(items: Any, mapper: LiveMapper, **_: Any) -> None:
        for item in items:
            mapper.put(*item)
        raise KeyboardInterrupt

    monkeypatch.setattr("ndtree.cli.commands.live.play", interrupted)
    done = cli("live", moving, "--queue", 1000, *FIXED)
    assert done.exit_code == 0 and "88 scans received: 88 mapped, 0 dropped" in done.stdout, done.stderr


def test_strict_refuses_scans_that_are_left_out(moving: Path, tmp_path: Path) -> None:
    bag = robot(tmp_path, "mcap", stands=1.0, first_pose=0.3)
    done = cli("live", bag, "--rate", 0, "--strict", "-o", tmp_path / "live.ndt", *FIXED)
    assert done.exit_code == 1 and "left out (before the first pose)" in done.stderr
    assert not (tmp_path / "live.ndt").exists()
    assert cli("live", moving, "--rate", 0, "--strict", "--every", 2, *FIXED).exit_code == 0


def test_a_node_is_told_of_parameters() -> None:
    said = (
        f"bag: no transform to laser, expected one of:\n    {key('trajectory')} FILE\n"
        f"    {key('still')}, if the sensor does not move\n    {key('sensor_frame')} FRAME, of a, b\n"
        f"  {key('topic')} /scan, which sees less; ndtree calibrate --find-mount"
    )
    assert in_parameters(said) == (
        "bag: no transform to laser, expected one of:\n    still, if the sensor does not move\n"
        "    sensor_frame FRAME, of a, b\n  topics /scan, which sees less; ndtree calibrate --find-mount"
    )
    assert (
        in_parameters(f"chosen: {key('dim')} 2 {key('range_sigma')} 0.02") == "chosen: dim 2 range_sigma 0.02"
    )


def test_what_publishers_dropped_is_counted_by_their_numbers() -> None:
    from ndtree.live.ros.topics import Numbers

    numbers = Numbers()
    assert not numbers
    for one in ("a7", "a8", "b1", "a12", "a10", "b2", "a13", "b0"):
        numbers.add(one[0], int(one[1:]))
    assert numbers and numbers.lost == 3
