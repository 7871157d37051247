# SPDX-License-Identifier: BSD-3-Clause
"""Foxglove's messages in JSON or protobuf, turned into those of ROS; and the Header of all messages."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from ndtree._lazy import needs
from ndtree.logs.core.failures import one_line
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.messages.beams import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, LASER, POINT_CLOUD, RANGE
from ndtree.logs.ros.storage import Raw, ros2_type

TRANSFORMS = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseStamped"
#: Foxglove's types, and those of ROS that say the same.
TYPES = {
    "foxglove.LaserScan": LASER,
    "foxglove.PointCloud": POINT_CLOUD,
    "foxglove.RawImage": IMAGE,
    "foxglove.CompressedImage": COMPRESSED_IMAGE,
    "foxglove.CameraCalibration": CAMERA_INFO,
    "foxglove.FrameTransform": TRANSFORMS,
    "foxglove.FrameTransforms": TRANSFORMS,
    "foxglove.PoseInFrame": POSE,
}
#: Numbers of types of fields, by Foxglove and by ROS: signed and unsigned are the other way round.
_FIELD_TYPES = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}


class Message(SimpleNamespace):
    """A message, or a part of one, by the names of its fields."""

    __msgtype__ = ""


def type_of(name: str) -> str | None:
    """The type of ROS of messages in JSON by the name of their schema; None where they are not read.

    Messages of ROS itself are read, too, with the names of their fields.
    """
    ros = ros2_type(name)
    return ros if ros in _FIELDS else TYPES.get(name)


def decoded(raw: Raw) -> Any:
    """A message as that of ROS which says the same.

    Raises ImportError if a library is not there; ValueError if it is none, or its schema is damaged.
    """
    type = raw.connection.type
    try:
        found = _fields(raw)
        message = _made(_FIELDS[type], found if _is_of_ros(found, type) else _MAKERS[type](found))
    except ImportError:
        raise
    except Exception as error:  # A library at the mercy of foreign bytes, and fields of any kind.
        what = f"no {error}" if isinstance(error, KeyError) else one_line(error)
        how = "in JSON" if raw.connection.encoding == "json" else "packed by protobuf"
        raise ValueError(f"no whole {type} {how} ({what})") from None
    message.__msgtype__ = type
    return message


def _head(raw: Raw) -> tuple[float, str] | None:
    try:
        found = _fields(raw)
        header = found.get("header", found)
        stamp = _time(header["stamp" if "header" in found else "timestamp"])
        return stamp.sec + 1e-9 * stamp.nanosec, plain(str(header["frame_id"]))
    except ImportError:
        raise
    except Exception:  # As above.
        return None


def _fields(raw: Raw) -> dict[str, Any]:
    one = raw.connection
    if one.encoding == "protobuf":
        return _unpacked(_decoder(one.name, one.schema)(raw.data))
    found = json.loads(raw.data)
    if not isinstance(found, dict):
        raise ValueError("expected an object")
    return found


def _is_of_ros(message: dict[str, Any], type: str) -> bool:
    if type not in _MAKERS:
        return True
    transforms = message.get("transforms")
    return "header" in (transforms[0] if isinstance(transforms, list) and transforms else message)


def _made(fields: Any, value: Any) -> Any:
    """A value as a table of fields says: by a function, a list of one kind, or a part with fields."""
    if isinstance(fields, list):
        if not isinstance(value, list):
            raise ValueError(f"found {str(value)[:60]}, expected a list")
        return [_made(fields[0], one) for one in value]
    if isinstance(fields, dict):
        return Message(**{name: _made(of, value[name]) for name, of in fields.items()})
    return fields(value)


# --- What is needed of each type --------------------------------------------------------------------


def _time(value: Any) -> Message:
    for seconds, rest in (("sec", "nsec"), ("sec", "nanosec"), ("secs", "nsecs")):
        if seconds in value and rest in value:
            made = Message(sec=int(value[seconds]), nanosec=int(value[rest]))
            if 0 <= made.sec < 1 << 33 and 0 <= made.nanosec < 1 << 33:
                return made
    raise ValueError(f"a time {str(value)[:60]}, expected sec and nsec")


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"found {str(value)[:60]}, expected a text")
    return value


def _number(value: Any) -> float:
    """NaN where it is null: JSON has no other word for it."""
    return np.nan if value is None else float(value)


def _numbers(values: Any) -> np.ndarray[Any, Any]:
    return np.array([_number(one) for one in values], dtype=np.float64)


def _bytes(value: str | bytes | list[int]) -> np.ndarray[Any, Any]:
    if isinstance(value, bytes):
        return np.frombuffer(value, dtype=np.uint8)
    if isinstance(value, str):
        return np.frombuffer(base64.b64decode(value, validate=True), dtype=np.uint8)
    return np.array(value, dtype=np.uint8)


_HEADER = {"stamp": _time, "frame_id": _text}
_VECTOR = dict.fromkeys("xyz", float)
_TURN = dict.fromkeys("xyzw", float)
_POSE = {"position": _VECTOR, "orientation": _TURN}
_POSE_STAMPED = {"header": _HEADER, "pose": _POSE}
_MOVE = {"translation": _VECTOR, "rotation": _TURN}
_TRANSFORM = {"header": _HEADER, "child_frame_id": _text, "transform": _MOVE}
_FIELDS: dict[str, dict[str, Any]] = {
    LASER: {
        "header": _HEADER, "angle_min": float, "angle_max": float, "angle_increment": float,
        "time_increment": float, "scan_time": float, "range_min": _number, "range_max": _number,
        "ranges": lambda values: _numbers(values).astype(np.float32),
    },
    RANGE: {"header": _HEADER, "min_range": _number, "max_range": _number, "range": _number},
    POINT_CLOUD: {
        "header": _HEADER, "height": int, "width": int, "is_bigendian": bool, "point_step": int,
        "row_step": int, "data": _bytes,
        "fields": [{"name": _text, "offset": int, "datatype": int, "count": int}],
    },
    IMAGE: {
        "header": _HEADER, "height": int, "width": int, "encoding": _text, "is_bigendian": int, "step": int,
        "data": _bytes,
    },
    COMPRESSED_IMAGE: {"header": _HEADER, "format": _text, "data": _bytes},
    CAMERA_INFO: {"header": _HEADER, "height": int, "width": int, "k": _numbers, "p": _numbers},
    TRANSFORMS: {"transforms": [_TRANSFORM]},
    "geometry_msgs/msg/TransformStamped": _TRANSFORM,
    POSE: _POSE_STAMPED,
    "geometry_msgs/msg/PoseWithCovarianceStamped": {"header": _HEADER, "pose": {"pose": _POSE}},
    "nav_msgs/msg/Odometry": {"header": _HEADER, "child_frame_id": _text, "pose": {"pose": _POSE}},
    "nav_msgs/msg/Path": {"header": _HEADER, "poses": [_POSE_STAMPED]},
}  # fmt: skip


# --- Foxglove's messages in the words of ROS --------------------------------------------------------


def _header(message: dict[str, Any]) -> dict[str, Any]:
    """Of a measurement, whose pose in its frame must change nothing: its beams would come from there."""
    pose = message.get("pose") or {}
    position, turn = pose.get("position") or {}, pose.get("orientation") or {}
    if any(position.values()) or any(turn.get(axis, 0) for axis in "xyz"):
        raise ValueError("a pose of the sensor in its frame, expected none, but a frame of its own")
    return _stamped(message, "frame_id")


def _stamped(message: dict[str, Any], frame: str) -> dict[str, Any]:
    return {"stamp": message["timestamp"], "frame_id": message[frame]}


def _laser(message: dict[str, Any]) -> dict[str, Any]:
    begin, end = float(message["start_angle"]), float(message["end_angle"])
    step = (end - begin) / max(len(message["ranges"]) - 1, 1)
    limits = {"range_min": 0.0, "range_max": float("inf")}
    return {
        "header": _header(message), "ranges": message["ranges"], "angle_min": begin, "angle_max": end,
        "angle_increment": step, "time_increment": 0.0, "scan_time": 0.0, **limits,
    }  # fmt: skip


def _cloud(message: dict[str, Any]) -> dict[str, Any]:
    data, step = _bytes(message["data"]), int(message["point_stride"])
    if step < 1 or len(data) % step:
        raise ValueError(f"{len(data)} bytes, expected a multiple of point_stride = {step}")
    fields = [{**one, "datatype": _FIELD_TYPES.get(one["type"], 0), "count": 1} for one in message["fields"]]
    return {
        "header": _header(message), "height": 1, "width": len(data) // step, "fields": fields,
        "is_bigendian": False, "point_step": step, "row_step": len(data), "data": message["data"],
    }  # fmt: skip


def _transforms(message: dict[str, Any]) -> dict[str, Any]:
    rows = message["transforms"] if "transforms" in message else [message]
    made = [{**row, "header": _stamped(row, "parent_frame_id"), "transform": row} for row in rows]
    return {"transforms": made}


_MAKERS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    LASER: _laser,
    POINT_CLOUD: _cloud,
    **dict.fromkeys(
        (IMAGE, COMPRESSED_IMAGE), lambda one: {**one, "header": _header(one), "is_bigendian": 0}
    ),
    CAMERA_INFO: lambda one: {**one, "header": _header(one), "k": one["K"], "p": one.get("P", [])},
    TRANSFORMS: _transforms,
    POSE: lambda one: {**one, "header": _stamped(one, "frame_id")},
}


# --- Messages packed by protobuf, as Foxglove's libraries write them: their fields as in JSON -------

#: How Google calls its time, and its fields.
_TIME, _DURATION = "google.protobuf.Timestamp", "google.protobuf.Duration"


@lru_cache(maxsize=64)
def _decoder(type: str, schema: bytes) -> Callable[[bytes], Any]:
    with needs("messages packed by protobuf need mcap-protobuf-support", "ros"):
        from mcap.records import Schema
        from mcap_protobuf.decoder import DecoderFactory
    known = Schema(id=1, data=schema, encoding="protobuf", name=type)
    decoder = DecoderFactory().decoder_for("protobuf", known)
    if decoder is None:
        raise ValueError("no schema of protobuf")
    return decoder  # type: ignore[no-any-return]


def _unpacked(message: Any) -> dict[str, Any]:
    if message.DESCRIPTOR.full_name in (_TIME, _DURATION):
        return {"sec": message.seconds, "nsec": message.nanos}
    found: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.message_type is None:
            found[field.name] = value
        elif _is_list(field):
            found[field.name] = [_unpacked(one) for one in value]
        elif message.HasField(field.name):
            found[field.name] = _unpacked(value)
    return found


def _is_list(field: Any) -> bool:
    repeated = getattr(field, "is_repeated", None)  # Older libraries have a label.
    return bool(field.label == field.LABEL_REPEATED if repeated is None else repeated)


# --- The Header at the beginning of messages, from their bytes ----------------------------------------


def order_of(data: bytes, is_ros1: bool) -> str:
    """The order of a message's bytes, "<" or ">"."""
    return "<" if is_ros1 or (len(data) > 1 and data[1] & 1) else ">"


def header_of(data: bytes, is_ros1: bool) -> tuple[Message, int]:
    """The Header that some bytes begin with, and where it ends.

    In ROS 1 a Header begins with a number of 4 bytes, in ROS 2 a message begins with 4 bytes that say how it
    is packed: all that follows stands in the same place.

    Raises ValueError if they are too few.
    """
    if len(data) < 16:
        raise ValueError(f"the message has {len(data)} bytes, expected a whole Header")
    seconds, nanoseconds, length = struct.unpack_from(order_of(data, is_ros1) + "3I", data, 4)
    if 16 + length > len(data):
        raise ValueError(f"the message has {len(data)} bytes, expected a frame of {length} in it")
    frame = data[16 : 16 + length].rstrip(b"\0").decode("utf-8", "replace")
    return Message(stamp=Message(sec=seconds, nanosec=nanoseconds), frame_id=frame), 16 + length


def head_of(raw: Raw) -> tuple[float, str] | None:
    """Stamp [s] and frame of a message, from its first bytes; None where it is too short to have one.

    The stamp is 0 where the message does not say when it was measured, or at the beginning of a clock.
    """
    if raw.connection.encoding in ("json", "protobuf"):
        return _head(raw)
    try:
        header, _ = header_of(raw.data, raw.connection.encoding == "ros1")
    except ValueError:
        return None
    return header.stamp.sec + 1e-9 * header.stamp.nanosec, plain(header.frame_id)
