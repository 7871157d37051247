# SPDX-License-Identifier: BSD-3-Clause
"""Arrays by what they hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
#: As a file or a message has them, of single or double precision.
Points = NDArray[np.floating[Any]]
