# SPDX-License-Identifier: BSD-3-Clause
"""The node of ROS 2 with real middleware: one process publishes, one maps, one receives.

It needs rclpy, tf2_msgs and map_msgs: of an installed ROS, or of the extra ``ros2`` and
``tools/ros2_messages``. They may be those of another interpreter that has ndtree: $NDTREE_ROS2_PYTHON.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import START, Messages, write_bag
from conftest import there
from robots import PATIENCE, Processes, apartment, check_office, check_services, grid_like, mapped, office
from slams import bag_of, drifted, path_message
from slams import office as driven
from test_rosbag_clouds import START as CLOUDS_START
from test_rosbag_clouds import bag as bag_of_clouds
from test_rosbag_clouds import box_points, colored

import ndtree
from ndtree.live.grid import GroundFollower
from ndtree.live.outputs import by_size, cell_points
from ndtree.maps.writers.map_server import noise_depth

PYTHON = os.environ.get("NDTREE_ROS2_PYTHON", sys.executable)
PROCESSES = Path(__file__).with_name("ros2")
#: No other node of this machine talks on it.
#: Up to 101 its ports are none that the system gives to others.
DOMAIN = str(1 + os.getpid() % 101)


def has_ros() -> bool:
    needed = "rclpy, tf2_msgs.msg, map_msgs.msg, ndtree, rosbags"
    return subprocess.run([PYTHON, "-c", f"import {needed}"], capture_output=True).returncode == 0


pytestmark = pytest.mark.skipif(
    not has_ros(), reason="no rclpy, tf2_msgs and map_msgs: see the head of the file for what to install"
)


class Robot(Processes):
    """As ROS 2 has them."""

    def __init__(self, folder: Path) -> None:
        own = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": DOMAIN}
        own["FASTDDS_DEFAULT_PROFILES_FILE"] = str(PROCESSES / "patient.xml")
        super().__init__(folder, PYTHON, {**os.environ, **own})
        self.stop, self.file = folder / "stop", folder / "map.ndt"  # Of receivers, and of the node.

    def script(self, name: str, *words: object, as_name: str = "") -> Any:
        """One of the processes beside this file."""
        return self.running(as_name or name, PROCESSES / f"{name}.py", *words)

    def node(self, name: str = "node", **given: object) -> Any:
        words = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
        return self.running(name, "-m", "ndtree.live.ros2", "--ros-args", *words)

    def publish(self, bag: Path, rate: float, node: subprocess.Popen[bytes]) -> None:
        with self.script("publisher", bag, rate, 1) as publisher:
            self.ended(publisher, "publisher", node)

    def end(self, receiver: subprocess.Popen[bytes], name: str = "receiver") -> None:
        self.stop.touch()
        assert receiver.wait(PATIENCE) == 0, self.log(name)


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


@dataclass
class Received:
    """What came of a bag that was published."""

    map: bytes
    arrays: Any
    text: Any
    log: str

    def grid_like(self, m: Any, **options: Any) -> tuple[np.ndarray, np.ndarray]:
        """See `robots.grid_like`."""
        return grid_like(self.arrays, m, **options)


def published(bag: Path, folder: Path, rate: float, scans: int, **parameters: object) -> Received:
    """What a node makes of a bag that another process publishes, and a third one receives."""
    robot, output, target = Robot(folder), folder / "out.npz", folder / "node.ndt"
    given = {"grid_stays": 0.0, **parameters, "reliable": "true", "queue": 5000, "patience": 120.0}
    with robot.script("receiver", output, robot.stop) as receiver:
        with robot.node(map_file=target, **given) as node:
            robot.publish(bag, rate, node)
            robot.interrupt(node)
        robot.end(receiver)
    text = robot.log()
    assert f"{scans} scans received: " in text, text
    arrays = np.load(output)
    return Received(target.read_bytes(), arrays, json.loads(str(arrays["text"])), text)


def test_the_office_is_mapped_as_from_a_recording(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "office", *office("mcap", 120))
    received = published(bag, tmp_path, 2.0, 120, range_sigma=0.02, no_return="free")
    m = mapped(bag, PYTHON, range_sigma=0.02, no_return="free")
    assert "120 mapped, 0 dropped" in received.log
    check_office(received, m)
    assert received.text["counts"]["map"] < 40  # Fewer on a busy machine.


def test_clouds_become_a_map_in_space_a_grid_of_a_band_and_octomaps(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "apartment", *apartment("mcap", 10))
    changes = {"range_sigma": 0.02, "min_cell_size": 0.1, "no_return": "free"}
    received = published(bag, tmp_path, 1.0, 10, grid_low=0.1, grid_high=1.5, **changes)
    m = mapped(bag, PYTHON, **changes)
    assert "10 mapped, 0 dropped" in received.log
    assert received.map == m.to_bytes()
    grid, expected = received.grid_like(m, height=(0.1, 1.5))
    assert np.array_equal(grid, expected) and np.count_nonzero(grid == 100) > 100
    for name, ending in (("octomap_full", "ot"), ("octomap_binary", "bt")):
        if name not in received.arrays.files:
            continue  # octomap_msgs is not there.
        file = tmp_path / f"map.{ending}"
        m.save_octomap(file)
        assert file.read_bytes().partition(b"\ndata\n")[2] == received.arrays[name].tobytes()


def test_cells_are_shown_in_the_colours_of_clouds(tmp_path: Path) -> None:
    make = Messages("mcap")
    clouds = [colored(make, CLOUDS_START + 0.1 * i, box_points(), big=False, name="rgb") for i in range(6)]
    bag = bag_of_clouds(tmp_path / "clouds", make, clouds)
    received = published(bag, tmp_path, 1.0, 6, colors="true", min_cell_size=0.1)
    m = ndtree.load(tmp_path / "node.ndt")
    expected = cell_points(m)
    assert m.layers == {"color": "mean3"} and len(expected) > 500
    points = received.arrays["points"]
    assert np.array_equal(points.view("<u4"), expected.view("<u4").reshape(len(expected), -1))
    colors = np.concatenate([one.colors for one in by_size(expected)])
    assert np.allclose(received.arrays["colors"], colors, atol=1e-6) and len(np.unique(colors, axis=0)) > 3


def has_octomap_services() -> bool:
    return subprocess.run([PYTHON, "-c", "import octomap_msgs.srv"], capture_output=True).returncode == 0


def octomap_of(m: Any, file: Path, **options: Any) -> bytes:
    m.save_octomap(file, **options)
    return file.read_bytes().partition(b"\ndata\n")[2]


@pytest.mark.skipif(not has_octomap_services(), reason="no services of octomap_msgs")
def test_it_has_all_of_octomap_server(robot: Robot, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "apartment", *apartment("mcap", 6))
    changes: dict[str, Any] = {"range_sigma": 0.02, "min_cell_size": 0.1, "no_return": "free"}
    changes |= {"box": "-2,-2,-0.2,3,3,2.2", "stride": 2}
    of_node = {"octomap_cell_size": 0.2, "filter_speckles": "true", "reliable": "true", "patience": 120.0}
    of_node |= {"grid_layers": "['low:0.1,0.5', 'high:1.0,1.5']", "grid_low": 0.3, "grid_high": 1.5}
    output = tmp_path / "asked.npz"
    with robot.node(**{**changes, **of_node}) as node:
        with robot.script("asker", 6, output) as asker:
            robot.publish(bag, 1.0, node)
            robot.ended(asker, "asker", node)
        robot.interrupt(node)
    m, found = mapped(bag, PYTHON, **changes), np.load(output)
    assert (m.bounds()[1] < [3.7, 3.7, 2.7]).all()  # It ends inside of a cell.
    free, occupied = m.leaves(states=["free"]), m.leaves(states=["occupied"])
    points = cell_points(m, without_speckles=True)
    assert len(found["free_cells"]) == len(free) > 100
    assert 0 < len(found["occupied_cells"]) == len(points) <= len(occupied)
    before, after, size = found["changes"][:, 4], found["changes"][:, 5], found["changes"][:, 3]
    for state, leaves in ((0, free), (1, occupied)):  # What was told of makes the map.
        volume = (size**3 * ((after == state).astype(float) - (before == state))).sum()
        assert volume == pytest.approx((leaves.size**3).sum(), rel=1e-3)
    for name, height in (("low", (0.1, 0.5)), ("high", (1.0, 1.5))):
        pixels = m.map_server_image(height=height, wall_depth=noise_depth(m))[0]
        for value, grey in ((100, 0), (0, 254)):
            assert np.count_nonzero(found[f"map_{name}"] == value) == np.count_nonzero(pixels == grey) > 0
    for name, ending in (("octomap_full", "ot"), ("octomap_binary", "bt")):
        assert found[name].tobytes() == octomap_of(m, tmp_path / f"map.{ending}", cell_size=0.2)
    ground = GroundFollower(None, (0.3, 1.5))
    ground.follow(m)
    assert ground.values is not None and np.array_equal(found["above ground"], ground.values)
    assert not np.array_equal(found["above robot"], found["above ground"])
    assert "must be one of map, robot, ground" in found["said of sky"][0] and found["said of robot"][0] == ""
    assert np.array_equal(found["above sky"], found["above robot"])
    m.clear([[-50.0] * 3, [0.0, 50.0, 50.0]])
    assert found["cleared"].tobytes() == octomap_of(m, tmp_path / "map.ot", cell_size=0.2)


#: Real bags: options of both, and how many scans they have.
REAL = {
    "ros2_scan_tf_odom_mac_take_2": ({"sweep": "reversed-end"}, 357),
    "ros1_scan_tf_turtlebot_kinect/test_turtlebot.bag": ({}, 819),
    "ros1_scan_tf_gmapping_replay_crash/test_replay_crash.bag": ({}, 136),
    "jackal_mocap/test_2026-02-17-16-26-34.bag": (
        {"poses": "/vrpn_client_node/jackal/pose", "mount": "0.013,0,-1.6deg", "time_offset": "-0.049"}, 431,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REAL)
def test_real_bags_are_mapped_as_from_a_recording(name: str, recordings: Path, tmp_path: Path) -> None:
    bag, (options, scans) = there(recordings / "bags" / name), REAL[name]
    (tmp_path / "bag").symlink_to(bag)
    options = {"range_sigma": 0.02, "no_return": "ignore", **options}
    received = published(bag, tmp_path, 2.0, scans, **options)
    link = tmp_path / f"bag{bag.suffix}"
    link.exists() or link.symlink_to(bag)
    m = mapped(link, PYTHON, **options)
    assert " 0 dropped" in received.log
    grid, expected = received.grid_like(m)
    assert np.array_equal(grid, expected)
    assert received.map == m.to_bytes()


def test_a_slams_path_moves_what_was_mapped(tmp_path: Path) -> None:
    rows = driven(30)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    late = {i: path_message(rows, true, i) for i in (15, 29)}
    bag = bag_of(tmp_path / "late", wrong, rows, late, "mcap")
    given = {"range_sigma": 0.02, "no_return": "free", "look": 0.5}
    received = published(bag, tmp_path, 1.0, 30, follow="/slam/path", **given)
    words = [word for name, value in given.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    command = ["live", str(bag), "--rate", "0", "-o", str(tmp_path / "offline.ndt"), *words]
    done = subprocess.run(
        [PYTHON, "-m", "ndtree", *command, "--follow", "/slam/path"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    (tmp_path / "node.ndt").write_bytes(received.map)
    one, other = (ndtree.load(tmp_path / name).leaves() for name in ("node.ndt", "offline.ndt"))
    for name in ("lower", "size", "log_odds", "hits", "misses"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert " correction" in received.log


def test_a_robot_is_found_in_a_saved_map(tmp_path: Path) -> None:
    rows = driven(160)[:40]
    true = [(place, turn) for _, place, turn, _, _ in rows]
    here = {"mount": (0.0, 0.0, 0.0)}
    whole = bag_of(tmp_path / "map", true, rows, {}, "mcap", **here)
    mapped(whole, PYTHON, range_sigma=0.02, no_return="free").save(tmp_path / "office.ndt")
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    bag = bag_of(tmp_path / "drive", wrong, rows, {}, "mcap", fixed_frame="odom", **here)
    x, y = true[0][0]
    given = {"localize": tmp_path / "office.ndt", "initial_pose": f"'{x + 0.1},{y},0.1'"}
    said, _, log = places_of(bag, tmp_path, **given)
    assert len(said["poses"]) > 30 and set(said["odometry"]) == {"odom"}, log
    for stamp, px, py, frame in said["poses"]:
        place = true[round((stamp - rows[0][0]) / 0.1)][0]
        assert frame == "map" and np.hypot(px - place[0], py - place[1]) < 0.1


def places_of(
    bag: Path, folder: Path, *, end: signal.Signals = signal.SIGINT, **given: object
) -> tuple[Any, int, str]:
    """Where a node says that the robot was while a bag is published, its status, and what it says."""
    robot, output = Robot(folder), folder / "places.json"
    robot.stop.unlink(missing_ok=True)
    with robot.script("places", output, robot.stop) as places:
        with robot.node(**given, look=0.5, reliable="true", queue=1000, patience=60.0) as node:
            robot.publish(bag, 2.0, node)
            if end is signal.SIGKILL:  # As soon as it has saved what was published.
                saved = Path(str(given["map_file"]))
                robot.wait(lambda: saved.exists() and time.time() - saved.stat().st_mtime > 5.0, node)
            node.send_signal(end)
            status = node.wait(PATIENCE)
        robot.end(places, "places")
    assert end is signal.SIGKILL or status == 0, robot.log()
    return json.loads(output.read_text()), status, robot.log()


def test_a_slam_that_is_killed_goes_on_where_it_is(tmp_path: Path) -> None:
    rows = driven(160)[:90]
    true = [(place, turn) for _, place, turn, _, _ in rows]
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    here = {"mount": (0.0, 0.0, 0.0), "fixed_frame": "odom"}
    first = bag_of(tmp_path / "first", wrong[:70], rows[:70], {}, "mcap", **here)
    given = {"slam": "true", "map_file": tmp_path / "office.ndt", "range_sigma": 0.02, "resume": "true"}
    said, status, log = places_of(first, tmp_path, save_period=1.0, end=signal.SIGKILL, **given)
    assert status == -signal.SIGKILL and (tmp_path / "office.scans.npz").exists(), log

    def wrong_by(said: Any) -> list[float]:
        assert set(said["odometry"]) == {"odom"} and {one[3] for one in said["poses"]} == {"map"}
        places = [true[round((one[0] - rows[0][0]) / 0.1)][0] for one in said["poses"]]
        return [float(np.hypot(*(one[1:3] - place))) for one, place in zip(said["poses"], places)]

    assert len(said["poses"]) >= 65 and max(wrong_by(said)) < 0.3, log
    # Its odometry begins anew, elsewhere.
    again = [(place + np.array([5.0, -3.0]), turn) for place, turn in wrong[40:]]
    second = bag_of(tmp_path / "second", again, rows[40:], {}, "mcap", **here)
    said, _, log = places_of(second, tmp_path, **given)
    assert len(said["poses"]) > 10 and max(wrong_by(said)) < 0.3, log
    assert "poses are doubtful: not found in the saved map yet: nothing is mapped" in log
    assert log.count("no reason to doubt the poses") >= 1, log
    m = ndtree.load(tmp_path / "office.ndt")
    right = mapped(
        bag_of(tmp_path / "right", true, rows, {}, "mcap", mount=(0.0, 0.0, 0.0)), PYTHON, range_sigma=0.02
    )
    walls = right.leaves(states=["occupied"]).center
    assert np.mean(m.state(walls) == 1) > 0.5, "in the frame of the first odometry, which is the map's"


def test_services_and_parameters(robot: Robot) -> None:
    file = robot.file
    given = {"range_sigma": 0.02, "look": 0.5, "clear_radius": 0.5, "reliable": "true", "patience": 60.0}
    with robot.node(map_file=file, **given) as node, robot.script("client", file) as client:
        robot.ended(client, "client", node)
    said = json.loads(robot.log("client").splitlines()[-1])
    assert said["state"] == "active"
    assert said["described"] == [True] * 3 and said["limits"] == [1]
    assert said["changed"] == [True, ""]
    assert said["refused"] == [False, "queue is read when the node is configured, and not while it maps"]
    assert not said["out of limits"][0] and "range" in said["out of limits"][1]
    check_services(said, file)


def test_a_node_that_is_configured_again_begins_anew(robot: Robot) -> None:
    with robot.node(range_sigma=0.02, look=0.5, reliable="true", autostart="false") as node:
        with robot.script("manager") as manager:
            robot.ended(manager, "manager", node)
    said = json.loads(robot.log("manager").splitlines()[-1])
    once = ["inactive", "active", "inactive", "unconfigured"]
    assert said["states"] == ["unconfigured", *once, *once]
    assert said["publishers"] == [[1, 1], [1, 1]]  # None of before, which would publish an old map.
    first, second = said["widths"]
    assert first >= 12 / 0.05 > second >= 4 / 0.05


@pytest.mark.parametrize(
    "given, said",
    [
        ({"no_return": "maybe"}, "no_return = maybe: must be one of auto, free, ignore"),
        ({"min_cell_size": -1.0}, "min_cell_size = -1"),
        ({"queue": 0}, "queue"),
        ({"slam": "true", "window": 3.0}, "window: not with slam"),
        ({"localize": "a.ndt", "fade": 3.0}, "fade: not with localize, which makes no map"),
    ],
    ids=str,
)
def test_wrong_parameters_are_refused(robot: Robot, given: dict[str, Any], said: str) -> None:
    with robot.node("wrong", **given) as node:
        assert node.wait(PATIENCE) != 0
    assert said in robot.log("wrong")


def test_without_ros_the_command_says_what_to_install(tmp_path: Path) -> None:
    code = "import sys; sys.modules['rclpy'] = None\n"
    code += "from ndtree.live.ros.run import main; sys.exit(main('ros2', []))"
    done = subprocess.run([PYTHON, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2 and "pip install 'rosbags>=" in done.stderr and " ros-rclpy " in done.stderr


#: Of nodes that save while they map.
SAVES = {"range_sigma": 0.02, "no_return": "free", "reliable": "true", "queue": 5000, "patience": 120.0}
SAVES |= {"save_period": 0.2, "grid_stays": 0.0}


def has_saved(file: Path) -> bool:
    return file.exists() and file.stat().st_size > len(ndtree.AdaptiveMap(dim=2).to_bytes()) + 100


def check_grid(robot: Robot, output: Path, m: Any) -> None:
    received = Received(robot.file.read_bytes(), np.load(output), {}, robot.log())
    grid, expected = received.grid_like(m)
    assert np.array_equal(grid, expected) and np.count_nonzero(grid == 100) > 500


def test_a_subscriber_that_hangs_holds_up_neither_the_map_nor_others(robot: Robot, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "office", *office("mcap", 120))
    output = tmp_path / "out.npz"
    with ExitStack() as stack:
        words = tmp_path / "hung.npz", robot.stop
        hung = stack.enter_context(robot.script("receiver", *words, as_name="hung"))
        receiver = stack.enter_context(robot.script("receiver", output, robot.stop))
        node = stack.enter_context(robot.node(map_file=robot.file, **SAVES))
        with robot.script("publisher", bag, 2.0, 1) as publisher:
            robot.wait(lambda: has_saved(robot.file), node)
            hung.send_signal(signal.SIGSTOP)
            stack.callback(hung.send_signal, signal.SIGCONT)
            robot.ended(publisher, "publisher", node)
        robot.interrupt(node)
        robot.end(receiver)
    assert "120 scans received: 120 mapped, 0 dropped" in robot.log(), robot.log()
    m = mapped(bag, PYTHON, range_sigma=0.02, no_return="free")
    assert robot.file.read_bytes() == m.to_bytes()
    check_grid(robot, output, m)


def test_a_node_that_is_killed_goes_on_from_its_last_saving(robot: Robot, tmp_path: Path) -> None:
    """Killed while scans come, the file is whole: the map of the first scans. A second node goes on with it,
    and a listener that saw both has the grid of the second."""
    make, content = office("mcap", 120)
    edge = START + 0.1 * 60 - 0.05
    bags = [
        write_bag(tmp_path / f"part{part}", make, [row for row in content if row[1] < START or place(row[1])])
        for part, place in enumerate((lambda at: at < edge, lambda at: at > edge))
    ]
    output, given = tmp_path / "out.npz", {**SAVES, "map_file": robot.file, "resume": "true"}
    with robot.script("receiver", output, robot.stop) as receiver:
        with robot.node("node1", **given) as node:
            with robot.script("publisher", bags[0], 1.0, 1, as_name="publisher1"):
                robot.wait(lambda: has_saved(robot.file), node)
                node.kill()
                assert node.wait(PATIENCE) == -signal.SIGKILL
        saved = robot.file.read_bytes()
        with robot.node("node2", **given) as node:
            robot.publish(bags[1], 2.0, node)
            robot.interrupt(node)
        robot.end(receiver)
    assert "60 scans received: 60 mapped, 0 dropped" in robot.log(), robot.log()
    m = ndtree.AdaptiveMap(dim=2, range_sigma=0.02)
    for scan in ndtree.read(bags[0]):
        scan.insert_into(m)
        if m.to_bytes() == saved:
            break
    assert m.to_bytes() == saved
    for scan in ndtree.read(bags[1]):
        scan.insert_into(m)
    assert robot.file.read_bytes() == m.to_bytes()
    check_grid(robot, output, m)


def test_of_a_burst_it_is_counted_what_was_lost(robot: Robot, tmp_path: Path) -> None:
    """More scans at once than wait to be taken, best effort as sensors are."""
    bag = write_bag(tmp_path / "office", *office("mcap", 200))
    with robot.node(patience=120.0, queue=5000, map_file=robot.file) as node:
        robot.publish(bag, 1e6, node)
        robot.interrupt(node)
    log = robot.log()
    counts = re.search(r"(\d+) scans received.*, (\d+) lost by the middleware", log)
    assert counts is not None and int(counts[1]) + int(counts[2]) == 200, log


def test_a_clock_that_never_begins_is_said(robot: Robot) -> None:
    with robot.node(use_sim_time="true") as node:
        robot.wait(lambda: "nothing comes on /clock" in robot.log(), node)
        robot.interrupt(node)
    assert robot.log().count("/clock") == 1


def test_what_is_missing_is_said_with_parameters(robot: Robot, tmp_path: Path) -> None:
    """A laser of whose place nothing is known."""
    make: Messages = Messages("mcap")
    content = [("/scan", START + 0.1 * i, make.laser(START + 0.1 * i, "laser", [2.0] * 9)) for i in range(60)]
    bag = write_bag(tmp_path / "alone", make, content)
    with robot.node() as node:
        robot.publish(bag, 1, node)
        robot.wait(lambda: "no transform to laser" in robot.log(), node)
        node.send_signal(signal.SIGINT)
        node.wait(PATIENCE)
    log = robot.log()
    assert "still, if the sensor does not move" in log and "--still" not in log and "--trajectory" not in log
