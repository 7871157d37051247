# SPDX-License-Identifier: BSD-3-Clause
"""Scans as an .npz recording, which `read` reads."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.base.files import replaced
from ndtree.base.scan import Scan


def is_archive(path: str) -> bool:
    """Whether a file is an archive of scans, and not of other arrays."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {"points.npy", "origins.npy"} <= set(archive.namelist())
    except (OSError, zipfile.BadZipFile, NotImplementedError):
        return False


def require_of_archive(scan: Scan, i: int, name: str) -> None:
    """Refuse a scan that an archive cannot hold. `i`, `name`: its number, and how errors call its log."""
    scan.require_sensor(f"archives as of {name}")
    if scan.origin.ndim != 1:
        raise ValueError(f"{name}: scan {i} has an origin for each beam, expected one: .npz cannot hold more")
    if scan.range_sigma is not None:
        raise ValueError(f"{name}: scan {i} has a range_sigma for each beam, which .npz cannot hold")


def save_archive(
    scans: Iterable[Scan],
    path: str | os.PathLike[str],
    name: str,
    fields: Callable[[int], dict[str, NDArray[Any]]] | None = None,
) -> int:
    """Write scans; `name` is how errors call their log. Returns how many there are.

    `fields` gives more arrays of each scan, with an entry for each of its beams.
    """
    if not os.fspath(path).endswith(".npz"):
        raise ValueError(f"{os.fspath(path)}: the name must end in .npz")
    kept: list[Scan] = []
    more: dict[str, list[NDArray[Any]]] = {}
    for i, scan in enumerate(scans):
        require_of_archive(scan, i, name)
        kept.append(scan)
        for field, values in (fields(i) if fields else {}).items():
            more.setdefault(field, []).append(values)
    if not kept:
        raise ValueError(f"{name}: no scans, expected at least one")
    arrays: dict[str, Any] = {
        "origins": np.asarray([one.origin for one in kept]),
        "points": np.concatenate([one.endpoints for one in kept]),
        "offsets": np.cumsum([0, *map(len, kept)]),
        "stamps": np.asarray([one.stamp for one in kept]),
        **{field: np.concatenate(values) for field, values in more.items()},
    }
    no_return = ~np.concatenate([one.did_return for one in kept])
    if no_return.any():
        arrays["no_return"] = no_return
    covariances = [one.pose_covariance for one in kept]
    known = [one for one in covariances if one is not None]
    if known:
        if len({one.shape for one in known}) > 1:
            raise ValueError(f"{name}: pose_covariance is (3, 3) of some scans, and (6, 6) of others")
        none = np.zeros_like(known[0])
        arrays["pose_covariances"] = np.stack([none if one is None else one for one in covariances])
    with replaced(path, is_archive) as part:
        np.savez_compressed(part, **arrays)
    return len(kept)
