# SPDX-License-Identifier: BSD-3-Clause
"""Foxglove's messages in MCAP files, in JSON or packed by protobuf: turned into those of ROS."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from ndtree.logs.ros.messages.beams import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, LASER, POINT_CLOUD, RANGE

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
    package, _, type_ = name.rpartition("/")
    ros = name if "/msg" in package else f"{package}/msg/{type_}"
    return ros if ros in _FIELDS else TYPES.get(name)


def decoded(data: bytes, type: str) -> Any:
    """The message of a type of ROS in some bytes of JSON; ValueError if it is none."""
    try:
        found = json.loads(data)
        if not isinstance(found, dict):
            raise ValueError("expected an object")
    except (ValueError, RecursionError) as error:
        raise ValueError(f"no whole {type} in JSON ({' '.join(str(error).split())[:200]})") from None
    return message_of(found, type, "in JSON")


def message_of(found: dict[str, Any], type: str, how: str = "packed by protobuf") -> Any:
    """The message of a type of ROS by the fields of one that says the same; ValueError if it is none."""
    try:
        if _is_of_ros(found, type):
            message = _made(_FIELDS[type], found)
        else:
            message = _made(_FIELDS[type], _MAKERS[type](found))
        message.__msgtype__ = type
        return message
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError, RecursionError) as error:
        what = f"no {error}" if isinstance(error, KeyError) else " ".join(str(error).split())[:200]
        raise ValueError(f"no whole {type} {how} ({what})") from None


def head_of(data: bytes) -> tuple[float, str] | None:
    """Stamp [s] and frame of a message; None where it has no header."""
    try:
        return head_in(json.loads(data))
    except (ValueError, RecursionError):
        return None


def head_in(found: Any) -> tuple[float, str] | None:
    """As `head_of`, of a message's fields."""
    try:
        header = found.get("header", found)
        stamp = _time(header["stamp" if "header" in found else "timestamp"])
        return stamp.sec + 1e-9 * stamp.nanosec, str(header["frame_id"])
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError, RecursionError):
        return None


def _is_of_ros(message: dict[str, Any], type: str) -> bool:
    """Whether its fields are those of ROS."""
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
_TRANSFORM = {
    "header": _HEADER,
    "child_frame_id": _text,
    "transform": {"translation": _VECTOR, "rotation": _TURN},
}
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
    return {"stamp": message["timestamp"], "frame_id": message["frame_id"]}


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
    fields = [
        {
            "name": one["name"],
            "offset": one["offset"],
            "datatype": _FIELD_TYPES.get(one["type"], 0),
            "count": 1,
        }
        for one in message["fields"]
    ]
    return {
        "header": _header(message), "height": 1, "width": len(data) // step, "fields": fields,
        "is_bigendian": False, "point_step": step, "row_step": len(data), "data": message["data"],
    }  # fmt: skip


def _image(message: dict[str, Any]) -> dict[str, Any]:
    return {**message, "header": _header(message), "is_bigendian": 0}


def _camera(message: dict[str, Any]) -> dict[str, Any]:
    return {**message, "header": _header(message), "k": message["K"], "p": message.get("P", [])}


def _transforms(message: dict[str, Any]) -> dict[str, Any]:
    rows = message["transforms"] if "transforms" in message else [message]
    return {
        "transforms": [
            {
                "header": {"stamp": row["timestamp"], "frame_id": row["parent_frame_id"]},
                "child_frame_id": row["child_frame_id"],
                "transform": row,
            }
            for row in rows
        ]
    }


def _pose(message: dict[str, Any]) -> dict[str, Any]:
    return {**message, "header": {"stamp": message["timestamp"], "frame_id": message["frame_id"]}}


_MAKERS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    LASER: _laser,
    POINT_CLOUD: _cloud,
    IMAGE: _image,
    COMPRESSED_IMAGE: _image,
    CAMERA_INFO: _camera,
    TRANSFORMS: _transforms,
    POSE: _pose,
}
