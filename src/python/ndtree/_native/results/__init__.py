# SPDX-License-Identifier: BSD-3-Clause
"""What maps answer: plain objects with arrays and numbers, which can be indexed, shown and pickled."""

from ndtree._native.results.arrays import Answers as Answers
from ndtree._native.results.arrays import Changes, Frontier, InformationGain, Leaves, NearestOccupied, RayEnds
from ndtree._native.results.reports import (
    Claims,
    CompressReport,
    HistoryReport,
    InsertReport,
    MapStats,
    Match,
    NoReturns,
    Path,
)

__all__ = [
    "Changes",
    "Claims",
    "CompressReport",
    "Frontier",
    "HistoryReport",
    "InformationGain",
    "InsertReport",
    "Leaves",
    "MapStats",
    "Match",
    "NearestOccupied",
    "NoReturns",
    "Path",
    "RayEnds",
]
