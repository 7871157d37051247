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

from ndtree.logs import read


def png_of(image: np.ndarray) -> bytes:
    packed = io.BytesIO()
    pytest.importorskip("PIL.Image").fromarray(image).save(packed, "PNG")
    return packed.getvalue()


@pytest.mark.parametrize("metres", [False, True])
def test_packed_depth_images(ros2: Messages, metres: bool, tmp_path: Path) -> None:
    depths = np.array([[1.0, 2.0], [0.0, 4.0]])
    a, b = 100.0, 2.0
    with np.errstate(divide="ignore"):
        values = np.where(depths > 0, a / depths + b if metres else 1000 * depths, 0).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b) + png_of(values)
    message = ros2.compressed_image(f"{'32FC1' if metres else '16UC1'}; compressedDepth png", data)
    info = ros2.camera_info(START, "camera", (2, 2), (1.0, 1.0, 0.0, 0.0))
    content = [
        ("/camera/depth/image/compressedDepth", START, message),
        ("/camera/depth/camera_info", START, info),
    ]
    (scan,) = read(write_bag(tmp_path / "bag", ros2, content), still=True)
    np.testing.assert_allclose(scan.endpoints, [[0, 0, 1], [2, 0, 2], [4, 4, 4]], rtol=0.02)
