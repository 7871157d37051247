# SPDX-License-Identifier: BSD-3-Clause
"""A bag that ROS 1 itself records of a robot that drives, read back.

Where ROS is not installed the test is skipped. Debian has it:
``apt-get install --no-install-recommends python3-rosbag python3-rospy python3-rosmaster python3-tf2-msgs``
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

import ndtree

SYSTEM_PYTHON = "/usr/bin/python3"
NEEDED = "rospy, rosbag, sensor_msgs.msg, tf2_msgs.msg"
#: Of the robot, which measures every second one; scans that both bags have at least.
STEPS, ENOUGH = 160, 20
ROOM = (-4.0, -3.0, 4.0, 3.0)


def has_ros() -> bool:
    if not (shutil.which("rosmaster") and shutil.which("rosbag") and os.path.exists(SYSTEM_PYTHON)):
        return False
    return subprocess.run([SYSTEM_PYTHON, "-c", f"import {NEEDED}"], capture_output=True).returncode == 0


pytestmark = pytest.mark.skipif(
    not has_ros(), reason="no ROS 1: see the head of the file for what to install"
)


#: So long something is waited for before it counts as broken [s]: machines of tests are busy.
PATIENCE = 120.0


def wait_for(condition: Callable[[], bool], what: str) -> None:
    """Until something holds, however long a busy machine takes."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f"waited {PATIENCE:g} s in vain for {what}"
        time.sleep(0.02)


@contextmanager
def running(command: list[Any], environment: dict[str, str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A program that is asked to end when it is no longer needed."""
    with open(log, "wb") as file:
        process = subprocess.Popen(
            [str(one) for one in command], env=environment, stdin=subprocess.PIPE, stdout=file, stderr=file,
            start_new_session=True,
        )  # fmt: skip
        try:
            yield process
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
            try:
                process.communicate(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def answers(port: int) -> bool:
    """Whether somebody listens."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def has_scans(bag: Path, copy: Path) -> bool:
    """Whether enough has been written of a bag that is still open; of it as it is a copy is made."""
    shutil.copy(bag, copy)
    try:
        log = ndtree.read(copy)
        return sum(1 for _ in log) > ENOUGH
    except ValueError:  # Not even one chunk.
        return False


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two bags of the same drive: one that was closed, and the file while it was still being written."""
    folder = tmp_path_factory.mktemp("ros1")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL"))},
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_HOME": str(folder),
        "ROS_PACKAGE_PATH": "/usr/share", "ROS_ROOT": "/usr/share/ros",
    }  # fmt: skip
    bag, active = folder / "drive.bag", folder / "drive.bag.active"
    unclosed = folder / "unclosed.bag.active"
    driven = folder / "robot.log"
    with running(["rosmaster", "--core", "-p", port], environment, folder / "master.log"):
        wait_for(lambda: answers(port), "the master")
        record = ["rosbag", "record", "--chunksize", "16", "-O", bag, "/tf", "/tf_static", "/scan"]
        with running(record, environment, folder / "record.log"):
            robot = [SYSTEM_PYTHON, Path(__file__).parent / "ros1" / "robot.py", STEPS]
            with running(robot, environment, driven) as process:
                wait_for(lambda: b"driven" in driven.read_bytes() or process.poll() is not None, "the robot")
                assert process.poll() is None, driven.read_text()
                wait_for(lambda: has_scans(active, unclosed), "scans in the bag")
        # `rosbag` ends at once when it is interrupted; the recorder that it has started closes the bag later.
        wait_for(bag.is_file, "the bag to be closed")
    return {"closed": bag, "unclosed": unclosed}


@pytest.mark.parametrize("which", ["closed", "unclosed"])
def test_a_bag_of_ros_itself_has_its_walls_where_the_room_has_them(bags: dict[str, Path], which: str) -> None:
    log = ndtree.read(bags[which])
    assert log.dim == 2 and log.uses == "/scan (LaserScan in laser), poses in odom from /tf"
    scans = list(log)
    assert len(scans) > (50 if which == "closed" else ENOUGH)
    for scan in scans:
        x, y = scan.endpoints.T
        off = np.minimum(
            np.minimum(abs(x - ROOM[0]), abs(x - ROOM[2])), np.minimum(abs(y - ROOM[1]), abs(y - ROOM[3]))
        )
        assert off.max() < 0.01  # The poses between transforms are those of a straight line.
        inside = (x > ROOM[0] - 0.01) & (x < ROOM[2] + 0.01) & (y > ROOM[1] - 0.01) & (y < ROOM[3] + 0.01)
        assert inside.all()
    summary = log.skipped["scans without a pose"].summary
    assert summary is not None and "scans had no pose: the poses begin 0." in summary
    assert any("never closed" in note for note in log.notes) == (which == "unclosed")
    m = ndtree.AdaptiveMap(dim=2, range_sigma=0.01)
    for scan in scans:
        scan.insert_into(m)
    # Shortly before a wall it is free, and at the wall occupied.
    walls = np.array([[2.0, ROOM[1]], [ROOM[2], 0.0], [1.0, ROOM[3]]])
    inwards = np.array([[0.0, 0.3], [-0.3, 0.0], [0.0, -0.3]])
    assert m.occupied_within(walls, 0.05).all()
    assert (m.state(walls + inwards) == 0).all()


@pytest.mark.parametrize("packing", ["--bz2", "--lz4"])
def test_what_ros_itself_packs_is_the_same(bags: dict[str, Path], packing: str, tmp_path: Path) -> None:
    path = tmp_path / "packed.bag"
    shutil.copy(bags["closed"], path)
    subprocess.run(["rosbag", "compress", packing, "-q", str(path)], check=True, capture_output=True)
    assert path.read_bytes() != bags["closed"].read_bytes()
    packed, plain = (list(ndtree.read(one)) for one in (path, bags["closed"]))
    assert len(packed) == len(plain) > 50
    for one, other in zip(packed, plain):
        np.testing.assert_array_equal(one.endpoints, other.endpoints)


def test_an_unclosed_bag_has_what_ros_finds_when_it_mends_it(bags: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "mended.bag"
    shutil.copy(bags["unclosed"], path)
    subprocess.run(["rosbag", "reindex", "-q", str(path)], check=True, capture_output=True)
    mended, as_it_is = (list(ndtree.read(one)) for one in (path, bags["unclosed"]))
    assert len(mended) == len(as_it_is) > ENOUGH
