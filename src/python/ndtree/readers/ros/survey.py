# SPDX-License-Identifier: BSD-3-Clause
"""One look at a whole bag: its transforms and poses, its cameras, and when its sensors measured."""

from __future__ import annotations

import posixpath
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree.readers.ros.bag import Bag
from ndtree.readers.ros.beams import CAMERA_INFO, short, stamp_of
from ndtree.readers.ros.head import head_of
from ndtree.readers.trajectory import Pose
from ndtree.readers.transforms import TransformTree, is_transform, plain

TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOMETRY = "nav_msgs/msg/Odometry"
PATH = "nav_msgs/msg/Path"
POSES = (
    ODOMETRY,
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    PATH,
)
POSE_NAMES = ", ".join(short(type) for type in POSES)


@dataclass
class Seen:
    """What the heads of a topic's messages say.

    Attributes
    ----------
    stamps : list of float
        In the order of recording [s].
    lags : list of float
        How long after its stamp each was recorded [s].
    frames : dict of str to int
        And in how many messages they are.
    """

    stamps: list[float] = field(default_factory=list)
    lags: list[float] = field(default_factory=list)
    frames: dict[str, int] = field(default_factory=dict)

    @property
    def frame(self) -> str:
        """The frame of most messages."""
        return max(self.frames, key=lambda frame: self.frames[frame], default="")

    @property
    def interval(self) -> float:
        """The usual time from message to message [s]; 0 where there are not two."""
        if len(self.stamps) < 2:
            return 0.0
        return float(np.median(np.abs(np.diff(self.stamps))))


@dataclass(frozen=True)
class PoseRow:
    """A pose of a topic: ``T_parent_child`` at a time [s]; `child` is "" where the message does not say."""

    parent: str
    child: str
    stamp: float
    position: list[float]
    quaternion: list[float]


class Survey:
    """What one pass over a bag found.

    Transforms with NaN, or quaternions of another length than 1, are passed over, as ROS does.

    Parameters
    ----------
    bag : Bag
    sensors : collection of str
        Topics of which stamps and frames are wanted.
    poses : str, optional
        Topic with poses, of one of `POSES`.

    Attributes
    ----------
    tree : TransformTree
        All that is in /tf and /tf_static.
    seen : dict of str to Seen
    poses : list of PoseRow
    lags : list of float
        How long after their stamps poses and transforms were recorded [s].
    infos : dict of str to list of (float, message)
        CameraInfo with its stamps [s], by topic.
    """

    def __init__(self, bag: Bag, sensors: Collection[str], poses: str | None = None) -> None:
        self.tree = TransformTree()
        self.seen: dict[str, Seen] = {name: Seen() for name in sensors}
        self.poses: list[PoseRow] = []
        self.lags: list[float] = []
        self.infos: dict[str, list[tuple[float, Any]]] = {}
        whole = {topic.name for topic in bag.of_type(*TF, CAMERA_INFO)}
        if poses is not None:
            whole.add(poses)
        for raw in bag.messages(whole, heads=self.seen, on_damage=lambda error: None):
            topic, type = raw.connection.topic, raw.connection.type
            if topic in self.seen and topic not in whole:
                head = head_of(raw)
                if head is not None:
                    self.seen[topic].stamps.append(head[0])
                    self.seen[topic].lags.append(1e-9 * raw.received - head[0])
                    self.seen[topic].frames[head[1]] = self.seen[topic].frames.get(head[1], 0) + 1
            elif topic == poses:
                rows = _poses_in(bag.named(raw), raw.received)
                self.poses += rows
                self.lags += [1e-9 * raw.received - row.stamp for row in rows]
            elif type in TF:
                self._add_transforms(bag.named(raw), raw.received, _is_static(topic))
            elif type == CAMERA_INFO:
                message = bag.named(raw)
                self.infos.setdefault(topic, []).append((stamp_of(message, raw.received), message))

    def _add_transforms(self, message: Any, received: int, is_static: bool) -> None:
        for one in message.transforms:
            position, quaternion = _numbers(one.transform.translation, one.transform.rotation)
            if not is_transform(position, quaternion):
                continue
            parent, child = one.header.frame_id, one.child_frame_id
            if is_static:
                self.tree.add_fixed(parent, child, Pose.from_quaternion(position, quaternion))
            else:
                stamp = stamp_of(one, received)
                self.tree.add(parent, child, stamp, position, quaternion)
                self.lags.append(1e-9 * received - stamp)


def _poses_in(message: Any, received: int) -> list[PoseRow]:
    """The poses that a message of one of the types `POSES` holds."""
    if message.__msgtype__ == PATH:
        return [row for one in message.poses for row in _poses_in(one, received)]
    if hasattr(message, "transform"):
        position, quaternion = _numbers(message.transform.translation, message.transform.rotation)
    else:
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        position, quaternion = _numbers(pose.position, pose.orientation)
    if not is_transform(position, quaternion):
        return []
    child = plain(getattr(message, "child_frame_id", ""))
    return [PoseRow(plain(message.header.frame_id), child, stamp_of(message, received), position, quaternion)]


def _is_static(topic: str) -> bool:
    return posixpath.basename(topic) == "tf_static"


def _numbers(position: Any, quaternion: Any) -> tuple[list[float], list[float]]:
    return (
        [position.x, position.y, position.z],
        [quaternion.x, quaternion.y, quaternion.z, quaternion.w],
    )


def share_within(stamps: NDArray[np.float64], span: tuple[float, float]) -> float:
    """The share of times that lie in a span; 1 where there are none."""
    if not len(stamps):
        return 1.0
    return float(np.mean((stamps >= span[0]) & (stamps <= span[1])))
