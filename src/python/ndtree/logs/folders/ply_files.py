# SPDX-License-Identifier: BSD-3-Clause
"""PLY, ascii and binary of both byte orders: the vertices, whatever else an element or a vertex has."""

from __future__ import annotations

import codecs
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.failures import shown
from ndtree.logs.core.plain_file import open_regular

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

    @property
    def has_lists(self) -> bool:
        """Whether instances may differ in length."""
        return any(one.count for one in self.properties)

    def dtype(self, order: str) -> np.dtype[Any]:
        """Layout of an instance without lists in binary data; fields are called by their numbers."""
        return np.dtype([(f"{i}", order + one.kind) for i, one in enumerate(self.properties)])


def ply_columns(path: str) -> list[NDArray[Any]]:
    """x, y and z of the vertices, each in the type that the file has.

    Raises ValueError if the header is not one, or the file ends before what it says.
    """
    with open_regular(path) as file:
        order, elements = _header(path, file)
        data = file.read()
    return _columns(path, (order, elements), data, "vertex", tuple("xyz"))


def ply_camera(path: str) -> tuple[Floats, Floats] | None:
    """Position (3,) and rotation (3, 3) of the sensor in the map, from the element camera that PCL writes.

    None where the file has none. Its rows are what PCL calls axes.
    """
    with open_regular(path) as file:
        order, elements = _header(path, file)
        if [one.count for one in elements if one.name == "camera"] != [1]:
            return None
        data = file.read()
    found = np.concatenate(_columns(path, (order, elements), data, "camera", _CAMERA)).astype(np.float64)
    return found[:3], found[3:].reshape(3, 3)


def _columns(
    path: str, header: tuple[str, list[_Element]], data: bytes, name: str, wanted: tuple[str, ...]
) -> list[NDArray[Any]]:
    """Properties of the only element of a name."""
    order, elements = header
    found = [one for one in elements if one.name == name]
    if len(found) != 1:
        raise _damaged(path, f"{len(found)} elements {name!r}, expected one")
    (element,) = found
    names = [one.name.lower() if one.count is None else "" for one in element.properties]
    missing = [axis for axis in wanted if names.count(axis) != 1]
    if missing:
        some = ", ".join(filter(None, names))
        raise ValueError(f"{path}: no property {' or '.join(missing)} of {_PLURALS[name]}, found {some}")
    before = [one for one in elements[: elements.index(element)] if one.count]
    with_lists = next((one for one in (*before * bool(order), element) if one.has_lists), None)
    if with_lists is not None:
        raise ValueError(
            f"{path}: lists in element {with_lists.name}, expected {_PLURALS[name]} of single values before "
            "others: CloudCompare saves them so"
        )
    axes = [names.index(axis) for axis in wanted]
    if not order:
        lines = [line for line in data.splitlines() if line.strip()]
        return _of_text(path, element, lines[sum(one.count for one in before) :], axes)
    data = data[sum(one.count * one.dtype(order).itemsize for one in before) :]
    dtype = element.dtype(order)
    if len(data) // dtype.itemsize < element.count:
        raise _fewer(path, element, len(data) // dtype.itemsize)
    table = np.frombuffer(data, dtype, count=element.count)
    return [table[f"{axis}"] for axis in axes]


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


def _of_text(path: str, element: _Element, lines: list[bytes], axes: list[int]) -> list[NDArray[Any]]:
    """An instance a line."""
    lines = lines[: element.count]
    if len(lines) < element.count:
        raise _fewer(path, element, len(lines))
    rows = [line.split() for line in lines]
    width = len(element.properties)
    for i, row in enumerate(rows):
        if len(row) != width:
            raise _damaged(path, f"{element.name} {i} has {len(row)} values, expected {width}")
    columns = []
    for axis in axes:
        kind = np.dtype(element.properties[axis].kind)
        column = np.array([row[axis] for row in rows], dtype="S")
        try:
            columns.append(column.astype(np.float64).astype(kind if kind.kind == "f" else np.float64))
        except ValueError:
            wrong = next((row[axis] for row in rows if not _is_number(row[axis])), b"")
            said = shown(wrong.decode(errors="replace"))
            raise _damaged(path, f"found {said!r}, expected a number") from None
    return columns


def _is_number(value: bytes) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def _damaged(path: str, what: str) -> ValueError:
    return ValueError(f"{path}: cannot be read as PLY, cut off or damaged ({what})")


def _fewer(path: str, one: _Element, found: int) -> ValueError:
    if one.name == "vertex":
        return ValueError(f"{path}: found {found} points, expected {one.count} as its header says")
    return _damaged(path, f"found {found} of element {one.name}, expected {one.count} as its header says")
