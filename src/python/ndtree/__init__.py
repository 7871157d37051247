# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy mapping in N^d-trees whose cells adapt to the measurements.

Lengths are in metres, arrays are (n, dim), everything is in the map frame.

>>> import numpy as np, ndtree
>>> m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, max_cell_size=1.6, range_sigma=0.03)
>>> report = m.insert(np.array([[2.0, 0.5], [2.0, 0.6]]), np.zeros(2))
>>> report.returned
2
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ndtree import _lazy

if TYPE_CHECKING:
    from ndtree import distributed as distributed
    from ndtree import logs as logs
    from ndtree import plot as plot
    from ndtree import study as study
    from ndtree import tiles as tiles
    from ndtree import typing as typing
    from ndtree import viewer as viewer
    from ndtree._native import OctoMap as OctoMap
    from ndtree._native._core import AdaptiveMap as AdaptiveMap
    from ndtree._native._core import Box as Box
    from ndtree._native._core import Capsule as Capsule
    from ndtree._native._core import Changes as Changes
    from ndtree._native._core import Claims as Claims
    from ndtree._native._core import CompressReport as CompressReport
    from ndtree._native._core import DistanceField as DistanceField
    from ndtree._native._core import FixedMap as FixedMap
    from ndtree._native._core import Frontier as Frontier
    from ndtree._native._core import FrontierSearch as FrontierSearch
    from ndtree._native._core import HeldOutTruth as HeldOutTruth
    from ndtree._native._core import HistoryReport as HistoryReport
    from ndtree._native._core import InformationGain as InformationGain
    from ndtree._native._core import InsertReport as InsertReport
    from ndtree._native._core import Leaves as Leaves
    from ndtree._native._core import MapStats as MapStats
    from ndtree._native._core import Match as Match
    from ndtree._native._core import Matcher as Matcher
    from ndtree._native._core import MovedEvidence as MovedEvidence
    from ndtree._native._core import NearestOccupied as NearestOccupied
    from ndtree._native._core import OccupancyMap as OccupancyMap
    from ndtree._native._core import Path as Path
    from ndtree._native._core import Planner as Planner
    from ndtree._native._core import RayEnds as RayEnds
    from ndtree._native._core import Reliability as Reliability
    from ndtree._native._core import ScanHistory as ScanHistory
    from ndtree._native._core import SeenSpace as SeenSpace
    from ndtree._native._core import Shape as Shape
    from ndtree._native._core import Sphere as Sphere
    from ndtree._native._core import __version__ as __version__
    from ndtree._native._core import default_options as default_options
    from ndtree._native._core import from_bytes as from_bytes
    from ndtree._native._core import from_grid as from_grid
    from ndtree._native._core import has_octomap as has_octomap
    from ndtree._native._core import load_octomap as load_octomap
    from ndtree.alignment import Alignment as Alignment
    from ndtree.alignment import align as align
    from ndtree.base.certificate import Certificate as Certificate
    from ndtree.base.scan import Scan as Scan
    from ndtree.base.sensor import RangeSensor as RangeSensor
    from ndtree.evaluation.comparison import Comparison as Comparison
    from ndtree.evaluation.comparison import compare as compare
    from ndtree.evaluation.delayed import DelayedMoved as DelayedMoved
    from ndtree.evaluation.map_comparison import MapComparison as MapComparison
    from ndtree.evaluation.map_comparison import compare_maps as compare_maps
    from ndtree.logs import Log as Log
    from ndtree.logs import read as read
    from ndtree.logs import simulate as simulate
    from ndtree.maps.conversion import convert as convert
    from ndtree.maps.loading import load as load
    from ndtree.tiles import TiledMap as TiledMap
    from ndtree.tiles import TileMapper as TileMapper
    from ndtree.tiles import open_tiles as open_tiles
    from ndtree.tuning.calibration import Calibration as Calibration
    from ndtree.tuning.calibration import calibrate as calibrate
    from ndtree.tuning.config import Config as Config
    from ndtree.tuning.first_look import FirstLook as FirstLook
    from ndtree.tuning.first_look import first_look as first_look
    from ndtree.tuning.inspection import inspect as inspect
    from ndtree.viewer import view as view

#: Modules that are attributes of the package without an import of their own; they load when they are used,
#: and name the extra that they need where it is not there.
_FOLDERS = ("distributed", "logs", "plot", "study", "tiles", "typing", "viewer")
#: The public names, by the module that has them; it loads when one is asked for, so that ``import ndtree`` is
#: quick.
_NAMES = {
    "_native": "OctoMap",
    "_native._core": (
        "AdaptiveMap Box Capsule Changes Claims CompressReport DistanceField FixedMap Frontier "
        "FrontierSearch HeldOutTruth HistoryReport InformationGain InsertReport Leaves MapStats "
        "Match Matcher MovedEvidence NearestOccupied OccupancyMap Path Planner RayEnds Reliability "
        "ScanHistory SeenSpace Shape Sphere __version__ default_options from_bytes from_grid "
        "has_octomap load_octomap"
    ),
    "alignment": "Alignment align",
    "base.certificate": "Certificate",
    "base.scan": "Scan",
    "base.sensor": "RangeSensor",
    "evaluation.comparison": "Comparison compare",
    "evaluation.delayed": "DelayedMoved",
    "evaluation.map_comparison": "MapComparison compare_maps",
    "logs": "Log read simulate",
    "maps.conversion": "convert",
    "maps.loading": "load",
    "tiles": "TileMapper TiledMap open_tiles",
    "tuning.calibration": "Calibration calibrate",
    "tuning.config": "Config",
    "tuning.first_look": "FirstLook first_look",
    "tuning.inspection": "inspect",
    "viewer": "view",
}
__all__, __getattr__, __dir__ = _lazy.names(__name__, _NAMES, folders=_FOLDERS)
