# SPDX-License-Identifier: BSD-3-Clause
"""Real bags that robots of others recorded map at the first try, or say what to type."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from calling import cli
from conftest import there

import ndtree


@pytest.fixture(scope="module")
def bags(recordings: Path) -> Path:
    return there(recordings / "bags")


def mapped(path: Path, target: Path, *options: str) -> tuple[str, str, int]:
    done = cli("map", path, "-o", target, *options)
    return done.stdout, done.stderr, done.exit_code


def areas(path: Path) -> tuple[float, float]:
    """Free and occupied [m2]."""
    leaves = ndtree.load(path).leaves()
    area = np.where(leaves.observed, leaves.size**2, 0)
    return float(area[leaves.state == 0].sum()), float(area[leaves.state == 1].sum())


#: Bag, options, free area [m2] at least and at most, occupied area [m2] at least, and what must be said.
MAPPED = {
    "TurtleBot 4": ("ros2_scan_tf_odom_mac_take_2", (), 60, 250, 6, "--no-return ignore"),
    "TurtleBot with Kinect": (
        "ros1_scan_tf_turtlebot_kinect/test_turtlebot.bag", (), 20, 60, 2, "11 of 819 scans had no pose",
    ),
    "standing": ("ros1_scan_tf_gmapping_replay_crash/test_replay_crash.bag", (), 30, 70, 0.8, "4 of 136"),
    "Jackal": (
        "jackal_mocap/test_2026-02-17-16-26-34.bag",
        ("--poses", "/vrpn_client_node/jackal/pose", "--mount", "0.013,0,-1.6deg", "--time-offset", "-0.049"),
        15, 60, 1.5, "--dim 2",
    ),
    "laser turned round": (
        "ros1_scan_tf_hrp_rplidar/mylaserdata3.bag", ("--mount", "0,0,180deg"), 25, 120, 1.5,
        "--no-return ignore",
    ),
    "no poses, and two sensors in one topic": (
        "ros2_scan_only_db3/mydata", ("--still",), 2, 10, 0.4, "259 of 522 messages of /scan are left out",
    ),
    "Stage": (
        "ros1_pointcloud2_embag/test.bag", ("--odometry", "/base_pose_ground_truth"), 15, 40, 0.1,
        "--no-return free",
    ),
    "lying index": ("ros1_scan_ccny_2010_badindexlen/demo.bag", ("--still",), 10, 60, 3, "360 scans"),
    "ROS 1 in MCAP": (
        "mcap_pointcloud2_pointcloudset/test.mcap", ("--still",), 0, 1e9, 1, "/os1_cloud_node/points",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MAPPED)
def test_real_bags_are_mapped(bags: Path, name: str, tmp_path: Path) -> None:
    path, options, least, most, occupied, said = MAPPED[name]
    target = tmp_path / "a.ndt"
    out, err, code = mapped(bags / path, target, *options)
    assert code == 0, err
    assert said in out + err
    found = areas(target)
    assert least < found[0] < most and found[1] > occupied, found


SAID = {
    "jackal_mocap/test_2026-02-17-16-26-34.bag": "--poses /vrpn_client_node/jackal/pose, and --mount",
    "ros1_scan_tf_hrp_rplidar/mylaserdata3.bag": "--base-frame base_link --mount X,Y,Z,ROLL,PITCH,YAW",
    "ros2_scan_only_db3/mydata": "expected one of: --trajectory FILE --still, if the sensor does not move",
    "ros1_pointcloud2_embag/array_test.bag": "found /array_test (Arrays)",
    "ros1_multiecho_cartographer/b0-2014-07-21-12-42-53-short.bag": "-o poses.txt, to find poses by",
    "mcap_pointcloud2_pointcloudset/test.mcap": "--fixed-frame FRAME, of os1_imu, os1_lidar, os1_sensor",
}


@pytest.mark.parametrize("path", SAID)
def test_what_is_missing_is_said_with_what_to_type(bags: Path, path: str, tmp_path: Path) -> None:
    out, err, code = mapped(bags / path, tmp_path / "a.ndt")
    assert code == 1 and out == "" and not (tmp_path / "a.ndt").exists()
    assert SAID[path] in " ".join(err.split()) and max(map(len, err.splitlines())) < 160


#: Bag, and whether its sensor moves.
MOVES = {
    "jackal_mocap/test_2026-02-17-16-26-34.bag": True,
    "ros1_multiecho_cartographer/b0-2014-07-21-12-42-53-short.bag": True,
    "ros1_scan_ccny_2010_badindexlen/demo.bag": True,
    "ros1_scan_tf_gmapping_replay_crash/test_replay_crash.bag": False,
    "ros2_scan_only_db3/mydata": False,
    "mcap_pointcloud2_pointcloudset/test.mcap": False,
}


@pytest.mark.parametrize("path", MOVES)
def test_a_sensor_that_does_not_stand_is_told(bags: Path, path: str) -> None:
    log = ndtree.read(bags / path, still=True)
    assert sum(1 for _ in log) > 1
    assert any("its scans show that it moves" in note for note in log.notes) == MOVES[path]


@pytest.mark.parametrize("share", [0.35, 0.8])
def test_what_is_left_of_a_real_bag_is_read(bags: Path, share: float, tmp_path: Path) -> None:
    whole = (bags / "ros1_scan_tf_turtlebot_kinect" / "test_turtlebot.bag").read_bytes()
    path = tmp_path / "cut.bag"
    path.write_bytes(whole[: int(share * len(whole))])
    log = ndtree.read(path)
    scans = sum(1 for _ in log)
    assert 0.5 * share < scans / 808 < 1.1 * share
    assert any("found in it" in note for note in log.notes)
