# SPDX-License-Identifier: BSD-3-Clause
"""The compiled module, with signatures, clear errors, arrays of any shape and the methods written in Python.

It is completed here, before any other module takes a class or a function of it.
"""

from ndtree._native import _compiled as _compiled
from ndtree._native import _methods as _methods
from ndtree._native._core import OccupancyMap, has_octomap

if has_octomap:
    from ndtree._native._core import OctoMap as OctoMap
else:

    def OctoMap(*_args: object, **_options: object) -> OccupancyMap:  # type: ignore[no-redef]
        """Say why there is no OctoMap: it was not there when the module was built."""
        raise RuntimeError(
            "ndtree was built without OctoMap: install liboctomap-dev and build it again "
            "(pip install --no-binary ndtree-mapping ndtree-mapping)"
        )
