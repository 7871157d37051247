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
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import Messages, write_bag
from drives import START
from robots import PATIENCE, apartment, grid_like, in_background, mapped, office
from slams import bag_of, drifted, path_message
from slams import office as driven
from test_rosbag_clouds import START as CLOUDS_START
from test_rosbag_clouds import bag as bag_of_clouds
from test_rosbag_clouds import box_points, colored

import ndtree
from ndtree.live.grid import GroundFollower
from ndtree.live.outputs import by_size, cell_points

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


def running(folder: Path, name: str, *command: object) -> AbstractContextManager[subprocess.Popen[bytes]]:
    environment = {
        **os.environ,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": DOMAIN,
        "PYTHONUNBUFFERED": "1",
        "FASTDDS_DEFAULT_PROFILES_FILE": str(PROCESSES / "patient.xml"),
    }
    return in_background([PYTHON, *map(str, command)], environment, folder / f"{name}.log")


def ended(process: subprocess.Popen[bytes], node: subprocess.Popen[bytes], log: Callable[[], str]) -> None:
    """Wait for the end of a process, as long as the node runs."""
    deadline = time.monotonic() + PATIENCE
    while process.poll() is None:
        assert node.poll() is None, log()
        assert time.monotonic() < deadline, log()
        time.sleep(0.05)


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
    stop, output, target = folder / "stop", folder / "out.npz", folder / "node.ndt"
    given = {"grid_stays": 0.0, **parameters, "reliable": "true", "queue": 5000, "patience": 120.0}
    words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
    ros = ["--ros-args", "-p", f"map_file:={target}", *words]

    def log() -> str:
        return (folder / "node.log").read_text(errors="replace")

    with ExitStack() as stack:
        receiver = stack.enter_context(running(folder, "receiver", PROCESSES / "receiver.py", output, stop))
        node = stack.enter_context(running(folder, "node", "-m", "ndtree.live.ros2", *ros))
        with running(folder, "publisher", PROCESSES / "publisher.py", bag, rate, 1) as publisher:
            ended(publisher, node, log)
        assert publisher.returncode == 0, (folder / "publisher.log").read_text()
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE) == 0, log()
        stop.touch()
        assert receiver.wait(PATIENCE) == 0, (folder / "receiver.log").read_text()
    text = log()
    assert f"{scans} scans received: " in text, text
    arrays = np.load(output)
    return Received(target.read_bytes(), arrays, json.loads(str(arrays["text"])), text)


def test_the_office_is_mapped_as_from_a_recording(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "office", *office("mcap", 120))
    received = published(bag, tmp_path, 2.0, 120, range_sigma=0.02, no_return="free")
    m = mapped(bag, PYTHON, range_sigma=0.02, no_return="free")
    assert "120 mapped, 0 dropped" in received.log
    assert received.map == m.to_bytes()
    grid, expected = received.grid_like(m)
    assert np.array_equal(grid, expected) and np.count_nonzero(grid == 100) > 500
    counts = received.text["counts"]
    assert 0 < counts["map_updates"] and 0 < counts["map"] < 40  # Fewer on a busy machine.
    occupied = m.leaves(states=["occupied"])
    order = np.lexsort(occupied.center.T)
    points = received.arrays["points"]
    assert np.allclose(points[np.lexsort(points[:, :2].T), :2], occupied.center[order], atol=1e-5)
    assert np.allclose(np.sort(points[:, 3]), np.sort(occupied.size))
    boxes = received.arrays["boxes"]
    assert len(boxes) == len(occupied)
    assert np.allclose(np.sort(boxes[:, 3]), np.sort(occupied.size))
    frontiers = np.array([one.goal for one in m.frontiers()])
    found = received.arrays["frontiers"]  # Of those of one size the order may be another one.
    assert np.allclose(*(rows[np.lexsort(np.round(rows, 6).T)] for rows in (found, frontiers)), atol=1e-6)
    assert received.text["diagnostics"]["mapped"] == "120" and received.text["frame"] == "map"


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
def test_it_has_all_of_octomap_server(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "apartment", *apartment("mcap", 6))
    changes: dict[str, Any] = {"range_sigma": 0.02, "min_cell_size": 0.1, "no_return": "free"}
    changes |= {"box": "-2,-2,-0.2,3,3,2.2", "stride": 2}
    of_node = {"octomap_cell_size": 0.2, "filter_speckles": "true", "reliable": "true", "patience": 120.0}
    of_node |= {"grid_layers": "['low:0.1,0.5', 'high:1.0,1.5']", "grid_low": 0.3, "grid_high": 1.5}
    words = [word for name, value in {**changes, **of_node}.items() for word in ("-p", f"{name}:={value}")]
    output = tmp_path / "asked.npz"

    def log() -> str:
        return (tmp_path / "node.log").read_text(errors="replace")

    with ExitStack() as stack:
        node = stack.enter_context(running(tmp_path, "node", "-m", "ndtree.live.ros2", "--ros-args", *words))
        asker = stack.enter_context(running(tmp_path, "asker", PROCESSES / "asker.py", 6, output))
        with running(tmp_path, "publisher", PROCESSES / "publisher.py", bag, 1.0, 1) as publisher:
            ended(publisher, node, log)
        ended(asker, node, log)
        assert asker.returncode == 0, (tmp_path / "asker.log").read_text() + log()
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE) == 0, log()
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
        pixels = m.map_server_image(height=height)[0]
        for value, grey in ((100, 0), (0, 254)):
            assert np.count_nonzero(found[f"map_{name}"] == value) == np.count_nonzero(pixels == grey) > 0
    for name, ending in (("octomap_full", "ot"), ("octomap_binary", "bt")):
        assert found[name].tobytes() == octomap_of(m, tmp_path / f"map.{ending}", cell_size=0.2)
    ground = GroundFollower(None, (0.3, 1.5))
    ground.follow(m)
    assert ground.values is not None and np.array_equal(found["above ground"], ground.values)
    assert not np.array_equal(found["above robot"], found["above ground"])
    assert "must be map, robot or ground" in found["said of sky"][0] and found["said of robot"][0] == ""
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
    bag, (options, scans) = recordings / "bags" / name, REAL[name]
    if not bag.exists():
        pytest.skip(f"no such bag: {bag}")
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
    assert "corrections" in received.log


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
    bag: Path, folder: Path, rate: float = 2.0, *, end: signal.Signals = signal.SIGINT, **given: object
) -> tuple[Any, int, str]:
    """Where a node says that the robot was while a bag is published, its status, and what it says."""
    given |= {"look": 0.5, "reliable": "true", "queue": 1000, "patience": 60.0}
    words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
    stop, output = folder / "stop", folder / "places.json"
    stop.unlink(missing_ok=True)

    def log() -> str:
        return (folder / "node.log").read_text(errors="replace")

    with ExitStack() as stack:
        places = stack.enter_context(running(folder, "places", PROCESSES / "places.py", output, stop))
        node = stack.enter_context(running(folder, "node", "-m", "ndtree.live.ros2", "--ros-args", *words))
        with running(folder, "publisher", PROCESSES / "publisher.py", bag, rate, 1) as publisher:
            ended(publisher, node, log)
        assert publisher.returncode == 0, (folder / "publisher.log").read_text()
        if end is signal.SIGKILL:  # As soon as it has saved what was published.
            time.sleep(4.0)
        node.send_signal(end)
        status = node.wait(PATIENCE)
        stop.touch()
        assert places.wait(PATIENCE) == 0, (folder / "places.log").read_text()
    assert end is signal.SIGKILL or status == 0, log()
    return json.loads(output.read_text()), status, log()


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
    assert "poses are doubtful; not found in the saved map yet: nothing is mapped" in log
    assert log.count("poses are sure") >= 1, log
    m = ndtree.load(tmp_path / "office.ndt")
    right = mapped(
        bag_of(tmp_path / "right", true, rows, {}, "mcap", mount=(0.0, 0.0, 0.0)), PYTHON, range_sigma=0.02
    )
    walls = right.leaves(states=["occupied"]).center
    assert np.mean(m.state(walls) == 1) > 0.5, "in the frame of the first odometry, which is the map's"


def test_services_and_parameters(tmp_path: Path) -> None:
    file = tmp_path / "map.ndt"
    given = {"map_file": file, "range_sigma": 0.02, "look": 0.5, "clear_radius": 0.5}
    given |= {"reliable": "true", "patience": 60.0}
    words = [w for k, v in given.items() for w in ("-p", f"{k}:={v}")]
    with running(tmp_path, "node", "-m", "ndtree.live.ros2", "--ros-args", *words) as node:
        with running(tmp_path, "client", PROCESSES / "client.py", file) as client:
            ended(client, node, (tmp_path / "node.log").read_text)
        assert client.returncode == 0, (tmp_path / "client.log").read_text()
    said = json.loads((tmp_path / "client.log").read_text().splitlines()[-1])
    assert said["state"] == "active" and "no map yet" in said["early save"]
    assert said["described"] == [True] * 3 and said["limits"] == [1]
    assert said["changed"] == [True, ""]
    assert said["refused"] == [False, "queue is read when the node is configured, and not while it maps"]
    assert not said["out of limits"][0] and "range" in said["out of limits"][1]
    assert said["save"] == [True, str(file)] and said["cleared"]
    assert 300 < said["known"] - said["known around"] < 500  # 1 m square of pixels of 5 cm.
    assert said["known without a box"] < said["known around"]
    assert said["plans"] == [["odom", 0.8, 2.0], ["odom"]]
    assert said["known after reset"] == 0
    assert said["load"] == [0, 1, 2]
    assert said["known after load"] == said["known"]


def test_a_node_that_is_configured_again_begins_anew(tmp_path: Path) -> None:
    given = {"range_sigma": 0.02, "look": 0.5, "reliable": "true", "autostart": "false"}
    words = [w for k, v in given.items() for w in ("-p", f"{k}:={v}")]
    with running(tmp_path, "node", "-m", "ndtree.live.ros2", "--ros-args", *words) as node:
        with running(tmp_path, "manager", PROCESSES / "manager.py") as manager:
            ended(manager, node, (tmp_path / "node.log").read_text)
        assert manager.returncode == 0, (tmp_path / "manager.log").read_text()
    said = json.loads((tmp_path / "manager.log").read_text().splitlines()[-1])
    once = ["inactive", "active", "inactive", "unconfigured"]
    assert said["states"] == ["unconfigured", *once, *once]
    assert said["publishers"] == [[1, 1], [1, 1]]  # None of before, which would publish an old map.
    first, second = said["widths"]
    assert first >= 12 / 0.05 > second >= 4 / 0.05


def test_wrong_parameters_are_refused(tmp_path: Path) -> None:
    for number, (word, said) in enumerate(
        {
            "no_return:=maybe": "no_return maybe: must be auto, free or ignore",
            "min_cell_size:=-1.0": "min_cell_size -1",
            "queue:=0": "queue",
        }.items()
    ):
        with running(tmp_path, f"wrong{number}", "-m", "ndtree.live.ros2", "--ros-args", "-p", word) as node:
            assert node.wait(PATIENCE) != 0
        assert said in (tmp_path / f"wrong{number}.log").read_text()


def test_without_ros_the_command_says_what_to_install(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['rclpy'] = None; from ndtree.live.ros2.run import main; sys.exit(main([]))"
    )
    done = subprocess.run([PYTHON, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2 and "pip install 'ndtree-mapping[ros2]'" in done.stderr


def wait_until(happens: Callable[[], bool], node: subprocess.Popen[bytes], log: Callable[[], str]) -> None:
    """As long as the node runs."""
    deadline = time.monotonic() + PATIENCE
    while not happens():
        assert node.poll() is None and time.monotonic() < deadline, log()
        time.sleep(0.02)


def test_a_subscriber_that_hangs_holds_up_neither_the_map_nor_others(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "office", *office("mcap", 120))
    file, stop, output = tmp_path / "map.ndt", tmp_path / "stop", tmp_path / "out.npz"
    given = {"range_sigma": 0.02, "no_return": "free", "reliable": "true", "queue": 5000, "patience": 120.0}
    given |= {"map_file": file, "save_period": 0.2, "grid_stays": 0.0}
    words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
    empty = len(ndtree.AdaptiveMap(dim=2).to_bytes()) + 100

    def log() -> str:
        return (tmp_path / "node.log").read_text(errors="replace")

    with ExitStack() as stack:
        target = tmp_path / "hung.npz"
        hung = stack.enter_context(running(tmp_path, "hung", PROCESSES / "receiver.py", target, stop))
        receiver = stack.enter_context(running(tmp_path, "receiver", PROCESSES / "receiver.py", output, stop))
        command = ["-m", "ndtree.live.ros2", "--ros-args", *words]
        node = stack.enter_context(running(tmp_path, "node", *command))
        with running(tmp_path, "publisher", PROCESSES / "publisher.py", bag, 2.0, 1) as publisher:
            wait_until(lambda: file.exists() and file.stat().st_size > empty, node, log)
            hung.send_signal(signal.SIGSTOP)
            stack.callback(hung.send_signal, signal.SIGCONT)
            ended(publisher, node, log)
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE) == 0, log()
        stop.touch()
        assert receiver.wait(PATIENCE) == 0, (tmp_path / "receiver.log").read_text()
    assert "120 scans received: 120 mapped, 0 dropped" in log(), log()
    m = mapped(bag, PYTHON, range_sigma=0.02, no_return="free")
    assert file.read_bytes() == m.to_bytes()
    received = Received(file.read_bytes(), np.load(output), {}, log())
    grid, expected = received.grid_like(m)
    assert np.array_equal(grid, expected) and np.count_nonzero(grid == 100) > 500


def test_a_node_that_is_killed_goes_on_from_its_last_saving(tmp_path: Path) -> None:
    """Killed while scans come, the file is whole: the map of the first scans. A second node goes on with it,
    and a listener that saw both has the grid of the second."""
    make, content = office("mcap", 120)
    edge = START + 0.1 * 60 - 0.05
    bags = [
        write_bag(tmp_path / f"part{part}", make, [row for row in content if row[1] < START or place(row[1])])
        for part, place in enumerate((lambda at: at < edge, lambda at: at > edge))
    ]
    file, stop, output = tmp_path / "map.ndt", tmp_path / "stop", tmp_path / "out.npz"
    given = {"range_sigma": 0.02, "no_return": "free", "reliable": "true", "queue": 5000, "patience": 120.0}
    given |= {"map_file": file, "resume": "true", "save_period": 0.2, "grid_stays": 0.0}
    words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
    command = ["-m", "ndtree.live.ros2", "--ros-args", *words]
    empty = len(ndtree.AdaptiveMap(dim=2).to_bytes()) + 100

    def log() -> str:
        return "".join(one.read_text(errors="replace") for one in tmp_path.glob("node*.log"))

    with running(tmp_path, "receiver", PROCESSES / "receiver.py", output, stop) as receiver:
        with running(tmp_path, "node1", *command) as node:
            with running(tmp_path, "publisher1", PROCESSES / "publisher.py", bags[0], 1.0, 1):
                wait_until(lambda: file.exists() and file.stat().st_size > empty, node, log)
                node.kill()
                assert node.wait(PATIENCE) == -signal.SIGKILL
        saved = file.read_bytes()
        with running(tmp_path, "node2", *command) as node:
            with running(tmp_path, "publisher2", PROCESSES / "publisher.py", bags[1], 2.0, 1) as publisher:
                ended(publisher, node, log)
            node.send_signal(signal.SIGINT)
            assert node.wait(PATIENCE) == 0, log()
        stop.touch()
        assert receiver.wait(PATIENCE) == 0, (tmp_path / "receiver.log").read_text()
    assert "60 scans received: 60 mapped, 0 dropped" in log(), log()
    m = ndtree.AdaptiveMap(dim=2, range_sigma=0.02)
    for scan in ndtree.read(bags[0]):
        scan.insert_into(m)
        if m.to_bytes() == saved:
            break
    assert m.to_bytes() == saved
    for scan in ndtree.read(bags[1]):
        scan.insert_into(m)
    assert file.read_bytes() == m.to_bytes()
    received = Received(file.read_bytes(), np.load(output), {}, log())
    grid, expected = received.grid_like(m)
    assert np.array_equal(grid, expected) and np.count_nonzero(grid == 100) > 500


def test_of_a_burst_it_is_counted_what_was_lost(tmp_path: Path) -> None:
    """More scans at once than wait to be taken, best effort as sensors are."""
    bag, target = write_bag(tmp_path / "office", *office("mcap", 200)), tmp_path / "node.ndt"

    def log() -> str:
        return (tmp_path / "node.log").read_text(errors="replace")

    words = ["-p", "patience:=120.0", "-p", "queue:=5000", "-p", f"map_file:={target}"]
    with running(tmp_path, "node", "-m", "ndtree.live.ros2", "--ros-args", *words) as node:
        with running(tmp_path, "publisher", PROCESSES / "publisher.py", bag, 1e6, 1) as publisher:
            ended(publisher, node, log)
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE) == 0, log()
    counts = re.search(r"(\d+) scans received.*, (\d+) lost by the middleware", log())
    assert counts is not None and int(counts[1]) + int(counts[2]) == 200, log()


def test_a_clock_that_never_begins_is_said(tmp_path: Path) -> None:
    def log() -> str:
        return (tmp_path / "node.log").read_text(errors="replace")

    words = ["--ros-args", "-p", "use_sim_time:=true"]
    with running(tmp_path, "node", "-m", "ndtree.live.ros2", *words) as node:
        wait_until(lambda: "nothing comes on /clock" in log(), node, log)
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE) == 0, log()
    assert log().count("/clock") == 1


def test_what_is_missing_is_said_with_parameters(tmp_path: Path) -> None:
    """A laser of whose place nothing is known."""
    make: Messages = Messages("mcap")
    content = [("/scan", START + 0.1 * i, make.laser(START + 0.1 * i, "laser", [2.0] * 9)) for i in range(60)]
    bag = write_bag(tmp_path / "alone", make, content)

    def log() -> str:
        return (tmp_path / "node.log").read_text(errors="replace")

    with running(tmp_path, "node", "-m", "ndtree.live.ros2") as node:
        with running(tmp_path, "publisher", PROCESSES / "publisher.py", bag, 1, 1) as publisher:
            ended(publisher, node, log)
        wait_until(lambda: "no transform to laser" in log(), node, log)
        node.send_signal(signal.SIGINT)
        node.wait(PATIENCE)
    assert (
        "still, if the sensor does not move" in log()
        and "--still" not in log()
        and "--trajectory" not in log()
    )
