# SPDX-License-Identifier: BSD-3-Clause
"""Maps on an interactive page: cubes, slices, the trajectory, and the numbers of the cell that is clicked."""

from __future__ import annotations

import atexit
import contextlib
import errno
import io
import logging
import math
import socket
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ndtree._core import OccupancyMap
from ndtree.lattice import Floats, Integers, Pyramid
from ndtree.plot import COLORS, Coloring
from ndtree.snapshot import AXES, IN_PLANE, KINDS, Layer, Look, Snapshot, Track, numbers_of, shown_kinds

if TYPE_CHECKING:
    from ndtree.scan import Scan

try:
    import viser
except ImportError as error:
    raise ImportError(
        f"ndtree.view needs viser ({error}); install it with: pip install 'ndtree-mapping[view]'"
    ) from None

from ndtree.page_guard import guarded

#: What browsers do wrong when they call is no news for the user.
logging.getLogger("websockets").addHandler(logging.NullHandler())

HOST = "127.0.0.1"
PORT = 8080
MAX_BOXES = 200_000  # Drawn of the occupied cells at once.
MAX_CLEAR_BOXES = 30_000  # And of those that are seen through, which the page has to sort.

_TRACK_COLOR = (200, 30, 120)
_CLEAR = {"free": 0.12, "unknown": 0.3, "plane_free": 0.5}  # Opacity.
_SETTLED = 0.25  # Seconds without motion after which the page is drawn anew for the camera.
_GROWN = 1.3  # From so much farther away a page looks at a map that has grown.
_MOVED = 0.2  # By this share of its distance the camera moves before that is done.
_FIELD_OF_VIEW = math.radians(60.0)
#: Lights: from where, and how bright.
_LIGHTS = (((0.15, -0.45, 0.9), 2.3), ((0.9, -0.3, 0.1), 0.6), ((-0.3, 0.6, -0.5), 0.5))
#: The page takes instances' colors as amounts of light, not as what a screen is told.
_LINEAR = np.rint(255 * (np.arange(256) / 255) ** 2.2).astype(np.uint8)
_CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_CUBE_FACES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ]
)


class Viewer:
    """A page on this computer that shows a map. Whoever opens it looks at it in their own way.

    Parameters
    ----------
    m : AdaptiveMap, FixedMap or OctoMap, optional
        With ``dim`` 2 or 3. Left out, the page is empty until `show`.
    port : int
        Where the page is; 0 takes any free port.
    look : Look, optional
        How it is shown at first.
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
        max_boxes: int = MAX_BOXES,
    ) -> None:
        self.max_boxes = max_boxes
        self.look = look
        self.snapshot: Snapshot | None = None
        self.track = Track()
        self.bytes_sent = 0
        self.aim: dict[str, Any] | None = None  # The camera of a page that nobody has turned.
        self._cost, self._shown_at = 0.0, -math.inf
        if m is not None:
            self._take(m)
        self._server = _started(port)
        atexit.register(self.close)  # Before viser does, which says goodbye.
        _light(self._server.scene)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        self._server.gui.set_panel_label("ndtree")
        self._visitors: dict[int, _Visitor] = {}
        self._lock = threading.Lock()
        if self.snapshot is not None:
            self._aim()
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(self._disconnected)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self._server.get_port()}"

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
        snapshot = Snapshot(m)
        if self.look is None:
            self.look = Look.of(m.dim)
        self.look.validate(m.dim)
        if self.snapshot is not None:  # The frame stays where the page's cameras know it.
            snapshot.origin = self.snapshot.origin
        self.snapshot = snapshot

    def _aim(self) -> None:
        """Have new pages, and those that nobody has turned, look at all of a map that has grown."""
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
        visitor = _Visitor(self, client)
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
    middle, extent = 0.5 * (low + high), high - low
    away = 0.5 * float(np.linalg.norm(extent)) / math.tan(0.5 * _FIELD_OF_VIEW)
    flat = snapshot.dim == 2
    direction = np.array([0.0, -1e-3, 1.0]) if flat else np.array([0.35, -0.6, 0.72])
    return {
        "up": np.array([0.0, 0.0, 1.0]),
        "look_at": middle,
        "position": middle + away * direction / np.linalg.norm(direction),
        "fov": _FIELD_OF_VIEW,
        "near": min(0.05, 1e-3 * away),
        "far": 100.0 * away,
    }


def _started(port: int) -> viser.ViserServer:
    if not 0 <= port <= 65535:
        raise ValueError(f"port = {port}: must be from 0 to 65535")
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((HOST, port))
    except OSError as error:
        raise _unusable(port, error.errno, error.strerror) from None
    with guarded(), contextlib.redirect_stdout(io.StringIO()):  # viser introduces itself.
        server = viser.ViserServer(host=HOST, port=port, verbose=False)
    if port and server.get_port() != port:  # Somebody was faster, and viser took another.
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
        raise _unusable(port, errno.EADDRINUSE, None)
    return server


def _light(scene: viser.SceneApi) -> None:
    """Faces are told apart by their brightness, and none is black."""
    scene.set_up_direction("+z")
    scene.configure_environment_map(hdri=None)
    scene.configure_default_lights(enabled=False)
    scene.add_light_ambient("/light", intensity=1.0)
    for i, (direction, intensity) in enumerate(_LIGHTS):
        scene.add_light_directional(f"/light/{i}", intensity=intensity, cast_shadow=False, position=direction)


def _unusable(port: int, number: int | None, reason: str | None) -> OSError:
    found = "in use by another program" if number == errno.EADDRINUSE else reason
    return OSError(number, f"port {port} is {found}, expected a free one", f"{HOST}:{port}")


@dataclass(frozen=True)
class _Eye:
    """Where a page's camera is, the apparent size of its pixels, and how far away is what it turns about."""

    position: Floats | None  # None before the page has said so.
    pixel: float
    reach: float


class _Visitor:
    """One open page: its controls, and a thread that draws what they ask for."""

    def __init__(self, viewer: Viewer, client: viser.ClientHandle) -> None:
        self._viewer, self._client = viewer, client
        self._drawn: dict[str, Any] = {}
        self._last: tuple[Snapshot, Look] | None = None
        self._aim = viewer.aim
        self._wake = threading.Condition()
        self._dirty, self._moved_at, self._stopped = True, -math.inf, False
        self._controls: _Controls | None = None
        client.camera.on_update(lambda _: self._camera_moved())
        client.scene.on_click()(self._pick)
        self._thread = threading.Thread(target=self._run, name="ndtree-view", daemon=True)
        self._thread.start()

    def refresh(self) -> None:
        """Draw anew, soon, and from farther away if the map has grown and nobody has turned the page."""
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
                self._controls = _Controls(self._client, snapshot, self._viewer.look, self.refresh)
            self._draw(snapshot, self._controls)

    def _draw(self, snapshot: Snapshot, controls: _Controls) -> None:
        controls.fit(snapshot)
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
                drawn, there = count, int(np.count_nonzero(snapshot.cells.occupied))
                controls.explain(layer.coloring)
        self._draw_track(snapshot, look)
        boxes = f"  \n{drawn:,} boxes for {there:,} occupied cells" if there else ""
        seen = int(np.count_nonzero(snapshot.cells.observed))
        controls.say(f"{snapshot.refinement} map, {seen:,} cells{boxes}")

    def _draw_boxes(self, kind: str, layer: Layer, look: Look, snapshot: Snapshot) -> int:
        budget = MAX_CLEAR_BOXES if kind in _CLEAR and snapshot.dim == 3 else self._viewer.max_boxes
        before = self._drawn.get(kind)
        is_same = before is not None and before[0] is layer
        if is_same and (layer.pyramid.leaves <= budget or not self._has_moved(before[2])):
            return len(before[1])
        eye = self._eye()
        chosen = layer.pyramid.chosen(eye.position, budget, eye.pixel)
        if is_same and np.array_equal(before[1], chosen):
            return len(chosen)
        if not len(chosen):
            self._remove(kind)
            return 0
        flat_axis = look.axis if kind in IN_PLANE else 2 if snapshot.dim == 2 else None
        boxes = _boxes(layer.pyramid, chosen, flat_axis, lift=0.01 if kind == "occupied" else 0.0)
        is_clear = kind in _CLEAR and snapshot.dim == 3
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
        self._drawn[kind] = (layer, chosen, eye, handle)
        self._viewer.bytes_sent += sum(array.nbytes for array in boxes.values())
        return len(chosen)

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
        self._remove("track")
        handle = self._client.scene.add_line_segments(
            "/track",
            np.stack([points[:-1], points[1:]], axis=1).astype(np.float32),
            _TRACK_COLOR,
            thickness=3.0,
            thickness_units="screen",
        )
        self._drawn["track"] = (len(points), None, handle)

    def _pick(self, event: Any) -> None:
        snapshot, controls = self._viewer.snapshot, self._controls
        if snapshot is None or controls is None:
            return
        origin, direction = (np.asarray(v, dtype=np.float64) for v in (event.ray_origin, event.ray_direction))
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
        handle = self._client.scene.add_line_segments(
            "/picked",
            _edges(lower - snapshot.origin, upper - snapshot.origin),
            (0, 0, 0),
            thickness=2.5,
            thickness_units="screen",
        )
        self._drawn["picked"] = (number, None, handle)


class _Controls:
    """The panel of one page."""

    def __init__(self, client: viser.ClientHandle, snapshot: Snapshot, look: Look, changed: Any) -> None:
        gui = client.gui
        self._dim = snapshot.dim
        self._about = gui.add_markdown("working …")
        colors = COLORS if self._dim == 3 else COLORS[1:]
        self._color = gui.add_dropdown("Color", colors, initial_value=look.color)
        self._legend = gui.add_html("")
        self._checks = {
            name: gui.add_checkbox(label, getattr(look, name))
            for name, label in (
                ("occupied", "Occupied"),
                ("free", "Free"),
                ("unknown", "Unknown by free"),
                ("track", "Trajectory"),
            )
        }
        inputs = [self._color, *self._checks.values()]
        self._axis = self._at = self._sliced = None
        if self._dim == 3:
            with gui.add_folder("Slice"):
                self._sliced = gui.add_checkbox("On", look.slice_at is not None)
                self._axis = gui.add_dropdown("Axis", tuple(AXES), initial_value=AXES[look.axis])
                low, high = (float(edge) for edge in snapshot.region[look.axis])
                at = 0.5 * (low + high) if look.slice_at is None else look.slice_at
                low, high = min(low, at), max(high, at)
                self._at = gui.add_slider("Position [m]", low, high, self._step(snapshot), at)
                self._cut = gui.add_checkbox("Cut away beyond", look.cut)
                self._plane = gui.add_checkbox("Draw its cells", look.plane)
            inputs += [self._sliced, self._at, self._cut, self._plane]
            self._axis.on_update(lambda _: self._turn(changed))
        with gui.add_folder("Cell"):
            self._cell = gui.add_markdown("Click on one.")
        self._snapshot = snapshot
        for each in inputs:
            each.on_update(lambda _: changed())

    @staticmethod
    def _step(snapshot: Snapshot) -> float:
        return snapshot.cells.unit / 4

    def look(self) -> Look:
        """What the controls ask for."""
        shown = {name: check.value for name, check in self._checks.items()}
        if self._sliced is None or not self._sliced.value:
            return Look(color=self._color.value, **shown)
        return Look(
            color=self._color.value,
            axis=AXES.index(self._axis.value),
            slice_at=float(self._at.value),
            cut=self._cut.value,
            plane=self._plane.value,
            **shown,
        )

    def _turn(self, changed: Any) -> None:
        """A slice of another axis begins in the middle."""
        low, high = (float(edge) for edge in self._snapshot.region[AXES.index(self._axis.value)])
        self._at.min, self._at.max = min(low, self._at.min), max(high, self._at.max)
        self._at.value = 0.5 * (low + high)
        self._at.min, self._at.max = low, high
        changed()

    def fit(self, snapshot: Snapshot) -> None:
        """Reach over all of a map that has grown."""
        if snapshot is self._snapshot:
            return
        self._snapshot = snapshot
        if self._at is not None:
            low, high = snapshot.region[AXES.index(self._axis.value)]
            self._at.min, self._at.max = min(self._at.min, float(low)), max(self._at.max, float(high))

    def say(self, text: str) -> None:
        self._about.content = text

    def say_cell(self, text: str) -> None:
        self._cell.content = text

    def explain(self, colors: Coloring | None) -> None:
        """What the colors mean: a strip from the lowest to the highest."""
        self._legend.content = "" if colors is None else legend_html(colors)


def legend_html(colors: Coloring) -> str:
    """A strip of the colors with their ends' values below."""
    shown = colors.legend()
    levels = shown.cmap(np.linspace(0, 1, 12))[:, :3]
    stops = ", ".join(f"rgb({', '.join(str(round(255 * c)) for c in level)})" for level in levels)
    return (
        '<div style="margin:0 1em 0.6em;font-size:0.8em">'
        f'<div style="height:0.8em;border-radius:3px;background:linear-gradient(to right, {stops})"></div>'
        '<div style="display:flex;justify-content:space-between">'
        f"<span>{shown.norm.vmin:.3g}</span><span>{colors.label}</span><span>{shown.norm.vmax:.3g}</span>"
        "</div></div>"
    )


def _boxes(pyramid: Pyramid, chosen: Integers, flat_axis: int | None, lift: float) -> dict[str, Any]:
    """What the page needs to draw boxes: one cube or tile, and where and how large it is each time."""
    lower, upper = pyramid.lower[chosen], pyramid.upper[chosen]
    positions, scales = 0.5 * (lower + upper), upper - lower
    vertices, faces = _CUBE, _CUBE_FACES
    if flat_axis is not None:
        vertices = np.zeros((4, 3))
        across = [a for a in range(3) if a != flat_axis]
        vertices[:, across] = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
        faces = np.array([(0, 1, 2), (0, 2, 3)])
        scales[:, flat_axis] = 1.0
        positions[:, flat_axis] += lift
    wxyzs = np.zeros((len(chosen), 4), dtype=np.float32)
    wxyzs[:, 0] = 1.0
    return {
        "vertices": vertices.astype(np.float32),
        "faces": faces.astype(np.uint32),
        "batched_wxyzs": wxyzs,
        "batched_positions": positions.astype(np.float32),
        "batched_scales": scales.astype(np.float32),
        "batched_colors": _LINEAR[pyramid.colors[chosen]],
    }


def _edges(lower: Floats, upper: Floats) -> NDArray[np.float32]:
    """The edges of a box: (12, 2, 3)."""
    corners = np.where(_CUBE > 0, upper, lower)
    pairs = [(i, j) for i in range(8) for j in range(i) if np.count_nonzero(_CUBE[i] != _CUBE[j]) == 1]
    return corners[np.array(pairs)].astype(np.float32)
