# SPDX-License-Identifier: BSD-3-Clause
"""Bags of several robots whose frames have the same names, and of clocks that begin again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import LEVEL, START, Messages, write_bag

from ndtree.logs import read
from ndtree.logs.ros.clock import Clock

Content = list[tuple[str, float, Any]]


def drive(
    make: Messages, space: str, speed: float, *, begin: float = START, received: float = START
) -> Content:
    """A robot that drives along x, and looks at a wall at x = 9."""
    content: Content = [
        (f"{space}/tf_static", received, make.tf(make.transform(begin, "base", "laser", [0.5, 0, 0], LEVEL)))
    ]
    for t in np.arange(0, 4, 0.1):
        moved = make.transform(begin + t, "odom", "base", [speed * t, 0, 0], LEVEL)
        content.append((f"{space}/tf", received + t, make.tf(moved)))
        laser = make.laser(begin + t, "laser", [9 - 0.5 - speed * t], angle_min=0.0, range_max=20.0)
        content.append((f"{space}/scan", received + t, laser))
    return content


def written(path: Path, make: Messages, content: Content) -> Path:
    return write_bag(path, make, sorted(content, key=lambda one: one[1]))


def test_robots_have_frames_of_their_own(ros2: Messages, tmp_path: Path) -> None:
    path = written(tmp_path / "bag", ros2, drive(ros2, "/a", 1.0) + drive(ros2, "/b", -2.0))
    for topics, count in ((["/a/scan"], 40), (["/b/scan"], 40), (["/b/scan", "/a/scan"], 80)):
        log = read(path, topic=topics)
        scans = list(log)
        assert len(scans) == count and not log.skipped
        for scan in scans:
            np.testing.assert_allclose(scan.endpoints, [[9, 0]], atol=1e-5)


def test_a_tf_for_all_serves_whom_it_knows(ros2: Messages, tmp_path: Path) -> None:
    content = drive(ros2, "", 1.0)
    other = [one for one in drive(ros2, "/b", -2.0) if "scan" not in one[0]]
    (scan, *_) = read(written(tmp_path / "bag", ros2, content + other))
    np.testing.assert_allclose(scan.endpoints, [[9, 0]], atol=1e-5)
    elsewhere = [(topic.replace("/tf", "/b/tf"), at, message) for topic, at, message in content]
    (scan, *_) = read(written(tmp_path / "elsewhere", ros2, elsewhere))
    np.testing.assert_allclose(scan.endpoints, [[9, 0]], atol=1e-5)


def test_a_clock_that_begins_again_goes_on(ros2: Messages, tmp_path: Path) -> None:
    first = drive(ros2, "", 1.0, begin=50.0)
    again = drive(ros2, "", -2.0, begin=50.0, received=START + 20)
    log = read(written(tmp_path / "bag", ros2, first + again))
    scans = list(log)
    assert len(scans) == 80 and not log.skipped
    assert any("the clock begins again at 50.000 s" in note for note in log.notes)
    stamps = np.array([scan.stamp for scan in scans])
    assert (np.diff(stamps) > 0).all()
    for scan in scans:
        np.testing.assert_allclose(scan.endpoints, [[9, 0]], atol=1e-5)
    whole = read(written(tmp_path / "whole", ros2, first))
    assert len(list(whole)) == 40 and not whole.notes


def test_only_stamps_that_stay_low_begin_again() -> None:
    def streams(*stamps: float) -> Clock:
        return Clock({"a": [(float(i), stamp) for i, stamp in enumerate(stamps)], "b": [(0.0, 0.0)]})

    for stamps in (
        [1, 2, 3, 4],
        [9, 2, 10, 11],
        [9, 10, 2],
        [9, 8, 9, 7.5],
        [5, 5, 5],
        [9, 2, 2.1, 9.1, 2.2, 2.3, 9.2],
        [],
    ):
        assert not streams(*stamps).falls
    stamps = [100, 101, 3, 4, 5, 6, 7, 8, 1, 2]
    clock = streams(*stamps)
    assert clock.falls == [3, 1]
    moved = [clock.time("a", i, stamp) for i, stamp in enumerate(stamps)]
    assert moved == [100, 101, 161, 162, 163, 164, 165, 166, 226, 227]
    assert clock.time("not seen", 3.5, 4) == 162  # By when others began again.
