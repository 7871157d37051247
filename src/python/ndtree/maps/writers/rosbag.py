# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 1 and ROS 2 with one message: octomap_msgs/Octomap, or nav_msgs/OccupancyGrid."""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from ndtree._lazy import needs
from ndtree._native._core import OccupancyMap
from ndtree.base.files import replaced
from ndtree.logs import contents
from ndtree.maps.writers.map_server import noise_depth

OCTOMAP_TOPIC = "/octomap_full"
GRID_TOPIC = "/map"
FRAME = "map"
_OCTOMAP = "octomap_msgs/msg/Octomap"
_GRID = "nav_msgs/msg/OccupancyGrid"
_HELD = tuple(kind.replace("/msg/", "/") for kind in (_OCTOMAP, _GRID))
_OCTOMAP_DEFINITION = """\
std_msgs/Header header
bool binary
string id
float64 resolution
int8[] data
"""
# Of a pixel's grey value; ROS has -1 for unknown, and percents.
_PERCENT = {254: 0, 0: 100, 205: -1}


def holds_maps_alone(path: str) -> bool:
    """Whether a bag is no recording, and may be replaced by a map."""
    try:
        topics = contents(path, format="rosbag", whole=False)["topics"]
    except (OSError, ValueError, ImportError, KeyError):
        return False
    return all(topic["type"].replace("/msg/", "/") in _HELD for topic in topics)


def write(
    m: OccupancyMap,
    path: Path,
    *,
    cell_size: float | None = None,
    height: tuple[float, float] | None = None,
    wall_depth: float | None = None,
) -> None:
    """A bag of ROS 1 (.bag), or the one file of a bag of ROS 2 (.mcap, .db3), in the frame ``map``.

    A 3-D map becomes an Octomap with its log-odds, on the topic ``/octomap_full``; a 2-D one, or a slice of
    the given height, an OccupancyGrid of 0, 100 and -1 on ``/map``. Who subscribes later gets it, too
    (latched, transient local).

    `wall_depth`: Of a grid; left out, `noise_depth`.
    """
    wall_depth = noise_depth(m) if wall_depth is None else wall_depth
    with needs("ROS bags need rosbags", "ros"):
        from rosbags import interfaces, rosbag1, rosbag2, typesys
    is_ros1 = path.suffix == ".bag"
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_ros1 else typesys.Stores.ROS2_HUMBLE)
    store.register(typesys.get_types_from_msg(_OCTOMAP_DEFINITION, _OCTOMAP))
    now = time.time_ns()
    if m.dim == 3 and height is None:
        topic, kind, message = OCTOMAP_TOPIC, _OCTOMAP, _octomap(m, store, now, cell_size)
    else:
        topic, kind, message = GRID_TOPIC, _GRID, _grid(m, store, now, cell_size, height, wall_depth)
    with replaced(path, holds_maps_alone) as part, tempfile.TemporaryDirectory() as folder:
        if is_ros1:
            data = Path(folder, "map.bag")
            with rosbag1.Writer(data) as bag:
                connection = bag.add_connection(topic, kind, typestore=store, latching=1)
                bag.write(connection, now, store.serialize_ros1(message, kind))
        else:
            plugin = rosbag2.StoragePlugin
            with rosbag2.Writer(
                Path(folder, "map"),
                version=9,
                storage_plugin=plugin.MCAP if path.suffix == ".mcap" else plugin.SQLITE3,
            ) as bag:
                connection = bag.add_connection(
                    topic, kind, typestore=store, offered_qos_profiles=[_latched(interfaces)]
                )
                bag.write(connection, now, store.serialize_cdr(message, kind))
            (data,) = Path(folder, "map").glob(f"*{path.suffix}")
        shutil.copyfile(data, part)


def _latched(interfaces: Any) -> Any:
    forever = interfaces.QosTime(2147483647, 4294967295)
    return interfaces.Qos(
        interfaces.QosHistory.KEEP_LAST,
        1,
        interfaces.QosReliability.RELIABLE,
        interfaces.QosDurability.TRANSIENT_LOCAL,
        forever,
        forever,
        interfaces.QosLiveliness.AUTOMATIC,
        forever,
        False,
    )


def _header(store: Any, now: int) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9)
    header = store.types["std_msgs/msg/Header"]
    if "seq" in header.__dataclass_fields__:  # ROS 1
        return header(seq=0, stamp=stamp, frame_id=FRAME)
    return header(stamp=stamp, frame_id=FRAME)


def octomap_nodes(m: OccupancyMap, cell_size: float | None, *, binary: bool) -> tuple[str, float, bytes]:
    """What a message with an OctoMap holds: the name of its kind, its resolution [m], and its nodes."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "map.bt" if binary else "map.ot")
        m.save_octomap(file, cell_size=cell_size)
        header, _, nodes = file.read_bytes().partition(b"\ndata\n")  # The message has no header of its own.
    kind = "ColorOcTree" if b"\nid ColorOcTree\n" in header else "OcTree"
    return kind, float(m.options["min_cell_size"] if cell_size is None else cell_size), nodes


def _octomap(m: OccupancyMap, store: Any, now: int, cell_size: float | None) -> Any:
    kind, resolution, nodes = octomap_nodes(m, cell_size, binary=False)
    return store.types[_OCTOMAP](
        header=_header(store, now),
        binary=False,
        id=kind,
        resolution=resolution,
        data=np.frombuffer(nodes, dtype=np.int8),
    )


def _grid(
    m: OccupancyMap,
    store: Any,
    now: int,
    cell_size: float | None,
    height: tuple[float, float] | None,
    wall_depth: float | None,
) -> Any:
    pixels, (x, y), size = m.map_server_image(cell_size=cell_size, height=height, wall_depth=wall_depth)
    percent = np.zeros(256, dtype=np.int8)
    for grey, value in _PERCENT.items():
        percent[grey] = value
    header = _header(store, now)
    types = store.types
    pose = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=height[0] if height else 0.0),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    )
    info = types["nav_msgs/msg/MapMetaData"](
        map_load_time=header.stamp,
        resolution=size,
        width=pixels.shape[1],
        height=pixels.shape[0],
        origin=pose,
    )
    return types[_GRID](header=header, info=info, data=percent[pixels[::-1]].ravel())
