# SPDX-License-Identifier: BSD-3-Clause
"""Bags as drivers write them that do not keep to the letter: what they mean is read, and told."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import Messages, write_bag

from ndtree.readers import contents, read
from ndtree.readers.ros.beams import pitch_of

START = 1.7e9
POINTS = np.random.default_rng(5).uniform(1, 9, (12, 3)).astype(np.float32)
DEPTHS = np.array([[0, 1000, 2000], [1500, 0, 500]], dtype=np.uint16)
CAMERA = (100.0, 110.0, 1.0, 0.5)


@pytest.fixture
def ros2() -> Messages:
    return Messages("mcap")


def placed(make: Messages, frame: str) -> tuple[str, float, Any]:
    return "/tf", START, make.tf(make.transform(START, "map", frame, [0, 0, 0], [0, 0, 0, 1]))


def changed(message: Any, **values: Any) -> Any:
    for name, value in values.items():
        object.__setattr__(message, name, value)
    return message


# --- Clouds -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("row_step", [0, 63, 3 * 64, 2**31])
@pytest.mark.parametrize("height", [1, 3])
def test_a_wrong_row_step_does_not_matter_where_points_fill_the_bytes(
    ros2: Messages, height: int, row_step: int, tmp_path: Path
) -> None:
    cloud = changed(ros2.cloud(START, "lidar", POINTS, height=height), row_step=row_step)
    (scan,) = read(write_bag(tmp_path / "bag", ros2, [placed(ros2, "lidar"), ("/points", START, cloud)]))
    np.testing.assert_array_equal(scan.endpoints, POINTS.astype(np.float64))


def test_rows_with_space_between_them_are_read_as_they_are_said() -> None:
    """All that may be said of 3 rows of 10 bytes; by hand."""
    assert [pitch_of(said, 3, 10, 30) for said in (0, 9, 10, 11, 30)] == [10] * 5
    assert [pitch_of(said, 3, 10, 34) for said in (12, 0, 9, 13)] == [12, 10, 10, 10]
    assert [pitch_of(said, 3, 10, 36) for said in (10, 11, 12, 13)] == [10, 11, 12, 13]
    assert pitch_of(12, 3, 10, 29) == 12  # Too few bytes for any: the error says what was said.


def test_empty_clouds_need_no_fields(ros2: Messages, tmp_path: Path) -> None:
    """Between others, and first: a driver's placeholders."""
    content = [placed(ros2, "lidar")]
    for number in range(4):
        cloud = ros2.cloud(START + 0.1 * number, "lidar", POINTS)
        if number % 2 == 0:
            empty = {"height": number // 2, "width": 0, "fields": [], "point_step": 0, "row_step": 0}
            cloud = changed(cloud, **empty, data=np.zeros(0, np.uint8))
        content.append(("/points", START + 0.1 * number, cloud))
    log = read(write_bag(tmp_path / "bag", ros2, content), still=True)
    assert [len(scan) for scan in log] == [0, 12, 0, 12]


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


def packed(make: Messages, format: str, data: bytes) -> Any:
    return make.of(
        "sensor_msgs/msg/CompressedImage", header=make.header(START, "camera"), format=format,
        data=np.frombuffer(data, dtype=np.uint8),
    )  # fmt: skip


@pytest.mark.parametrize("said", ["Z16", "z16", "16SC1", "mono16", "png", "", "PNG", "16UC1; png compressed"])
def test_depths_by_whatever_name(ros2: Messages, said: str, tmp_path: Path) -> None:
    if "png" in said.lower() or not said:
        image: Any = packed(ros2, said, png(DEPTHS))
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
        ("/grey", START, packed(ros2, "png", png(DEPTHS.astype(np.uint8)))),
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


@pytest.mark.parametrize("least, most", [(0.1, 0.0), (0.1, np.nan), (0.1, 0.1), (0.2, 0.1), (0.0, -1.0)])
def test_a_largest_range_that_is_none_counts_as_not_given(
    ros2: Messages, least: float, most: float, tmp_path: Path
) -> None:
    ranges = [0.05, 1.0, 7.0, np.inf, np.nan, 0.0, 7.0]
    laser = ros2.laser(START, "laser", ranges, range_min=least, range_max=most)
    path = write_bag(tmp_path / "bag", ros2, [placed(ros2, "laser"), ("/scan", START, laser)])
    log = read(path, still=True)
    (scan,) = log
    assert np.isfinite(scan.endpoints).all(axis=1).tolist() == [least == 0, True, True, *3 * [False], True]
    note = next(one for one in log.notes if "1 of 1 messages the largest range" in one)
    assert f"range_max = {most:g} m" in note
    log.no_return_range = 12.0
    (scan,) = log
    length = np.linalg.norm(scan.endpoints, axis=1)
    assert length[3] == pytest.approx(12) and not scan.returned[3] and scan.returned[[1, 2, 6]].all()
