# SPDX-License-Identifier: BSD-3-Clause
"""The format "rosbag": how a bag is recognised, and what a user may say of it."""

from __future__ import annotations

import os
from typing import Any

from ndtree.logs.core.source import TIME_OFFSET, ZERO_IS, Format, ReaderOption, Source
from ndtree.logs.folders.depth_image import CAMERA, PIXEL_STRIDE
from ndtree.logs.formats.velodyne import STILL
from ndtree.logs.poses.covariances import USES
from ndtree.logs.poses.trajectory_files import TRAJECTORY
from ndtree.logs.ros.files.bag import ENDINGS, MAGICS, METADATA, METADATA_BEGINS, ZSTD_MAGIC, open_bag
from ndtree.logs.ros.messages.sweep import BY_WORD
from ndtree.logs.ros.options import BagOptions
from ndtree.logs.ros.outline import outline
from ndtree.logs.ros.rosbag import RosbagLog
from ndtree.logs.ros.survey import POSE_NAMES

TOPIC = ReaderOption(
    "topic", list[str], "Of a ROS bag: topic with scans, clouds or depth images; @SIGMA [m] may follow."
)
FIXED_FRAME = ReaderOption(
    "fixed_frame", str, "Of a ROS bag: frame of the map; else map, odom, world or a root."
)
ODOMETRY = ReaderOption("odometry", str, "Of a ROS bag: topic with Odometry, for poses instead of /tf.")
POSE_TOPIC = ReaderOption("poses", str, f"Of a ROS bag: topic with poses: {POSE_NAMES}.")
MOUNT = ReaderOption("mount", str, "Of a ROS bag: sensor on its base, X,Y,Z,ROLL,PITCH,YAW or X,Y,YAW.")
SENSOR_FRAME = ReaderOption(
    "sensor_frame", str, "Of a ROS bag: the sensor's frame, whatever its messages say."
)
BASE_FRAME = ReaderOption(
    "base_frame",
    str,
    "Of a ROS bag: frame of the mount, that the poses are of, or that a cloud was seen from.",
)
DESKEW = ReaderOption("deskew", bool, "Of a ROS bag: each beam from the pose of its own time (default).")

SWEEP = ReaderOption(
    "sweep", str, f"Of a ROS bag: when its beams were measured: {', '.join(BY_WORD)}; else the log decides."
)

BODY = ReaderOption(
    "body",
    str,
    "Of a ROS bag: the robot itself, box:LX,LY,LZ[,X,Y,Z], sphere:, capsule: or footprint:, + more, @FRAME.",
)

POSE_COVARIANCE = ReaderOption(
    "pose_covariance",
    str,
    f"Of a ROS bag: covariances of poses widen beams: {', '.join(USES)}; auto unless a driver's default.",
)


def _recognises(source: Source) -> bool:
    if source.is_folder:
        return METADATA in source.names or any(name.endswith(ENDINGS) for name in source.names)
    if source.head.startswith(ZSTD_MAGIC):  # What is in it, its name says.
        return source.path.endswith(ENDINGS)
    return source.head.startswith((*MAGICS, METADATA_BEGINS))


def _bag_of(source: Source) -> str:
    """The path of the bag: of its metadata.yaml, the folder."""
    return os.path.dirname(source.path) or "." if source.head.startswith(METADATA_BEGINS) else source.path


def _open(source: Source, *, dim: int | None = None, **options: Any) -> RosbagLog:
    return RosbagLog(_bag_of(source), BagOptions(**options), dim=dim)


def _contents(source: Source, whole: bool = True) -> dict[str, Any]:
    with open_bag(_bag_of(source)) as bag:
        return outline(bag, whole=whole)


ROSBAG = Format(
    "rosbag",
    "a ROS bag",
    _recognises,
    _open,
    options=(
        TOPIC, FIXED_FRAME, ODOMETRY, POSE_TOPIC, TRAJECTORY, STILL, MOUNT, SENSOR_FRAME, BASE_FRAME,
        TIME_OFFSET, DESKEW, SWEEP, CAMERA, PIXEL_STRIDE, ZERO_IS, BODY, POSE_COVARIANCE,
    ),
    stored_as="either",
    contents=_contents,
    dim=None,
)  # fmt: skip
