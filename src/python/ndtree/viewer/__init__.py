# SPDX-License-Identifier: BSD-3-Clause
"""Maps on an interactive page: cubes, slices, the trajectory, and the numbers of the cell that is clicked."""

from __future__ import annotations

import logging

from ndtree._lazy import needs

with needs("ndtree.viewer needs viser", "view"):
    import viser as _viser  # noqa: F401

from ndtree.viewer.controls import legend_html
from ndtree.viewer.look import Look
from ndtree.viewer.page_guard import HOST
from ndtree.viewer.viewer import MAX_BOXES, PORT, Viewer, first_camera, view
from ndtree.viewer.visitor import MAX_CLEAR_BOXES

#: What browsers do wrong when they call is no news for the user.
logging.getLogger("websockets").addHandler(logging.NullHandler())

__all__ = [
    "HOST",
    "MAX_BOXES",
    "MAX_CLEAR_BOXES",
    "PORT",
    "Look",
    "Viewer",
    "first_camera",
    "legend_html",
    "view",
]
