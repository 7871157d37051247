# SPDX-License-Identifier: BSD-3-Clause
"""One open page: what it shows, and a thread that draws it."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import viser
from numpy.typing import NDArray

from ndtree.cells.lattice import Floats
from ndtree.cells.regions import Track
from ndtree.plot.figures import kind_of
from ndtree.viewer.controls import Controls
from ndtree.viewer.frame import draw_frame, drawn_boxes, edges_of
from ndtree.viewer.look import IN_PLANE, KINDS, Look, shown_kinds
from ndtree.viewer.snapshot import Layer, Snapshot, numbers_of
from ndtree.viewer.ways import Ways, place_on_plane

MAX_CLEAR_BOXES = 30_000  # And of those that are seen through, which the page has to sort.
Color = tuple[int, int, int]
_TRACK_COLOR = (200, 30, 120)
_WAY_COLOR = (230, 120, 0)
_CLEAR = {"free": 0.12, "unknown": 0.3, "plane_free": 0.5}  # Opacity.
_SETTLED = 0.25  # Seconds without motion after which the page is drawn anew for the camera.
_MOVED = 0.2  # By this share of its distance the camera moves before that is done.


class Shown(Protocol):
    """What all pages of a map have in common."""

    snapshot: Snapshot | None
    look: Look | None
    track: Track
    aim: dict[str, Any] | None
    max_boxes: int


@dataclass(frozen=True)
class _Eye:
    """Where a page's camera is, the apparent size of its pixels, and how far away is what it turns about."""

    position: Floats | None  # None before the page has said so.
    pixel: float
    reach: float


class Visitor:
    """One open page: its controls, and a thread that draws what they ask for."""

    def __init__(self, viewer: Shown, client: viser.ClientHandle) -> None:
        self._viewer, self._client = viewer, client
        self._drawn: dict[str, Any] = {}
        self._last: tuple[Snapshot, Look] | None = None
        self._aim = viewer.aim
        self._ways = Ways()
        self._wake = threading.Condition()
        self._dirty, self._moved_at, self._stopped = True, -math.inf, False
        self._controls: Controls | None = None
        client.camera.on_update(lambda _: self._camera_moved())
        client.scene.on_click()(self._pick)
        self._thread = threading.Thread(target=self._run, name="ndtree-view", daemon=True)
        self._thread.start()

    def refresh(self) -> None:
        """Draw anew, soon, and from farther away if the map has grown and the page was not turned."""
        self._follow()
        with self._wake:
            self._dirty = True
            self._wake.notify()

    def _follow(self) -> None:
        aim, position = self._viewer.aim, self._eye().position
        if aim is None or aim is self._aim or position is None:
            return
        if self._aim is not None:
            away = np.linalg.norm(position - self._aim["position"])
            if away > 0.01 * np.linalg.norm(self._aim["position"] - self._aim["look_at"]):
                return
        self._aim = aim
        camera = self._client.camera
        with self._client.atomic():
            camera.position = aim["position"]  # Takes the point that it looks at with it.
            camera.look_at = aim["look_at"]
            camera.near, camera.far, camera.fov = aim["near"], aim["far"], aim["fov"]

    def stop(self) -> None:
        with self._wake:
            self._stopped = True
            self._wake.notify()

    def _camera_moved(self) -> None:
        with self._wake:
            self._moved_at = time.perf_counter()
            self._wake.notify()

    def _run(self) -> None:
        seen_motion = -math.inf
        while True:
            with self._wake:
                while not self._stopped and not self._dirty:
                    if self._moved_at > seen_motion:
                        rest = self._moved_at + _SETTLED - time.perf_counter()
                        if rest <= 0:
                            break
                        self._wake.wait(rest)
                    else:
                        self._wake.wait()
                if self._stopped:
                    return
                self._dirty = False
                seen_motion = self._moved_at
            snapshot = self._viewer.snapshot
            if snapshot is None:
                continue
            if self._controls is None:
                assert self._viewer.look is not None
                self._controls = Controls(
                    self._client,
                    snapshot,
                    self._viewer.look,
                    self.refresh,
                    has_track=bool(self._viewer.track.points),
                )
            self._draw(snapshot, self._controls)

    def _draw(self, snapshot: Snapshot, controls: Controls) -> None:
        controls.fit(snapshot)
        controls.offer_track(bool(self._viewer.track.points))
        look = controls.look()
        if (snapshot, look) != self._last:
            controls.say("working …")
            self._last = (snapshot, look)
        kinds = shown_kinds(look)
        drawn, there = 0, 0
        for kind in KINDS:
            if kind not in kinds:
                self._remove(kind)
                continue
            layer = snapshot.layer(kind, look)
            count = self._draw_boxes(kind, layer, look, snapshot)
            if kind == "occupied":
                drawn, there = count, snapshot.counts[1]
                controls.explain(layer.coloring)
        self._draw_track(snapshot, look)
        self._draw_frame(snapshot, look)
        boxes = f"  \n{drawn:,} boxes for {there:,} occupied cells" if there else ""
        controls.say(f"{kind_of(snapshot.refinement)} map, {snapshot.counts[0]:,} cells{boxes}")

    def _draw_boxes(self, kind: str, layer: Layer, look: Look, snapshot: Snapshot) -> int:
        budget = MAX_CLEAR_BOXES if kind in _CLEAR and snapshot.dim == 3 else self._viewer.max_boxes
        before = self._drawn.get(kind)
        is_same = before is not None and before[0] is layer
        if is_same and (len(layer.cells) <= budget or not self._has_moved(before[2])):
            return int(before[1])
        eye = self._eye()
        chosen = layer.pyramid.chosen(eye.position, budget, eye.pixel)
        if not len(chosen):
            self._remove(kind)
            return 0
        flat_axis = look.axis if kind in IN_PLANE else 2 if snapshot.dim == 2 else None
        is_clear = kind in _CLEAR and snapshot.dim == 3
        boxes = drawn_boxes(layer.pyramid, chosen, flat_axis, lift=0.01 if kind == "occupied" else 0.0)
        with self._client.atomic():
            self._remove(kind)
            handle = self._client.scene.add_batched_meshes_simple(
                f"/{kind}",
                **boxes,
                lod="off",
                opacity=_CLEAR[kind] if is_clear else None,
                flat_shading=True,
                side="front" if flat_axis is None else "double",
                cast_shadow=False,
                receive_shadow=False,
            )
        self._drawn[kind] = (layer, len(chosen), eye, handle)
        return len(chosen)

    def _draw_lines(
        self, name: str, lines: NDArray[np.floating], color: Color, width: float, key: Any = None
    ) -> None:
        """Segments (n, 2, 3) [m] instead of those of this name; `key`: By which they are known again."""
        self._remove(name)
        handle = self._client.scene.add_line_segments(
            f"/{name}", lines.astype(np.float32), color, thickness=width, thickness_units="screen"
        )
        self._drawn[name] = (key, handle)

    def _remove(self, kind: str) -> None:
        before = self._drawn.pop(kind, None)
        if before is not None:
            before[-1].remove()

    def _eye(self) -> _Eye:
        camera = self._client.camera
        try:
            position = np.asarray(camera.position, dtype=np.float64)
            pixel = 2 * math.tan(0.5 * camera.fov) / max(camera.image_height, 1)
            return _Eye(position, pixel, float(np.linalg.norm(position - camera.look_at)))
        except AssertionError:  # viser's way to say "not yet".
            return _Eye(None, 0.0, 0.0)

    def _has_moved(self, before: _Eye) -> bool:
        """Whether what is near has changed so much that it is worth choosing anew what is drawn finely."""
        now = self._eye()
        if now.position is None or before.position is None:
            return now.position is not None
        return float(np.linalg.norm(now.position - before.position)) > _MOVED * before.reach

    def _draw_track(self, snapshot: Snapshot, look: Look) -> None:
        points = np.asarray(self._viewer.track) - snapshot.origin
        before = self._drawn.get("track")
        if not look.track or len(points) < 2:
            self._remove("track")
            return
        if before is not None and before[0] == len(points):
            return
        self._draw_lines("track", np.stack([points[:-1], points[1:]], axis=1), _TRACK_COLOR, 3.0, len(points))

    def _draw_frame(self, snapshot: Snapshot, look: Look) -> None:
        bounds = (snapshot.region.T - snapshot.origin).tolist()
        before = self._drawn.get("frame")
        if look.grid and before is not None and before[0] == bounds:
            return
        for handle in self._drawn.pop("frame", (None, []))[1]:
            handle.remove()
        if look.grid:
            handles = draw_frame(self._client.scene, *(np.array(corner) for corner in bounds))
            self._drawn["frame"] = (bounds, handles)

    def _pick(self, event: Any) -> None:
        snapshot, controls = self._viewer.snapshot, self._controls
        if snapshot is None or controls is None:
            return
        origin, direction = (np.asarray(v, dtype=np.float64) for v in (event.ray_origin, event.ray_direction))
        if controls.way is not None:
            self._ask_way(snapshot, controls, origin, direction)
            return
        found = snapshot.picked(origin, direction, controls.look())
        self._remove("picked")
        if found is None:
            controls.say_cell("no cell there")
            return
        cells, number = found
        controls.say_cell(numbers_of(cells, number))
        lower, upper = np.zeros((2, 3))
        lower[: snapshot.dim] = cells.lower[number] * cells.unit
        upper[: snapshot.dim] = cells.upper[number] * cells.unit
        edges = edges_of(lower - snapshot.origin, upper - snapshot.origin)
        self._draw_lines("picked", edges, (0, 0, 0), 2.5)

    def _ask_way(self, snapshot: Snapshot, controls: Controls, origin: Floats, direction: Floats) -> None:
        assert controls.way is not None
        radius, height = controls.way
        place = place_on_plane(origin + snapshot.origin, direction, height)
        if place is None:
            return
        said, points = self._ways.clicked(snapshot.map, place, radius)
        controls.say_cell(said)
        self._remove("way")
        self._remove("way ends")
        shown = np.zeros((len(points), 3))
        shown[:, : points.shape[1]] = points
        if snapshot.dim == 2:
            shown[:, 2] = 0.05  # Above the cells.
        shown = (shown - snapshot.origin).astype(np.float32)
        if len(shown) > 1:
            self._draw_lines("way", np.stack([shown[:-1], shown[1:]], axis=1), _WAY_COLOR, 4.0)
        if len(shown):
            colors = np.tile(np.array(_WAY_COLOR, dtype=np.uint8), (len(shown), 1))
            dots = self._client.scene.add_point_cloud(
                "/way_ends", shown, colors, point_size=0.5 * radius, point_shape="circle"
            )
            self._drawn["way ends"] = (None, dots)
