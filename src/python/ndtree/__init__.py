# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy mapping in N^d-trees whose cells adapt to what is measured.

Lengths are in metres, arrays are (n, dim), everything is in the map frame.

>>> import numpy as np, ndtree
>>> m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, max_cell_size=1.6, range_sigma=0.03)
>>> report = m.insert(np.array([[2.0, 0.5], [2.0, 0.6]]), np.zeros(2))
>>> report.returned
2
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ndtree import distributed as distributed
    from ndtree import logs as logs
    from ndtree import plot as plot
    from ndtree import study as study
    from ndtree import tiles as tiles
    from ndtree import typing as typing
    from ndtree import viewer as viewer
    from ndtree._native import OctoMap
    from ndtree._native._core import (
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
        HistoryReport,
        InformationGain,
        InsertReport,
        Leaves,
        MapStats,
        Match,
        Matcher,
        MovedEvidence,
        NearestOccupied,
        OccupancyMap,
        Path,
        Planner,
        RayEnds,
        Reliability,
        ScanHistory,
        SeenSpace,
        Shape,
        Sphere,
        __version__,
        default_options,
        from_bytes,
        from_grid,
        has_octomap,
        load_octomap,
    )
    from ndtree.alignment import Alignment, align
    from ndtree.base.certificate import Certificate
    from ndtree.base.scan import Scan
    from ndtree.base.sensor import RangeSensor
    from ndtree.evaluation.comparison import Comparison, compare
    from ndtree.evaluation.delayed import DelayedMoved
    from ndtree.evaluation.map_comparison import MapComparison, compare_maps
    from ndtree.logs import Log, read, simulate
    from ndtree.maps.conversion import convert
    from ndtree.maps.loading import load
    from ndtree.tiles import TiledMap, TileMapper, open_tiles
    from ndtree.tuning.calibration import Calibration, calibrate
    from ndtree.tuning.config import Config
    from ndtree.tuning.first_look import FirstLook, first_look
    from ndtree.tuning.inspection import inspect
    from ndtree.viewer import view

__all__ = [
    "AdaptiveMap",
    "Alignment",
    "Box",
    "Calibration",
    "Capsule",
    "Certificate",
    "Changes",
    "Claims",
    "Comparison",
    "CompressReport",
    "Config",
    "DelayedMoved",
    "DistanceField",
    "FirstLook",
    "FixedMap",
    "Frontier",
    "FrontierSearch",
    "HeldOutTruth",
    "HistoryReport",
    "InformationGain",
    "InsertReport",
    "Leaves",
    "Log",
    "MapComparison",
    "MapStats",
    "Match",
    "Matcher",
    "MovedEvidence",
    "NearestOccupied",
    "OccupancyMap",
    "OctoMap",
    "Path",
    "Planner",
    "RangeSensor",
    "RayEnds",
    "Reliability",
    "Scan",
    "ScanHistory",
    "SeenSpace",
    "Shape",
    "Sphere",
    "TileMapper",
    "TiledMap",
    "__version__",
    "align",
    "calibrate",
    "compare",
    "compare_maps",
    "convert",
    "default_options",
    "first_look",
    "from_bytes",
    "from_grid",
    "has_octomap",
    "inspect",
    "load",
    "load_octomap",
    "open_tiles",
    "read",
    "simulate",
    "view",
]

#: Modules that are attributes of the package without an import of their own; they load when they are used,
#: and name the extra that they need where it is not there.
_FOLDERS = ("distributed", "logs", "plot", "study", "tiles", "typing", "viewer")
#: Modules of the names in `__all__`; all others are the compiled module's.
_MODULES = {
    "Alignment": "ndtree.alignment",
    "Calibration": "ndtree.tuning.calibration",
    "Certificate": "ndtree.base.certificate",
    "Comparison": "ndtree.evaluation.comparison",
    "Config": "ndtree.tuning.config",
    "DelayedMoved": "ndtree.evaluation.delayed",
    "FirstLook": "ndtree.tuning.first_look",
    "Log": "ndtree.logs",
    "MapComparison": "ndtree.evaluation.map_comparison",
    "OctoMap": "ndtree._native",
    "RangeSensor": "ndtree.base.sensor",
    "Scan": "ndtree.base.scan",
    "TileMapper": "ndtree.tiles",
    "TiledMap": "ndtree.tiles",
    "align": "ndtree.alignment",
    "calibrate": "ndtree.tuning.calibration",
    "compare": "ndtree.evaluation.comparison",
    "compare_maps": "ndtree.evaluation.map_comparison",
    "convert": "ndtree.maps.conversion",
    "first_look": "ndtree.tuning.first_look",
    "inspect": "ndtree.tuning.inspection",
    "load": "ndtree.maps.loading",
    "open_tiles": "ndtree.tiles",
    "read": "ndtree.logs",
    "simulate": "ndtree.logs",
    "view": "ndtree.viewer",
}


def __getattr__(name: str) -> Any:
    """A name of the package: its module loads when it is asked for, so that ``import ndtree`` is quick."""
    if name in _FOLDERS:
        return import_module(f"ndtree.{name}")
    if name not in __all__:
        raise AttributeError(f"module 'ndtree' has no attribute {name!r}")
    value = getattr(import_module(_MODULES.get(name, "ndtree._native._core")), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *_FOLDERS, *(name for name in globals() if name.startswith("__"))})
