# SPDX-License-Identifier: BSD-3-Clause
"""Clouds with colours, and clouds that point_cloud_transport has packed."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import KINDS, Messages, write_bag
from rosbags.typesys import get_types_from_msg

import ndtree
from ndtree.live.outputs import by_size, cell_points
from ndtree.tuning.config import Config

START, SEED = 1.7e9, 5
PACKED = "point_cloud_interfaces/msg/CompressedPointCloud2"
DEFINITION = """std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] compressed_data
bool is_dense
string format
"""
#: Red, green and blue of walls at x = 2, x = -2 and elsewhere.
RED, BLUE, GREEN = (200, 10, 20), (5, 15, 250), (40, 180, 60)


def box_points() -> np.ndarray:
    """Of a room of 4 m, around the sensor."""
    ways = np.random.default_rng(SEED).normal(size=(3000, 3))
    return 2 * ways / np.abs(ways).max(axis=1, keepdims=True)


def colors_at(points: np.ndarray) -> np.ndarray:
    x = points[:, :1]
    return np.where(x > 1.9, RED, np.where(x < -1.9, BLUE, GREEN)).astype(np.uint32)


def colored(make: Messages, stamp: float, points: np.ndarray, *, big: bool, name: str) -> Any:
    """A PointCloud2 as PCL writes it: the colour behind x, y, z and 4 bytes of nothing."""
    message = make.cloud(stamp, "sensor", points, step=32, big=big)
    packed = colors_at(points) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    data = message.data.reshape(-1, 32).copy()
    data[:, 16:20] = packed.astype(">u4" if big else "<u4").view(np.uint8).reshape(-1, 4)
    message.data = data.ravel()
    kind = {"rgb": 7, "rgba": 6}[name]
    message.fields.append(make.of("sensor_msgs/msg/PointField", name=name, offset=16, datatype=kind, count=1))
    return message


def bag(path: Path, make: Messages, clouds: list[Any]) -> Path:
    content: list[Any] = []
    for i, cloud in enumerate(clouds):
        stamp = START + 0.1 * i
        tf = make.tf(make.transform(stamp, "map", "sensor", [0.01 * i, 0, 0], [0, 0, 0, 1]))
        content += [("/tf", stamp, tf), ("/points", stamp, cloud)]
    return write_bag(path, make, content)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("name", ["rgb", "rgba"])
@pytest.mark.parametrize("kind", KINDS)
def test_cells_have_the_colour_of_what_ended_in_them(tmp_path: Path, kind: str, name: str, big: bool) -> None:
    make, points = Messages(kind), box_points()
    clouds = [colored(make, START + 0.1 * i, points, big=big, name=name) for i in range(3)]
    path = bag(tmp_path / "bag", make, clouds)
    assert all(scan.layers is None for scan in ndtree.read(path))
    m = Config.of(colors=True, min_cell_size=0.1).new_map(3)
    for scan in ndtree.read(path, colors=True):
        assert scan.layers is not None and scan.layers["color"].tolist() == colors_at(points).tolist()
        part = scan.only(slice(5, 40, 7))
        assert part.layers is not None and len(part.layers["color"]) == len(part) == 5
        scan.insert_into(m)
        scan.insert_into(ndtree.AdaptiveMap(dim=3))  # Without that layer.
    cells = cell_points(m)
    assert len(cells) > 500
    seen = 0
    for _, centers, colors in by_size(cells):
        for side, color in ((1, RED), (-1, BLUE)):
            inside = (side * centers[:, 0] > 1.9) & (np.abs(centers[:, 1:]) < 1.3).all(axis=1)
            found = np.round(255 * colors[inside]).astype(int)
            found = found[(found != 128).any(axis=1)]  # Grey: occupied, but no beam ended there.
            seen += len(found)
            assert (found == color).all()
    assert seen > 100
    plain = by_size(cell_points(ndtree.AdaptiveMap(dim=3)))
    assert plain == []


@pytest.mark.parametrize("form", ["zlib", "zstd", "draco"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_packed_cloud_is_the_cloud(tmp_path: Path, kind: str, form: str) -> None:
    make, points = Messages(kind), box_points()
    make.store.register(get_types_from_msg(DEFINITION, PACKED))
    packers = {"zlib": zlib.compress, "zstd": lambda data: zstd().compress(data), "draco": draco(points)}
    raw = [make.cloud(START + 0.1 * i, "sensor", points) for i in range(3)]
    same = ("header", "height", "width", "fields", "is_bigendian", "point_step", "row_step", "is_dense")
    packed = [
        make.of(
            PACKED,
            compressed_data=np.frombuffer(packers[form](one.data.tobytes()), np.uint8),
            format=form,
            **{name: getattr(one, name) for name in same},
        )
        for one in raw
    ]
    as_they_were = list(ndtree.read(bag(tmp_path / "raw", make, raw)))
    found = list(ndtree.read(bag(tmp_path / "packed", make, packed)))
    assert len(found) == len(as_they_were) == 3
    for scan, expected in zip(found, as_they_were):
        assert scan.stamp == expected.stamp and np.allclose(scan.endpoints, expected.endpoints, atol=1e-3)
        assert form == "draco" or np.array_equal(scan.endpoints, expected.endpoints)
    wrong = [make.of(PACKED, **{**vars(packed[0]), "compressed_data": packed[0].compressed_data[:-9]})]
    wrong[0].compressed_data = np.ascontiguousarray(wrong[0].compressed_data)
    with pytest.raises(ValueError, match="cloud"):
        list(ndtree.read(bag(tmp_path / "wrong", make, [packed[0], *wrong]), topic="/points"))
    packed[1].format = "cloudini"
    with pytest.raises(ValueError, match=r"cloudini.*expected draco, zlib or zstd"):
        list(ndtree.read(bag(tmp_path / "other", make, packed[:2])))


def zstd() -> Any:
    return pytest.importorskip("zstandard").ZstdCompressor()


def draco(points: np.ndarray) -> Any:
    def packed(_: bytes) -> bytes:
        encode = pytest.importorskip("DracoPy").encode
        data: bytes = encode(points.astype(np.float32), quantization_bits=16, preserve_order=True)
        return data

    return packed
