# SPDX-License-Identifier: BSD-3-Clause
"""Two maps of any kind beside each other: where their states agree, and how far their surfaces are apart."""

from ndtree.evaluation.map_comparison.run import MapComparison, compare_maps

__all__ = ["MapComparison", "compare_maps"]
