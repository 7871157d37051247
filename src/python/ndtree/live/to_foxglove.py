# SPDX-License-Identifier: BSD-3-Clause
"""Shows a live map to Foxglove: a server in this process, to which the application connects."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from itertools import repeat
from typing import Any

import numpy as np

from ndtree._lazy import needs
from ndtree._native._core import OccupancyMap
from ndtree.live.grid import GridFollower
from ndtree.live.outputs import GRID_COLORS, Frontiers, Shown, by_size, cell_points

with needs("ndtree.live.FoxgloveSink needs foxglove-sdk", "foxglove"):
    import foxglove
    from foxglove import channels, messages

#: Where Foxglove looks for a server, and how often the map is shown [s].
PORT, PERIOD = 8765, 0.5
#: A pixel: as nav_msgs/OccupancyGrid has it, and its colour.
PIXEL = np.dtype([("occupancy", "i1"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("alpha", "u1")])


class FoxgloveSink:
    """A sink of a live mapper that serves the map to Foxglove.

    ``/map`` is a Grid in the plane, ``/cells`` a PointCloud of occupied cells with fields x, y, z, size and
    probability, ``/cell_boxes`` a scene with an entity for each size of cells, ``/frontiers`` and ``/way``
    are poses. Each is made only while a client listens to it, and for a client that comes.

    `port`: 0: one that is free.
    `host`: On which of this machine's addresses; "0.0.0.0" for all.
    `frame`: Of the map.
    `**shown`: Fields of `Shown`: ``period``, ``height``, ``way``, ``min_cells``.
    Raises ValueError if a number is out of its limits; OSError if the port is taken.
    """

    def __init__(
        self,
        port: int = PORT,
        *,
        host: str = "127.0.0.1",
        frame: str | Callable[[], str] = "map",
        **shown: Any,
    ) -> None:
        if not 0 <= port <= 65535:
            raise ValueError(f"port = {port}: must be from 0 to 65535")
        how = Shown(**{"period": PERIOD, **shown})
        self.period = how.period
        self._frame, self._way = frame, how.way
        self._grid, self._frontiers = GridFollower(None, how.height), Frontiers(how.min_cells)
        self._z = 0.0 if how.height is None else how.height[0]
        self._last: tuple[OccupancyMap, float] | None = None
        self._lock = threading.Lock()
        self._context = context = foxglove.Context()  # Without it, its channels are gone.
        made = {
            "/map": (channels.GridChannel, self._map),
            "/cells": (channels.PointCloudChannel, self._cells),
            "/cell_boxes": (channels.SceneUpdateChannel, self._boxes),
            "/frontiers": (channels.PosesInFrameChannel, self._frontier_poses),
            "/way": (channels.PosesInFrameChannel, self._passed),
        }
        self._channels: dict[str, tuple[Any, Callable[[OccupancyMap, float], Any]]] = {
            topic: (kind(topic, context=context), make) for topic, (kind, make) in made.items()
        }
        try:
            self._server = foxglove.start_server(
                name="ndtree", host=host, port=port, context=context, server_listener=_Listener(self)
            )
        except RuntimeError as error:
            raise OSError(f"port {port} of {host}: {error}, expected one that is free") from None
        #: Where clients connect.
        self.url = f"ws://{host}:{self._server.port}"

    def update(self, m: OccupancyMap, stamp: float) -> None:
        """Send what clients listen to."""
        with self._lock:
            self._last = m, stamp
            for topic in self._channels:
                self._send(topic, m, stamp)

    def welcome(self, topic: str) -> None:
        """Send a topic as it is now, to a client that has come."""
        with self._lock:
            if self._last is not None and topic in self._channels:
                self._send(topic, *self._last)

    def close(self) -> None:
        """Serve no more."""
        self._server.stop()

    def _send(self, topic: str, m: OccupancyMap, stamp: float) -> None:
        channel, make = self._channels[topic]
        if not channel.has_sinks():
            return
        message = make(m, stamp)
        if message is not None:
            channel.log(message, log_time=round(max(stamp, 0.0) * 1e9))

    def _head(self, stamp: float) -> dict[str, Any]:
        nanoseconds = round(max(stamp, 0.0) * 1e9)
        time = messages.Timestamp(sec=nanoseconds // 10**9, nsec=nanoseconds % 10**9)
        return {"timestamp": time, "frame_id": self._frame if isinstance(self._frame, str) else self._frame()}

    def _map(self, m: OccupancyMap, stamp: float) -> Any:
        self._grid.follow(m)
        values = self._grid.values
        if values is None:
            return None
        pixels = np.zeros(values.shape, dtype=PIXEL)
        pixels["occupancy"] = values
        for value, color in GRID_COLORS.items():
            for name, one in zip(("red", "green", "blue", "alpha"), color):
                pixels[name][values == value] = one
        x, y = self._grid.origin
        return messages.Grid(
            **self._head(stamp),
            pose=_pose((x, y, self._z)),
            column_count=values.shape[1],
            cell_size=messages.Vector2(x=self._grid.cell_size, y=self._grid.cell_size),
            row_stride=PIXEL.itemsize * values.shape[1],
            cell_stride=PIXEL.itemsize,
            fields=_fields(PIXEL),
            data=pixels.tobytes(),
        )

    def _cells(self, m: OccupancyMap, stamp: float) -> Any:
        points = cell_points(m)
        return messages.PointCloud(
            **self._head(stamp),
            pose=_pose((0.0, 0.0, 0.0)),
            point_stride=points.dtype.itemsize,
            fields=_fields(points.dtype),
            data=points.tobytes(),
        )

    def _boxes(self, m: OccupancyMap, stamp: float) -> Any:
        entities = []
        for size, centers, colors in by_size(cell_points(m)):
            edges = messages.Vector3(x=size, y=size, z=size)
            shown = [messages.Color(r=r, g=g, b=b, a=1.0) for r, g, b in colors.tolist()]
            cubes = [
                messages.CubePrimitive(pose=_pose(one), size=edges, color=color)
                for one, color in zip(centers.tolist(), shown if len(shown) > 1 else repeat(shown[0]))
            ]
            entities.append(messages.SceneEntity(**self._head(stamp), id=f"cells of {size:g} m", cubes=cubes))
        everything = messages.SceneEntityDeletion(type=messages.SceneEntityDeletionType.All)
        return messages.SceneUpdate(deletions=[everything], entities=entities)

    def _frontier_poses(self, m: OccupancyMap, stamp: float) -> Any:
        poses = [_pose(*one) for one in self._frontiers.follow(m)]
        return messages.PosesInFrame(**self._head(stamp), poses=poses)

    def _passed(self, m: OccupancyMap, stamp: float) -> Any:
        points = [] if self._way is None else self._way.points().tolist()
        return messages.PosesInFrame(**self._head(stamp), poses=list(map(_pose, points)))


class _Listener(foxglove.ServerListener):
    """Sends what a new client would otherwise wait for until the map changes."""

    def __init__(self, sink: FoxgloveSink) -> None:
        self._sink = sink

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self._sink.welcome(channel.topic)


def _pose(position: Sequence[float], quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Any:
    x, y, z = position
    qx, qy, qz, qw = quaternion
    return messages.Pose(
        position=messages.Vector3(x=x, y=y, z=z), orientation=messages.Quaternion(x=qx, y=qy, z=qz, w=qw)
    )


def _fields(layout: np.dtype[Any]) -> list[Any]:
    numbers = messages.PackedElementFieldNumericType
    kinds = {"i1": numbers.Int8, "u1": numbers.Uint8, "f4": numbers.Float32}
    fields = layout.fields
    assert fields is not None
    return [
        messages.PackedElementField(name=name, offset=offset, type=kinds[kind.str[1:]])
        for name, (kind, offset, *_) in fields.items()
    ]
