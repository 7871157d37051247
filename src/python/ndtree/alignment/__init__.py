# SPDX-License-Identifier: BSD-3-Clause
"""Poses of logs whose own drift, or that have none: scans matched with each other, and loops closed."""

from ndtree.alignment.aligning import MAX_RANGE, align
from ndtree.alignment.result import Alignment

__all__ = ["MAX_RANGE", "Alignment", "align"]
