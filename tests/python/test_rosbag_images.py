# SPDX-License-Identifier: BSD-3-Clause
"""Depth images in bags that are packed: as PNG, and by RVL."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("hypothesis")

from bags import START, Messages, write_bag
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ndtree.logs import read
from ndtree.logs.ros.messages.image import rvl_image


def rvl_of(image: np.ndarray) -> bytes:
    """Pack an image by RVL pixel by pixel, as its paper describes it."""
    groups: list[int] = []

    def put(value: int) -> None:
        while True:
            groups.append(value & 7 | (8 if value >> 3 else 0))
            value >>= 3
            if not value:
                return

    flat, at, before = [int(value) for value in image.ravel()], 0, 0
    while at < len(flat):
        empty = next((i for i, value in enumerate(flat[at:]) if value), len(flat) - at)
        at += empty
        full = next((i for i, value in enumerate(flat[at:]) if not value), len(flat) - at)
        put(empty)
        put(full)
        for value in flat[at : at + full]:
            step = value - before
            put(2 * step if step >= 0 else -2 * step - 1)
            before = value
        at += full
    groups += [0] * (-len(groups) % 8)
    words = [int("".join(f"{group:x}" for group in groups[i : i + 8]), 16) for i in range(0, len(groups), 8)]
    return struct.pack(f"<ii{len(words)}I", image.shape[1], image.shape[0], *words)


def png_of(image: np.ndarray) -> bytes:
    packed = io.BytesIO()
    pytest.importorskip("PIL.Image").fromarray(image).save(packed, "PNG")
    return packed.getvalue()


@pytest.mark.parametrize("packing", ["png", "rvl"])
@pytest.mark.parametrize("metres", [False, True])
def test_packed_depth_images(ros2: Messages, metres: bool, packing: str, tmp_path: Path) -> None:
    depths = np.array([[1.0, 2.0], [0.0, 4.0]])
    a, b = 100.0, 2.0
    with np.errstate(divide="ignore"):
        values = np.where(depths > 0, a / depths + b if metres else 1000 * depths, 0).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b) + (png_of if packing == "png" else rvl_of)(values)
    message = ros2.compressed_image(f"{'32FC1' if metres else '16UC1'}; compressedDepth {packing}", data)
    info = ros2.camera_info(START, "camera", (2, 2), (1.0, 1.0, 0.0, 0.0))
    content = [
        ("/camera/depth/image/compressedDepth", START, message),
        ("/camera/depth/camera_info", START, info),
    ]
    (scan,) = read(write_bag(tmp_path / "bag", ros2, content), still=True)
    np.testing.assert_allclose(scan.endpoints, [[0, 0, 1], [2, 0, 2], [4, 4, 4]], rtol=0.02)


@given(
    image=arrays(np.uint16, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.sampled_from(
        [0, 0, 0, 1, 2, 3, 700, 701, 40000, 65535])),
    cut=st.integers(1, 40),
)  # fmt: skip
def test_rvl_is_unpacked_to_what_was_packed(image: np.ndarray, cut: int) -> None:
    packed = rvl_of(image)
    np.testing.assert_array_equal(rvl_image(packed), image)
    try:  # What is cut off is told, or was padding.
        np.testing.assert_array_equal(rvl_image(packed[:-cut]), image)
    except ValueError as error:
        assert "expected" in str(error)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"\2\0\0\0", "has 4 bytes, expected its size"),
        (struct.pack("<ii", -1, 3), "has -1 x 3 pixels"),
        (struct.pack("<ii", 1 << 20, 1 << 20), "expected at most"),
        (struct.pack("<iiI", 2, 2, 0), "a run of 0 and 0 pixels after 0"),
        (struct.pack("<iiI", 2, 2, 0x50000000), "a run of 5 and 0 pixels after 0"),
        (struct.pack("<iiII", 2, 2, 0xFFFFFFFF, 0xFFFF1111), "a number of 39 bits"),
    ],
)
def test_rvl_that_is_damaged_is_told(data: bytes, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        rvl_image(data)
