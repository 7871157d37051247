# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy mapping in N^d-trees whose cells adapt to what is measured.

Lengths are in metres, arrays are (n, dim), everything is in the map frame.

>>> import numpy as np, ndtree
>>> m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, max_cell_size=1.6, range_sigma=0.03)
>>> report = m.insert(np.array([[2.0, 0.5], [2.0, 0.6]]), np.zeros(2))
>>> report.returned
2
"""

from . import _interrupt

if _interrupt.is_command():
    _interrupt.end_quietly()

from . import _compiled as _compiled  # Before anybody takes a function of the compiled module.
from . import _methods as _methods
from ._core import (
    AdaptiveMap,
    Box,
    Capsule,
    Changes,
    Claims,
    CompressReport,
    DistanceField,
    FixedMap,
    Frontier,
    FrontierSearch,
    HeldOutTruth,
    InsertReport,
    Leaves,
    MapStats,
    NearestOccupied,
    OccupancyMap,
    RayEnds,
    SeenSpace,
    Shape,
    Sphere,
    __version__,
    default_options,
    from_bytes,
    from_grid,
    has_octomap,
    load,
    load_octomap,
)
from .calibration import Calibration, calibrate
from .comparison import Comparison, compare
from .conversion import convert
from .first_look import FirstLook, first_look
from .map_comparison import MapComparison, compare_maps
from .readers import Log, read, simulate
from .scan import Scan
from .tiles import TiledMap, TileMapper, open_tiles

if has_octomap:
    from ._core import OctoMap
else:

    def OctoMap(*_args: object, **_options: object) -> OccupancyMap:
        """Say why there is no OctoMap: it was not there when the module was built."""
        raise RuntimeError(
            "ndtree was built without OctoMap: install liboctomap-dev and build it again "
            "(pip install --no-binary ndtree-mapping ndtree-mapping)"
        )


__all__ = [
    "AdaptiveMap",
    "Box",
    "Calibration",
    "Capsule",
    "Changes",
    "Claims",
    "Comparison",
    "CompressReport",
    "DistanceField",
    "FirstLook",
    "FixedMap",
    "Frontier",
    "FrontierSearch",
    "HeldOutTruth",
    "InsertReport",
    "Leaves",
    "Log",
    "MapComparison",
    "MapStats",
    "NearestOccupied",
    "OccupancyMap",
    "OctoMap",
    "RayEnds",
    "Scan",
    "SeenSpace",
    "Shape",
    "Sphere",
    "TileMapper",
    "TiledMap",
    "__version__",
    "calibrate",
    "compare",
    "compare_maps",
    "convert",
    "default_options",
    "first_look",
    "from_bytes",
    "from_grid",
    "has_octomap",
    "load",
    "load_octomap",
    "open_tiles",
    "read",
    "simulate",
]
