# SPDX-License-Identifier: BSD-3-Clause
"""PCD of all versions: ascii, binary and binary_compressed; of the fields, x y z are read."""

from __future__ import annotations

import codecs
import itertools
import struct
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._lazy import needs
from ndtree.logs.core.failures import one_line
from ndtree.logs.core.plain_file import numbers_of, open_regular

#: No header is longer; it ends with its line DATA.
_HEADER_LINES, _LINE_BYTES = 200, 1 << 16
#: LZF makes 264 bytes of 3 at most.
_MOST_UNPACKED = 88
_ENCODINGS = ("ascii", "binary", "binary_compressed")
_TYPES = {"F": "f", "I": "i", "U": "u"}
_KEYWORDS = frozenset("VERSION FIELDS COLUMNS SIZE TYPE COUNT WIDTH HEIGHT VIEWPOINT POINTS DATA".split())


@dataclass(frozen=True)
class PcdHeader:
    """What the header says: name, type and count of each field, number of points, and how they are kept."""

    fields: tuple[str, ...]
    types: tuple[np.dtype[Any], ...]
    counts: tuple[int, ...]
    points: int
    encoding: str

    def dtype(self, zero_is: int) -> np.dtype[Any]:
        """Layout of a point in binary data, where a field of COUNT 0 has `zero_is` values."""
        counts = self.columns(zero_is)
        return np.dtype([(f"{i}", kind, (counts[i],)) for i, kind in enumerate(self.types)])

    def columns(self, zero_is: int) -> list[int]:
        """Number of values of each field in a line of ascii data."""
        return [count or zero_is for count in self.counts]


def pcd_columns(path: str) -> list[NDArray[Any]]:
    """x, y and z of the points, each in the type that the file has.

    VERSION, COUNT, HEIGHT, VIEWPOINT and, in old files, SIZE and TYPE may be missing. A field of COUNT 0 has
    no values, or one where only that fits the data. Beside such fields, padding (``_``) may be missing.

    Raises ValueError if the header is not one, or there are more or fewer points than it says.
    """
    with open_regular(path) as file:
        header = _header(path, file)
        data = file.read()
    axes = []
    for axis in "xyz":
        if axis not in header.fields:
            missing = " or ".join(name for name in "xyz" if name not in header.fields)
            raise ValueError(f"{path}: no field {missing}, found {', '.join(header.fields)}")
        i = header.fields.index(axis)
        if header.counts[i] != 1:
            raise ValueError(f"{path}: field {axis} has COUNT {header.counts[i]}, expected 1")
        axes.append(i)
    if header.encoding == "ascii":
        return _of_text(path, header, data, axes)
    if header.encoding == "binary":
        table = binary_table(path, header, data)
        return [table[f"{i}"].reshape(-1) for i in axes]
    _, columns = unpacked(path, header, data)
    return [columns[i].reshape(-1)[: header.points] for i in axes]


def _header(path: str, file: Any) -> PcdHeader:
    lines: dict[str, list[str]] = {}
    for number in range(1, _HEADER_LINES + 1):
        line = file.readline(_LINE_BYTES)
        if number == 1:
            line = line.removeprefix(codecs.BOM_UTF8)
        fields = line.decode("utf-8", "replace").split("#", 1)[0].split()
        if not line:
            break
        if not fields:
            continue
        if fields[0].upper() not in _KEYWORDS:
            raise _damaged(path, f"line {number}: found {fields[0][:40]!r}, expected a PCD's header")
        lines[fields[0].upper()] = fields[1:]
        if fields[0].upper() == "DATA":
            return _parsed(path, lines)
    raise _damaged(path, "no line DATA, expected the end of the header")


def _parsed(path: str, lines: dict[str, list[str]]) -> PcdHeader:
    names = lines.get("FIELDS") or lines.get("COLUMNS")
    if not names:
        raise _damaged(path, "no line FIELDS")
    sizes = _integers(path, lines, "SIZE", [4] * len(names))
    counts = _integers(path, lines, "COUNT", [1] * len(names))
    kinds = [kind.upper() for kind in lines.get("TYPE", ["F"] * len(names))]
    for what, values in (("SIZE", sizes), ("COUNT", counts), ("TYPE", kinds)):
        if len(values) != len(names):
            raise _damaged(path, f"{what} has {len(values)} values for {len(names)} fields")
    types = []
    for name, kind, size in zip(names, kinds, sizes):
        if kind not in _TYPES or size not in ((2, 4, 8) if kind == "F" else (1, 2, 4, 8)):
            what = f"field {name}: TYPE {kind} of SIZE {size}"
            raise _damaged(path, f"{what}, expected F of 4 or 8, I or U of 1 to 8")
        types.append(np.dtype(f"<{_TYPES[kind]}{size}"))
    if sum(counts) > 1 << 20:
        raise _damaged(path, f"COUNT of {sum(counts)} values a point")
    shape = [_integers(path, lines, what, default) for what, default in (("WIDTH", []), ("HEIGHT", [1]))]
    if "POINTS" in lines:
        points = _integers(path, lines, "POINTS", [])
    elif shape[0]:
        points = [shape[0][0] * shape[1][0]]
    else:
        raise _damaged(path, "neither POINTS nor WIDTH")
    encoding = " ".join(lines["DATA"]).lower()
    if len(points) != 1 or encoding not in _ENCODINGS:
        raise _damaged(path, f"found DATA {encoding[:40]!r}, expected {', '.join(_ENCODINGS)}")
    return PcdHeader(tuple(names), tuple(types), tuple(counts), points[0], encoding)


def _integers(path: str, lines: dict[str, list[str]], what: str, default: list[int]) -> list[int]:
    if what not in lines:
        return default
    try:
        found = [int(value) for value in lines[what]]
    except ValueError:
        found = []
    if not found or min(found) < 0 or max(found) > 1 << 40:
        raise _damaged(path, f"found {what} {' '.join(lines[what])[:40]!r}, expected whole numbers from 0")
    return found


def _of_text(path: str, header: PcdHeader, data: bytes, axes: list[int]) -> list[NDArray[Any]]:
    rows = [row for row in (line.split() for line in data.splitlines()) if row]
    if len(rows) != header.points:
        raise _other_number(path, len(rows), header.points)
    width = len(rows[0]) if rows else 0
    zero_is = 1 if 0 in header.counts and rows and width == sum(header.columns(1)) else 0
    columns = header.columns(zero_is)
    if rows and width != sum(columns):
        raise _damaged(path, f"point 0 has {width} values, expected {sum(columns)}")
    for i, row in enumerate(rows):
        if len(row) != width:
            raise _damaged(path, f"point {i} has {len(row)} values, expected {width}")
    starts = np.concatenate([[0], np.cumsum(columns)]).tolist()
    try:
        return [numbers_of([row[starts[i]] for row in rows], header.types[i]) for i in axes]
    except ValueError as error:
        raise _damaged(path, one_line(error)) from None


def binary_table(path: str, header: PcdHeader, data: bytes) -> NDArray[Any]:
    """Points as binary data has them, in fields that are called by their numbers."""
    dtype = _layout(header, len(data))
    found = len(data) // dtype.itemsize
    if found == header.points and len(data) % dtype.itemsize and 0 in header.counts:
        raise _damaged(path, f"{len(data)} bytes of points, expected {found * dtype.itemsize}")
    if found != header.points:
        raise _other_number(path, found, header.points)
    return np.frombuffer(data, dtype, count=found)


def _layout(header: PcdHeader, size: int) -> np.dtype[Any]:
    """A point's layout: as the header says, or what its fields of COUNT 0 leave open and the size fits."""
    said = header.dtype(0)
    if 0 not in header.counts or not header.points or size == header.points * said.itemsize:
        return said
    padding = [i for i, name in enumerate(header.fields) if name == "_" and header.counts[i]][:8]
    fitting: dict[tuple[int, ...], np.dtype[Any]] = {}
    for zero_is in (1, 0):
        layout = header.dtype(zero_is)
        for missing in itertools.chain.from_iterable(
            itertools.combinations(padding, n) for n in range(len(padding) + 1)
        ):
            kept = [name for name in layout.names or () if int(name) not in missing]
            dtype = np.dtype([(name, layout[name]) for name in kept])
            if size == header.points * dtype.itemsize:
                offsets = [dtype.fields[f"{header.fields.index(axis)}"][1] for axis in "xyz"]  # type: ignore[index]
                fitting.setdefault(tuple(offsets), dtype)
    return next(iter(fitting.values())) if len(fitting) == 1 else said


def unpacked(path: str, header: PcdHeader, data: bytes) -> tuple[np.dtype[Any], list[NDArray[Any]]]:
    """A point's layout and the fields, which lie one behind the other, compressed by LZF."""
    if not header.points:
        empty = [np.zeros((0, count), kind) for kind, count in zip(header.types, header.counts)]
        return header.dtype(0), empty
    with needs("compressed PCD files need pypcd4", "clouds"):
        lzf = import_module("lzf")
    if len(data) < 8:
        raise _damaged(path, f"{len(data)} bytes behind DATA, expected two sizes")
    packed, size = struct.unpack_from("<II", data)
    if len(data) - 8 < packed or size > (1 << 10) + _MOST_UNPACKED * packed:
        raise _damaged(path, f"found {len(data) - 8} compressed bytes, expected {packed} for {size}")
    wanted = [header.points * header.dtype(zero_is).itemsize for zero_is in (0, 1)]
    if size not in wanted:
        raise _other_number(path, size // max(header.dtype(0).itemsize, 1), header.points)
    counts = header.columns(wanted.index(size))
    try:
        content = lzf.decompress(data[8 : 8 + packed], size)
    except Exception as error:  # The library has no error of its own.
        if packed != size:
            raise _damaged(path, one_line(error)) from None
        content = data[8 : 8 + size]  # What LZF cannot shorten, some write as it is.
    if content is None or len(content) != size:
        raise _damaged(path, f"unpacked {len(content or b'')} bytes, expected {size}")
    lengths = [kind.itemsize * count * header.points for kind, count in zip(header.types, counts)]
    starts = np.concatenate([[0], np.cumsum(lengths)]).tolist()
    return header.dtype(wanted.index(size)), [
        np.frombuffer(content, kind, header.points * count, starts[i]).reshape(header.points, count)
        for i, (kind, count) in enumerate(zip(header.types, counts))
    ]


def _damaged(path: str, what: str) -> ValueError:
    return ValueError(f"{path}: cannot be read as PCD, cut off or damaged ({what})")


def _other_number(path: str, found: int, expected: int) -> ValueError:
    return ValueError(f"{path}: found {found} points, expected {expected} as its header says")
