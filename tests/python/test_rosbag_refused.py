# SPDX-License-Identifier: BSD-3-Clause
"""Bags that say too little, contradict themselves, or are damaged: what is left out, and what is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import LEVEL, START, Messages, changed, write_bag
from drives import SCAN_TIMES, Drive, standing
from rosbags.typesys import get_types_from_msg

from ndtree.logs import read


@pytest.mark.parametrize("when", [-1.0, 9.0])
def test_a_scan_outside_of_the_transforms_is_left_out_or_named(
    make: Messages, when: float, tmp_path: Path
) -> None:
    drive = Drive(planar=True)
    stamps = sorted([START + when, *SCAN_TIMES])
    content = drive.transforms(make) + [("/scan", t, make.laser(t, "sensor", [1, 2, 3])) for t in stamps]
    path = write_bag(tmp_path / "bag", make, sorted(content, key=lambda one: one[1]))
    log = read(path)
    assert len(list(log)) == 5
    (left_out,) = log.skipped.values()
    assert list(log.skipped) == ["scans without a pose"] and left_out.count == 1
    how = "begin 1.00 s later" if when < 0 else "end 6.60 s earlier"
    assert left_out.summary == f"1 of 6 scans had no pose: the poses {how}"
    message = (
        rf"{path}: /scan: message {0 if when < 0 else 5}: transform from \w+ to \w+: no pose at "
        rf"{START + when:.6f} s, expected a time from {START:.6f} to [\d.]+ s"
    )
    with pytest.raises(ValueError, match=message):
        list(read(path, strict=True))


def test_a_log_without_any_pose_is_an_error(ros2: Messages, tmp_path: Path) -> None:
    content = Drive(planar=True).transforms(ros2)
    content += [("/scan", START, ros2.laser(START + 90 + t, "sensor", [1, 2, 3])) for t in range(3)]
    log = read(write_bag(tmp_path / "bag", ros2, content))
    with pytest.raises(ValueError, match=r"3 of 3 scans had no pose: the poses end 8\d.60 s earlier"):
        list(log)


def test_scans_in_a_gap_of_the_transforms_are_left_out(ros2: Messages, tmp_path: Path) -> None:
    """Where the robot moved meanwhile: a robot that stood is where it was."""
    for moved in (True, False):
        content: list[tuple[str, float, Any]] = []
        for i in [*range(10), *range(40, 50)]:
            place = [0.05 * i if moved else 0.0, 0, 0]
            content.append(
                (
                    "/tf",
                    START + 0.1 * i,
                    ros2.tf(ros2.transform(START + 0.1 * i, "odom", "laser", place, LEVEL)),
                )
            )
        for i in range(50):
            content.append(("/scan", START + 0.1 * i, ros2.laser(START + 0.1 * i, "laser", [1, 2, 3])))
        path = write_bag(tmp_path / str(moved), ros2, sorted(content, key=lambda one: one[1]))
        log = read(path)
        assert len(list(log)) == (20 if moved else 50)
        summaries = [one.summary for one in log.skipped.values()]
        assert summaries == (
            ["30 of 50 scans had no pose: the poses have gaps of up to 3.10 s"] if moved else []
        )


def test_damaged_messages_are_named_or_passed_over(make: Messages, tmp_path: Path) -> None:
    good = make.laser(START, "sensor", [1, 2, 3])
    content = [make.fixed(START, "map", "sensor", [0, 0, 0])]
    content += [("/scan", START + i, good) for i in range(4)]
    content.insert(3, ("/scan", START + 1.5, ("sensor_msgs/msg/LaserScan", b"\0\1\0\0rubbish")))
    content.insert(3, ("/scan", START + 1.2, make.text("not a scan")))
    path = write_bag(tmp_path / "bag", make, content)
    with pytest.raises(
        ValueError, match=f"{path}: /scan: message 2: is of type std_msgs/msg/String, expected"
    ):
        list(read(path, topic="/scan"))
    log = read(path, keep_going=True, topic="/scan")
    assert len(list(log)) == 4
    assert log.skipped["damaged messages"].count == 2


def test_damaged_bags_are_named(make: Messages, tmp_path: Path) -> None:
    drive = Drive(planar=True)
    content = drive.transforms(make) + [("/scan", t, make.laser(t, "sensor", [1, 2])) for t in SCAN_TIMES]
    path = write_bag(tmp_path / "bag", make, content)
    file = path if path.is_file() else next(one for one in path.iterdir() if one.suffix != ".yaml")
    whole = file.read_bytes()
    scans = list(read(path))
    for kept in (0.01, 0.3, 0.9):
        file.write_bytes(whole[: int(kept * len(whole))])
        try:
            log = read(path)
            found = list(log)
        except ValueError as error:  # What is left holds nothing to map.
            assert str(error).startswith((f"{path}: ", f"{file}: ")) and "\n" not in str(error)
            assert "found none" not in str(error) or "the file is cut off" in str(error)
            continue
        assert 0 < len(found) <= len(scans) == 5
        for one, other in zip(found, scans):
            np.testing.assert_array_equal(one.endpoints, other.endpoints)
        assert any("found in it" in note for note in log.notes)
        with pytest.raises(ValueError, match="found in it"):
            list(read(path, strict=True))
    if path.is_dir():
        file.write_bytes(whole)
        for text in ("rosbag2_bagfile_information: {version: 5}", None):
            if text is None:
                (path / "metadata.yaml").unlink()
            else:
                (path / "metadata.yaml").write_text(text)
            assert len(list(read(path))) == 5
        file.unlink()
        with pytest.raises((ValueError, OSError)):
            read(path, format="rosbag")


def test_damage_in_the_middle_keeps_what_was_read(tmp_path: Path) -> None:
    make = Messages("ros1")
    content = [make.fixed(START, "map", "sensor", [0, 0, 0])]
    ranges = np.random.default_rng(1).uniform(1, 7, (100, 9000))
    content += [("/scan", START + i, make.laser(START + i, "sensor", row)) for i, row in enumerate(ranges)]
    path = write_bag(tmp_path / "bag", make, content, packed=True)
    damaged = bytearray(path.read_bytes())
    place = len(damaged) * 2 // 3
    damaged[place : place + 100] = bytes(100)
    path.write_bytes(bytes(damaged))
    with pytest.raises(ValueError, match="cannot be read as a ROS bag"):
        list(read(path))
    log = read(path, keep_going=True)
    assert 20 < len(list(log)) < 100
    assert list(log.skipped) == ["damaged bags"]


def test_what_cannot_be_chosen_is_listed(ros2: Messages, tmp_path: Path) -> None:
    fixed = ros2.tf(ros2.transform(START, "map", "sensor", [0, 0, 0], LEVEL))
    away = ros2.tf(ros2.transform(START, "earth", "laser", [0, 0, 0], LEVEL))
    scan, cloud = ros2.laser(START, "sensor", [1, 2]), ros2.cloud(START, "sensor", np.ones((2, 3)))
    unturned = ros2.tf(ros2.transform(START, "base", "sensor", [1, 0, 0], (0, 0, 0, 0)))  # Messages begin so.
    image = ros2.image(START, "sensor", np.ones((2, 2)), "16UC1")
    odometry = ros2.odometry(START, "odom", "wheel", [0, 0, 0], LEVEL)
    kitti = tmp_path / "kitti.txt"
    kitti.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    two = {"/tf_static": fixed, "/scan": scan, "/points": cloud, "/words": ros2.text("a")}
    cases: list[tuple[dict[str, Any], dict[str, Any], type[Exception], str]] = [
        ({"/words": ros2.text("a")}, {}, ValueError, r"no LaserScan, .* in it, found /words \(String\)"),
        (two, {"topic": "/nothing"}, ValueError, "no topic /nothing, expected one of /points"),
        (two, {"topic": "/words"}, ValueError, "/words is of type std_msgs/msg/String, expected"),
        (two, {"topic": "scan", "fixed_frame": "moon"}, ValueError, "no transform between sensor and moon"),
        (two, {"topic": "scan", "camera": "1,1,1,1"}, TypeError, "camera: /scan has no depth images"),
        (two, {"topic": "scan", "odometry": "/o"}, ValueError, "no Odometry in /o, expected another bag"),
        (two, {"topic": "scan", "odometry": "/o", "fixed_frame": "map"}, TypeError, "expected one of them"),
        (two, {"topic": "scan", "trajectory": str(kitti)}, ValueError, "kitti.txt: has no times"),
        ({"/scan": scan}, {}, ValueError, "no transform to sensor, the frame of /scan: there is no /tf"),
        ({"/scan": scan, "/tf_static": unturned}, {}, ValueError,
         r"of /scan \(/tf_static: at \[1.0, 0.0, 0.0\], quaternion \[0.0, 0.0, 0.0, 0.0\], expected finite"),
        ({"/scan": ros2.laser(START, "laser", [1]), "/tf_static": away}, {}, ValueError,
         "laser is connected to none of map, odom, world(?s:.*) fixed_frame FRAME, of earth, laser"),
        ({"/depth": image, "/tf_static": fixed}, {}, ValueError, "no CameraInfo of 2 x 2 pixels beside"),
        ({"/depth": image, "/tf_static": fixed}, {"camera": "1"}, ValueError, "expected fx,fy,cx,cy"),
        ({"/scan": scan, "/odom": odometry}, {"odometry": "/odom"}, ValueError,
         "no transform between sensor, the frame of /scan, and wheel, of which /odom has the poses"),
    ]  # fmt: skip
    for number, (content, options, kind, message) in enumerate(cases):
        path = write_bag(tmp_path / str(number), ros2, [(t, START, m) for t, m in content.items()])
        with pytest.raises(kind, match=message) as caught:
            read(path, **options)
        assert all(line.startswith(("  ", "the frames")) for line in str(caught.value).splitlines()[1:])
    assert len(list(read(tmp_path / "1", topic="scan"))) == 1
    alone = read(tmp_path / "1")  # A laser comes before a cloud.
    assert alone.uses.startswith("/scan (LaserScan")
    assert alone.notes == ["topic would take another sensor than /scan: /points (PointCloud2)"]


def test_lasers_whose_beams_have_no_directions(ros2: Messages, tmp_path: Path) -> None:
    for step in (0.0, np.nan):
        laser = ros2.laser(START, "sensor", [1, 2], angle_increment=step)
        with pytest.raises(ValueError, match=r"message 0: angle_increment = .* rad of 2 ranges: must be"):
            standing(ros2, "/scan", [laser], tmp_path / str(step))
    (alone,) = standing(ros2, "/scan", [ros2.laser(START, "sensor", [1], angle_increment=0.0)], tmp_path)
    assert len(alone) == 1


def test_raw_packets_are_known_for_what_they_are(tmp_path: Path) -> None:
    make = Messages("ros1")
    store = make.store
    text = "Header header\nvelodyne_msgs/VelodynePacket[] packets\n"
    for name, definition in (("Packet", "time stamp\nuint8[1206] data\n"), ("Scan", text)):
        store.register(get_types_from_msg(definition, f"velodyne_msgs/msg/Velodyne{name}"))
    message = store.types["velodyne_msgs/msg/VelodyneScan"](make.header(START, "velodyne"), [])
    path = write_bag(tmp_path / "bag", make, [("/velodyne_packets", START, message)])
    with pytest.raises(
        ValueError, match=r"found /velodyne_packets \(VelodyneScan\); /velodyne_packets has a lidar's"
    ):
        read(path)


def test_cameras_without_calibration(ros2: Messages, tmp_path: Path) -> None:
    fixed = ros2.tf(ros2.transform(START, "map", "sensor", [0, 0, 0], LEVEL))
    content = [("/tf_static", START, fixed)]
    content.append(("/depth", START, ros2.image(START, "sensor", np.ones((2, 2)), "16UC1")))
    content.append(("/camera_info", START, ros2.camera_info(START, "sensor", (2, 2), (0, 0, 0, 0))))
    with pytest.raises(ValueError, match=r"camera fx,fy,cx,cy; found /camera_info; of /camera_info: fx = 0"):
        read(write_bag(tmp_path / "bag", ros2, content))
    assert len(list(read(tmp_path / "bag", camera="1,1,1,1"))) == 1


def test_a_log_without_one_valid_beam_makes_no_map(ros2: Messages, tmp_path: Path) -> None:
    pytest.importorskip("typer")
    from calling import cli

    drive = Drive(planar=True)
    beyond = "; /scan: in 5 of 5 messages most ranges are beyond the largest"
    cases: tuple[tuple[list[float], str, str], ...] = (
        ([np.nan] * 3, "15 beams: 15 invalid", ""),
        ([], "0 beams", ""),
        ([9, 8.5], "10 beams: 10 invalid", beyond),
    )
    for ranges, said, why in cases:
        content = drive.transforms(ros2) + [("/scan", t, ros2.laser(t, "sensor", ranges)) for t in SCAN_TIMES]
        path = write_bag(tmp_path / f"bag{len(ranges)}", ros2, sorted(content, key=lambda one: one[1]))
        done = cli("map", path, "-o", tmp_path / "a.ndt")
        assert done.exit_code == 1 and not (tmp_path / "a.ndt").exists()
        text = " ".join(done.stderr.split())
        assert text.startswith(f"ndtree: {path}: nothing to map in 5 scans, {said}") and why in text


@pytest.mark.parametrize(
    "change, message",
    [
        ({"width": 90}, r"the cloud has 32 bytes, expected 1440 for 1 row of"),
        (
            {"point_step": 9},
            "field z of the cloud ends at byte 12 of a point, expected at most point_step",
        ),
        ({"fields": []}, "the cloud has no field x or y or z, expected x, y and z, found none"),
    ],
)
def test_clouds_that_contradict_themselves(
    ros2: Messages, change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    cloud = ros2.cloud(START, "sensor", np.ones((2, 3)))
    if "width" in change:
        change = {**change, "row_step": 1440}
    with pytest.raises(ValueError, match=f"/points: message 0: {message}"):
        standing(ros2, "/points", [changed(cloud, **change)], tmp_path)


def test_messages_of_which_none_can_be_read_are_named(make: Messages, tmp_path: Path) -> None:
    broken = ("sensor_msgs/msg/LaserScan", b"\x01\x02\x03")
    rows = [("/scan", START + 0.1 * i, broken) for i in range(6)]
    rows += [make.moved(START + 0.1 * i, "odom", "laser", [0.1 * i, 0, 0]) for i in range(6)]
    with pytest.raises(ValueError, match="/scan: none of its messages can be read, expected some"):
        list(read(write_bag(tmp_path / "bag", make, rows)))


def test_images_that_contradict_themselves(ros2: Messages, tmp_path: Path) -> None:
    image = changed(ros2.image(START, "sensor", np.ones((4, 5)), "16UC1"), height=40)
    with pytest.raises(ValueError, match="the image has 40 bytes, expected 400 for 40 rows of 10 bytes"):
        standing(ros2, "/depth", [image], tmp_path, camera="1,1,1,1")
