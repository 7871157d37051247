# SPDX-License-Identifier: BSD-3-Clause
"""A range of 0 is no echo or nothing at all: as it was said, or as the log shows."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import ndtree
from ndtree.logs.ros.messages.laser import laser_beams
from ndtree.tuning.inspection import inspect


def carmen(path: Path, inside: bool, scans: int = 60) -> Path:
    """A laser that drives along a wall in the open; or in a room, where every fifth beam is lost."""
    generator = np.random.default_rng(4)
    lines = []
    for i in range(scans):
        x = 0.05 * i
        angle = -math.pi / 2 + np.arange(180) * math.pi / 180
        with np.errstate(divide="ignore"):
            to_wall = np.where(np.sin(angle) > 0, 2 / np.sin(angle), np.inf)
            if inside:
                others = [np.where(np.sin(angle) < 0, -2 / np.sin(angle), np.inf), (9 - x) / np.cos(angle)]
                to_wall = np.minimum(to_wall, np.minimum(*others))
        ranges = np.where(to_wall < 20, to_wall + generator.normal(0, 0.01, 180), 0)
        if inside:
            ranges[generator.random(180) < 0.2] = 0
        text = " ".join(f"{one:.2f}" if one else "0" for one in ranges)
        lines.append(f"FLASER 180 {text} {x:.3f} 0 0 {x:.3f} 0 0 {i} host {i}\n")
    path.write_text("".join(lines))
    return path


def silent(log: ndtree.logs.Log) -> tuple[int, int]:
    """How many beams did not return, and how many are invalid: of no length."""
    scans = list(log)
    lost = sum(int((~scan.returned).sum()) for scan in scans)
    return lost, sum(int((scan.endpoints == scan.origin).all(axis=1).sum()) for scan in scans)


def test_what_was_said_of_zero_holds(tmp_path: Path) -> None:
    path = carmen(tmp_path / "a.log", inside=False)
    zeros = silent(ndtree.read(path))[1]
    assert zeros > 4000 and silent(ndtree.read(path, zero_is="invalid")) == (0, zeros)
    log = ndtree.read(path, zero_is="no-echo")
    assert silent(log) == (zeros, 0) and log.zeros == zeros
    first = next(iter(log))
    gone = ~first.returned
    way = first.endpoints[gone] - first.origin
    right = -math.pi / 2 + np.flatnonzero(gone) * math.pi / 180
    np.testing.assert_allclose(np.arctan2(way[:, 1], way[:, 0]), right, atol=1e-9)
    with pytest.raises(ValueError, match="zero_is = 'far': must be one of no-echo, invalid"):
        ndtree.read(path, zero_is="far")


@pytest.mark.parametrize("inside, meaning", [(False, "no-echo"), (True, "invalid")])
def test_the_log_decides_where_zero_is_was_not_given(inside: bool, meaning: str, tmp_path: Path) -> None:
    log = ndtree.read(carmen(tmp_path / "a.log", inside))
    found = inspect(log)
    assert found.get("zero_is") == found.ruled(log).rules.zero_is == meaning
    assert log.rules.zero_is is None, "looking changes nothing"
    (line,) = (line for line in found.notes if "ranges are 0" in line)
    assert f"zero_is {'invalid' if meaning == 'no-echo' else 'no-echo'}" in line
    assert not any("every beam of the scans" in line for line in found.notes)
    given = ndtree.read(log.path, zero_is="invalid")
    assert inspect(given).ruled(given).rules.zero_is == "invalid"


def test_of_a_laser_scan_zero_is_as_infinity_where_it_was_said() -> None:
    ranges = np.array([0, 1.5, np.inf, np.nan, 0], dtype=np.float32)
    message = SimpleNamespace(
        ranges=ranges, range_min=0.1, range_max=8.0, angle_min=0.0, angle_max=0.4, angle_increment=0.1,
        time_increment=0.0, scan_time=0.0,
    )  # fmt: skip
    plain, asked = laser_beams(message), laser_beams(message, zero_is_silent=True)
    assert plain.zeros == asked.zeros == 2
    np.testing.assert_array_equal(np.isnan(plain.points[:, 0]), [True, False, False, True, True])
    lengths = np.linalg.norm(asked.points, axis=1)
    np.testing.assert_allclose(lengths[[0, 1, 2, 4]], [8, 1.5, 8, 8], rtol=1e-6)
    np.testing.assert_array_equal(asked.returned, [False, True, False, False, False])
