# SPDX-License-Identifier: BSD-3-Clause
"""Maps of the same log side by side: cells, updates, time, memory and truth, all counted alike."""

from ndtree.evaluation.comparison.run import DEFAULT_MAPS, NO_RETURN, Trial, Turns, compare, map_in_turns
from ndtree.evaluation.comparison.table import Comparison

__all__ = ["DEFAULT_MAPS", "NO_RETURN", "Comparison", "Trial", "Turns", "compare", "map_in_turns"]
