# SPDX-License-Identifier: BSD-3-Clause
"""NumPy archives of whole recordings: every end point in one array, cut into scans by offsets.

Programs without Python read them by ``tools/compare/npz.hpp``, which says why.
"""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.base.scan import Scan
from ndtree.logs.core.log import SizedLog
from ndtree.logs.core.source import Format, Source

ZIP_MAGIC = b"PK\x03\x04"
REQUIRED = ("origins", "points", "offsets")
_OPTIONAL = ("no_return", "stamps", "pose_covariances")
#: Bytes that the arrays of an archive may unpack to: three quarters of the machine's memory.
MOST_BYTES = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 4 * 3
#: What reading a damaged archive runs into.
_DAMAGES = (
    OSError, zipfile.BadZipFile, zlib.error, EOFError, MemoryError, ValueError, RuntimeError
)  # fmt: skip


class NpzLog(SizedLog):
    """An archive with these arrays, of which the first three must be there.

    - ``origins`` (S, 2) or (S, 3): position of the sensor, one a scan [m]
    - ``points`` (P, 2) or (P, 3): end points in the map frame [m]
    - ``offsets`` (S + 1,) integer: scan i is ``points[offsets[i]:offsets[i + 1]]``
    - ``no_return`` (P,) bool: true where nothing was hit up to the point
    - ``stamps`` (S,): times [s]
    - ``pose_covariances`` (S, 3, 3) or (S, 6, 6): how sure poses are, as ``pose_covariance`` of `Scan`

    A log of 3-D points is 2-D if all have one z, and all origins too; ``dim=3`` keeps it as it is.
    """

    format = "npz"
    may_be_cut_off = True
    marks_no_returns = True

    def __init__(self, source: Source, *, dim: int | None = None) -> None:
        path = source.path
        arrays = _load(path)
        self._origins = arrays["origins"].astype(np.float64, copy=False)
        self._points = arrays["points"]
        self._offsets = arrays["offsets"]
        no_return = arrays.get("no_return")
        self._returned = None if no_return is None else ~no_return
        self._stamps = arrays.get("stamps")
        self._covariances = arrays.get("pose_covariances")
        stored = self._points.shape[1]
        if stored == 3 and dim != 3:
            flat = _is_one_value(self._points[:, 2]) and _is_one_value(self._origins[:, 2])
            if dim == 2 and not flat:
                raise ValueError(f"{path}: points: z is not the same for all, expected a 2-D log (or dim=3)")
            if flat:
                self._points = np.ascontiguousarray(self._points[:, :2])
                self._origins = np.ascontiguousarray(self._origins[:, :2])
        elif stored == 2 and dim == 3:
            raise ValueError(f"{path}: points: has shape {self._points.shape}, expected (P, 3) for dim=3")
        super().__init__(path, dim=self._points.shape[1])

    def __len__(self) -> int:
        return len(self._origins)

    def _scans(self) -> Iterator[Scan]:
        for i in range(len(self)):
            part = slice(int(self._offsets[i]), int(self._offsets[i + 1]))
            yield Scan(
                self._points[part],
                self._origins[i],
                None if self._returned is None else self._returned[part],
                0.0 if self._stamps is None else float(self._stamps[i]),
                pose_covariance=None if self._covariances is None else self._covariances[i],
            )


def _load(path: str) -> dict[str, NDArray[Any]]:
    if not zipfile.is_zipfile(path):
        raise ValueError(f"{path}: not a zip archive or cut off, expected a whole .npz")
    arrays: dict[str, NDArray[Any]] = {}
    name = "archive"
    try:
        with np.load(path, allow_pickle=False) as archive:
            found = archive.files
            wanted = [one for one in (*REQUIRED, *_OPTIONAL) if one in found]
            size = sum(one.file_size for one in archive.zip.infolist() if one.filename[:-4] in wanted)
            if size <= MOST_BYTES:
                for name in wanted:
                    arrays[name] = archive[name]
    except _DAMAGES as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise ValueError(f"{path}: {name}: cannot be read as an array, expected a whole .npz") from None
    if size > MOST_BYTES:
        raise ValueError(f"{path}: its arrays unpack to {size:,} bytes, expected at most {MOST_BYTES:,} here")
    missing = [name for name in REQUIRED if name not in arrays]
    if missing:
        said = f"no array {' and no '.join(missing)}, expected {', '.join(REQUIRED)}"
        raise ValueError(f"{path}: {said}, found {', '.join(found) or 'nothing'}")
    for name, holds, expected in _expected(path, arrays):
        if not holds:
            found_there = f"has shape {arrays[name].shape} of {arrays[name].dtype}"
            raise ValueError(f"{path}: {name}: {found_there}, expected {expected}")
    return arrays


def _expected(path: str, arrays: dict[str, NDArray[Any]]) -> Iterator[tuple[str, bool, str]]:
    """Of each array whether it is right, and what it should be; one after the other, as each needs others."""
    points, origins, offsets = (arrays[name] for name in ("points", "origins", "offsets"))
    is_right = points.ndim == 2 and points.shape[1] in (2, 3) and points.dtype.kind == "f"
    yield "points", is_right, "(P, 2) or (P, 3) floats"
    n, (count, dim) = len(origins), points.shape
    is_right = origins.ndim == 2 and origins.shape[1] == dim and origins.dtype.kind == "f"
    yield "origins", is_right, f"(S, {dim}) floats"
    is_right = offsets.shape == (n + 1,) and offsets.dtype.kind in "iu"
    yield "offsets", is_right, f"({n + 1},) integers, one more than origins"
    if offsets[0] != 0 or offsets[-1] != count or np.any(offsets[1:] < offsets[:-1]):
        raise ValueError(f"{path}: offsets: must rise from 0 to {count}, the number of points")
    if (flags := arrays.get("no_return")) is not None:
        yield "no_return", flags.shape == (count,) and flags.dtype == np.bool_, f"({count},) bools"
    if (stamps := arrays.get("stamps")) is not None:
        yield "stamps", stamps.shape == (n,) and stamps.dtype.kind in "fiu", f"({n},) numbers"
    if (sure := arrays.get("pose_covariances")) is not None:
        shapes = [(n, 6, 6)] + [(n, 3, 3)] * (dim == 2 or _is_one_value(points[:, 2]))
        yield "pose_covariances", sure.shape in shapes and sure.dtype.kind == "f", f"({n}, 6, 6) floats"


def _is_one_value(values: NDArray[Any]) -> bool:
    """Whether all values that are not NaN are equal."""
    known = values[~np.isnan(values)]
    return known.size == 0 or bool(np.all(known == known[0]))


def _recognises(source: Source) -> bool:
    """Whether a zip file holds at least one of the arrays that a recording must have."""
    if not source.head.startswith(ZIP_MAGIC):
        return False
    try:
        with zipfile.ZipFile(source.path) as archive:
            return any(f"{name}.npy" in archive.namelist() for name in REQUIRED)
    except zipfile.BadZipFile:
        raise ValueError(f"{source.path}: the zip archive is damaged, expected a whole .npz") from None


NPZ = Format("npz", "an .npz recording", _recognises, NpzLog, dim=None)
