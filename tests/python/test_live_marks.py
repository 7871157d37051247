# SPDX-License-Identifier: BSD-3-Clause
"""Marks of what passes, rule by rule, by a map of which the answers are given."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

import ndtree
from ndtree.live.passing import STAYS, Passing, hide

Column = tuple[int, int]


def noted(
    passing: Passing, stamp: float, hit: set[Column], came: set[Column], *, height: float | None = None
) -> set[Column]:
    """The marked columns of 1 m after a scan that hit some, of which some came into free space."""
    columns = sorted(hit | came)
    ends = np.array(columns, float).reshape(-1, 2) + 0.5
    origin = [0.0, 0.0]
    if height is not None:
        ends, origin = np.column_stack([ends, np.full(len(ends), height)]), [0.0, 0.0, 0.0]

    def moved(points: np.ndarray) -> np.ndarray:
        return np.array([tuple(np.floor(point[:2]).astype(int)) in came for point in points], float)

    def state(points: np.ndarray) -> np.ndarray:
        return np.full(len(points), -1)

    m: Any = SimpleNamespace(options={"min_cell_size": 1.0}, dim=ends.shape[1], moved=moved, state=state)
    passing.note(m, ndtree.Scan(ends, origin, stamp=stamp))
    places = passing.places()
    assert (places % 1.0 == 0.5).all(), "centres"
    return {tuple(place) for place in np.floor(places).astype(int).tolist()}


def beside(*columns: Column) -> set[Column]:
    return {(x + i, y + j) for x, y in columns for i in (-1, 0, 1) for j in (-1, 0, 1)}


TWO: set[Column] = {(5, -5), (6, -5)}
MARKED = beside(*TWO)


def begun(stays: float = STAYS) -> Passing:
    passing = Passing(lambda: stays)
    assert noted(passing, 0.0, set(), TWO) == MARKED
    return passing


def test_one_column_alone_is_an_edge() -> None:
    assert noted(Passing(lambda: STAYS), 0.0, set(), {(5, -5)}) == set()
    assert noted(Passing(lambda: STAYS), 0.0, {(6, -5)}, {(5, -5)}) == set()


def test_a_mark_that_nobody_hits_is_forgotten_in_the_end() -> None:
    passing = begun()
    assert noted(passing, 5.0 * STAYS, set(), set()) == MARKED
    assert noted(passing, 5.0 * STAYS + 0.1, set(), set()) == set()


def test_what_stays_loses_its_mark_where_it_is_hit() -> None:
    passing = begun()
    assert noted(passing, STAYS, TWO, set()) == MARKED
    assert noted(passing, STAYS + 0.1, TWO, set()) == MARKED - TWO


def test_what_comes_again_has_to_stand_anew() -> None:
    passing = begun()
    assert noted(passing, 1.5 * STAYS, set(), TWO) == MARKED
    assert noted(passing, 2.4 * STAYS, TWO, set()) == MARKED
    assert noted(passing, 2.6 * STAYS, TWO, set()) == MARKED - TWO


def test_what_is_hit_beside_a_mark_is_as_old_as_that() -> None:
    passing, third = begun(), (8, -5)
    assert noted(passing, 0.5 * STAYS, {third}, set()) == MARKED | {third}
    assert noted(passing, STAYS + 0.1, {third}, set()) == MARKED


def test_beside_an_old_mark_nothing_is_marked() -> None:
    assert noted(begun(), 1.5 * STAYS, {(8, -5)}, set()) == MARKED


def test_marks_of_a_time_to_come_are_forgotten() -> None:
    assert noted(begun(), -1.0, set(), set()) == set()


def test_heights_between_two_count_and_the_lower_one_itself() -> None:
    for height, expected in ((0.0, set()), (0.1, MARKED), (1.7, MARKED), (1.8, set())):
        passing = Passing(lambda: STAYS, lambda: (0.1, 1.8))
        assert noted(passing, 0.0, set(), TWO, height=height) == expected, height


def test_only_obstacles_that_are_new_are_hidden() -> None:
    before = np.zeros((3, 3), np.int8)
    before[0, 2] = 100  # Its lower corner is a pixel to the right: of column 3 then.
    values = np.full((4, 4), 100, np.int8)
    values[3, 3] = -1
    places = np.array([[3.5, 0.5], [2.5, 0.5], [0.5, 2.5], [3.5, 3.5], [9.5, 0.5]])
    hide(values, (0.0, 0.0), 1.0, places, (before, (1.0, 0.0)))
    assert {tuple(at) for at in np.argwhere(values == 0).tolist()} == {(0, 2), (2, 0)}
    assert values[3, 3] == -1


def test_what_comes_again_too_soon_does_not_begin_anew() -> None:
    passing, begin = Passing(lambda: STAYS), 10 * STAYS
    assert noted(passing, begin, set(), TWO) == MARKED
    assert noted(passing, begin + 0.5 * STAYS, set(), TWO) == MARKED
    assert noted(passing, begin + 1.2 * STAYS, TWO, set()) == MARKED - TWO


def test_points_without_a_sensor_and_heights_of_the_plane_say_nothing() -> None:
    ones = {"moved": lambda ends: np.ones(len(ends)), "state": lambda ends: np.zeros(len(ends))}
    m: Any = SimpleNamespace(options={"min_cell_size": 1.0}, dim=2, **ones)
    ends = np.array([[5.5, -4.5], [6.5, -4.5]])
    passing = Passing(lambda: STAYS, lambda: (0.0, 1.0))
    passing.note(m, ndtree.Scan(ends, np.zeros(2), points_only=True))
    assert not len(passing.places())
    passing.note(m, ndtree.Scan(ends, np.zeros(2)))
    assert len(passing.places()) == len(MARKED)
