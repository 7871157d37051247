# SPDX-License-Identifier: BSD-3-Clause
"""Parts of logs have the scans and beams that brute force finds, and far-away points lose no digit."""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ndtree
from ndtree.logs import Log


class ListLog(Log):
    """Scans in a list that counts how many were asked for."""

    format = "list"

    def __init__(self, scans: list[ndtree.Scan]) -> None:
        super().__init__(None, scans[0].dim)
        self.scans = scans
        self.asked = 0

    def _scans(self) -> Iterator[ndtree.Scan]:
        for scan in self.scans:
            self.asked += 1
            yield scan


def some(dim: int = 3, n: int = 30, beams: int = 40, *, shift: float = 0.0, start: float = 1.7e9) -> ListLog:
    generator = np.random.default_rng(dim)
    return ListLog(
        [
            ndtree.Scan(
                generator.normal(0, 4, (beams, dim)) + shift,
                generator.normal(0, 2, dim if i % 2 else (beams, dim)) + shift,
                None if i % 3 == 0 else generator.random(beams) < 0.7,
                start + 0.5 * i,
                None if i % 5 == 0 else generator.uniform(0.01, 0.1, beams),
            )
            for i in range(n)
        ]
    )


def same(one: ndtree.Scan, other: ndtree.Scan) -> bool:
    def arrays(scan: ndtree.Scan) -> list[Any]:
        return [scan.endpoints, scan.origin, scan.returned, scan.range_sigma]

    return one.stamp == other.stamp and all(
        a is b is None or np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
        for a, b in zip(arrays(one), arrays(other))
    )


# --- What is chosen ---------------------------------------------------------------------------------


def test_nothing_chosen_is_everything() -> None:
    log = some()
    chosen = log.select()
    assert (chosen.dim, chosen.format, chosen.name, chosen.path) == (3, "list", "list", None)
    for _ in range(2):
        assert all(same(a, b) for a, b in zip(chosen, log.scans)) and len(list(chosen)) == 30


@pytest.mark.parametrize("every", [1, 2, 7, 100])
@pytest.mark.parametrize("start, stop", [(None, None), (2.0, 8.0), (1.9, None), (None, 0.1), (14.5, 14.6)])
def test_scans_by_number_and_time(every: int, start: float | None, stop: float | None) -> None:
    log = some(start=1000.0)
    chosen = list(log.select(every=every, start=start, stop=stop))
    low, high = start or 0.0, math.inf if stop is None else stop
    expected = [scan for scan in log.scans if low <= scan.stamp - 1000.0 < high][::every]
    assert len(chosen) == len(expected) > 0
    assert all(same(a, b) for a, b in zip(chosen, expected))


def test_reading_ends_where_nothing_more_is_wanted() -> None:
    log = some()
    assert len(list(log.select(stop=3.0))) == 6
    assert log.asked == 7
    list(zip(range(3), log.select(every=2)))
    assert log.asked < 7 + 9, "a log is read as far as it is iterated"


@pytest.mark.parametrize("stride", [1, 3, 50])
def test_beams_by_number(stride: int) -> None:
    log = some()
    for chosen, scan in zip(log.select(stride=stride), log.scans):
        indices = list(range(0, len(scan), stride))
        np.testing.assert_array_equal(chosen.endpoints, scan.endpoints[indices])
        for name in ("returned", "range_sigma"):
            values = getattr(scan, name)
            assert values is None or np.array_equal(getattr(chosen, name), values[indices])
        if scan.origin.ndim == 2:
            np.testing.assert_array_equal(chosen.origin, scan.origin[indices])


def test_short_beams_are_left_out_and_invalid_ones_are_not() -> None:
    ends = np.array([[1.0, 0], [0, 2], [np.nan, 0], [0, 3], [0, 0]])
    log = ListLog([ndtree.Scan(ends, np.zeros(2))])
    (scan,) = log.select(min_range=2.0)
    np.testing.assert_array_equal(scan.endpoints, ends[1:4])


@pytest.mark.parametrize("dim", [2, 3])
def test_beams_are_cut_where_they_leave_the_box(dim: int) -> None:
    """Sampled densely, a beam is kept if a point of it is in the box, up to the last such point."""
    lower, upper = np.array([-1.0, -2.0, -1.5])[:dim], np.array([2.0, 1.5, 3.0])[:dim]
    log = some(dim, n=12)
    share = np.linspace(0, 1, 4001)[:, None, None]
    kept = cut = dropped = 0
    for scan, whole in zip(log.select(box=(lower, upper)), log.scans):
        start = np.broadcast_to(whole.origin, whole.endpoints.shape)
        points = start + share * (whole.endpoints - start)
        inside = ((points >= lower) & (points < upper)).all(axis=2)
        last = np.where(inside.any(axis=0), 4000 - inside[::-1].argmax(axis=0), -1)
        row = 0
        for i in range(len(whole)):
            way = np.linalg.norm(whole.endpoints[i] - start[i])
            if last[i] < 0:
                dropped += 1
                continue
            end = scan.endpoints[row]
            assert np.linalg.norm(end - points[last[i], i]) <= way / 4000 + 1e-9
            was = True if whole.returned is None else bool(whole.returned[i])
            assert scan.returned[row] == (was and last[i] == 4000)
            if last[i] == 4000:
                np.testing.assert_array_equal(end, whole.endpoints[i])
                kept += 1
            else:
                cut += 1
            origin = scan.origin if scan.origin.ndim == 1 else scan.origin[row]
            np.testing.assert_array_equal(origin, start[i])
            row += 1
        assert row == len(scan)
    assert min(kept, cut, dropped) > 10


def test_boxes_have_their_lower_faces_only() -> None:
    ends = [[0, 0.5], [1, 0.5], [0.5, 0], [0.5, 1], [-1, 1], [-1, 0.999], [0.5, 3], [np.nan, 0]]
    log = ListLog([ndtree.Scan(np.array(ends, dtype=np.float64), np.array([0.5, 0.5]))])
    (scan,) = log.select(box=((0, 0), (1, 1)))
    expected = [[0, 0.5], [1, 0.5], [0.5, 0], [0.5, 1], [0, 2 / 3], [0, 0.5 + 0.499 / 3], [0.5, 1]]
    np.testing.assert_allclose(scan.endpoints, expected, atol=1e-15)
    np.testing.assert_array_equal(scan.returned, [1, 0, 1, 0, 0, 0, 0])
    along = ListLog([ndtree.Scan(np.array([[5.0, 1.0], [5.0, 0.0]]), np.array([[-5.0, 1.0], [-5.0, 0.0]]))])
    (scan,) = along.select(box=((0, 0), (1, 1)))
    np.testing.assert_array_equal(scan.endpoints, [[1.0, 0.0]])


def test_far_away_coordinates_are_shifted_exactly() -> None:
    """What is left differs from exact arithmetic by no more than the last digit of the result."""
    origin = np.array([691_234.567, 5_334_891.123, 512.25])
    generator = np.random.default_rng(9)
    ends = origin + generator.normal(0, 30, (200, 3))
    log = ListLog([ndtree.Scan(ends, origin + np.array([1.0, 2.0, 3.0]))])
    (scan,) = log.select(origin=origin)
    for shifted, end in zip(scan.endpoints, ends):
        for value, whole, less in zip(shifted, end, origin):
            assert value == float(Fraction(float(whole)) - Fraction(float(less)))
    np.testing.assert_allclose(scan.origin, [1, 2, 3], atol=1e-9)
    assert scan.endpoints.dtype == np.float64
    narrow = ListLog([ndtree.Scan(ends.astype(np.float32), origin)])
    (scan,) = narrow.select(origin=origin)
    np.testing.assert_array_equal(scan.endpoints, ends.astype(np.float32).astype(np.float64) - origin)
    (scan,) = log.select(origin=origin, box=((-9, -9, -9), (9, 9, 9)))
    assert len(scan) == 200 and 8 < np.abs(scan.endpoints).max() <= 9 + 1e-12, "the box is in the map"


def test_a_selected_log_keeps_going_and_says_how_far_it_is(tmp_path: Path) -> None:
    lines = [f"{i} 0 {i} {j}\n" for i in range(300) for j in range(20)]
    for name, content in (("a.txt", "".join(lines)), ("b.txt", "".join([*lines, "0 0 x 1\n"]))):
        (tmp_path / name).write_text(content)
    (tmp_path / "c.gz").write_bytes(gzip.compress("".join(lines).encode()))
    for name in ("a.txt", "c.gz"):
        chosen = ndtree.read(tmp_path / name).select(every=2)
        shares = [chosen.share_read for _ in chosen]
        assert shares == sorted(shares) and 0 <= shares[0] < 0.9 < shares[-1] <= 1
    bad = ndtree.read(tmp_path / "b.txt", keep_going=True).select(every=2)
    assert len(list(bad)) == 150 and bad.skipped["damaged lines"].count == 1
    simulated = ndtree.simulate("office", scans=4)
    assert [simulated.share_read for _ in simulated] == [0.25, 0.5, 0.75, 1.0]
    assert some().share_read is None


# --- What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options, message",
    [
        ({"every": 0}, "every = 0: must be a whole number >= 1"),
        ({"stride": 1.5}, "stride = 1.5: must be a whole number >= 1"),
        ({"min_range": -1}, "min_range = -1 m: must be >= 0 and finite"),
        ({"start": 3, "stop": 3}, "start = 3 s, stop = 3 s: must be 0 <= start < stop"),
        ({"start": -1}, "start = -1 s"),
        ({"start": math.nan}, "start = nan s"),
        ({"origin": (1, 2)}, r"origin has a point \[1, 2\]: must be 3 finite numbers"),
        ({"origin": (1, 2, math.inf)}, "must be 3 finite numbers"),
        ({"box": ((0, 0, 0), (1, 1))}, r"box has a point \[1, 1\]: must be 3 finite numbers"),
        ({"box": ((0, 0, 0), (1, 0, 1))}, "must be lower < upper"),
        ({"box": ((0, 0, 0),)}, "box has 1 corners"),
    ],
)
def test_wrong_selections_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        some().select(**options)


def test_times_need_stamps() -> None:
    log = ListLog([ndtree.Scan(np.ones((1, 2)), np.zeros(2)) for _ in range(3)])
    with pytest.raises(ValueError, match="list: its scans have no times"):
        list(log.select(start=1.0))
    assert len(list(log.select(every=2))) == 2


ENDPOINTS = np.arange(8.0).reshape(4, 2) + 1
RETURNED = np.array([True, False, True, False])


def test_returned_only_keeps_the_order_and_the_origins():
    one = ndtree.Scan(ENDPOINTS, np.zeros(2), RETURNED, stamp=3.0).returned_only()
    np.testing.assert_array_equal(one.endpoints, ENDPOINTS[[0, 2]])
    assert one.returned is None and one.stamp == 3.0 and one.origin.shape == (2,)
    each = ndtree.Scan(ENDPOINTS, ENDPOINTS + 9, RETURNED).returned_only()
    np.testing.assert_array_equal(each.origin, ENDPOINTS[[0, 2]] + 9)
    whole = ndtree.Scan(ENDPOINTS, np.zeros(2))
    assert whole.returned_only() is whole


def test_the_sigma_of_each_beam_is_kept_checked_and_handed_on():
    sigma = np.arange(4, dtype=np.float32) + 1
    scan = ndtree.Scan(ENDPOINTS, np.zeros(2), RETURNED, range_sigma=sigma)
    np.testing.assert_array_equal(scan.returned_only().range_sigma, sigma[[0, 2]])
    assert scan.range_sigma.dtype == np.float32
    assert ndtree.Scan(ENDPOINTS, np.zeros(2), RETURNED).returned_only().range_sigma is None

    class Target:
        def insert(self, endpoints, origin, **options):
            return options

    np.testing.assert_array_equal(scan.insert_into(Target())["range_sigma"], sigma)
    assert "range_sigma" not in ndtree.Scan(ENDPOINTS, np.zeros(2)).insert_into(Target())


@pytest.mark.parametrize(
    "sigma, message",
    [
        (np.ones(3), r"range_sigma has shape \(3,\): must be \(4,\) for endpoints of shape \(4, 2\)"),
        ([1, 2, 0, 4], "range_sigma = 0 m of beam 2: must be > 0 and finite"),
        ([1, -1, 2, 4], "range_sigma = -1 m of beam 1: must be > 0 and finite"),
        ([1, 1, 2, np.inf], "range_sigma = inf m of beam 3"),
        ([np.nan, 1, 2, 3], "range_sigma = nan m of beam 0"),
    ],
)
def test_a_wrong_sigma_is_refused(sigma, message):
    with pytest.raises(ValueError, match=message):
        ndtree.Scan(ENDPOINTS, np.zeros(2), range_sigma=sigma)


def test_a_comparison_without_the_beams_that_did_not_return():
    log = [ndtree.Scan(ENDPOINTS, np.zeros(2), RETURNED)] * 4
    free = ndtree.compare(log, ["adaptive"], held_out=0, no_return="free")
    ignored = ndtree.compare(log, ["adaptive"], held_out=0, no_return="ignore")
    assert free["beams"]["not_returned"] == 8 and ignored["beams"]["not_returned"] == 0
    assert free["beams"]["returned"] == ignored["beams"]["returned"] == 8
    assert ignored["parameters"]["no_return"] == "ignore"
    with pytest.raises(ValueError, match="no_return = 'guess': must be one of free, ignore"):
        ndtree.compare(log, no_return="guess")
