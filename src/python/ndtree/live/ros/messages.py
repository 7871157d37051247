# SPDX-License-Identifier: BSD-3-Clause
"""Messages of ROS 1 and ROS 2 that show a map, made of arrays. Classes have the same names in both."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseArray,
    PoseWithCovarianceStamped,
    Quaternion,
    TransformStamped,
)
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ndtree.live.canvas import GridPart
from ndtree.live.localizing import quaternion_of
from ndtree.live.outputs import FrontierPose, by_size

#: Messages of ROS 1 take bytes, and arrays of numbers by classes of their own; those of ROS 2 take arrays.
IS_ROS1 = hasattr(Header, "_md5sum")


def class_of(type: str) -> Any:
    """The class of a type as "sensor_msgs/msg/LaserScan"; ImportError if its package is not there."""
    package, kind, name = type.split("/")
    return getattr(import_module(f"{package}.{kind}"), name)


def optional_class(type: str) -> Any:
    """As `class_of`; None if it is not there."""
    try:
        return class_of(type)
    except (ImportError, AttributeError):
        return None


def _of_numbers(kind: Any) -> Any:
    """A class of messages with the field `data` of int8, which is given to it as `_numbers`."""
    return import_module("rospy.numpy_msg").numpy_msg(kind) if IS_ROS1 else kind


def _numbers(values: NDArray[np.int8]) -> Any:
    return values.ravel().view(_Numbers) if IS_ROS1 else array("b", values.tobytes())


class _Numbers(NDArray[np.int8] if TYPE_CHECKING else np.ndarray):  # type: ignore[misc]
    """An array as rospy packs it: NumPy 2 has no such name any more."""

    def tostring(self) -> bytes:
        return self.tobytes()


def header(frame: str, stamp: float) -> Header:
    """Of a frame at a time [s]."""
    nanoseconds = max(round(stamp * 1e9), 0)
    message = Header(frame_id=frame)
    # Only the parts of a time have other names.
    parts = ("secs", "nsecs") if hasattr(message.stamp, "secs") else ("sec", "nanosec")
    for name, part in zip(parts, divmod(nanoseconds, 10**9)):
        setattr(message.stamp, name, part)
    return message


def pose_message(position: Sequence[float], quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Pose:
    """Of a position [m], and a quaternion x, y, z, w."""
    x, y, z = map(float, position)
    qx, qy, qz, qw = map(float, quaternion)
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def _placed(pose: NDArray[np.float64]) -> Pose:
    """Of a pose in the plane (3, 3) or in space (4, 4)."""
    return pose_message([*pose[:-1, -1], 0.0][:3], quaternion_of(pose))


def transform(parent: str, child: str, stamp: float, pose: NDArray[np.float64]) -> TransformStamped:
    """Of a pose in the plane or in space at a time [s]."""
    message, place = TransformStamped(header=header(parent, stamp), child_frame_id=child), _placed(pose)
    message.transform.rotation = place.orientation
    for name in "xyz":
        setattr(message.transform.translation, name, getattr(place.position, name))
    return message


def pose_with_covariance(
    frame: str, stamp: float, pose: NDArray[np.float64], covariance: NDArray[np.float64]
) -> PoseWithCovarianceStamped:
    """Of a pose in the plane or in space, and the covariance of x, y, in space z, and yaw."""
    message = PoseWithCovarianceStamped(header=header(frame, stamp))
    message.pose.pose = _placed(pose)
    whole = np.zeros((6, 6))
    freedoms = [*range(len(pose) - 1), 5]
    whole[np.ix_(freedoms, freedoms)] = covariance
    message.pose.covariance = whole.ravel().tolist()
    return message


def grid_message(
    values: NDArray[np.int8], cell_size: float, origin: tuple[float, float, float], frame: str, stamp: float
) -> OccupancyGrid:
    """All of a grid."""
    message = _of_numbers(OccupancyGrid)(header=header(frame, stamp))
    message.info.map_load_time = message.header.stamp
    message.info.resolution = float(cell_size)
    message.info.height, message.info.width = values.shape
    message.info.origin = pose_message(origin)
    message.data = _numbers(values.copy())
    return message


def update_message(kind: Any, part: GridPart, frame: str, stamp: float) -> Any:
    """A part of a grid, as map_msgs/OccupancyGridUpdate."""
    height, width = part.values.shape
    return _of_numbers(kind)(
        header=header(frame, stamp),
        x=part.column,
        y=part.row,
        width=width,
        height=height,
        data=_numbers(part.values),
    )


def cloud_message(points: NDArray[np.void], frame: str, stamp: float) -> PointCloud2:
    """Records of numbers of float32 as points."""
    kind, data = points.dtype, points.tobytes()
    fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate(kind.names or ())
    ]
    return PointCloud2(
        header=header(frame, stamp),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=kind.itemsize,
        row_step=kind.itemsize * len(points),
        data=data if IS_ROS1 else array("B", data),
        is_dense=True,
    )


def marker_message(points: NDArray[np.void], frame: str, stamp: float) -> MarkerArray:
    """Cells as boxes, a list of each size; lists of before are deleted."""
    markers = [Marker(header=header(frame, stamp), action=Marker.DELETEALL)]
    for number, (size, centers, colors) in enumerate(by_size(points)):
        marker = Marker(header=header(frame, stamp), ns=f"cells of {size:g} m", id=number)
        marker.type, marker.action = Marker.CUBE_LIST, Marker.ADD
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = size
        marker.colors = [ColorRGBA(r=r, g=g, b=b, a=1.0) for r, g, b in colors.tolist()]
        marker.color = marker.colors[0]
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in centers.tolist()]
        if len(marker.colors) < len(marker.points):  # One for all.
            marker.colors = []
        markers.append(marker)
    return MarkerArray(markers=markers)


def frontier_message(poses: Sequence[FrontierPose], frame: str, stamp: float) -> PoseArray:
    """Frontiers as poses."""
    return PoseArray(header=header(frame, stamp), poses=[pose_message(*pose) for pose in poses])


def octomap_message(
    kind: Any, content: tuple[str, float, bytes], frame: str, stamp: float, *, binary: bool
) -> Any:
    """An octomap_msgs/Octomap of what `octomap_nodes` has."""
    name, resolution, nodes = content
    return _of_numbers(kind)(
        header=header(frame, stamp),
        binary=binary,
        id=name,
        resolution=resolution,
        data=_numbers(np.frombuffer(nodes, np.int8)),
    )
