# SPDX-License-Identifier: BSD-3-Clause
"""Types for annotations: the words that calls take, and their options as dictionaries.

>>> from ndtree.typing import MapOptions
>>> options: MapOptions = {"min_cell_size": 0.1, "range_sigma": 0.02}
>>> m = ndtree.AdaptiveMap(dim=3, **options)
"""

from ndtree.base.typing import *  # noqa: F403
from ndtree.base.typing import __all__ as __all__
