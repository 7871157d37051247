# SPDX-License-Identifier: BSD-3-Clause
"""Messages whose bytes are in the other order than they say are read as they are, and that is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import Messages, write_bag

from ndtree import read
from ndtree.logs.ros.messages.beams import is_swapped

START = 1_700_000_000.0
RANDOM = np.random.default_rng(2)
CLOUD = RANDOM.normal(0, 8, (400, 3)).astype(np.float32).astype(np.float64)
ROWS, COLUMNS = np.indices((60, 80))
DEPTHS = (1200 + 9 * ROWS + 4 * COLUMNS + RANDOM.integers(0, 6, ROWS.shape)).astype(np.uint16)
DEPTHS[RANDOM.random(ROWS.shape) < 0.1] = 0


def contradicting(message: Any) -> Any:
    message.is_bigendian = type(message.is_bigendian)(not message.is_bigendian)
    return message


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("type_", [7, 8])
def test_clouds(type_: int, big: bool, tmp_path: Path) -> None:
    make = Messages("ros1")
    how: Any = {"types": (type_,) * 3, "offsets": (0, 8, 16), "step": 24, "big": big}
    plain = make.cloud(START, "a", CLOUD, **how)
    swapped = contradicting(make.cloud(START + 1, "a", CLOUD, **how))
    path = write_bag(tmp_path / "a", make, [("/points", START, plain), ("/points", START + 1, swapped)])
    log = read(path, still=True)
    for scan in log:
        np.testing.assert_array_equal(scan.endpoints, CLOUD)
    assert any("in 1 of 2 messages is_bigendian contradicts" in note for note in log.notes)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_depth_images(encoding: str, big: bool, tmp_path: Path) -> None:
    make = Messages("ros1")
    values = DEPTHS if encoding == "16UC1" else (DEPTHS / 1000).astype(np.float32)
    plain = make.image(START, "a", values, encoding, big=big)
    swapped = contradicting(make.image(START + 1, "a", values, encoding, big=big))
    path = write_bag(
        tmp_path / "a", make, [("/depth/image", START, plain), ("/depth/image", START + 1, swapped)]
    )
    log = read(path, still=True, camera="80,80,40,30")
    first, second = log
    np.testing.assert_array_equal(first.endpoints, second.endpoints)
    assert len(first) == np.count_nonzero(DEPTHS)
    assert any("in 1 of 2 messages is_bigendian contradicts" in note for note in log.notes)


@pytest.mark.parametrize(
    "values",
    [
        np.zeros((20, 20), "<f4"),
        np.full((20, 20), np.nan, ">f4"),
        CLOUD.astype("<f4") + 5e6,
        CLOUD.astype(">f4") * 1e-3,
        RANDOM.integers(0, 65536, (40, 40)).astype("<u2"),
        np.full((40, 40), 256, ">u2"),
        np.zeros((0, 0), "<u2"),
        DEPTHS,
    ],
)
def test_what_is_as_it_says_stays_so(values: np.ndarray) -> None:
    assert not is_swapped(values)
