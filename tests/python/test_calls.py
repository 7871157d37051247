# SPDX-License-Identifier: BSD-3-Clause
"""A wrong call is told in one short line which argument is wrong, and what is expected."""

from __future__ import annotations

import pickle
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ndtree
from ndtree._native import _core
from ndtree._native._methods import _ELSEWHERE

POINTS, ORIGIN = np.ones((3, 2)), np.zeros(2)
M = ndtree.AdaptiveMap(dim=2)

WRONG: dict[str, tuple[Callable[[], Any], str]] = {
    "missing": (lambda: M.insert(POINTS), "insert(): origin is missing, expected points, origin, "),
    "unknown": (lambda: M.cast_rays(ORIGIN, POINTS, far=3),
        "cast_rays(): no argument far, expected origins, directions, max_range"),
    "too many": (lambda: M.stats(1), "stats(): 1 argument without a name, expected none"),
    "not by name": (lambda: ndtree.AdaptiveMap(0.05),
        "AdaptiveMap(): 1 argument without a name, expected none: did you mean min_cell_size = 0.05?"),
    "a file as what a map is made of": (lambda: ndtree.FixedMap("hall.ndt"),
        "FixedMap(): 1 argument without a name, expected none: did you mean ndtree.load('hall.ndt')?"),
    "a number of NumPy": (lambda: ndtree.FixedMap(np.float64(0.5)),
        "FixedMap(): 1 argument without a name, expected none: did you mean min_cell_size = 0.5?"),
    "fixed, not by name": (lambda: ndtree.FixedMap(0.1, 2),
        "FixedMap(): 2 arguments without names, expected none; the others by name: min_cell_size, dim, "),
    "what goes by name": (lambda: ndtree.MovedEvidence(2, 0.1),
        "MovedEvidence(): 2 arguments without names, expected none; the others by name: dim, cell_size, "),
    "some by name": (lambda: M.insert(POINTS, ORIGIN, None),
        "insert(): 3 arguments without names, expected at most 2 (points, origin); the others by name: ret"),
    "no scans": (lambda: ndtree.SeenSpace(POINTS),
        "SeenSpace(): scans = array of shape (3, 2) and dtype float64: must be several, each an ndtree.Scan"),
    "no number": (lambda: M.insert(POINTS, ORIGIN, max_range="x"),
        "insert(): max_range = 'x': must be a number"),
    "one text for several": (lambda: ndtree.AdaptiveMap(dim=2).leaves(states="free"),
        "leaves(): states = 'free': must be several texts, as ['...', '...']"),
    "no integer": (lambda: ndtree.AdaptiveMap(dim=2.5), "AdaptiveMap(): dim = 2.5: must be an integer"),
    "no constructor": (lambda: ndtree.OccupancyMap(dim=2),
        "OccupancyMap(): has no constructor, expected AdaptiveMap or FixedMap"),
    "no path": (lambda: M.save(3), "save(): path = 3: must be a path"),
    "no bytes": (lambda: ndtree.from_bytes("x"), "from_bytes(): bytes = 'x': must be bytes"),
    "no text": (lambda: ndtree.AdaptiveMap(dim=2, refinement=1),
        "AdaptiveMap(): refinement = 1: must be a text"),
    "no body": (lambda: M.plan((0, 0), (1, 1), body=0.3),
        "plan(): body = 0.3: must be an ndtree.Sphere, Capsule or Box, or several joined by |"),
    "no map": (lambda: ndtree.Planner(3, ndtree.Sphere(0.3)),
        "Planner(): map = 3: must be an ndtree.OccupancyMap"),
    "twice": (lambda: M.insert(POINTS, origin=ORIGIN, points=POINTS), "insert(): points is given twice"),
    "twice, of lines": (lambda: M.state(POINTS, points=np.zeros((2, 3, 2))),
        "state(): points is given twice"),
    "none at all": (lambda: M.save(None), "save(): path = None: must be a path"),
    "a long text": (lambda: M.insert(POINTS, ORIGIN, max_range="x" * 10**6), "insert(): max_range = 'xxxx"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_in_one_line(case: str) -> None:
    call, expected = WRONG[case]
    with pytest.raises(TypeError) as caught:
        call()
    said = str(caught.value)
    assert said.startswith(expected) and "\n" not in said and len(said) < 300
    assert caught.value.__cause__ is None and caught.value.__context__ is None


BEYOND: dict[str, tuple[Callable[[], Any], str]] = {
    "dim": (lambda: ndtree.AdaptiveMap(dim=10**300),
        "AdaptiveMap(): dim = an integer of 997 bits: must be from 2 to 4"),
    "threads": (lambda: M.insert(np.zeros((1000, 2)), ORIGIN, threads=2**31),
        "insert(): threads = 2147483648: must be from 0 to 2147483647"),
    "number": (lambda: M.insert(POINTS, ORIGIN, number=2**63),
        "insert(): number = 9223372036854775808: must be from 0 to 9223372036854775807"),
    "max_leaves": (lambda: M.compress(max_leaves=-1),
        "compress(): max_leaves = -1: must be from 0 to 18446744073709551615"),
    "max_bytes": (lambda: M.compress(max_bytes=10**30),
        f"compress(): max_bytes = {10**30}: must be from 0 to 18446744073709551615"),
    "max_loss": (lambda: M.compress(max_loss=float("nan")), "max_loss = nan: must be >= 0 bits"),
    "scans": (lambda: _core.simulate("office", scans=-3),
        "simulate(): scans = -3: must be from 0 to 18446744073709551615"),
}  # fmt: skip


@pytest.mark.parametrize("name", BEYOND)
def test_numbers_out_of_bounds_are_values_that_are_wrong(name: str) -> None:
    call, expected = BEYOND[name]
    with pytest.raises(ValueError) as caught:
        call()
    assert str(caught.value) == expected
    assert caught.value.__cause__ is None and caught.value.__context__ is None


def test_own_errors_pass_as_they_are() -> None:
    with pytest.raises(TypeError, match="points has dtype <U1: must be an array of real numbers"):
        M.insert("a", ORIGIN)
    with pytest.raises(TypeError, match="no_such"):
        ndtree.AdaptiveMap(no_such=1)
    with pytest.raises(ValueError, match="shape"):
        M.insert(np.ones((3, 3)), ORIGIN)


def test_functions_keep_their_names_and_words() -> None:
    assert ndtree.load.__name__ == "load" and "Read a map" in (ndtree.load.__doc__ or "")
    assert pickle.loads(pickle.dumps(ndtree.load)) is ndtree.load
    m = ndtree.AdaptiveMap(dim=2)
    assert m.insert(points=POINTS, origin=ORIGIN).returned == 3
    assert m.insert.__doc__ == ndtree.AdaptiveMap.insert.__doc__


def test_names_of_other_libraries_are_answered_with_ours() -> None:
    for name, meant in {"insertPointCloud": "insert", "cast_ray": "cast_rays", "size": "stats"}.items():
        with pytest.raises(AttributeError, match=f"^AdaptiveMap has no {name}: did you mean {meant}"):
            getattr(M, name)
    with pytest.raises(AttributeError, match="has no attribute 'qwertz'"):
        _ = M.qwertz  # type: ignore[attr-defined]
    assert all(hasattr(M, re.split(r"\W", meant)[0]) for meant in _ELSEWHERE.values())


def test_odd_values_that_may_be_meant_are_warned_of(tmp_path: Path) -> None:
    with pytest.warns(
        UserWarning, match="^range_sigma = 20: is more than the largest cells, 1.6 m: expected"
    ):
        ndtree.AdaptiveMap(dim=2, range_sigma=20)
    rooms = ndtree.AdaptiveMap(dim=3)
    rooms.insert(np.ones((1, 3)), np.zeros(3))
    with pytest.warns(UserWarning, match="^height is not given: cells at all heights are drawn"):
        rooms.save(tmp_path / "rooms.yaml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ndtree.AdaptiveMap(dim=2, range_sigma=1.6)
        ndtree.FixedMap(dim=2, range_sigma=20)
        ndtree.convert(rooms, tmp_path / "rooms.yaml", height=(0.0, 2.0))
