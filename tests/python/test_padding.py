# SPDX-License-Identifier: BSD-3-Clause
"""Padding, as drivers write it for beams that did not return, is no measurement, in logs of any format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ndtree.logs import read
from ndtree.logs.core.silence import NEAREST, without_padding

POSITION = np.array([1.5, -2.25, 0.5])
POINTS = np.array([[3, 4, 1], [-2, 5, 0.5], [0, 0.01, 0], [6, -1, 2]], dtype=np.float32)
#: What stands between the measured points.
PADDING = np.array([[0, 0, 0], [0, 0, 0], [2e-4, -3e-4, 1e-4], [np.nan] * 3], dtype=np.float32)
BOTH = np.concatenate([PADDING[:2], POINTS[:2], PADDING[2:], POINTS[2:]])
START = 1.7e9


def kitti(path: Path) -> Path:
    (path / "velodyne").mkdir()
    np.column_stack([BOTH, np.ones(len(BOTH))]).astype("<f4").tofile(path / "velodyne" / "000000.bin")
    row = np.column_stack([np.eye(3), POSITION]).ravel()
    (path / "poses.txt").write_text(" ".join(map(repr, map(float, row))) + "\n")
    (path / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    return path


def pcd(path: Path) -> Path:
    pytest.importorskip("pypcd4")
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(BOTH)}\nHEIGHT 1\nVIEWPOINT {' '.join(map(str, POSITION))} 1 0 0 0\n"
        f"POINTS {len(BOTH)}\nDATA binary\n"
    )
    (path / "a.pcd").write_bytes(header.encode() + BOTH.astype("<f4").tobytes())
    return path / "a.pcd"


def npz(path: Path) -> Path:
    points = (BOTH + POSITION).astype(np.float32)
    np.savez(path / "a.npz", origins=POSITION[None], points=points, offsets=np.array([0, len(points)]))
    return path / "a.npz"


def text(path: Path) -> Path:
    rows = BOTH[np.isfinite(BOTH).all(axis=1)].astype(np.float64) + POSITION
    lines = [" ".join(map(repr, map(float, (*POSITION, *row)))) for row in rows]
    (path / "a.xyz").write_text("\n".join(lines) + "\n")
    return path / "a.xyz"


def bag(path: Path) -> Path:
    pytest.importorskip("rosbags")
    from bags import Messages, write_bag

    make = Messages("mcap")
    tf = make.tf(make.transform(START, "map", "lidar", POSITION, [0, 0, 0, 1]))
    cloud = make.cloud(START, "lidar", BOTH)
    return write_bag(path / "bag", make, [("/tf", START, tf), ("/points", START, cloud)])


@pytest.mark.parametrize("write", [kitti, pcd, npz, text, bag], ids=lambda one: one.__name__)
def test_no_reader_takes_padding_for_a_beam(write: Callable[[Path], Path], tmp_path: Path) -> None:
    """Also points some tenths of a millimetre off; one at a centimetre is measured."""
    (scan,) = read(write(tmp_path), dim=3)
    known = np.isfinite(scan.endpoints).all(axis=1) & (scan.endpoints != scan.origin).any(axis=1)
    np.testing.assert_allclose(scan.endpoints[known], POINTS + POSITION, atol=1e-6)
    assert len(scan) - np.count_nonzero(known) == (3 if write is text else 4)
    np.testing.assert_array_equal(scan.origin, POSITION)


def test_zeros_of_a_cloud_in_a_fixed_frame_are_padding(tmp_path: Path) -> None:
    """Moving the points left them at the map's origin; a single one may be measured."""
    pytest.importorskip("pypcd4")
    path = pcd(tmp_path)
    (scan,) = read(path, points_in="map")
    assert (
        np.isfinite(scan.endpoints).all(axis=1).sum() == len(POINTS) + 1
    )  # That a half millimetre off zero.
    alone = np.concatenate([[[9, 9, 9]], BOTH[1:]])
    path.write_bytes(path.read_bytes().replace(BOTH.astype("<f4").tobytes(), alone.astype("<f4").tobytes()))
    (scan,) = read(path, points_in="map")
    assert np.isfinite(scan.endpoints).all(axis=1).sum() == len(POINTS) + 3


def timed_bag(path: Path, pad: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, Any]]) -> Path:
    """A lidar at 1.5 m/s whose every second point is padding, with times of the points."""
    from bags import Messages, write_bag

    make = Messages("mcap")
    content: list[tuple[str, float, Any]] = []
    for t in np.arange(0, 3, 0.1):
        content.append(make.moved(START + t, "odom", "lidar", [1.5 * t, 0, 0]))
    turn = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    ring = 4 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    for t in np.arange(0.5, 2.5, 0.1):
        points = ring.astype(np.float32)
        points, times = pad(points, np.linspace(0, 0.099, 100))
        cloud = make.with_times(make.cloud(START + t, "lidar", points), points, times, "t")
        content.append(("/points", START + t, cloud))
    return write_bag(path, make, content)


def padded(value: float, time: float | None) -> Any:
    def pad(points: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        points = points.copy()
        points[::2] = value
        times = np.round(1e9 * times).astype("u4")
        if time is not None:
            times[::2] = time
        return points, times

    return pad


def test_padding_with_times_of_its_own_is_none_of_the_robots_way(tmp_path: Path) -> None:
    """The same scans as with NaN instead, whatever the times of the padding are."""
    pytest.importorskip("rosbags")
    truth = list(read(timed_bag(tmp_path / "nan", padded(np.nan, None))))
    assert len(truth) == 20
    for number, pad in enumerate([padded(0, None), padded(0, 0), padded(0, 4e9), padded(np.nan, 4e9)]):
        log = read(timed_bag(tmp_path / str(number), pad))
        for scan, other in zip(log, truth, strict=True):
            np.testing.assert_allclose(scan.endpoints, other.endpoints, atol=1e-6)
            length = np.linalg.norm(scan.endpoints - scan.origin, axis=1)
            assert np.nanmin(length) > 3.5 and np.isnan(length).sum() == 50
        assert log.notes == []


def test_times_that_make_no_sense_are_told(tmp_path: Path) -> None:
    """A measured point with a wild time: all of its message count as of the stamp, and a line says so."""
    pytest.importorskip("rosbags")

    def wild(points: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        times = np.round(1e9 * times).astype("u4")
        times[7] = 4_000_000_000
        return points, times

    log = read(timed_bag(tmp_path / "wild", wild))
    scans = list(log)
    np.testing.assert_allclose(np.linalg.norm(scans[3].endpoints - scans[3].origin, axis=1), 4, atol=1e-5)
    (note,) = log.notes
    assert "/points" in note and "20 of 20 messages" in note and "t from 0 to 4e+09" in note
    log = read(timed_bag(tmp_path / "equal", lambda points, times: (points, np.zeros(100, "u4"))))
    assert list(log) and log.notes == []


def test_the_rule_has_one_limit() -> None:
    points = np.array([[0.9 * NEAREST, 0], [1.1 * NEAREST, 0], [np.nan, 0], [np.inf, 0], [1e300, 0]])
    found = without_padding(points)
    assert np.isnan(found[0]).all() and np.array_equal(found[1:], points[1:], equal_nan=True)
    assert without_padding(points[1:]) is not None and without_padding(points[1:]).base is points
    far = points + np.array([5e5, 4e6])
    assert np.isnan(without_padding(far, [5e5, 4e6])[0]).all()
