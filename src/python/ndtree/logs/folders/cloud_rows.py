# SPDX-License-Identifier: BSD-3-Clause
"""Point clouds with some of a file's points, and all that the file says of them."""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.arrays import Bools
from ndtree.logs.core.plain_file import open_regular
from ndtree.logs.folders import pcd_files, ply_files
from ndtree.logs.folders.cloud_files import kind_of_name

Numbers = NDArray[np.float32]
#: Of the types of columns, as all who read PLY call them.
_NAMES = {ply_files._TYPES[name]: name for name in "float double char uchar short ushort int uint".split()}


def write_rows(source: str, target: str, keep: Bools, moved: Numbers | None = None) -> None:
    """Write a PCD, PLY, LAS or LAZ with some points of another of its kind.

    `source`, `target`: Paths; a compressed PCD becomes a binary one.
    `keep` (ndarray of bool, (n,)): For each point of the file.
    `moved` (ndarray of float32, (n,)): A field of this name is added.
    Raises ValueError if the file is none of these, or has another number of points; it is named.
    """
    kind = kind_of_name(source)
    write = {"PCD": _pcd, "PLY": _ply, "LAS": _las}.get(kind.name if kind else "")
    if write is None:
        raise ValueError(f"{source}: expected a PCD, PLY, LAS or LAZ file")
    write(source, target, keep, moved)


def write_cloud(target: str | os.PathLike[str], columns: dict[str, NDArray[Any]]) -> None:
    """Write columns of one length as a binary PCD or PLY, by the ending of the name."""
    table = np.rec.fromarrays(list(columns.values()), names=list(columns)) if columns else np.empty(0)
    table = table.astype(table.dtype.newbyteorder("<"))
    pcd = os.fspath(target).lower().endswith(".pcd")
    kinds = [table.dtype[i] for i in range(len(columns))]
    if pcd:
        letters = {"f": "F", "i": "I", "u": "U"}
        head = [
            "# .PCD v0.7 - Point Cloud Data file format",
            "VERSION 0.7",
            f"FIELDS {' '.join(columns)}",
            f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
            f"TYPE {' '.join(letters[kind.kind] for kind in kinds)}",
            f"COUNT {' '.join('1' for _ in kinds)}",
            f"WIDTH {len(table)}",
            "HEIGHT 1",
            "VIEWPOINT 0 0 0 1 0 0 0",
            f"POINTS {len(table)}",
            "DATA binary",
        ]
    else:
        head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
        head += [f"property {_NAMES[kind.str[1:]]} {name}" for name, kind in zip(columns, kinds)]
        head.append("end_header")
    with open(target, "wb") as file:
        file.write(("\n".join(head) + "\n").encode())
        file.write(table.tobytes())


def _fits(source: str, found: int, keep: Bools) -> None:
    if found != len(keep):
        raise ValueError(f"{source}: has {found} points, expected {len(keep)} as were read before")


def _pcd(source: str, target: str, keep: Bools, moved: Numbers | None) -> None:
    with open_regular(source) as file:
        header = pcd_files._header(source, file)
        begin = file.tell()
        data = file.read()
        file.seek(0)
        head = file.read(begin).decode("utf-8", "replace")
    _fits(source, header.points, keep)
    count = int(np.count_nonzero(keep))
    if header.encoding == "ascii":
        rows = [line for line in data.splitlines() if line.strip()]
        body = _text(rows, keep, moved)
    else:
        if header.encoding == "binary":
            table = pcd_files.binary_table(source, header, data)
        else:
            layout, columns = pcd_files.unpacked(source, header, data)
            table = np.empty(header.points, layout)
            for name, column in zip(layout.names or (), columns):
                table[name] = column
        body = _binary(table, keep, moved, "<")
    is_same = count == header.points
    lines = []
    for line in head.splitlines():
        word = line.split("#", 1)[0].split()[:1]
        key = word[0].upper() if word else ""
        if moved is not None and key in ("FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT"):
            line += {"SIZE": " 4", "TYPE": " F", "COUNT": " 1"}.get(key, " moved")
        if not is_same and key in ("WIDTH", "HEIGHT", "POINTS"):
            line = f"{key} {1 if key == 'HEIGHT' else count}"
        if key == "DATA" and header.encoding == "binary_compressed":
            line = "DATA binary"
        lines.append(line)
    with open(target, "wb") as out:
        out.write(("\n".join(lines) + "\n").encode() + body)


def _text(rows: list[bytes], keep: Bools, moved: Numbers | None) -> bytes:
    """Lines of some points, with one number more or not."""
    more = [b""] * len(rows) if moved is None else [f" {value:g}".encode() for value in moved]
    return b"".join(row + end + b"\n" for row, end, use in zip(rows, more, keep) if use)


def _binary(table: NDArray[Any], keep: Bools, moved: Numbers | None, order: str) -> bytes:
    """Rows of some points, with one column more or not."""
    if moved is not None:
        names = table.dtype.names or ()
        columns: list[Any] = [*((name, table.dtype[name]) for name in names), ("moved", order + "f4")]
        joined = np.empty(len(table), columns)
        for name in names:
            joined[name] = table[name]
        joined["moved"] = moved
        table = joined
    return table[keep].tobytes()


def _ply(source: str, target: str, keep: Bools, moved: Numbers | None) -> None:
    with open_regular(source) as file:
        order, elements = ply_files._header(source, file)
        begin = file.tell()
        data = file.read()
        file.seek(0)
        head = file.read(begin)
    vertex = next(one for one in elements if one.name == "vertex")
    _fits(source, vertex.count, keep)
    others = [one for one in elements if one.count and one.name != "vertex"]
    if others and not keep.all():
        raise ValueError(f"{source}: has {others[0].name}s beside its points, expected points alone")
    if any(one.count for one in vertex.properties):
        raise ValueError(f"{source}: its points have lists, expected single values")
    if elements[0] is not vertex:
        raise ValueError(f"{source}: its points come behind others, expected them first")
    if not order:
        rows = [line for line in data.splitlines() if line.strip()]
        body = _text(rows[: vertex.count], keep, moved)
        rest = b"".join(row + b"\n" for row in rows[vertex.count :])
    else:
        dtype = np.dtype([(f"{i}", order + p.kind) for i, p in enumerate(vertex.properties)])
        table = np.frombuffer(data, dtype, count=vertex.count)
        rest = data[table.nbytes :]
        body = _binary(table, keep, moved, order)
    head = re.sub(rb"(?m)^element vertex\s+\d+", b"element vertex %d" % np.count_nonzero(keep), head)
    if moved is not None:
        last = [found.end() for found in re.finditer(rb"(?m)^property .*$", head[: _end_of_vertex(head)])][-1]
        head = head[:last] + b"\nproperty float moved" + head[last:]
    with open(target, "wb") as out:
        out.write(head + body + rest)


def _end_of_vertex(head: bytes) -> int:
    """Where the properties of the vertices end in a header."""
    begin = re.search(rb"(?m)^element vertex\b", head)
    assert begin is not None
    after = re.search(rb"(?m)^(element|end_header)\b", head[begin.end() :])
    assert after is not None
    return begin.end() + after.start()


def _las(source: str, target: str, keep: Bools, moved: Numbers | None) -> None:
    import laspy

    cloud = laspy.read(source)
    _fits(source, len(cloud.points), keep)
    if moved is not None:
        cloud.add_extra_dim(laspy.ExtraBytesParams("moved", np.float32, "probability that it moved"))
        cloud.moved = moved
    cloud.points = cloud.points[keep]
    with open(target, "wb") as out:
        cloud.write(out, do_compress=source.lower().endswith(".laz"))
