# SPDX-License-Identifier: BSD-3-Clause
"""Maps out: one file for each format, chosen by the name of the file that is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ndtree._errors import WrongValue, key
from ndtree._native._core import OccupancyMap
from ndtree.maps.writers import arrays, map_server, mesh, points, rosbag
from ndtree.maps.writers.cells import STATES

__all__ = ["FORMATS", "OPTIONS", "STATES", "MapFormat", "format_of", "write"]

#: Keywords that formats may read.
OPTIONS = ("cell_size", "height", "wall_depth", "states", "faces")


@dataclass(frozen=True)
class MapFormat:
    """One row of the table of formats.

    `fits`: Whether a file that begins as this format's is no recording, and may be replaced.
    `dims`: Of the maps that it can hold.
    """

    name: str  # The word for ``format=``.
    suffixes: tuple[str, ...]  # Endings of its files.
    options: tuple[str, ...]  # Which of `OPTIONS` it reads.
    write: Callable[..., None]  # ``write(map, path, **options)``; the file appears whole or not at all.
    fits: Callable[[str], bool] = lambda path: True
    dims: tuple[int, ...] = (2, 3)


def _save(m: OccupancyMap, path: Path) -> None:
    if m.refinement == "octomap":
        raise ValueError(f"{path}: an OctoMap cannot be written as a map of ndtree's, but as .ot")
    m.save(path)


def _octomap(m: OccupancyMap, path: Path, *, cell_size: float | None = None) -> None:
    m.save_octomap(path, cell_size=cell_size)


#: Of several formats with one ending, the first is chosen unless another is named.
FORMATS = (
    MapFormat("ndtree", (".ndt",), (), _save),
    MapFormat("octomap", (".bt", ".ot"), ("cell_size",), _octomap, dims=(3,)),
    MapFormat(
        "map_server", (".yaml", ".pgm", ".png"), ("cell_size", "height", "wall_depth"), map_server.write
    ),
    MapFormat(
        "rosbag",
        (".bag", ".mcap", ".db3"),
        ("cell_size", "height", "wall_depth"),
        rosbag.write,
        rosbag.holds_maps_alone,
    ),
    MapFormat("ply", (".ply",), ("cell_size", "states", "faces"), points.write_ply),
    MapFormat("pcd", (".pcd",), ("cell_size", "states"), points.write_pcd),
    MapFormat("gltf", (".glb", ".gltf"), ("cell_size", "states"), mesh.write_gltf),
    MapFormat("vtk", (".vtu",), ("cell_size", "states"), mesh.write_vtu),
    MapFormat("leaves", (".npz",), ("cell_size", "states"), arrays.write_leaves, arrays.holds_no_scans),
    MapFormat("grid", (".npy", ".npz"), ("cell_size",), arrays.write_grid, arrays.holds_no_scans),
)


def format_of(path: Path, format: str | None, options: dict[str, Any]) -> MapFormat:
    """The format of a file that is to be written.

    Raises ValueError if there is none for the ending or of that name, or it does not read one of the options.
    """
    if format is not None:
        named = {one.name: one for one in FORMATS}
        if format not in named:
            raise WrongValue.of("format", f"{format!r}", f"one of {', '.join(named)}")
        chosen = named[format]
        if path.suffix not in chosen.suffixes:
            raise ValueError(f"{path}: format {format} writes {', '.join(chosen.suffixes)}")
    else:
        by_suffix = [one for one in FORMATS if path.suffix in one.suffixes]
        if not by_suffix:
            every = dict.fromkeys(suffix for one in FORMATS for suffix in one.suffixes)
            raise ValueError(f"{path}: no format has this ending, expected one of {', '.join(every)}")
        chosen = by_suffix[0]
    for option in options:
        if option not in chosen.options:
            taken = ", ".join(map(key, chosen.options)) or "none"
            raise WrongValue(
                f"{key(option)}: format {chosen.name} ({path.suffix}) takes no such option, it takes {taken}"
            )
    return chosen


def write(m: OccupancyMap, path: Path) -> None:
    """Write a map as its file's ending says; raises as `format_of` and the format do."""
    format_of(path, None, {}).write(m, path)
