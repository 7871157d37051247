# SPDX-License-Identifier: BSD-3-Clause
"""Where the robot is, published by a node that finds it in a map: a pose, and map to odom."""

from __future__ import annotations

from geometry_msgs.msg import PoseWithCovarianceStamped

from ndtree.live.localizing import ODOMETRY, Localization
from ndtree.live.ros.messages import optional_class, pose_with_covariance, transform
from ndtree.live.ros.middleware import Middleware

#: The frame of a map that the robot is found in.
MAP = "map"
#: How far ahead the transform is dated, as others need it for times that are a little later [s].
AHEAD = 0.1
#: For so long it is said again where scans wait [s].
REPEATS = 10.0


class Whereabouts:
    """Publishes each `Localization`, while the robot is not lost; ValueError without tf2_msgs."""

    def __init__(self, node: Middleware) -> None:
        transforms = optional_class("tf2_msgs/msg/TFMessage")
        if transforms is None:
            what = "slam" if node.value("slam") else "localize"
            raise ValueError(f"{what}: needs the package tf2_msgs, to publish where the robot is")
        self._node, self._transforms = node, transforms
        self._tf = node.publisher(transforms, "/tf", depth=100)
        self._poses = node.publisher(PoseWithCovarianceStamped, "~/pose", depth=10)
        self._told: Localization | None = None

    def tell(self, found: Localization) -> None:
        """Publish where the robot is, while it is known."""
        if found.is_lost:
            return
        self._told = found
        self._send_odometry(found, found.stamp)
        self._poses.publish(pose_with_covariance(MAP, found.stamp, found.body, found.covariance))

    def _send_odometry(self, found: Localization, stamp: float) -> None:
        """Where the frame of odometry is at a time [s]."""
        odometry = self._node.value("fixed_frame") or ODOMETRY
        moved = transform(MAP, odometry, stamp + AHEAD, found.map_odometry)
        self._tf.publish(self._transforms(transforms=[moved]))

    def repeat(self) -> None:
        """Say it again by slam, where scans wait: while a loop moves the map, others need it all the same."""
        told, now = self._told, self._node.now()
        if self._node.value("slam") and told is not None and AHEAD < now - told.stamp < REPEATS:
            self._send_odometry(told, now)
