# SPDX-License-Identifier: BSD-3-Clause
"""One look at a whole bag: its transforms and poses, its cameras, and when its sensors measured."""

from __future__ import annotations

import posixpath
from collections.abc import Collection, Hashable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ndtree.logs.core.arrays import Floats
from ndtree.logs.core.failures import at_place
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.transforms import TransformTree, is_transform, plain
from ndtree.logs.ros.clock import Clock
from ndtree.logs.ros.files.bag import Bag
from ndtree.logs.ros.messages.beams import CAMERA_INFO, short, stamp_of
from ndtree.logs.ros.messages.foxglove import head_of

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
#: Topic, parent and child; when received, stamp [s], position and quaternion.
_Edge = tuple[str, str, str]
_Row = tuple[float, float, list[float], list[float]]
#: What the clock calls the topic with poses.
POSES_STREAM = "poses"
POSE_NAMES = ", ".join(short(type) for type in POSES)


@dataclass
class Seen:
    """What the heads of a topic's messages say."""

    stamps: list[float] = field(default_factory=list)  # In the order of recording [s].
    received: list[float] = field(default_factory=list)  # When each message was recorded [s].
    lags: list[float] = field(default_factory=list)  # How long after its stamp each was recorded [s].
    frames: dict[str, int] = field(default_factory=dict)  # And in how many messages they are.
    each: list[str] = field(default_factory=list)  # The frame of each message.
    placed: list[str] = field(default_factory=list)  # Frames that are connected with others by transforms.

    @property
    def frame(self) -> str:
        """The frame of most messages; of those that hang in the tree of transforms, if some do."""
        return max(self.placed or self.frames, key=lambda frame: self.frames[frame], default="")

    @property
    def own_stamps(self) -> list[float]:
        """Those of messages in the frame of most: of another sensor's in the topic the clock may differ."""
        most = self.frame
        return [stamp for stamp, frame in zip(self.stamps, self.each) if frame == most]

    @property
    def rate(self) -> float | None:
        """Messages in a second of the time in which there are some [Hz]; None where that is not known."""
        for times in (self.received, self.stamps):
            if len(times) > 1 and (span := max(times) - min(times)) > 0:
                return (len(times) - 1) / span
        return None

    @property
    def interval(self) -> float:
        """The usual time from message to message [s]; 0 where there are not two."""
        stamps = self.own_stamps
        return float(np.median(np.abs(np.diff(stamps)))) if len(stamps) > 1 else 0.0


@dataclass(frozen=True)
class PoseRow:
    """A pose of a topic: ``T_parent_child`` at a time [s]; `child` is "" where the message does not say.

    `covariance` has 36 numbers, or is None.
    """

    parent: str
    child: str
    stamp: float
    position: list[float]
    quaternion: list[float]
    covariance: Floats | None = None


class Survey:
    """What one pass over a bag found.

    Transforms with NaN, or quaternions of another length than 1, are passed over, as ROS does; the tree names
    their frames.

    `sensors`: Topics of which stamps and frames are wanted.
    `poses`: Topic with poses, of one of `POSES`.
    `offset`: Added to the stamps of the sensors [s].
    Attributes:
    `tree`: All that is in /tf and /tf_static, of all robots.
    `lags`: How long after their stamps poses and transforms were recorded [s].
    `infos` (dict of str to list of (float, message)): CameraInfo with its stamps [s], by topic.
    `clock`: Of sensors by topic and frame, of poses by "poses".
    `damaged`: One for each message that was needed and is not whole.
    `ends`: Why what follows in a file could not be read.
    """

    def __init__(
        self, bag: Bag, sensors: Collection[str], poses: str | None = None, offset: float = 0.0
    ) -> None:
        self.seen: dict[str, Seen] = {name: Seen() for name in sensors}
        self.poses: list[PoseRow] = []
        self.lags: list[float] = []
        self.infos: dict[str, list[tuple[float, Any]]] = {}
        self.damaged: list[ValueError] = []
        self.ends: list[ValueError] = []
        self._fixed: list[tuple[str, str, str, Pose]] = []
        self._moving: dict[_Edge, list[_Row]] = {}
        self._refused: dict[str, str] = {}
        heads: dict[str, list[tuple[float, float, str]]] = {name: [] for name in sensors}
        pose_rows: list[tuple[float, PoseRow]] = []
        infos: list[tuple[str, float, Any]] = []
        whole = {topic.name for topic in bag.of_type(*TF, CAMERA_INFO)}
        if poses is not None:
            whole.add(poses)
        for raw in bag.messages({*whole, *self.seen}, self.ends.append):
            topic, type, received = raw.connection.topic, raw.connection.type, 1e-9 * raw.received
            if topic in self.seen and topic not in whole:
                head = head_of(raw)
                if head is not None:
                    heads[topic].append((received, *head))
                continue
            try:
                with at_place(f"{bag.path}: {topic}"):
                    message = bag.decoded(raw)
            except ValueError as error:
                self.damaged.append(error)
                continue
            if topic == poses:
                pose_rows += [(received, row) for row in poses_in(message)]
            elif type in TF:
                self._note_transforms(topic, message, raw.received)
            elif type == CAMERA_INFO:
                infos.append((topic, received, message))
        streams: dict[Hashable, list[tuple[float, float]]] = {}
        for name, ones in heads.items():
            for received, stamp, frame in ones:
                streams.setdefault((name, frame), []).append((received, stamp))
        streams.update({edge: [row[:2] for row in rows] for edge, rows in self._moving.items()})
        streams[POSES_STREAM] = [(received, row.stamp) for received, row in pose_rows]
        self.clock = Clock(streams)
        for topic, ones in heads.items():
            for received, stamp, frame in ones:
                stamp = self.clock.stamp((topic, frame), received, stamp)
                self.seen[topic].stamps.append(self.clock.time((topic, frame), received, stamp) + offset)
                self.seen[topic].received.append(received)
                self.seen[topic].lags.append(received - stamp)
                self.seen[topic].frames[frame] = self.seen[topic].frames.get(frame, 0) + 1
                self.seen[topic].each.append(frame)
        for received, row in pose_rows:
            self.lags.append(received - self.clock.stamp(POSES_STREAM, received, row.stamp))
            self.poses.append(replace(row, stamp=self.clock.time(POSES_STREAM, received, row.stamp)))
        for edge, rows in self._moving.items():
            for received, stamp, *_ in rows:
                self.lags.append(received - self.clock.stamp(edge, received, stamp))
        for topic, received, message in infos:
            stamp = self.clock.time(topic, received, stamp_of(message))
            self.infos.setdefault(topic, []).append((stamp, message))
        self.tree = self._tree(None)
        for seen in self.seen.values():
            seen.placed = [frame for frame in seen.frames if len(self.tree.connected(frame)) > 1]

    def tree_of(self, topic: str, frame: str) -> TransformTree:
        """The transforms that concern a topic.

        Where robots share a bag, each has a /tf of its own, whose frames may have the same names: of
        /robot1/scan those on /robot1/tf count and those on /tf, if they know the sensor's frame; else all.
        """
        spaces = {space_of(name) for name, *_ in (*self._fixed, *self._moving)}
        own = {one for one in spaces if not one or plain(topic).startswith(plain(one) + "/")}
        if own < spaces:
            tree = self._tree(own)
            if len(tree.connected(frame)) > 1:
                return tree
        return self.tree

    def _tree(self, spaces: Collection[str] | None) -> TransformTree:
        tree = TransformTree(spaces)
        tree.refused = self._refused
        for topic, parent, child, pose in self._fixed:
            if spaces is None or space_of(topic) in spaces:
                tree.add_fixed(parent, child, pose)
        for edge, rows in self._moving.items():
            topic, parent, child = edge
            if spaces is None or space_of(topic) in spaces:
                for received, stamp, position, quaternion in rows:
                    tree.add(parent, child, self.clock.time(edge, received, stamp), position, quaternion)
        return tree

    def _note_transforms(self, topic: str, message: Any, received: int) -> None:
        for row in transforms_in(message, self._refused, topic):
            if is_static(topic):
                pose = Pose.from_quaternion(row.position, row.quaternion)
                self._fixed.append((topic, row.parent, row.child, pose))
            else:
                rows = self._moving.setdefault((topic, row.parent, row.child), [])
                rows.append((1e-9 * received, row.stamp, row.position, row.quaternion))


def transforms_in(message: Any, refused: dict[str, str] | None = None, topic: str = "") -> Iterator[PoseRow]:
    """The transforms of a message of one of the types `TF`; those that are none are left out, as ROS does.

    `refused`: Where these are noted, by their frames.
    """
    for one in message.transforms:
        position, quaternion = _numbers(one.transform.translation, one.transform.rotation)
        if is_transform(position, quaternion):
            yield PoseRow(one.header.frame_id, one.child_frame_id, stamp_of(one), position, quaternion)
        elif refused is not None:
            refused[plain(one.child_frame_id)] = f"{topic}: at {position}, quaternion {quaternion}"


def is_static(topic: str) -> bool:
    """Whether the transforms of a topic hold at every time."""
    return posixpath.basename(topic) == "tf_static"


def poses_in(message: Any) -> list[PoseRow]:
    """The poses that a message of one of the types `POSES` holds."""
    if message.__msgtype__ == PATH:
        return [row for one in message.poses for row in poses_in(one)]
    covariance = getattr(getattr(message, "pose", None), "covariance", None)
    if hasattr(message, "transform"):
        position, quaternion = _numbers(message.transform.translation, message.transform.rotation)
    else:
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        position, quaternion = _numbers(pose.position, pose.orientation)
    if not is_transform(position, quaternion):
        return []
    child = plain(getattr(message, "child_frame_id", ""))
    row = PoseRow(plain(message.header.frame_id), child, stamp_of(message), position, quaternion)
    has_covariance = covariance is not None and len(covariance) == 36
    return [replace(row, covariance=np.array(covariance, dtype=np.float64)) if has_covariance else row]


def space_of(topic: str) -> str:
    """The namespace of a topic: "" of /tf."""
    return plain(posixpath.dirname(topic))


def _numbers(position: Any, quaternion: Any) -> tuple[list[float], list[float]]:
    return ([position.x, position.y, position.z], [quaternion.x, quaternion.y, quaternion.z, quaternion.w])
