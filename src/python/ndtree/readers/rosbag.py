# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 1 and ROS 2, read without ROS: laser scans, point clouds and depth images with their poses."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ndtree.readers import ros_messages as ros
from ndtree.readers.depth_image import CAMERA, PIXEL_STRIDE, Camera, camera_of, check_stride
from ndtree.readers.log import SizedLog
from ndtree.readers.plain_file import BoundedPath
from ndtree.readers.source import Format, ReaderOption, Source, WrongOption
from ndtree.readers.trajectory import TRAJECTORY, Pose, read_trajectory
from ndtree.readers.transforms import TransformTree, is_transform, plain
from ndtree.scan import Scan

ROS1_MAGIC = b"#ROSBAG V"
MCAP_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\0"
METADATA = "metadata.yaml"
#: Endings by which the library for bags tells the storage of a single file.
_ENDINGS = ((MCAP_MAGIC, ".mcap", "an MCAP file"), (SQLITE_MAGIC, ".db3", "an SQLite file"))

TOPIC = ReaderOption("topic", str, "Of a ROS bag: topic with the scans, clouds or depth images.")
FIXED_FRAME = ReaderOption("fixed_frame", str, "Of a ROS bag: frame of the map; else map, odom or world.")
ODOMETRY = ReaderOption("odometry", str, "Of a ROS bag: topic with Odometry, for poses instead of /tf.")

TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
SENSORS = (ros.LASER, ros.MULTI_ECHO_LASER, ros.POINT_CLOUD, ros.IMAGE)
_WANTED = (*SENSORS, ros.CAMERA_INFO, *TF, ODOMETRY_TYPE)
_SENSOR_NAMES = "LaserScan, MultiEchoLaserScan, PointCloud2 or depth Image"
_FIXED_FRAMES = ("map", "odom", "world")
_TRAJECTORY_FRAME = "the trajectory's frame"

#: A laser is planar if it tilts no more [rad], and keeps its height so well [m], at up to so many times.
PLANAR_TILT, PLANAR_HEIGHT, PLANAR_LOOKS = 0.035, 0.1, 5000


@dataclass(frozen=True)
class Topic:
    """One topic of a bag."""

    name: str
    type: str
    messages: int


class Bag:
    """A bag that is open: its topics, and their messages one after the other."""

    def __init__(self, path: str, reader: Any, library: _Library) -> None:
        self.path = path
        self._reader = reader
        self._library = library
        self._store: Any = None
        self._is_ros1 = isinstance(reader, library.reader1)
        self.topics = [
            Topic(name, info.msgtype or info.connections[0].msgtype, int(info.msgcount))
            for name, info in sorted(reader.topics.items())
        ]
        has_messages = any(topic.messages for topic in self.topics)
        #: When the first and the last message were recorded [s].
        self.start = 1e-9 * reader.start_time if has_messages else 0.0
        self.end = 1e-9 * (reader.end_time - 1) if has_messages else 0.0

    def of_type(self, *types: str) -> list[Topic]:
        """Topics of some types that have messages."""
        return [topic for topic in self.topics if topic.type in types and topic.messages]

    def raw_messages(self, topics: Collection[str]) -> Iterator[tuple[str, str, int, bytes]]:
        """Topic, type, time of recording [ns] and bytes of each message of some topics.

        Raises
        ------
        ValueError
            Where the bag is damaged: nothing behind that place can be read.
        """
        connections = [one for one in self._reader.connections if one.topic in topics]
        if not connections:
            return
        with _named(self.path):
            messages = self._reader.messages(connections=connections)
        while True:
            with _named(self.path):
                found = next(messages, None)
            if found is None:
                return
            connection, stamp, raw = found
            yield connection.topic, connection.msgtype, int(stamp), raw

    def decoded(self, type: str, raw: bytes) -> Any:
        """A message of one of the types that are read here; ValueError if it is damaged."""
        if type not in _WANTED:
            raise ValueError(f"is of type {type}, expected {_SENSOR_NAMES}")
        if self._store is None:
            with _named(self.path):
                self._store = self._library.store(self._reader.connections, self._is_ros1)
        decode = self._store.deserialize_ros1 if self._is_ros1 else self._store.deserialize_cdr
        try:
            return decode(raw, type)
        except (
            Exception
        ) as error:  # A library at the mercy of foreign bytes: it raises whatever it runs into.
            raise ValueError(f"no whole {type} ({_line(error)})") from None

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Topic, time of recording [ns] and message, of small messages that must all be whole."""
        for topic, type, received, raw in self.raw_messages(topics):
            try:
                yield topic, received, self.decoded(type, raw)
            except ValueError as error:
                raise ValueError(f"{self.path}: {topic}: {error}") from None

    def first(self, topic: str) -> Any:
        """The first message of a topic that has some."""
        for _, type, _, raw in self.raw_messages([topic]):
            try:
                return self.decoded(type, raw)
            except ValueError as error:
                raise ValueError(f"{self.path}: {topic}: first message: {error}") from None
        raise ValueError(f"{self.path}: {topic}: no message, expected at least one")


@contextmanager
def open_bag(path: str) -> Iterator[Bag]:
    """Open a bag of ROS 1 or ROS 2 for as long as it is read.

    Raises
    ------
    ImportError
        If rosbags is not there.
    OSError
        If there is no such file.
    ValueError
        If it is no bag, or damaged.
    """
    library = _Library()
    is_ros1 = False
    if os.path.isdir(path):
        if METADATA not in os.listdir(path):
            raise ValueError(f"{path}: no {METADATA} in it, expected a whole ROS 2 bag, or one of its files")
    else:
        with open(path, "rb") as file:
            head = file.read(16)
        is_ros1 = head.startswith(ROS1_MAGIC)
        for magic, ending, what in _ENDINGS:
            if head.startswith(magic) and not path.endswith(ending):
                raise ValueError(f"{path}: {what}, expected a name that ends in {ending}")
    with _named(path):
        reader = (library.reader1 if is_ros1 else library.reader2)(BoundedPath(path))
        reader.open()
    try:
        with _named(path):
            bag = Bag(path, reader, library)
        yield bag
    finally:
        reader.close()


class _Library:
    """What is used of the library for bags; @raises ImportError that names the extra."""

    def __init__(self) -> None:
        try:
            from rosbags import interfaces, rosbag1, rosbag2, typesys
        except ImportError as error:
            raise ImportError(
                f"ROS bags need rosbags ({error}); install it with: pip install 'ndtree-mapping[ros]'"
            ) from None
        self.reader1: Any = rosbag1.Reader
        self.reader2: Any = rosbag2.Reader
        self._formats: Any = interfaces.MessageDefinitionFormat
        self._types: Any = typesys

    def store(self, connections: Any, is_ros1: bool) -> Any:
        """Definitions of the types that are read: as the bag has them, else ROS's own."""
        definitions = {
            one.msgtype: one.msgdef.data
            for one in connections
            if one.msgtype in _WANTED and one.msgdef.format == self._formats.MSG
        }
        return _store(self._types, tuple(sorted(definitions.items())), is_ros1)


@lru_cache(maxsize=8)
def _store(types: Any, definitions: tuple[tuple[str, str], ...], is_ros1: bool) -> Any:
    """Makes the store of definitions, which takes a while."""
    known = types.get_typestore(types.Stores.ROS1_NOETIC if is_ros1 else types.Stores.ROS2_HUMBLE)
    every = dict(known.fielddefs)
    for type_, text in definitions:
        every.update(types.get_types_from_msg(text, type_))
    store = types.get_typestore(types.Stores.EMPTY)
    store.register(every)
    return store


class RosbagLog(SizedLog):
    """The messages of one sensor topic with their poses.

    Poses and cameras are read when the log is opened, measurements while it is iterated. A message's pose
    is that of its stamp. The length is the topic's number of messages.
    """

    format = "rosbag"
    path: str

    def __init__(
        self,
        path: str,
        *,
        dim: int | None = None,
        topic: str | None = None,
        fixed_frame: str | None = None,
        odometry: str | None = None,
        trajectory: str | None = None,
        camera: str | None = None,
        pixel_stride: int = 1,
    ) -> None:
        ways = {"fixed_frame": fixed_frame, "odometry": odometry, "trajectory": trajectory}
        given = [name for name, value in ways.items() if value is not None]
        if len(given) > 1:
            raise WrongOption(f"{path}: {' and '.join(given)}: expected one of them")
        check_stride(pixel_stride)
        self._pixel_stride = pixel_stride
        with open_bag(path) as bag:
            self.topic = _chosen(bag, topic)
            first = bag.first(self.topic.name)
            self.frame = plain(first.header.frame_id)
            odometry_topic = _odometry_topic(bag, odometry)
            self._cameras: tuple[np.ndarray[Any, Any], list[Camera]] | None = None
            camera_topic = None
            if self.topic.type == ros.IMAGE:
                ros.depth_of(first)
                scale = ros.DEPTH_ENCODINGS[first.encoding][1]
                if camera is not None:
                    self._cameras = np.zeros(1), [camera_of(camera, scale=scale)]
                else:
                    camera_topic, self._cameras = _cameras(bag, self.topic.name, first, scale)
            elif camera is not None:
                raise WrongOption(f"{path}: camera: {self.topic.name} has no depth images")
            self._tree, odometry_frame = _transforms(
                bag, odometry_topic, is_moving=not (odometry or trajectory)
            )
        if trajectory is not None:
            poses_of_sensor = read_trajectory(trajectory)
            if poses_of_sensor.is_numbered:
                raise ValueError(
                    f"{trajectory}: has no times, expected t x y z qx qy qz qw for the scans of a bag"
                )
            self._tree.add_trajectory(_TRAJECTORY_FRAME, self.frame, poses_of_sensor)
            self.fixed_frame = _TRAJECTORY_FRAME
        else:
            wanted = odometry_frame if odometry_topic else fixed_frame
            self.fixed_frame = _fixed_frame(path, self._tree, self.frame, wanted)
        origin = odometry or trajectory or "/tf"
        self.uses = (
            f"{self.topic.name} ({self.topic.type.split('/')[-1]} in {self.frame})"
            + (f", cameras from {camera_topic}" if camera_topic else "")
            + f", poses in {self.fixed_frame} from {origin}"
        )
        super().__init__(path, dim=self._dimension(path, dim))

    def __len__(self) -> int:
        return self.topic.messages

    def _dimension(self, path: str, wanted: int | None) -> int:
        """2 for a laser that stays in a level plane, whichever side is up."""
        if self.topic.type not in ros.PLANAR:
            if wanted == 2:
                raise ValueError(f"{path}: {self.topic.type} is 3-D, expected dim=3")
            return 3
        if wanted is not None:
            return wanted
        stamps = self._tree.stamps(self.fixed_frame, self.frame)
        looked_at = stamps[:: len(stamps) // PLANAR_LOOKS + 1] if len(stamps) else [0.0]
        poses = [self._tree.pose_at(self.fixed_frame, self.frame, stamp) for stamp in looked_at]
        level = min(abs(pose.rotation[2, 2]) for pose in poses)
        heights = [pose.position[2] for pose in poses]
        is_planar = level >= np.cos(PLANAR_TILT) and max(heights) - min(heights) <= PLANAR_HEIGHT
        return 2 if is_planar else 3

    def _scans(self) -> Iterator[Scan]:
        with open_bag(self.path) as bag:
            messages = bag.raw_messages([self.topic.name])
            number = -1
            while True:
                try:
                    found = next(messages, None)
                except ValueError as error:
                    self._skip("damaged bags", error)
                    return
                if found is None:
                    return
                number += 1
                _, type, received, raw = found
                where = f"{self.path}: {self.topic.name}: message {number}"
                try:
                    message = bag.decoded(type, raw)
                    stamp = ros.stamp_of(message, received)
                    beams = self._beams(message, stamp)
                except ValueError as error:
                    self._skip("damaged messages", ValueError(f"{where}: {error}"))
                    continue
                try:
                    pose = self._tree.pose_at(self.fixed_frame, message.header.frame_id, stamp)
                except ValueError as error:
                    error = ValueError(f"{where}: {error}; keep_going passes over such messages")
                    self._skip("messages without a pose", error)
                    continue
                points = pose.apply(beams.points)[:, : self.dim]
                yield Scan(points, pose.position[: self.dim], beams.returned, stamp)

    def _beams(self, message: Any, stamp: float) -> ros.Beams:
        if self.topic.type == ros.LASER:
            return ros.laser_beams(message)
        if self.topic.type == ros.MULTI_ECHO_LASER:
            return ros.multi_echo_beams(message)
        if self.topic.type == ros.POINT_CLOUD:
            return ros.cloud_beams(message)
        assert self._cameras is not None
        stamps, cameras = self._cameras
        return ros.depth_beams(message, cameras[int(np.abs(stamps - stamp).argmin())], self._pixel_stride)


def _chosen(bag: Bag, wanted: str | None) -> Topic:
    """The topic that was asked for, or the only one that can be read."""
    if wanted is not None:
        for topic in bag.topics:
            if plain(topic.name) == plain(wanted):
                if topic.type not in SENSORS:
                    raise ValueError(
                        f"{bag.path}: topic {topic.name} is of type {topic.type}, expected {_SENSOR_NAMES}"
                    )
                return topic
        raise ValueError(f"{bag.path}: no topic {wanted}, expected one of {_list(bag.of_type(*SENSORS))}")
    readable = [topic for topic in bag.of_type(*SENSORS) if topic.type != ros.IMAGE or _has_depth(bag, topic)]
    if len(readable) == 1:
        return readable[0]
    if readable:
        raise ValueError(
            f"{bag.path}: {len(readable)} topics could be read, expected topic as one of {_list(readable)}"
        )
    raise ValueError(f"{bag.path}: no {_SENSOR_NAMES} in it, found {_list(bag.topics)}")


def _has_depth(bag: Bag, topic: Topic) -> bool:
    return bag.first(topic.name).encoding in ros.DEPTH_ENCODINGS


def _list(topics: list[Topic]) -> str:
    shown = [f"{topic.name} ({topic.type.split('/')[-1]})" for topic in topics[:12]]
    return ", ".join(shown + ["..."] * (len(topics) > 12)) or "none"


def _odometry_topic(bag: Bag, wanted: str | None) -> str | None:
    if wanted is None:
        return None
    topics = bag.of_type(ODOMETRY_TYPE)
    for topic in topics:
        if plain(topic.name) == plain(wanted):
            return topic.name
    raise ValueError(f"{bag.path}: no Odometry in {wanted}, expected one of {_list(topics)}")


def _cameras(
    bag: Bag, topic: str, first: Any, scale: float
) -> tuple[str, tuple[np.ndarray[Any, Any], list[Camera]]]:
    """The topic with an image's cameras, and stamps and cameras in it."""
    by_topic: dict[str, tuple[list[float], list[Camera]]] = {}
    frame = plain(first.header.frame_id)
    names = [info.name for info in bag.of_type(ros.CAMERA_INFO)]
    for name, received, message in bag.messages(names):
        is_near = posixpath.dirname(name) == posixpath.dirname(topic)
        is_alike = (message.width, message.height) == (first.width, first.height)
        if is_alike and (is_near or plain(message.header.frame_id) == frame):
            stamps, cameras = by_topic.setdefault(name, ([], []))
            stamps.append(ros.stamp_of(message, received))
            cameras.append(ros.camera_of_info(message, scale))
    if not by_topic:
        raise ValueError(
            f"{bag.path}: no CameraInfo of {first.width} x {first.height} pixels beside {topic} or in frame "
            f"{frame}, expected one, or camera as fx,fy,cx,cy; found {', '.join(names) or 'none'}"
        )
    chosen = min(by_topic, key=lambda name: (posixpath.dirname(name) != posixpath.dirname(topic), name))
    return chosen, (np.array(by_topic[chosen][0]), by_topic[chosen][1])


def _transforms(bag: Bag, odometry: str | None, *, is_moving: bool) -> tuple[TransformTree, str | None]:
    """All fixed transforms, and those over time of an odometry or, if `is_moving`, of /tf.

    Transforms with NaN, or quaternions of another length than 1, are passed over, as ROS does.
    """
    tree, frame = TransformTree(), None
    topics = [topic.name for topic in bag.of_type(*TF) if is_moving or _is_static(topic.name)]
    for topic, received, message in bag.messages([*topics, *([odometry] if odometry else [])]):
        if topic == odometry:
            if not message.child_frame_id:
                raise ValueError(f"{bag.path}: {topic}: an Odometry without child_frame_id, expected one")
            frame = plain(message.header.frame_id)
            pose = message.pose.pose
            position, quaternion = _numbers(pose.position, pose.orientation)
            if is_transform(position, quaternion):
                stamp = ros.stamp_of(message, received)
                tree.add(frame, message.child_frame_id, stamp, position, quaternion)
            continue
        for one in message.transforms:
            position, quaternion = _numbers(one.transform.translation, one.transform.rotation)
            if not is_transform(position, quaternion):
                continue
            if _is_static(topic):
                tree.add_fixed(
                    one.header.frame_id, one.child_frame_id, Pose.from_quaternion(position, quaternion)
                )
            else:
                stamp = ros.stamp_of(one, received)
                tree.add(one.header.frame_id, one.child_frame_id, stamp, position, quaternion)
    return tree, frame


def _is_static(topic: str) -> bool:
    return posixpath.basename(topic) == "tf_static"


def _numbers(position: Any, quaternion: Any) -> tuple[list[float], list[float]]:
    return (
        [position.x, position.y, position.z],
        [quaternion.x, quaternion.y, quaternion.z, quaternion.w],
    )


def _fixed_frame(path: str, tree: TransformTree, frame: str, wanted: str | None) -> str:
    """The frame of the map: as asked for, or the first usual one that the sensor is connected with."""
    connected = tree.connected(frame)
    if wanted is not None:
        if plain(wanted) not in connected:
            raise ValueError(
                f"{path}: no transform between {frame} and {wanted}, "
                f"expected fixed_frame as one of {', '.join(connected)}"
            )
        return plain(wanted)
    for usual in _FIXED_FRAMES:
        if usual in connected:
            return usual
    if len(connected) == 1:
        raise ValueError(
            f"{path}: no transform to {frame} in /tf or /tf_static, expected odometry or trajectory "
            "to be given"
        )
    raise ValueError(
        f"{path}: {frame} is connected with none of {', '.join(_FIXED_FRAMES)}, "
        f"expected fixed_frame as one of {', '.join(connected)}"
    )


@contextmanager
def _named(path: str) -> Iterator[None]:
    """What the library runs into becomes a ValueError with the file's name."""
    try:
        yield
    except (ImportError, MemoryError):
        raise
    except Exception as error:
        raise ValueError(
            f"{path}: cannot be read as a ROS bag ({_line(error)}), expected a whole one"
        ) from None


def _line(error: Exception) -> str:
    """An exception's kind and message in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def _recognises(source: Source) -> bool:
    if source.is_folder:
        endings = tuple(ending for _, ending, _ in _ENDINGS)
        return METADATA in source.names or any(name.endswith(endings) for name in source.names)
    return source.head.startswith((ROS1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC))


def _open(source: Source, *, dim: int | None = None, **options: Any) -> RosbagLog:
    return RosbagLog(source.path, dim=dim, **options)


def _contents(source: Source) -> dict[str, Any]:
    """Topics with their types, numbers of messages and frames, and when the bag was recorded [s]."""
    with open_bag(source.path) as bag:
        topics = []
        for topic in bag.topics:
            frame = None
            if topic.messages and topic.type in (*SENSORS, ros.CAMERA_INFO, ODOMETRY_TYPE):
                frame = plain(bag.first(topic.name).header.frame_id)
            topics.append(
                {"topic": topic.name, "type": topic.type, "messages": topic.messages, "frame": frame}
            )
        return {"start": bag.start, "end": bag.end, "topics": topics}


ROSBAG = Format(
    "rosbag",
    "a ROS bag",
    _recognises,
    _open,
    options=(TOPIC, FIXED_FRAME, ODOMETRY, TRAJECTORY, CAMERA, PIXEL_STRIDE),
    stored_as="either",
    contents=_contents,
)
