# SPDX-License-Identifier: BSD-3-Clause
"""Maps of any kind into files of any kind."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from ndtree._native._checked import checked
from ndtree._native._core import OccupancyMap
from ndtree.base.files import require_no_input
from ndtree.maps.open import PlacedMap, open_map
from ndtree.maps.writers import format_of

if TYPE_CHECKING:
    from typing_extensions import Unpack


class WritingOptions(TypedDict, total=False):
    """Keywords of `convert`, of which each format takes some; None is as if left out."""

    cell_size: float | None
    height: tuple[float, float] | None
    wall_depth: float | None
    states: Sequence[str] | None
    faces: bool


@checked
def convert(
    source: OccupancyMap | PlacedMap | str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    format: str | None = None,
    **options: Unpack[WritingOptions],
) -> None:
    """Write a map as a file of another kind; it appears whole or not at all.

    Parameters
    ----------
    source : map, PlacedMap, str or path
        A map, or a file: ours, OctoMap's (.bt, .ot) or map_server's (.yaml). An image that begins at no whole
        number of pixels from 0 is moved to the nearest.
    path : str or path
        Its ending decides the format: .ndt, a map of ours; .bt and .ot, OctoMap's; .yaml, .pgm and .png, an
        image for map_server and nav2, and its .yaml; .bag, .mcap and .db3, a ROS bag with an Octomap or an
        OccupancyGrid; .ply, points, or a mesh; .pcd, points; .glb and .gltf, a mesh; .vtu, VTK's cells; .npz,
        the leaves as records, or with ``format="grid"`` a dense array of states; .npy, the latter.
    format : str, optional
        One of "ndtree", "octomap", "map_server", "rosbag", "ply", "pcd", "gltf", "vtk", "leaves" and "grid",
        where the ending does not say.
    cell_size : float, optional
        Of the cells in all files but .ndt [m]; left out, the map's own, or where all are of one size, its
        smallest. A larger cell is occupied if some occupied cell overlaps it, else free if some free one
        does, else unknown. Written so, cells in points, meshes and records are all of that size, without
        counts of beams and layers; an .ot keeps its colours.
    height : (low, high), optional
        Of an image or an OccupancyGrid of a 3-D map: only cells that overlap low <= z < high [m].
    wall_depth : float, optional
        Of an image or an OccupancyGrid of a map in which beams have ended: how far behind free space occupied
        cells larger than the smallest are drawn [m]; beyond they are unknown. Left out, 2 range_sigma +
        min_cell_size: far walls become no thicker than their noise. inf draws all of each.
    states : sequence of {"occupied", "free", "frontier"}, optional
        Which cells are written as points, mesh, VTK's cells or records; frontier is unknown space beside free
        cells. Left out, the occupied ones, and for .vtu and .npz the free ones, too.
    faces : bool
        A .ply holds the mesh of the cells' faces, without those that other cells hide, instead of points.

    Raises
    ------
    OSError
        If a file cannot be read or written.
    ValueError
        If the source is no map or damaged, the ending or a value is wrong, or the format does not read an
        option or cannot hold the map.
    ImportError
        If the format needs a library that is not installed; it names the extra.
    """
    target = Path(path)
    given: dict[str, Any] = {
        name: value for name, value in options.items() if value is not None and value is not False
    }
    chosen = format_of(target, format, given)
    if isinstance(source, OccupancyMap):
        m = source
    else:
        placed = source if isinstance(source, PlacedMap) else open_map(source)
        require_no_input(target, [placed.name])
        m = placed.resampled(given.get("cell_size"))
    chosen.write(m, target, **given)
