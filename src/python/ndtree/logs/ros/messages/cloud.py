# SPDX-License-Identifier: BSD-3-Clause
"""PointCloud2 to beams in the sensor's own frame, with the times of the points where the cloud has them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.base.words import number_of
from ndtree.logs.core.arrays import Bools
from ndtree.logs.core.silence import without_padding
from ndtree.logs.ros.messages.beams import (
    LONGEST_SWEEP,
    LOOKED_AT,
    SENSELESS,
    SWAPPED,
    Beams,
    Floats,
    is_swapped,
    pitch_of,
)  # fmt: skip

_FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}

#: What drivers call the time of a point: Velodyne, Ouster, Hesai and RoboSense, Livox, and others.
_TIMES = ("t", "time", "timestamp", "time_stamp", "offset_time", "time_offset")
#: Fields with a colour, 0x00RRGGBB, whatever type they say it is.
_COLORS = ("rgb", "rgba")
#: Units of times [s], and the shortest sweep that they are told apart by [s].
_UNITS, SHORTEST_SWEEP = (1.0, 1e-3, 1e-6, 1e-9), 1e-3


def cloud_beams(message: Any, stamp: float, *, colored: bool = False) -> Beams:
    """Points of a PointCloud2 with fields x, y and z of any type, byte order and layout.

    NaN is invalid, and so is padding. A message without points may be without fields, too. Where the points
    without space between rows need all bytes, `row_step` is not asked: many drivers set it wrong. Where
    `colored`, colours are read of a field rgb or rgba, if there is one, as PCL packs them.
    """
    height, width, step = int(message.height), int(message.width), int(message.point_step)
    data = np.asarray(message.data, dtype=np.uint8)
    if width and not height and len(data) == width * step:  # Of one row some say that it is none.
        height = 1
    if not height or not width or not (len(data) or message.fields):
        return Beams(np.zeros((0, 3), dtype=np.float32))
    by_name = {field.name: field for field in message.fields}
    missing = [name for name in ("x", "y", "z") if name not in by_name]
    if missing:
        said = f"the cloud has no field {' or '.join(missing)}"
        raise ValueError(f"{said}, expected x, y and z, found {', '.join(by_name) or 'none'}")
    names = ["x", "y", "z", *(name for name in _TIMES if name in by_name)][:4]
    order = ">" if message.is_bigendian else "<"
    formats, offsets = [], []
    for name in names:
        field = by_name[name]
        if field.datatype not in _FIELD_TYPES:
            raise ValueError(f"field {name} of the cloud has type {field.datatype}, expected 1 to 8")
        formats.append(order + _FIELD_TYPES[field.datatype])
        offsets.append(int(field.offset))
    row_step = pitch_of(int(message.row_step), height, width * step, len(data))
    for name, kind, offset in zip(names, formats, offsets):
        if (end := offset + np.dtype(kind).itemsize) > step:
            said = f"field {name} of the cloud ends at byte {end} of a point"
            raise ValueError(f"{said}, expected at most point_step = {step}")
    needed = (height - 1) * row_step + width * step
    if width * step > row_step or len(data) < needed:
        rows = f"{number_of(height, 'row')} of {row_step} bytes and {width} points of {step}"
        raise ValueError(f"the cloud has {len(data)} bytes, expected {needed} for {rows}")
    layout = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    table = np.ndarray((height, width), layout, np.ascontiguousarray(data), strides=(row_step, step))
    first = np.concatenate([table[axis].ravel()[:LOOKED_AT] for axis in "xyz"])
    swapped = all(kind[1] == "f" for kind in formats[:3]) and is_swapped(first)
    if swapped:
        table = table.view(layout.newbyteorder())
    kind = np.float32 if all(kind[1:] == "f4" for kind in formats[:3]) else np.float64
    points = np.empty((height, width, 3), dtype=kind)
    for axis, name in enumerate(("x", "y", "z")):
        points[:, :, axis] = table[name]
    flat = without_padding(points.reshape(-1, 3))
    color = next((by_name[name] for name in _COLORS if name in by_name), None)
    colors = None
    if colored and color is not None and 0 <= color.offset <= step - 4:
        strides = (row_step, step)
        packed = np.ndarray((height, width), order + "u4", np.ascontiguousarray(data), color.offset, strides)
        colors = (packed.reshape(-1, 1) >> np.array([16, 8, 0], np.uint32)).astype(np.uint8)
    odd = {SWAPPED: f"{len(flat)} points"} if swapped else {}
    times = None
    if len(names) > 3:
        times, wrong = times_of(table[names[3]].ravel(), stamp, np.isfinite(flat).all(axis=1))
        odd = {**odd, SENSELESS: f"{names[3]} {wrong}"} if wrong else odd
    return Beams(flat, times=times, colors=colors, odd=odd)


def times_of(values: NDArray[Any], stamp: float, measured: Bools) -> tuple[Floats | None, str]:
    """Times of points since the message's stamp [s], whatever their unit and their beginning.

    The unit is the one of s, ms, us and ns in which they last between 1 ms and 1 s: there is only one. They
    are absolute where they then lie within a sweep of the stamp, else they count from it. Padding may have
    any time: where it makes no sense, only points that were `measured` are asked.

    Returns times ndarray of float64, or None: None where the points have one time, or senseless ones; wrong
    str: What is wrong with senseless times.
    """
    wrong = ""
    finite = np.isfinite(values.astype(np.float64))
    for known in (finite, finite & measured):
        times, wrong = _times_of_known(values, stamp, known)
        if times is not None:
            return times, ""
    return None, wrong


def _times_of_known(values: NDArray[Any], stamp: float, known: Bools) -> tuple[Floats | None, str]:
    if not known.any():
        return None, ""
    times = values.astype(np.float64)
    first, last = float(times[known].min()), float(times[known].max())
    if first == last:
        return None, ""
    wrong = f"from {first:.6g} to {last:.6g}"
    for unit in _UNITS:
        if SHORTEST_SWEEP <= (last - first) * unit < LONGEST_SWEEP:
            break
    else:
        return None, wrong
    # Absolute times are subtracted in their own type: nanoseconds since 1970 have no room in a double.
    begin = values[known][int(times[known].argmin())]
    since_first = np.where(known, (values - begin).astype(np.float64) * unit, 0.0)
    for offset in (float(begin) * unit - stamp, float(begin) * unit):
        if abs(offset) <= LONGEST_SWEEP:
            return since_first + offset, ""
    return None, f"{wrong}, the stamp being {stamp:.6g} s"
