# SPDX-License-Identifier: BSD-3-Clause
"""Poses of logs whose own drift, or that have none: scans matched with each other, and loops closed."""

from ndtree.alignment.aligning import MAX_RANGE, align
from ndtree.alignment.result import Alignment
from ndtree.alignment.spatial import MAX_RANGE_IN_SPACE, SpatialAlignment, align_in_space

__all__ = [
    "MAX_RANGE",
    "MAX_RANGE_IN_SPACE",
    "Alignment",
    "SpatialAlignment",
    "align",
    "align_in_space",
]
