# SPDX-License-Identifier: BSD-3-Clause
"""Bags as drivers write them that do not keep to the letter: what they mean is read, and told."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("typer")

from bags import START, Messages, changed, write_bag

from ndtree.cli.commands.messages import in_words
from ndtree.logs import contents, read
from ndtree.logs.ros.messages.beams import pitch_of
from ndtree.logs.ros.messages.foxglove import decoded, type_of
from ndtree.logs.ros.storage import Connection, Raw

POINTS = np.random.default_rng(5).uniform(1, 9, (12, 3)).astype(np.float32)
DEPTHS = np.array([[0, 1000, 2000], [1500, 0, 500]], dtype=np.uint16)
CAMERA = (100.0, 110.0, 1.0, 0.5)


def placed(make: Messages, frame: str) -> tuple[str, float, Any]:
    return "/tf", START, make.tf(make.transform(START, "map", frame, [0, 0, 0], [0, 0, 0, 1]))


# --- Clouds -----------------------------------------------------------------------------------------


def test_a_wrong_row_step_does_not_matter_where_points_fill_the_bytes(ros2: Messages, tmp_path: Path) -> None:
    content = [placed(ros2, "lidar")]
    for height in (1, 3):
        for row_step in (0, 1, 63, 64, 65, 3 * 64, 2**31):
            cloud = changed(ros2.cloud(START, "lidar", POINTS, height=height), row_step=row_step)
            content.append(("/points", START, cloud))
    scans = list(read(write_bag(tmp_path / "bag", ros2, content), still=True))
    assert len(scans) == 14
    for scan in scans:
        np.testing.assert_array_equal(scan.endpoints, POINTS.astype(np.float64))


def test_rows_with_space_between_them_are_read_as_they_are_said() -> None:
    """All that may be said of 3 rows of 10 bytes; by hand."""
    assert [pitch_of(said, 3, 10, 30) for said in (0, 9, 10, 11, 30)] == [10] * 5
    assert [pitch_of(said, 3, 10, 34) for said in (12, 0, 9, 13)] == [12, 10, 10, 10]
    assert [pitch_of(said, 3, 10, 36) for said in (10, 11, 12, 13)] == [10, 11, 12, 13]
    assert pitch_of(12, 3, 10, 29) == 12  # Too few bytes for any: the error says what was said.


def test_empty_clouds_need_no_fields(ros2: Messages, tmp_path: Path) -> None:
    """Between others, and first: a driver's placeholders. One row may be said to be none."""
    content = [placed(ros2, "lidar")]
    for number, size in enumerate([(0, 0), None, (1, 0), None, (1, 1), (0, 12)]):
        cloud = ros2.cloud(START + 0.1 * number, "lidar", POINTS)
        if size is not None:
            cloud = changed(cloud, height=size[0], width=size[1])
        if size is not None and size[1] < 12:
            empty = {"fields": [], "point_step": 0, "row_step": 0, "data": np.zeros(0, np.uint8)}
            cloud = changed(cloud, **empty)
        content.append(("/points", START + 0.1 * number, cloud))
    log = read(write_bag(tmp_path / "bag", ros2, content), still=True)
    assert [len(scan) for scan in log] == [0, 12, 0, 12, 0, 12]


# --- Depth images -----------------------------------------------------------------------------------


def of_depths(scale: float) -> np.ndarray:
    fx, fy, cx, cy = CAMERA
    v, u = np.nonzero(DEPTHS)
    z = DEPTHS[v, u] * scale
    return np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=1)


def png(values: np.ndarray) -> bytes:
    image = pytest.importorskip("PIL.Image")
    file = io.BytesIO()
    image.fromarray(values).save(file, "PNG")
    return file.getvalue()


@pytest.mark.parametrize("said", ["Z16", "z16", "16SC1", "png", "", "16UC1; png compressed"])
def test_depths_by_whatever_name(ros2: Messages, said: str, tmp_path: Path) -> None:
    if "png" in said.lower() or not said:
        image: Any = ros2.compressed_image(said, png(DEPTHS))
    else:
        image = changed(ros2.image(START, "camera", DEPTHS, said), step=0)
    info = ros2.camera_info(START, "camera", DEPTHS.shape, CAMERA)
    content = [placed(ros2, "camera"), ("/depth/camera_info", START, info), ("/depth/image", START, image)]
    path = write_bag(tmp_path / "bag", ros2, content)
    (scan,) = read(path, still=True)
    np.testing.assert_allclose(scan.endpoints, of_depths(0.001), atol=1e-9)
    (topic,) = (one for one in contents(path)["topics"] if one["topic"] == "/depth/image")
    is_named = said in ("Z16", "z16", "16SC1", "mono16")
    assert topic["encoding"] == (said.capitalize() if said == "z16" else said if is_named else "16UC1")


def test_images_without_depths_are_named_with_their_encoding(ros2: Messages, tmp_path: Path) -> None:
    content = [
        ("/rgb", START, ros2.image(START, "camera", np.zeros((2, 6)), "rgb8")),
        ("/grey", START, ros2.compressed_image("png", png(DEPTHS.astype(np.uint8)))),
    ]
    with pytest.raises(ValueError, match=r"/grey \(CompressedImage of png\), /rgb \(Image of rgb8\).*Z16"):
        read(write_bag(tmp_path / "bag", ros2, content))


@pytest.mark.parametrize("unit, sensor", [(0.00025, 0), (0.0001, 0), (0.001, 0), (0.00025, 1), (None, 0)])
def test_depths_have_the_unit_that_a_realsense_recorded(
    ros2: Messages, unit: float | None, sensor: int, tmp_path: Path
) -> None:
    """Of the same sensor, or at least the same device."""
    depth = "/device_0/sensor_0/Depth_0"
    info = ros2.camera_info(START, "0", DEPTHS.shape, CAMERA)
    content = [
        (f"{depth}/info/camera_info", START, info),
        (f"{depth}/image/data", START, ros2.image(START, "0", DEPTHS, "mono16")),
        ("/device_1/sensor_0/option/Depth_Units/value", START, ros2.of("std_msgs/msg/Float32", data=0.5)),
    ]
    if unit is not None:
        of = ros2.of("std_msgs/msg/Float32", data=unit)
        content.append((f"/device_0/sensor_{sensor}/option/Depth_Units/value", START, of))
    log = read(write_bag(tmp_path / "bag", ros2, content), still=True)
    (scan,) = log
    np.testing.assert_allclose(scan.endpoints, of_depths(unit or 0.001), rtol=1e-6)
    assert len(log.notes) == (unit is not None) and all(f"{unit:g} m" in note for note in log.notes)
    (scan,) = read(log.path, still=True, camera=",".join(map(str, (*CAMERA, 2000))))
    np.testing.assert_allclose(scan.endpoints, of_depths(1 / 2000), rtol=1e-6)


# --- Ranges -----------------------------------------------------------------------------------------


def test_a_largest_range_that_is_none_counts_as_not_given(ros2: Messages, tmp_path: Path) -> None:
    ranges = [0.05, 1.0, 7.0, np.inf, np.nan, 0.0, 7.0]
    limits = [(0.1, 0.0), (0.1, np.nan), (0.1, 0.1), (0.2, 0.1), (0.0, -1.0)]
    lasers = [ros2.laser(START, "laser", ranges, range_min=a, range_max=b) for a, b in limits]
    content = [placed(ros2, "laser"), *(("/scan", START, laser) for laser in lasers)]
    log = read(write_bag(tmp_path / "bag", ros2, content), still=True)
    for (least, _), scan in zip(limits, log, strict=True):
        valid = [least == 0, True, True, False, False, False, True]
        assert (np.linalg.norm(scan.endpoints, axis=1) > 0).tolist() == valid
    note = next(one for one in log.notes if "5 of 5 messages the largest range" in one)
    assert "range_max = 0 m, expected more than 0.1 m" in note
    log = log.ruled(no_return_range=12.0)
    for scan in log:
        length = np.linalg.norm(scan.endpoints, axis=1)
        assert length[3] == pytest.approx(12) and not scan.returned[3] and scan.returned[[1, 2, 6]].all()


def test_ranges_that_are_mostly_beyond_the_largest_one_are_told_of(ros2: Messages, tmp_path: Path) -> None:
    metres = np.array([0.5, 1.0, 7.0, 12.0])
    some = [1000 * metres, [*1000 * metres, np.inf], [*metres, 40.0], [np.inf] * 3]
    some += [[1.0, 31.0, 34.0, 40.0], [1.0, 31.0, 31.0, 31.0]]  # The last is one value, for no echo.
    lasers = [ros2.laser(START, "laser", ranges, range_min=0.1, range_max=30.0) for ranges in some]
    content = [placed(ros2, "laser"), *(("/scan", START, laser) for laser in lasers)]
    log = read(write_bag(tmp_path / "bag", ros2, content), still=True)
    assert [int(np.count_nonzero(scan.did_return)) for scan in log] == [0, 0, 4, 0, 1, 1]
    note = next(one for one in log.notes if "beyond" in one)
    assert "in 3 of 6 messages most ranges" in note and "500.0 to 12,000.0 m, expected up to 30 m" in note


# --- Several sensors --------------------------------------------------------------------------------


def laser_and_radar(make: Messages, path: Path, *, planar: bool, laser_frame: str = "laser") -> Path:
    """For 2 s a laser at 50 Hz and a radar at 13 Hz, whose topic comes first by its name and its type."""
    generator = np.random.default_rng(1)
    way = ("base_link", "laser") if laser_frame == "laser" else ("a", "b")
    fixed = make.transform(START, *way, [0, 0, 0], [0, 0, 0, 1])
    content: list[tuple[str, float, Any]] = [("/tf_static", START, make.tf(fixed))]
    for t in np.arange(0, 2.02, 0.02):
        moved = [
            make.transform(START + t, "odom", "base_link", [t, 0, 0], [0, 0, 0, 1]),
            make.transform(START + t, "base_link", "radar", [0, 0, 0], [0, 0, 0, 1]),
        ]
        content.append(("/tf", START + t, make.tf(*moved)))
        ring = np.linspace(-2, 2, 200)
        if planar:
            scan = make.laser(START + t, laser_frame, np.full(200, 5.0), angle_min=-2, angle_increment=0.02)
        else:
            points = 5 * np.stack([np.cos(ring), np.sin(ring), np.zeros(200)], axis=1)
            scan = make.cloud(START + t, laser_frame, points.astype(np.float32))
        content.append(("/sensors/laser", START + t, scan))
    for t in np.arange(0, 2, 1 / 13):
        cloud = make.cloud(START + t, "radar", generator.uniform(3, 30, (20, 3)).astype(np.float32))
        content.append(("/radar", START + t, cloud))
    return write_bag(path, make, sorted(content, key=lambda one: one[1]))


@pytest.mark.parametrize("planar", [True, False])
def test_what_makes_a_map_is_taken(ros2: Messages, planar: bool, tmp_path: Path) -> None:
    log = read(laser_and_radar(ros2, tmp_path / "bag", planar=planar))
    assert "/sensors/laser" in log.uses and "/radar" not in log.uses
    assert any("/radar (PointCloud2)" in note for note in log.notes)
    (scan, *_) = read(log.path, topic="/radar")
    assert len(scan) == 20


@pytest.mark.parametrize("planar", [True, False])
def test_a_radar_does_not_stand_in_for_a_laser_without_a_place(
    ros2: Messages, planar: bool, tmp_path: Path
) -> None:
    path = laser_and_radar(ros2, tmp_path / "bag", planar=planar, laser_frame="elsewhere")
    with pytest.raises(ValueError, match=r"(?s)no transform to elsewhere.*mount X.*\n  topic /radar"):
        read(path)


def test_texts_that_only_look_like_options_stay() -> None:
    for text in ("/poses: no pose in it", "a.bag: /x/poses: poses of a", "2 trajectories in topic /scan"):
        assert in_words(text) == text


# --- Time -------------------------------------------------------------------------------------------


def drive(make: Messages, path: Path, begins: float, first: float | None = None) -> Path:
    """1 m/s for 2 s by a clock that begins somewhere, recorded by the wall's; two scans at a time.

    `first` is the stamp of the first messages instead.
    """
    content: list[tuple[str, float, Any]] = []
    for number in range(20):
        t = begins + 0.1 * number
        stamp = first if first is not None and not number else t
        content.append(make.moved(stamp, "odom", "laser", [0.1 * number, 0, 0], at=START + 0.1 * number))
        for side in (-1.0, 1.0):
            laser = make.laser(stamp, "laser", np.full(30, 4 + 0.1 * side))
            content.append(("/scan", START + 0.1 * number, laser))
    return write_bag(path, make, content)


def test_a_clock_that_begins_at_0_is_a_clock(ros2: Messages, tmp_path: Path) -> None:
    log = read(drive(ros2, tmp_path / "zero", 0.0))
    scans = list(log)
    assert log.notes == [] and len(scans) == 40 and not log.skipped
    np.testing.assert_allclose([scan.stamp for scan in scans[::2]], 0.1 * np.arange(20), atol=1e-9)
    np.testing.assert_allclose([scan.origin[0] for scan in scans[::2]], 0.1 * np.arange(20), atol=1e-9)
    assert log.spans == {"scans": pytest.approx((0, 1.9)), "poses": pytest.approx((0, 1.9))}


def test_a_stamp_of_0_before_others_of_today_says_nothing(ros2: Messages, tmp_path: Path) -> None:
    log = read(drive(ros2, tmp_path / "bag", START, first=0.0))
    stamps = [scan.stamp for scan in log]
    assert log.notes == []
    np.testing.assert_allclose(stamps[::2], START + 0.1 * np.arange(20), atol=1e-6)


def test_stamps_that_are_all_0_are_told_of(ros2: Messages, tmp_path: Path) -> None:
    times = START + 0.1 * np.arange(20)
    content = [("/scan", t, ros2.laser(0.0, "laser", np.full(30, 4.0))) for t in times]
    log = read(write_bag(tmp_path / "bag", ros2, content), still=True)
    np.testing.assert_allclose([scan.stamp for scan in log], times, atol=1e-6)
    (note,) = (note for note in log.notes if "are 0" in note)
    assert "/scan (LaserScan)" in note and "when they were recorded" in note


def test_the_rate_is_messages_over_their_time(ros2: Messages, tmp_path: Path) -> None:
    """Not over the usual time between two: here every second message comes with the one before it."""
    held = contents(drive(ros2, tmp_path / "bag", START))
    rates = {one["topic"]: one["rate"] for one in held["topics"]}
    assert rates["/scan"] == pytest.approx(39 / 1.9)


# --- MCAP of others ---------------------------------------------------------------------------------


def mcap(path: Path, rows: list[tuple[str, str, float, bytes]], packing: str = "json") -> Path:
    """Messages, each with its topic, type and time [s], by the library of the format."""
    writer_module = pytest.importorskip("mcap.writer")
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start()
        channels: dict[str, int] = {}
        for topic, type_, time, data in rows:
            if topic not in channels:
                schema = writer.register_schema(type_, "omgidl" if packing == "cdr" else "jsonschema", b"{}")
                channels[topic] = writer.register_channel(topic, packing, schema)
            writer.add_message(channels[topic], round(1e9 * time), data, round(1e9 * time))
        writer.finish()
    return path


def vector(*values: float) -> dict[str, float]:
    return dict(zip("xyzw", map(float, values)))


def stamped(t: float) -> dict[str, Any]:
    return {"timestamp": {"sec": int(t), "nsec": round(1e9 * (t % 1))}}


def foxglove_log(path: Path, sensor: str, **changes: Any) -> Path:
    """A second in which a sensor moves by 1 m along x, a metre above its base, in Foxglove's words."""
    packed_points = np.column_stack([POINTS, np.zeros(12)]).astype("<f4").tobytes()
    said: dict[str, Any] = {
        "foxglove.LaserScan": {"start_angle": -1, "end_angle": 1, "ranges": [2, 3, None, 4, 5]},
        "foxglove.PointCloud": {
            "point_stride": 16, "data": base64.b64encode(packed_points).decode(),
            "fields": [{"name": name, "offset": 4 * i, "type": 7} for i, name in enumerate("xyz")],
        },
        "foxglove.RawImage": {
            "width": 3, "height": 2, "encoding": "16UC1", "step": 6,
            "data": base64.b64encode(DEPTHS.tobytes()).decode(),
        },
    }  # fmt: skip
    rows: list[tuple[str, str, float, bytes]] = []

    def add(topic: str, type_: str, t: float, message: dict[str, Any]) -> None:
        rows.append((topic, type_, t, json.dumps(message).encode()))

    for number in range(11):
        t = START + 0.1 * number
        moved = {
            "parent_frame_id": "odom", "child_frame_id": "base",
            "translation": vector(0.1 * number, 0, 0), "rotation": vector(0, 0, 0, 1),
        }  # fmt: skip
        held = {**moved, "parent_frame_id": "base", "child_frame_id": "eye", "translation": vector(0, 0, 1)}
        add("/tf", "foxglove.FrameTransforms", t, {"transforms": [{**stamped(t), **moved}]})
        add("/held", "foxglove.FrameTransform", t, {**stamped(t), **held})
        f, g, cx, cy = CAMERA
        k = [f, 0, cx, 0, g, cy, 0, 0, 1]
        camera = {"frame_id": "eye", "width": 3, "height": 2, "K": k, "P": [0.0] * 12}
        add("/eye/calibration", "foxglove.CameraCalibration", t, {**stamped(t), **camera})
        add("/eye/data", sensor, t, {**stamped(t), "frame_id": "eye", **said[sensor], **changes})
    return mcap(path, rows)


@pytest.mark.parametrize("sensor", ["foxglove.LaserScan", "foxglove.PointCloud", "foxglove.RawImage"])
def test_messages_in_json_by_foxglove(sensor: str, tmp_path: Path) -> None:
    angles = np.linspace(-1, 1, 5)[[0, 1, 3, 4]]
    ranges = np.array([2, 3, 4, 5])
    expected = {
        "foxglove.LaserScan": ranges[:, None]
        * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1),
        "foxglove.PointCloud": POINTS,
        "foxglove.RawImage": of_depths(0.001),
    }[sensor]
    log = read(foxglove_log(tmp_path / "a.mcap", sensor), dim=3)
    assert log.notes == []
    scans = list(log)
    assert len(scans) == 11
    for number, scan in enumerate(scans):
        ends = scan.endpoints[np.isfinite(scan.endpoints).all(axis=1)]
        np.testing.assert_allclose(
            ends - expected, np.tile([0.1 * number, 0, 1], (len(expected), 1)), atol=1e-6
        )
        np.testing.assert_allclose(scan.origin, [0.1 * number, 0, 1], atol=1e-6)
        assert scan.stamp == pytest.approx(START + 0.1 * number, abs=1e-6)


def test_poses_in_json_by_foxglove(tmp_path: Path) -> None:
    rows = []
    for number in range(5):
        t = START + number
        pose = {"position": vector(number, 0, 0), "orientation": vector(0, 0, 0, 1)}
        scan = {"start_angle": 0, "end_angle": 1, "ranges": [1, 2], "frame_id": "laser"}
        for topic, type_, said in (
            ("/where", "foxglove.PoseInFrame", {"frame_id": "map", "pose": pose}),
            ("/scan", "foxglove.LaserScan", scan),
        ):
            rows.append((topic, type_, t, json.dumps({**stamped(t), **said}).encode()))
    log = read(mcap(tmp_path / "a.mcap", rows), poses="/where")
    np.testing.assert_array_equal([scan.origin for scan in log], [[number, 0] for number in range(5)])


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"pose": {"position": vector(1, 0, 0), "orientation": vector(0, 0, 0, 1)}}, "a pose of the sensor"),
        ({"ranges": "none"}, "no whole sensor_msgs/msg/LaserScan in JSON"),
        ({"start_angle": None}, "no whole"),
        ({"timestamp": {"sec": 1}}, "a time .* expected sec and nsec"),
        ({"timestamp": "2024-01-01T00:00:00Z"}, "expected sec and nsec"),
    ],
)
def test_damaged_json_is_named(changes: dict[str, Any], said: str, tmp_path: Path) -> None:
    path = foxglove_log(tmp_path / "a.mcap", "foxglove.LaserScan", **changes)
    with pytest.raises(ValueError, match=f"a.mcap: /eye/data: .*{said}"):
        list(read(path, still=True))


def ros_log() -> dict[str, tuple[str, dict[str, Any]]]:
    """By topic a message of ROS with its type, in JSON: a laser, and Odometry."""
    stamp = {"sec": 5, "nanosec": 0}
    pose = {"position": vector(1, 2, 0), "orientation": vector(0, 0, 0, 1)}
    laser = {
        "header": {"stamp": stamp, "frame_id": "laser"}, "angle_min": 0, "angle_max": 1,
        "angle_increment": 0.5, "time_increment": 0, "scan_time": 0, "range_min": 0.1, "range_max": 9,
        "ranges": [1, None, 2],
    }  # fmt: skip
    odometry = {
        "header": {"stamp": stamp, "frame_id": "odom"}, "child_frame_id": "laser", "pose": {"pose": pose},
    }  # fmt: skip
    return {"/scan": ("sensor_msgs/LaserScan", laser), "/odom": ("nav_msgs/msg/Odometry", odometry)}


def test_messages_of_ros_in_json(tmp_path: Path) -> None:
    rows = [(topic, type_, 5.0, json.dumps(said).encode()) for topic, (type_, said) in ros_log().items()]
    (scan,) = read(mcap(tmp_path / "a.mcap", rows))
    np.testing.assert_array_equal(scan.origin, [1, 2])
    np.testing.assert_allclose(np.linalg.norm(scan.endpoints - [1, 2], axis=1), [1, np.nan, 2], atol=1e-6)


def in_json(data: bytes, kind: str) -> Raw:
    return Raw(Connection(0, "/topic", kind, "json"), 0, data)


def test_messages_in_json_lack_no_field() -> None:
    """Of each message, each field left out, and in its place an object, or a list of one."""
    cases = 0
    for type_, said in ros_log().values():
        kind = type_of(type_)
        assert kind is not None
        for name in said:
            left = {key: value for key, value in said.items() if key != name}
            for changes in ({}, {name: {"x": []}}, {name: [{}]}):
                with pytest.raises(ValueError, match=f"no whole {kind} in JSON"):
                    decoded(in_json(json.dumps({**left, **changes}).encode(), kind))
                cases += 1
    assert cases >= 36
    for data in (b"", b"{", b"[]", b"3", b'"a"', b"{}", b"\xff", b"[" * 100_000):
        with pytest.raises(ValueError, match="in JSON"):
            decoded(in_json(data, "sensor_msgs/msg/LaserScan"))


def test_types_and_topics_by_the_names_of_dds(ros2: Messages, tmp_path: Path) -> None:
    laser = ros2.store.serialize_cdr(ros2.laser(START, "laser", [1, 2, 3]), "sensor_msgs/msg/LaserScan")
    for number, (topic, type_) in enumerate(
        [
            ("rt/scan", "sensor_msgs::msg::dds_::LaserScan_"),
            ("/scan", "sensor_msgs::msg::dds_::LaserScan_"),
            ("/scan", "sensor_msgs::msg::LaserScan"),
        ]
    ):
        path = mcap(tmp_path / f"{number}.mcap", [(topic, type_, START, bytes(laser))], "cdr")
        (scan,) = read(path, topic="/scan", still=True)
        np.testing.assert_allclose(np.linalg.norm(scan.endpoints, axis=1), [1, 2, 3], atol=1e-6)


def test_what_cannot_be_read_is_named_with_its_packing(tmp_path: Path) -> None:
    path = mcap(tmp_path / "a.mcap", [("/scan", "foxglove.LaserScan", START, b"\x08\x01")], "protobuf")
    with pytest.raises(ValueError, match=r"/scan \(foxglove.LaserScan as protobuf\); expected ros1, cdr"):
        read(path)
    (topic,) = contents(path)["topics"]
    assert (topic["type"], topic["messages"], topic["encoding"]) == ("foxglove.LaserScan", 1, "protobuf")
