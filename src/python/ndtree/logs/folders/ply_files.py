# SPDX-License-Identifier: BSD-3-Clause
"""PLY, ascii and binary of both byte orders: the vertices, whatever else an element or a vertex has."""

from __future__ import annotations

import codecs
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.failures import at_place, shown
from ndtree.logs.core.plain_file import are_numbers, numbers_of, open_regular
from ndtree.logs.poses.pose import Pose

_HEADER_LINES, _LINE_BYTES = 10_000, 1 << 16
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("long", "int64"), "i8"),
    **dict.fromkeys(("ulong", "uint64"), "u8"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_CAMERA = (*(f"view_p{axis}" for axis in "xyz"), *(f"{row}_axis{axis}" for row in "xyz" for axis in "xyz"))
_PLURALS = {"vertex": "vertices", "camera": "cameras"}


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    #: Type of the number of values of a list; None for a single value.
    count: str | None = None


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def ply_columns(path: str) -> list[NDArray[Any]]:
    """x, y and z of the vertices, each in the type that the file has.

    Raises ValueError if the header is not one, or the file ends before what it says.
    """
    with open_regular(path) as file:
        order, elements = _header(path, file)
        data = file.read()
    return _columns(path, (order, elements), data, "vertex", tuple("xyz"))


def ply_viewpoint(path: str) -> Pose:
    """Pose of the sensor by the element camera that PCL writes, whose axes are rows; else the identity."""
    with open_regular(path) as file:
        order, elements = _header(path, file)
        if [one.count for one in elements if one.name == "camera"] != [1]:
            return Pose.identity()
        data = file.read()
    found = np.concatenate(_columns(path, (order, elements), data, "camera", _CAMERA)).astype(np.float64)
    with at_place(f"{path}: element camera", "a position and a rotation"):
        return Pose.from_matrix(np.column_stack([found[3:].reshape(3, 3), found[:3]]))


def _columns(
    path: str, header: tuple[str, list[_Element]], data: bytes, name: str, wanted: tuple[str, ...]
) -> list[NDArray[Any]]:
    """Properties of the only element of a name."""
    order, elements = header
    found = [one for one in elements if one.name == name]
    if len(found) != 1:
        raise _damaged(path, f"{len(found)} elements {name!r}, expected one")
    names = [one.name.lower() if one.count is None else "" for one in found[0].properties]
    missing = [axis for axis in wanted if names.count(axis) != 1]
    if missing:
        raise ValueError(
            f"{path}: no property {' or '.join(missing)} of {_PLURALS[name]}, "
            f"found {', '.join(filter(None, names))}"
        )
    axes = [names.index(axis) for axis in wanted]
    if order:
        return _of_binary(path, (order, elements), data, name, axes)
    return _of_text(path, elements, data, name, axes)


def _header(path: str, file: Any) -> tuple[str, list[_Element]]:
    elements: list[_Element] = []
    order: str | None = None
    first = file.readline(_LINE_BYTES).removeprefix(codecs.BOM_UTF8)
    if first.strip() != b"ply" or not first.endswith(b"\n"):
        raise _damaged(path, "the header's lines end otherwise than by a line feed, expected 'ply'")
    for number in range(2, _HEADER_LINES):
        line = file.readline(_LINE_BYTES)
        fields = line.decode("utf-8", "replace").split()
        if not line:
            break
        if not fields or fields[0] in ("comment", "obj_info"):
            continue
        if fields == ["end_header"]:
            if order is None:
                raise _damaged(path, "no line format")
            return order, elements
        try:
            if fields[0] == "format":
                order = _ORDERS[fields[1]]
            elif fields[0] == "element":
                elements.append(_Element(fields[1], int(fields[2])))
                if elements[-1].count < 0:
                    raise ValueError
            elif fields[:2] == ["property", "list"]:
                count, kind, name = fields[2:]
                if _TYPES[count][0] == "f":
                    raise ValueError
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count]))
            elif fields[0] == "property":
                kind, name = fields[1:]
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
            else:
                raise ValueError
        except (ValueError, LookupError):
            found = " ".join(fields)[:60]
            raise _damaged(path, f"line {number}: found {found!r}, expected a line of a header") from None
    raise _damaged(path, "no line end_header")


def _of_text(
    path: str, elements: list[_Element], data: bytes, name: str, axes: list[int]
) -> list[NDArray[Any]]:
    """An instance a line."""
    lines = [line for line in data.splitlines() if line.strip()]
    start, found = 0, None
    for one in elements:
        part = lines[start : start + one.count]
        start += one.count
        if len(part) < one.count:
            raise _fewer(path, one, len(part))
        if one.name == name:
            found = _columns_of(path, one, part, axes)
    assert found is not None
    return found


def _columns_of(path: str, vertex: _Element, lines: list[bytes], axes: list[int]) -> list[NDArray[Any]]:
    has_lists = any(one.count for one in vertex.properties)
    columns: list[list[bytes]] = [[] for _ in axes]
    for i, line in enumerate(lines):
        values, places = line.split(), axes
        try:
            if has_lists:
                at, starts = 0, []
                for one in vertex.properties:
                    starts.append(at)
                    length = int(values[at]) if one.count else 0
                    if length < 0:
                        raise ValueError
                    at += 1 + length
                places = [starts[axis] for axis in axes]
            else:
                at = len(vertex.properties)
        except (ValueError, IndexError):
            at = -1
        if at != len(values):
            wanted = "as many as its lists say" if has_lists else str(len(vertex.properties))
            raise _damaged(path, f"{vertex.name} {i} has {len(values)} values, expected {wanted}")
        for column, place in zip(columns, places):
            column.append(values[place])
    kinds = [np.dtype(vertex.properties[axis].kind) for axis in axes]
    try:
        return [numbers_of(column, kind) for column, kind in zip(columns, kinds)]
    except ValueError:
        texts = (value.decode(errors="replace") for column in columns for value in column)
        wrong = next((text for text in texts if not are_numbers([text])), "")
        raise _damaged(path, f"found {shown(wrong)!r}, expected a number") from None


def _of_binary(
    path: str, header: tuple[str, list[_Element]], data: bytes, name: str, axes: list[int]
) -> list[NDArray[Any]]:
    order, elements = header
    at, found = 0, None
    for one in elements:
        if all(p.count is None for p in one.properties):
            columns, at = _fixed(path, order, one, data, at)
        else:
            columns, at = _with_lists(path, order, one, data, at)
        if one.name == name:
            found = [columns(axis) for axis in axes]
    assert found is not None
    return found


def _fixed(path: str, order: str, one: _Element, data: bytes, at: int) -> tuple[Any, int]:
    """The columns of an element without lists, and where the next begins."""
    dtype = np.dtype([(f"{i}", order + p.kind) for i, p in enumerate(one.properties)])
    if not one.properties:
        return None, at
    if (len(data) - at) // dtype.itemsize < one.count:
        raise _fewer(path, one, (len(data) - at) // dtype.itemsize)
    table = np.frombuffer(data, dtype, count=one.count, offset=at)
    return lambda axis: table[f"{axis}"], at + one.count * dtype.itemsize


def _with_lists(path: str, order: str, one: _Element, data: bytes, at: int) -> tuple[Any, int]:
    """As `_fixed`, of an element whose instances differ in length; runs of equal ones are read at once."""
    counts = [None if p.count is None else np.dtype(order + p.count) for p in one.properties]
    kinds = [np.dtype(order + p.kind) for p in one.properties]
    keeps = one.name in _PLURALS
    parts: list[list[NDArray[Any]]] = [[] for _ in kinds]
    done, run = 0, 1
    while done < one.count:
        columns: list[Any] = []
        size = 0
        for i, (count, kind) in enumerate(zip(counts, kinds)):
            length = 1
            if count is not None:
                if at + size + count.itemsize > len(data):
                    raise _fewer(path, one, done)
                length = int(np.frombuffer(data, count, 1, at + size)[0])
                columns.append((f"n{i}", count))
                size += count.itemsize
                if not 0 <= length <= len(data):
                    raise _damaged(path, f"{one.name} {done}: a list of {length} values")
            columns.append((f"{i}", kind, (length,)))
            size += kind.itemsize * length
        fitting = (len(data) - at) // size
        if fitting == 0:
            raise _fewer(path, one, done)
        table = np.frombuffer(data, np.dtype(columns), min(run, fitting, one.count - done), at)
        same = np.ones(len(table), bool)
        for i, count in enumerate(counts):
            if count is not None:
                same &= table[f"n{i}"] == table[f"n{i}"][0]
        equal = len(table) if same.all() else int(same.argmin())
        if keeps:
            for i, count in enumerate(counts):
                if count is None:
                    parts[i].append(table[f"{i}"][:equal, 0])
        done += equal
        at += equal * size
        run = run * 4 if equal == len(table) else max(1, run // 4)
    return lambda axis: np.concatenate(parts[axis]) if parts[axis] else np.zeros(0, np.float32), at


def _damaged(path: str, what: str) -> ValueError:
    return ValueError(f"{path}: cannot be read as PLY, cut off or damaged ({what})")


def _fewer(path: str, one: _Element, found: int) -> ValueError:
    if one.name == "vertex":
        return ValueError(f"{path}: found {found} points, expected {one.count} as its header says")
    return _damaged(path, f"found {found} of element {one.name}, expected {one.count} as its header says")
