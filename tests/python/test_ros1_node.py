# SPDX-License-Identifier: BSD-3-Clause
"""The node of ROS 1 with a real master: one process publishes, one maps, one receives.

Debian has what it needs: ``apt-get install --no-install-recommends python3-rospy python3-rosmaster
python3-nav-msgs python3-map-msgs python3-tf2-msgs python3-visualization-msgs python3-diagnostic-msgs``, for
its own interpreter ($NDTREE_ROS1_PYTHON, else /usr/bin/python3), which must be of the version that ndtree is
installed for.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import socket
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import write_bag
from robots import PATIENCE, Processes, apartment, check_office, check_services, grid_like, mapped, office
from slams import bag_of, drifted, path_message
from slams import office as driven

import ndtree

PYTHON = os.environ.get("NDTREE_ROS1_PYTHON", "/usr/bin/python3")
PROCESSES = Path(__file__).with_name("ros1")


def environment() -> dict[str, str]:
    """Packages of this interpreter first, then those of the system's, which have rospy."""
    own = [
        str(Path(ndtree.__file__).parents[1]),
        sysconfig.get_path("purelib"),
        sysconfig.get_path("platlib"),
    ]
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "ROS_"))}
    return {
        **kept,
        "PYTHONPATH": os.pathsep.join([*dict.fromkeys(own), "/usr/lib/python3/dist-packages"]),
        "ROS_IP": "127.0.0.1",
    }


def has_ros() -> bool:
    if not shutil.which("rosmaster") or not os.path.exists(PYTHON):
        return False
    needed = "rospy, nav_msgs.msg, map_msgs.msg, tf2_msgs.msg, visualization_msgs.msg, diagnostic_msgs.msg"
    code = f"import {needed}, std_srvs.srv, rosbags, ndtree._native"
    return subprocess.run([PYTHON, "-c", code], capture_output=True, env=environment()).returncode == 0


pytestmark = pytest.mark.skipif(
    not has_ros(), reason="no ROS 1 for this version of Python: see the head of the file for what to install"
)


class Robot(Processes):
    """A master, and processes that know it."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = probe.getsockname()[1]
        own = {"ROS_MASTER_URI": f"http://127.0.0.1:{self._port}", "ROS_HOME": str(folder)}
        super().__init__(folder, PYTHON, {**environment(), **own})

    @contextmanager
    def master(self) -> Iterator[None]:
        words = ["/usr/bin/rosmaster", "--core", "-p", self._port]
        with self.running("master", *words, python="/usr/bin/python3") as process:
            self.wait(lambda: self._answers(), process, "master")
            yield

    def _answers(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self._port)) == 0

    def parameter(self, name: str) -> Any:
        """Of the master's parameters."""
        return self._asked("getParam", name)

    def topic(self, name: str) -> list[str]:
        """The nodes that publish a topic."""
        published = self._asked("getSystemState")[0]
        return next((nodes for topic, nodes in published if topic == name), [])

    def _asked(self, call: str, *words: str) -> Any:
        master = ServerProxy(self.environment["ROS_MASTER_URI"])
        return getattr(master, call)("/test", *words)[2]

    def node(self, name: str = "node", **parameters: object) -> Any:
        words = [f"_{key}:={value}" for key, value in parameters.items()]
        return self.running(name, "-m", "ndtree.live.ros1", *words)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    robot = Robot(tmp_path)
    with robot.master():
        yield robot


class Received:
    """What a node made of a bag that another process published, and a third one received."""

    def __init__(self, robot: Robot, bag: Path, rate: float, **parameters: object) -> None:
        output, target = robot.folder / "out.npz", robot.folder / "node.ndt"
        given = {"grid_stays": 0.0, **parameters, "queue": 5000, "patience": 120.0, "map_file": target}
        given |= {"diagnostics_period": 0.1}
        with ExitStack() as stack:
            words = PROCESSES / "receiver.py", output
            receiver = stack.enter_context(robot.running("receiver", *words))
            node = stack.enter_context(robot.node(**given))
            words = PROCESSES / "publisher.py", bag, rate
            with robot.running("publisher", *words) as publisher:
                robot.ended(publisher, "publisher", node)
            robot.interrupt(node)
            assert receiver.wait(PATIENCE) == 0, robot.log("receiver")
        self.map, self.arrays, self.log = target.read_bytes(), np.load(output), robot.log("node")
        self.text = json.loads(str(self.arrays["text"]))

    def grid_like(self, m: Any, **options: Any) -> tuple[np.ndarray, np.ndarray]:
        """See `robots.grid_like`."""
        return grid_like(self.arrays, m, **options)


@pytest.mark.parametrize("waits", [True, False])
def test_a_slow_subscriber_gets_what_was_published_before_the_end(
    waits: bool, robot: Robot, tmp_path: Path
) -> None:
    count, output = 25, tmp_path / "received"
    with robot.running("slow", PROCESSES / "slow.py", output) as slow:
        with robot.running("sender", PROCESSES / "sender.py", count, *["deliver"] * waits) as sender:
            robot.wait(lambda: sender.poll() is not None, slow, "slow")
            assert sender.returncode == 0, robot.log("sender")
        assert slow.wait(PATIENCE) == 0, robot.log("slow")
    received = int(output.read_text())
    assert received == count if waits else received < count, "what waits is lost where nobody waits for it"


def test_the_office_is_mapped_as_from_a_recording(robot: Robot, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "office", *office("ros1", 120))
    received = Received(robot, bag, 4.0, range_sigma=0.02, no_return="free")
    m = mapped(bag, range_sigma=0.02, no_return="free")
    assert "uses /scan (LaserScan in laser), poses in map from /tf" in received.log
    assert "120 scans received: 120 mapped, 0 dropped" in received.log
    check_office(received, m)


def test_clouds_become_a_map_in_space_and_a_grid_of_a_band(robot: Robot, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "apartment", *apartment("ros1", 10))
    changes = {"range_sigma": 0.02, "min_cell_size": 0.1, "no_return": "free"}
    received = Received(robot, bag, 0, grid_low=0.1, grid_high=1.5, **changes)
    m = mapped(bag, **changes)
    assert "10 scans received: 10 mapped, 0 dropped" in received.log
    assert received.map == m.to_bytes()
    grid, expected = received.grid_like(m, height=(0.1, 1.5))
    assert np.array_equal(grid, expected) and np.count_nonzero(grid == 100) > 100


def test_services_and_parameters_that_change(robot: Robot, tmp_path: Path) -> None:
    file = tmp_path / "map.ndt"
    given = {"map_file": file, "range_sigma": 0.02, "look": 0.5, "clear_radius": 0.5, "patience": 60.0}
    with robot.node(**given, diagnostics_period=0.1) as node:
        with robot.running("client", PROCESSES / "client.py", file) as client:
            robot.ended(client, "client", node)
    said = json.loads(robot.log("client").splitlines()[-1])
    check_services(said, file)
    assert said["changed"].startswith("within 0.75 m of ") and said["refused"] == said["changed"]
    assert said["warning"] == "clear_radius = -1.0: must be a number from 0 to 1,000,000; 0.75 holds"


def test_of_a_burst_it_is_counted_what_was_lost(robot: Robot) -> None:
    """More scans than their publisher keeps while the node sleeps."""
    with robot.node(still="true", queue=5000, diagnostics_period=0.1) as node:
        with robot.running("burst", PROCESSES / "burst.py", 300, node.pid) as burst:
            robot.ended(burst, "burst", node)
    received, lost = map(int, robot.log("burst").split()[-2:])
    assert received + lost == 300 and lost > 0


def test_a_slams_path_moves_what_was_mapped(robot: Robot, tmp_path: Path) -> None:
    rows = driven(30)
    true = [(place, turn) for _, place, turn, _, _ in rows]
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    late = {i: path_message(rows, true, i) for i in (15, 29)}
    bag = bag_of(tmp_path / "late.bag", wrong, rows, late, "ros1")
    given = {"range_sigma": 0.02, "no_return": "free", "look": 0.5, "topics": "[/scan]"}
    received = Received(robot, bag, 0, follow="/slam/path", **given)
    words = ["--range-sigma", "0.02", "--no-return", "free", "--look", "0.5", "--follow", "/slam/path"]
    command = ["live", bag, "--rate", "0", "-o", tmp_path / "offline.ndt", *words]
    done = subprocess.run(
        [sys.executable, "-m", "ndtree", *map(str, command)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    one, other = ndtree.load(robot.folder / "node.ndt"), ndtree.load(tmp_path / "offline.ndt")
    for name in ("lower", "size", "log_odds", "hits", "misses"):
        np.testing.assert_array_equal(getattr(one.leaves(), name), getattr(other.leaves(), name))
    assert "by 1 correction" in received.log


@pytest.mark.parametrize("how", ["localize", "slam"])
def test_where_a_robot_is_is_told(robot: Robot, tmp_path: Path, how: str) -> None:
    """In a saved map, and in one that is made meanwhile, which begins in the frame of odometry."""
    rows = driven(160)[:40]
    true = [(place, turn) for _, place, turn, _, _ in rows]
    mapped_bag = bag_of(tmp_path / "map.bag", true, rows, {}, "ros1", mount=(0, 0, 0))
    mapped(mapped_bag, range_sigma=0.02, no_return="free").save(tmp_path / "office.ndt")
    wrong = [drifted(i, *pose) for i, pose in enumerate(true)]
    bag = bag_of(tmp_path / "drive.bag", wrong, rows, {}, "ros1", fixed_frame="odom", mount=(0, 0, 0))
    x, y = true[0][0]
    place = f"{x + 0.1},{y},0.1"
    output = tmp_path / "places.json"
    saved = {"localize": tmp_path / "office.ndt", "initial_pose": place}
    given = {**(saved if how == "localize" else {"slam": True}), "look": 0.5, "queue": 1000}
    with ExitStack() as stack:
        receiver = stack.enter_context(robot.running("places", PROCESSES / "places.py", output))
        node = stack.enter_context(robot.node(**given, diagnostics_period=0.1, patience=60.0))
        with robot.running("publisher", PROCESSES / "publisher.py", bag, 5.0) as publisher:
            robot.ended(publisher, "publisher", node)
        robot.interrupt(node)
        assert receiver.wait(PATIENCE) == 0, robot.log("places")
    said = json.loads(output.read_text())
    told = len(said["odometry"])
    assert len(said["poses"]) == told and (told == 40 if how == "localize" else 30 <= told <= 40), robot.log(
        "node"
    )
    for stamp, px, py, frame in said["poses"]:
        place_i = true[round((stamp - rows[0][0]) / 0.1)][0]
        off = math.hypot(px - place_i[0], py - place_i[1])
        assert frame == "map" and off < (0.1 if how == "localize" else 0.3)
    assert {one[0] for one in said["odometry"]} == {"odom"}
    stamps = [one[1] for one in said["odometry"]]
    assert stamps == sorted(set(stamps)), "each once"
    assert np.count_nonzero(np.array(said["grid"]) == 100) > 100  # The map is published.


@pytest.mark.skipif(not shutil.which("roslaunch"), reason="no roslaunch")
def test_the_launch_file_starts_the_node(robot: Robot, tmp_path: Path) -> None:
    examples = Path(__file__).parents[2] / "examples" / "ros1"
    program = tmp_path / "ndtree_map"
    program.write_text(f'#!/bin/sh\nexec {PYTHON} -m ndtree.live.ros1 "$@"\n')
    program.chmod(0o755)
    parameters = tmp_path / "own.yaml"
    parameters.write_text("clear_radius: 0.625\n")
    robot.environment |= {
        "NDTREE_MAP": str(program),
        "ROS_PACKAGE_PATH": f"{examples}:/usr/share",
        "ROS_ROOT": "/usr/share/ros",
    }
    words = ["ndtree_map", "ndtree_map.launch", f"params:={parameters}", "map:=projected_map"]
    with robot.running("launch", "/usr/bin/roslaunch", *words, python="/usr/bin/python3") as process:
        robot.wait(lambda: "/ndtree_map" in robot.topic("/projected_map"), process, "launch")
        assert robot.parameter("/ndtree_map/clear_radius") == 0.625
        assert robot.parameter("/ndtree_map/grid_high") == 1.8  # The node's own, which it says.


@pytest.mark.parametrize(
    "word, said",
    [
        ("_no_return:=maybe", "no_return = maybe: must be one of auto, free, ignore"),
        ("_min_cell_size:=-1.0", "min_cell_size = -1"),
        ("_queue:=0", "queue = 0: must be a whole number from 1 to 100,000"),
        ("_queue:=many", "queue = many: must be a whole number"),
        ("_windows:=3", "~windows: there is no such parameter, expected one of autostart, "),
    ],
)
def test_wrong_parameters_are_refused(robot: Robot, word: str, said: str) -> None:
    with robot.running("wrong", "-m", "ndtree.live.ros1", word) as node:
        assert node.wait(PATIENCE) == 1
    assert said in robot.log("wrong")


@pytest.mark.parametrize("version, expected", [("1", True), ("2", False)])
def test_the_command_takes_the_ros_that_was_sourced(
    version: str, expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    from ndtree.live.ros.run import is_ros1

    monkeypatch.setenv("ROS_VERSION", version)
    assert is_ros1() is expected
