# SPDX-License-Identifier: BSD-3-Clause
"""Wrong values in calls of public functions and methods are named in one sentence; nothing hangs."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ndtree

LOG = ndtree.simulate("office", scans=3)
SCAN = LOG[0]
MAP = ndtree.AdaptiveMap(dim=2)
SCAN.insert_into(MAP)
PLANNER = ndtree.Planner(MAP, ndtree.Sphere(0.1), unknown="free")
HISTORY = ndtree.ScanHistory(dim=2)
HISTORY.insert(0, SCAN.endpoints - SCAN.origin, [*SCAN.origin, 0.0])
MATCHER, MOVED = MAP.matcher(), ndtree.MovedEvidence(dim=2)
WRONG: tuple[Any, ...] = (
    None, "x", b"x", math.nan, math.inf, -1, 1e300, 1e-300, 2**80, [], [[]], {"a": 1}, print, 1 + 2j,
    np.timedelta64(1),
    np.zeros(0), np.zeros((2, 5)), np.array(["a"]), np.array([None, 1]), np.full((2, 2), np.nan),
    [[1, 2], [3]], ("a", 1), SCAN, ndtree.Sphere(1.0),
)  # fmt: skip
#: What a call needs that shall fail by another argument.
RIGHT: dict[str, Any] = {
    "log": LOG, "scans": [SCAN], "target": MAP, "endpoints": SCAN.endpoints, "origin": SCAN.origin, "dim": 2,
    "path": "a.npz", "source": MAP, "a": MAP, "b": MAP, "world": "office", "which": slice(3), "scan": SCAN,
    "points": SCAN.endpoints, "start": [2.0, 4.0], "goal": [3.0, 4.0], "goals": [[3.0, 4.0]], "frontiers": [],
    "storage": "a.tiles", "m": MAP, "url": "a.tiles", "i": 0, "name": "a.npz", "poses": [[0, 0, 0]],
    "body": ndtree.Sphere(0.1), "lower": [0, 0], "upper": [1, 1], "box": [[0, 0], [1, 1]], "cell_size": 0.1,
    "max_distance": 1.0, "directions": [[1.0, 0.0]], "spacing": 0.1, "max_range": 9.0, "radius": 1.0,
    "guess": (0, 0, 0), "window": (0.1, 0.1, 0.1), "other": MAP, "since": MAP, "value": "occupied",
    "key": 0, "keys": [0], "pose": (0, 0, 0), "count": 0,
}  # fmt: skip
#: What another library, or Python itself, says of values; and what is in several lines.
FOREIGN = re.compile(
    r"pybind|Unable to cast|incompatible|object is not|has no attribute|not supported between|truth value|"
    r"could not convert|another kind than|inhomogeneous|ufunc|invalid literal|\bint\(\)|float\(\)|"
    r"cannot convert|broadcast|\n"
)
#: These take seconds, open a page, or take what Python checks by itself.
ELSEWHERE = {"view", "compare", "calibrate", "align", "first_look", "inspect"}


def calls() -> Iterator[tuple[str, Callable[..., Any]]]:
    for name in ndtree.__all__:
        held = getattr(ndtree, name)
        if inspect.isfunction(held) and name not in ELSEWHERE:
            yield name, held
    for made in (ndtree.Sphere, ndtree.Scan, ndtree.DelayedMoved, ndtree.RangeSensor, ndtree.Planner):
        yield made.__name__, made
    for owner in (MAP, LOG, SCAN, PLANNER, HISTORY, MATCHER, MOVED):
        for name in dir(type(owner)):
            if not name.startswith("_") and callable(held := getattr(owner, name, None)):
                yield f"{type(owner).__name__}.{name}", held


def parameters(call: Callable[..., Any]) -> list[inspect.Parameter]:
    kinds = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return [one for one in inspect.signature(call).parameters.values() if one.kind not in kinds]


@pytest.mark.parametrize("name, call", [pytest.param(*one, id=one[0]) for one in calls()])
def test_a_wrong_value_is_named_in_a_sentence(
    name: str, call: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    needed = {
        one.name: RIGHT[one.name]
        for one in parameters(call)
        if one.default is one.empty and one.name in RIGHT
    }
    for one in parameters(call):
        if one.name in ("progress", "observe"):
            continue
        for value in WRONG:
            try:
                call(**{**needed, one.name: value})
            except (
                TypeError,
                ValueError,
                OSError,
                MemoryError,
                RuntimeError,
                ImportError,
                LookupError,
            ) as error:
                assert not FOREIGN.search(str(error)), (name, one.name, value, error)


def test_the_values_of_calls_that_take_long_are_named_as_well() -> None:
    for call, argument, value, expected in (
        (ndtree.align, "log", 3, "an ndtree.Log"),
        (ndtree.align, "max_range", "far", "a number"),
        (ndtree.calibrate, "limit", "few", "an integer or None"),
        (ndtree.compare, "maps", 3, "different names of maps or None"),
        (ndtree.compare, "maps", [None], "different names of maps or None"),
        (ndtree.inspect, "source", 3, "an ndtree.Log or a path"),
    ):
        needed = {"source": LOG} if call is ndtree.inspect else {"log": LOG}
        with pytest.raises(
            TypeError, match=re.escape(f"{call.__name__}(): {argument} = {value!r}: must be {expected}") + "$"
        ):
            call(**{**needed, argument: value})


@pytest.mark.parametrize("call, said", [
    (lambda: ndtree.Scan(np.zeros((2, 2), complex), [0, 0]), r"endpoints = array of .* complex128: must be"),
    (lambda: ndtree.Scan(np.zeros((2, 2), "M8[s]"), [0, 0]), r"endpoints = array of .*: must be an array"),
    (lambda: ndtree.Scan(SCAN.endpoints, SCAN.origin, points_only="no"), r"points_only = 'no': must be True"),
    (lambda: ndtree.Scan(SCAN.endpoints, SCAN.origin, heading="x"), r"heading = 'x': must be a number"),
    (lambda: ndtree.DelayedMoved(dim=2, after=math.nan), r"after = nan: must be an integer"),
    (lambda: ndtree.DelayedMoved(dim=2, max_range=math.nan), r"max_range = nan m: must be > 0"),
    (lambda: HISTORY.remove(0), r"remove\(\): keys = 0: must be several integers, as \[0, 1\]"),
    (lambda: MAP.matcher(np.full((2, 2), math.nan)), r"box: from nan to nan m on axis 0: must be finite"),
    (lambda: MOVED.add(SCAN.endpoints, SCAN.origin, max_range=math.nan), r"max_range = nan m: must be > 0"),
    (lambda: MOVED.look(SCAN.endpoints, SCAN.origin, max_range=-1), r"max_range = -1.0 m: must be > 0"),
])  # fmt: skip
def test_nonsense_is_not_taken(call: Callable[[], Any], said: str) -> None:
    with pytest.raises((TypeError, ValueError), match=said):
        call()


def test_what_says_more_of_the_argument_stays() -> None:
    with pytest.raises(TypeError, match=r"^log = 'a.npz': expected a Log, as of:\n  ndtree.read\('a.npz'\)$"):
        ndtree.align("a.npz")  # type: ignore[arg-type]


def test_an_error_inside_is_not_hidden_by_what_is_right(tmp_path: Path) -> None:
    def observe(*_: object) -> None:
        raise AttributeError("of the caller's own")

    with pytest.raises(AttributeError, match="of the caller's own"):
        LOG.save(tmp_path / "a.npz", progress=observe)
