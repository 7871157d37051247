# SPDX-License-Identifier: BSD-3-Clause
"""LAS and LAZ, read by laspy; what their headers promise is looked at before a library believes it."""

from __future__ import annotations

import os
import struct
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue
from ndtree._lazy import install_of, needs
from ndtree.logs.core.failures import readable
from ndtree.logs.core.plain_file import open_regular
from ndtree.logs.folders.coordinate_system import METRES, Units, units_of_keys, units_of_wkt

_POINTS_AT_ONCE = 1 << 20
#: The first point of each chunk of a LAZ is not compressed, and no point is smaller.
_SMALLEST_CHUNK = 20
#: By LASzip's description: its third way to compress, and how many layers the parts of a point have with it.
_LAYERED = 3
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_EXTRA_BYTES = 14
_VARIABLE = 2**32 - 1
_LARGE_CHUNK = 1 << 22
#: Of degrees that are written to the decimetre; no scanner measures micrometres.
_STEP_OF_DEGREES = 1e-6
_DOUBLES = 34736  # The record with GeoTIFF's numbers of floating point.


def las_points(path: str) -> NDArray[np.float64]:
    """Points of a LAS or LAZ [m]: its integers times its scale, plus its offset, in the unit that it names.

    Raises ValueError also if they are degrees, or of Web Mercator.
    """
    with needs("LAS and LAZ files need laspy", "clouds"):
        import laspy
    with open_regular(path) as file, readable(path, "cannot be read as LAS", foreign=True):
        _check_header(path, file)
        with laspy.open(file, closefd=False) as reader:
            if reader.header.are_points_compressed:
                if not laspy.LazBackend.detect_available():
                    raise ImportError(f"LAZ files need lazrs; install it with:\n  {install_of('clouds')}")
                if reader.header.point_count:
                    largest = _checked_chunks(path, file, reader.header)
                    if largest > _LARGE_CHUNK:  # Threads would make room for several at once.
                        reader.laz_backend = laspy.LazBackend.Lazrs
            steps = reader.header.scales.tolist()
            if not all(0 < step < float("inf") for step in steps):
                raise WrongValue(f"{path}: steps of x, y and z: found {steps}, expected numbers > 0")
            units = _units(reader)
            if units.are_degrees or units.are_stretched:
                degrees, web = "degrees of longitude and latitude", "stretched, as Web Mercator's are"
                are = degrees if units.are_degrees else web
                raise WrongValue(
                    f"{path}: coordinates are {are}, expected metres, as of UTM: "
                    "pdal translate IN OUT reprojection --filters.reprojection.out_srs=EPSG:CODE"
                )
            expected = reader.header.point_count
            parts = [np.empty((0, 3))]
            for points in reader.chunk_iterator(_POINTS_AT_ONCE):
                if not len(points):
                    break
                parts.append(np.column_stack([np.asarray(getattr(points, axis)) for axis in "xyz"]))
    found = np.concatenate(parts)
    if len(found) != expected:
        raise ValueError(f"{path}: found {len(found)} points, expected {expected} as its header says")
    found = found.astype(np.float64, copy=False)
    is_metric = (units.across, units.height) == (1.0, 1.0)
    return found if is_metric else found * (units.across, units.across, units.height)


def las_note(path: str) -> str:
    """What a user should know of the unit of a LAS or LAZ, in one line, or nothing."""
    try:
        import laspy
    except ImportError:
        return ""
    with open_regular(path) as file, readable(path, "cannot be read as LAS", foreign=True):
        _check_header(path, file)
        with laspy.open(file, closefd=False) as reader:
            return _units(reader).note


def _units(reader: Any) -> Units:
    """Of a file's coordinates, by the records of its coordinate system."""
    header = reader.header
    records = [*header.vlrs, *(reader.evlrs or ())]
    by_kind = {type(record).__name__: record for record in records}
    wkt, keys = by_kind.get("WktCoordinateSystemVlr"), by_kind.get("GeoKeyDirectoryVlr")
    if wkt is not None and wkt.string.strip("\0 ") and (header.global_encoding.wkt or keys is None):
        try:
            found = units_of_wkt(wkt.string)
        except ValueError:
            found = Units(unknown="its coordinate system")
    elif keys is not None:
        found = units_of_keys(_values(keys, by_kind.get("GeoDoubleParamsVlr")))
    elif _are_finer_across(header):
        return Units(unknown="a file with finer steps of x and y than of heights, as of degrees,")
    else:
        return METRES
    if found.are_degrees and not (_within(header, 0, 360) and _within(header, 1, 90)):
        return Units(unknown="a coordinate system of degrees, which its coordinates are not,")
    return found


def _are_finer_across(header: Any) -> bool:
    """Whether x and y may be degrees, in steps that would be micrometres, and heights are in coarser ones."""
    x, y, z = header.scales
    return bool(max(x, y) <= _STEP_OF_DEGREES and z >= 10 * max(x, y)) and (
        _within(header, 0, 360) and _within(header, 1, 90)
    )


def _within(header: Any, axis: int, largest: float) -> bool:
    """Whether coordinates along an axis are degrees up to a largest number."""
    return bool(-largest <= header.mins[axis] <= header.maxs[axis] <= largest)


def _values(keys: Any, doubles: Any) -> dict[int, float]:
    """Values of GeoTIFF's keys: in their place, or among the numbers of another record."""
    found: dict[int, float] = {}
    for key in keys.geo_keys:
        if key.tiff_tag_location == 0:
            found[key.id] = float(key.value_offset)
        elif (
            key.tiff_tag_location == _DOUBLES
            and doubles is not None
            and key.value_offset < len(doubles.doubles)
        ):
            found[key.id] = float(doubles.doubles[key.value_offset].value)
    return found


def _check_header(path: str, file: IO[bytes]) -> None:
    """Refuses numbers of records that do not fit into the file: the library would look for each of them."""
    size = os.fstat(file.fileno()).st_size
    header = file.read(247)
    file.seek(0)
    if len(header) < 227:
        raise ValueError(
            f"{path}: the LAS header is cut off, expected at least 227 bytes, found {len(header)}"
        )
    header_size, first_point, records = struct.unpack_from("<HII", header, 94)
    if not header_size + 54 * records <= first_point <= size:
        raise ValueError(
            f"{path}: the LAS header of {header_size} bytes says {records} records and points from byte "
            f"{first_point} of {size}, expected that they fit"
        )
    if header[25] >= 4 and len(header) == 247:  # Version 1.4 may have more records behind the points.
        start, records = struct.unpack_from("<QI", header, 235)
        if records and start + 60 * records > size:
            raise ValueError(
                f"{path}: the LAS header says {records} records from byte {start} of {size}, "
                "expected that they fit"
            )


def _checked_chunks(path: str, file: IO[bytes], header: Any) -> int:
    """Number of points of the largest chunk; refuses a table of chunks that do not fit into the file.

    Rust's library makes room for as many as it says, and ends the process where there is none.
    """
    import lazrs

    size = os.fstat(file.fileno()).st_size
    first = header.offset_to_point_data
    table = _number(path, file, first, "<q")
    if table == -1:  # Who wrote it could not go back: it stands at the end.
        table = _number(path, file, size - 8, "<q")
    if not first + 8 <= table <= size - 8:
        raise _wrong(path, f"the table of chunks is at byte {table} of {size}, expected behind the points")
    count = _number(path, file, table + 4, "<I")
    if count > (table - first) // _SMALLEST_CHUNK:
        said = f"{count} chunks in {table - first} bytes"
        raise _wrong(path, f"{said}, expected at least {_SMALLEST_CHUNK} bytes each")
    found = header.vlrs.get("LasZipVlr")
    if not found:
        raise _wrong(path, "no record of LASzip, expected one")
    record = found[0].record_data
    (points,) = struct.unpack_from("<I", record, 12)
    point = sum(bytes_ for _, bytes_ in _parts(record))
    if points == 0 or point != header.point_format.size:
        said = f"chunks of {points} points of {point} bytes"
        raise _wrong(path, f"{said}, expected some of {header.point_format.size} bytes")
    file.seek(first)
    table_of_chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(record))
    chunks = [size for _, size in table_of_chunks]
    if sum(chunks) > table - first:
        raise _wrong(path, f"chunks of {sum(chunks)} bytes in {table - first}, expected that they fit")
    at, head, layers = first + 8, *_layers(record)
    for chunk in chunks:
        sizes = [_number(path, file, at + head + 4 + 4 * i, "<I") for i in range(layers)]
        if sum(sizes) > chunk:
            raise _wrong(path, f"parts of {sum(sizes)} bytes in a chunk of {chunk}, expected that they fit")
        at += chunk
    file.seek(first)
    return max((number for number, _ in table_of_chunks), default=0) if points == _VARIABLE else points


def _wrong(path: str, said: str) -> ValueError:
    return ValueError(f"{path}: cannot be read as LAZ: {said}")


def _parts(record: bytes) -> list[tuple[int, int]]:
    """Kind and size of the parts of a point, as the record of LASzip has them."""
    (count,) = struct.unpack_from("<H", record, 32)
    return [struct.unpack_from("<HH", record, 34 + 6 * i) for i in range(count)]


def _layers(record: bytes) -> tuple[int, int]:
    """Of a chunk: bytes of its first point, and how many parts are compressed alone; 0 in older files."""
    if struct.unpack_from("<H", record)[0] != _LAYERED:
        return 0, 0
    parts = _parts(record)
    layers = sum(size if kind == _EXTRA_BYTES else _LAYERS.get(kind, 0) for kind, size in parts)
    return sum(size for _, size in parts), layers


def _number(path: str, file: IO[bytes], at: int, layout: str) -> int:
    file.seek(at)
    content = file.read(struct.calcsize(layout))
    if len(content) != struct.calcsize(layout):
        raise ValueError(f"{path}: cut off at byte {at}, expected the table of its chunks")
    return int(struct.unpack(layout, content)[0])
