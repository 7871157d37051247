# SPDX-License-Identifier: BSD-3-Clause
"""Arrays in and out: a point or a grid of them where many points are, and no masked arrays."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from ndtree._native.results import Answers, InsertReport

#: Of each argument, how many axes belong to one entry: a vector has one, a number none. The first argument
#: says how many entries there are; the others have as many, or are one for all.
Axes = Mapping[str, int]

_POINTS: Axes = {"points": 1}
_BEAMS: Axes = {"points": 1, "origin": 1, "returned": 0, "range_sigma": 0}
_POSES: Axes = {"poses": 2}
_RAYS: Axes = {"directions": 1, "origins": 1}

#: By the name of a method, with that of its class where another has one of the name.
TAKEN: dict[str, Axes] = {
    **dict.fromkeys("probability state occupied_within distance_to_occupied cell_size".split(), _POINTS),
    **dict.fromkeys("nearest_occupied layer distance gradient contains".split(), _POINTS),
    "OccupancyMap.moved": _POINTS,
    **dict.fromkeys(("insert", "evaluate", "MovedEvidence.add", "MovedEvidence.look"), _BEAMS),
    **dict.fromkeys(("cast_rays", "SimulatedLog2.distance", "SimulatedLog3.distance"), _RAYS),
    "states_in": {"lower": 1, "upper": 1},
    **dict.fromkeys(("collides", "path_collides", "information_gain"), _POSES),
}


def refuse_masked(call: str, given: Mapping[str, Any]) -> None:
    """Masked arrays would lose their mask without a word.

    Raises TypeError if one of the arguments is one.
    """
    masked = getattr(sys.modules.get("numpy.ma"), "MaskedArray", None)
    if masked is None:  # Before numpy.ma is loaded, which takes a while, no array is a masked one.
        return
    for name, value in given.items():
        if isinstance(value, masked):
            raise TypeError(
                f"{call}(): {name} is a masked array of shape {value.shape}: must be a plain one, "
                "with what is not masked alone"
            )


def flattened(
    axes: Axes, given: dict[str, Any], dim: Callable[[], int]
) -> tuple[dict[str, Any], tuple[int, ...] | None]:
    """Arguments as compiled functions take them, (n, ...), and the shape that results get.

    That is None where nothing was to do, or where the shape is wrong in a way that the function says better.
    """
    first = next((name for name in axes if name in given), None)
    if first is None or first != next(iter(axes)):
        return given, None
    own = axes[first]
    array = _array(given[first])
    if array is None or (array.ndim == own + 1 and first != "poses"):
        return given, None
    if first == "poses":
        return _posed(given, array, dim())
    if array.ndim < own or array.shape[-1] != dim():
        return given, None
    leading = array.shape[: array.ndim - own]
    changed = {**given, first: array.reshape(-1, *array.shape[array.ndim - own :])}
    for name, own in axes.items():
        if name == first or given.get(name) is None:
            continue
        other = _array(given[name])
        if other is not None and other.shape[: other.ndim - own] == leading and other.ndim >= own:
            changed[name] = other.reshape(changed[first].shape[0], *other.shape[other.ndim - own :])
    return changed, leading


#: Of a pose in space without a turn, what follows its position: a quaternion; in the plane an angle.
_UNTURNED = {2: (0.0,), 3: (0.0, 0.0, 0.0, 1.0)}


def _posed(
    given: dict[str, Any], array: np.ndarray[Any, Any], dim: int
) -> tuple[dict[str, Any], tuple[int, ...] | None]:
    """Poses as compiled functions take them, and the shape of what was given.

    A pose is a matrix (dim + 1, dim + 1); or x, y and yaw; or x, y, z and a quaternion; or a position alone.
    In the plane (3, 3) are three poses of x, y and yaw, and no matrix.
    """
    if dim not in _UNTURNED or not array.ndim or array.dtype.kind not in "fiub":
        return given, None
    last, whole = array.shape[-1], dim + len(_UNTURNED[dim])
    if last == dim:
        turns = np.broadcast_to(np.array(_UNTURNED[dim]), (*array.shape[:-1], whole - dim))
        array = np.concatenate([array.astype(np.float64), turns], axis=-1)
    elif array.ndim >= 2 and array.shape[-2:] == (dim + 1, dim + 1) and not (dim == 2 and array.ndim == 2):
        leading = array.shape[:-2]
        return {**given, "poses": array.reshape(-1, dim + 1, dim + 1)}, leading
    elif last != whole:
        turned = "x, y and yaw" if dim == 2 else "x, y, z, qx, qy, qz and qw"
        raise ValueError(
            f"poses has shape {array.shape}: must be (n, {dim + 1}, {dim + 1}), (n, {whole}) of {turned}, "
            f"or (n, {dim}) of {', '.join('xyz'[: dim - 1])} and {'xyz'[dim - 1]}"
        )
    return {**given, "poses": array.reshape(-1, whole)}, array.shape[:-1]


def shaped(result: Any, leading: tuple[int, ...]) -> Any:
    """A result (n, ...) in the shape of what was asked; a number of one point is one of Python's."""
    if isinstance(result, np.ndarray):
        answer = result.reshape(leading + result.shape[1:])
        return answer if answer.ndim else answer.item()
    if isinstance(result, tuple):
        return tuple(shaped(one, leading) for one in result)
    if isinstance(result, Answers):
        return replace(result, **{f.name: shaped(getattr(result, f.name), leading) for f in fields(result)})
    if isinstance(result, InsertReport) and result.moved is not None:
        return replace(result, moved=result.moved.reshape(leading))
    return result


def _array(value: Any) -> np.ndarray[Any, Any] | None:
    """None where NumPy makes none of it: the function that gets it says what is wrong."""
    try:
        return np.asarray(value)
    except (ValueError, TypeError):
        return None
