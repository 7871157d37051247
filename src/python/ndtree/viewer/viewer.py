# SPDX-License-Identifier: BSD-3-Clause
"""A map on pages, which may grow."""

from __future__ import annotations

import atexit
import contextlib
import io
import math
import os
import threading
import time
import webbrowser
from typing import TYPE_CHECKING, Any

import numpy as np
import viser

from ndtree._native._core import OccupancyMap
from ndtree.cells.lattice import Floats
from ndtree.cells.regions import Track
from ndtree.maps.open import open_map
from ndtree.viewer.frame import framed
from ndtree.viewer.look import Look
from ndtree.viewer.page_guard import HOST, light_up, started
from ndtree.viewer.snapshot import Snapshot
from ndtree.viewer.visitor import Visitor

if TYPE_CHECKING:
    from ndtree.base.scan import Scan

PORT = 8080
MAX_BOXES = 200_000  # Drawn of the occupied cells at once.
_GROWN = 1.3  # From so much farther away a page looks at a map that has grown.
_FIELD_OF_VIEW = math.radians(60.0)
_MARGIN = 1.03  # Space around what is framed.


class Viewer:
    """A page on this computer that shows a map. Each browser that opens it has its own view.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap, optional
        With ``dim`` 2 or 3. Left out, the page is empty until `show`.
    port : int
        Where the page is; 0 takes any free port.
    look : Look, optional
        How it is shown at first.
    name : str
        What the page's panel is called, as the map's file.
    max_boxes : int
        More occupied cells than this are drawn coarser the farther they are away.

    Raises
    ------
    OSError
        If the port is in use.
    ValueError
        If the map is empty, or cannot be shown so.
    """

    def __init__(
        self,
        m: OccupancyMap | None = None,
        *,
        port: int = PORT,
        look: Look | None = None,
        name: str = "ndtree",
        max_boxes: int = MAX_BOXES,
    ) -> None:
        self.max_boxes = max_boxes
        self.look = look
        self.snapshot: Snapshot | None = None
        self.track = Track()
        self.aim: dict[str, Any] | None = None  # The camera of a page that was not turned.
        self._cost, self._shown_at = 0.0, -math.inf
        if m is not None:
            self._take(m)
        self._server = started(port)
        atexit.register(self.close)  # Before viser does, which says goodbye.
        light_up(self._server.scene)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        self._server.gui.set_panel_label(name)
        self._visitors: dict[int, Visitor] = {}
        self._lock = threading.Lock()
        if self.snapshot is not None:
            self._aim()
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(self._disconnected)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self._server.get_port()}"

    def __repr__(self) -> str:
        return f"<page of a map at {self.url}>"

    def show(self, m: OccupancyMap) -> None:
        """Show a map, or what has become of it. It is copied: it may change at once."""
        self._take(m)
        self._aim()
        self.refresh()

    def refresh(self) -> None:
        """Have open pages drawn anew."""
        with self._lock:
            visitors = list(self._visitors.values())
        for visitor in visitors:
            visitor.refresh()

    def add_track(self, scan: Scan) -> None:
        """Take a scan's origin into the trajectory; it is seen with the next `show` or `refresh`."""
        self.track.add(scan)

    def update(self, m: OccupancyMap, scan: Scan) -> None:
        """Show a growing map after one more scan, as often as takes a fifth of the time."""
        self.add_track(scan)
        now = time.perf_counter()
        if now - self._shown_at < max(0.5, 4 * self._cost) or not m.stats().observed_leaves:
            return
        self.show(m)
        self._shown_at = time.perf_counter()
        self._cost = self._shown_at - now

    def wait(self) -> None:
        """Return when the user interrupts."""
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                time.sleep(3600)

    def close(self) -> None:
        """Take the page from the net."""
        atexit.unregister(self.close)
        with self._lock:
            visitors = list(self._visitors.values())
        for visitor in visitors:
            visitor.stop()
        with contextlib.redirect_stdout(io.StringIO()):  # viser says goodbye.
            self._server.stop()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _take(self, m: OccupancyMap) -> None:
        snapshot = Snapshot(m, None if self.snapshot is None else self.snapshot.origin)
        if self.look is None:
            self.look = Look.below_ceiling(m)
        self.look.validate(m.dim)
        self.snapshot = snapshot

    def _aim(self) -> None:
        """Have new pages, and pages that were not turned, look at all of a map that has grown."""
        assert self.snapshot is not None
        wanted = first_camera(self.snapshot)
        if self.aim is not None:
            reach, before = (np.linalg.norm(c["position"] - c["look_at"]) for c in (wanted, self.aim))
            if reach < _GROWN * before:
                return
        self.aim = wanted
        for name, value in wanted.items():
            setattr(self._server.initial_camera, name, value)

    def _connected(self, client: viser.ClientHandle) -> None:
        visitor = Visitor(self, client)
        with self._lock:
            self._visitors[client.client_id] = visitor
        visitor.refresh()

    def _disconnected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            visitor = self._visitors.pop(client.client_id, None)
        if visitor is not None:
            visitor.stop()


def first_camera(snapshot: Snapshot) -> dict[str, Any]:
    """Where a page's camera stands at first: above a flat map, else to the south and half-way up."""
    low, high = snapshot.region.T - snapshot.origin
    middle = 0.5 * (low + high)
    flat = snapshot.dim == 2
    direction = np.array([0.0, -1e-3, 1.0]) if flat else np.array([0.35, -0.6, 0.72])
    direction /= np.linalg.norm(direction)
    low, high = framed(low, high)
    away = _distance_to_see(low - middle, high - middle, direction)
    return {
        "up": np.array([0.0, 0.0, 1.0]),
        "look_at": middle,
        "position": middle + away * direction,
        "fov": _FIELD_OF_VIEW,
        "near": min(0.05, 1e-3 * away),
        "far": 100.0 * away,
    }


def _distance_to_see(low: Floats, high: Floats, direction: Floats) -> float:
    """How far from the middle of a box a camera sees all its corners, also in a window as high as wide."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    beside = np.abs(np.stack([corners @ right, corners @ up])).max(axis=0)
    return float((corners @ direction + beside / math.tan(0.5 * _FIELD_OF_VIEW)).max()) * _MARGIN


def view(
    m: OccupancyMap | str | os.PathLike[str],
    *,
    port: int = PORT,
    look: Look | None = None,
    browser: bool = False,
) -> Viewer:
    """Show a map on an interactive page of this computer, as the command ``ndtree view`` does.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap, OctoMap, str or path
        A map, or its file.
    port : int
        Where the page is; 0 takes any free port.
    look : Look, optional
        How it is shown at first.
    browser : bool
        Open the page.

    Returns
    -------
    Viewer
        Its ``url`` is the page, there until ``close()``; ``wait()`` returns when the user interrupts.
    """
    name = "ndtree"
    if isinstance(m, (str, os.PathLike)):
        placed = open_map(m)
        m, name = placed.resampled(), os.path.basename(os.path.normpath(m))
    page = Viewer(m, port=port, look=look, name=name)
    if browser:
        webbrowser.open(page.url)
    return page
