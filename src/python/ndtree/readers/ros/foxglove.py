# SPDX-License-Identifier: BSD-3-Clause
"""Messages in JSON, as Foxglove's libraries write them into MCAP files: turned into those of ROS."""

from __future__ import annotations

import base64
import json
from types import SimpleNamespace
from typing import Any

import numpy as np

from ndtree.readers.ros.beams import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    LASER,
    MULTI_ECHO_LASER,
    POINT_CLOUD,
)

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
_PACKAGES = ("sensor_msgs/", "geometry_msgs/", "nav_msgs/", "tf2_msgs/", "tf/")
#: Numbers of types of fields, by Foxglove and by ROS: signed and unsigned are the other way round.
_FIELD_TYPES = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}
_FLOATS = ("ranges", "D", "K", "R", "P", "d", "k", "r", "p")


def type_of(name: str) -> str | None:
    """The type of ROS of messages in JSON by the name of their schema; None where they are not read.

    Messages of ROS itself are read, too, with the names of their fields.
    """
    package, _, type_ = name.rpartition("/")
    ros = name if "/msg" in package else f"{package}/msg/{type_}"
    if ros.startswith(_PACKAGES) and ros != MULTI_ECHO_LASER:  # Its echoes are lists of lists.
        return ros
    return TYPES.get(name)


def decoded(data: bytes, type: str) -> Any:
    """The message of a type of ROS in some bytes of JSON; ValueError if it is none."""
    try:
        found = json.loads(data)
        if not isinstance(found, dict):
            raise ValueError("expected an object")
        message = _of_ros(found) if _is_of_ros(found) else _MAKERS[type](found)
        message.__msgtype__ = type
        return message
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        what = f"no {error}" if isinstance(error, KeyError) else " ".join(str(error).split())[:200]
        raise ValueError(f"no whole {type} in JSON ({what})") from None


def head_of(data: bytes) -> tuple[float, str] | None:
    """Stamp [s] and frame of a message; None where it has no header."""
    try:
        found = json.loads(data)
        header = found.get("header", found)
        stamp = _time(header["stamp" if "header" in found else "timestamp"])
        return stamp.sec + 1e-9 * stamp.nanosec, str(header["frame_id"])
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError):
        return None


def _is_of_ros(message: dict[str, Any]) -> bool:
    """Whether its fields are those of ROS."""
    transforms = message.get("transforms")
    return "header" in (transforms[0] if isinstance(transforms, list) and transforms else message)


def _of_ros(value: Any, name: str = "") -> Any:
    if isinstance(value, dict):
        if "sec" in value or "secs" in value:
            return _time(value)
        return SimpleNamespace(**{key: _of_ros(one, key) for key, one in value.items()})
    if name == "data" and isinstance(value, (str, list)):
        return _bytes(value)
    if isinstance(value, list):
        return _numbers(value) if name in _FLOATS else [_of_ros(one) for one in value]
    if value is None:  # JSON has no NaN.
        return float("nan")
    return value


def _laser(message: dict[str, Any]) -> SimpleNamespace:
    ranges = _numbers(message["ranges"]).astype(np.float32)
    begin, end = float(message["start_angle"]), float(message["end_angle"])
    return SimpleNamespace(
        header=_header(message), ranges=ranges, angle_min=begin, angle_max=end,
        angle_increment=(end - begin) / max(len(ranges) - 1, 1), time_increment=0.0, scan_time=0.0,
        range_min=0.0, range_max=float("inf"),
    )  # fmt: skip


def _cloud(message: dict[str, Any]) -> SimpleNamespace:
    data, step = _bytes(message["data"]), int(message["point_stride"])
    if step < 1 or len(data) % step:
        raise ValueError(f"{len(data)} bytes, expected a multiple of point_stride = {step}")
    fields = [
        SimpleNamespace(
            name=one["name"], offset=int(one["offset"]), datatype=_FIELD_TYPES.get(one["type"], 0), count=1
        )
        for one in message["fields"]
    ]
    count = len(data) // step
    return SimpleNamespace(
        header=_header(message), height=1, width=count, fields=fields, is_bigendian=False, point_step=step,
        row_step=count * step, data=data,
    )  # fmt: skip


def _image(message: dict[str, Any]) -> SimpleNamespace:
    return SimpleNamespace(
        header=_header(message), height=int(message["height"]), width=int(message["width"]),
        encoding=message["encoding"], is_bigendian=0, step=int(message["step"]), data=_bytes(message["data"]),
    )  # fmt: skip


def _compressed(message: dict[str, Any]) -> SimpleNamespace:
    return SimpleNamespace(header=_header(message), format=message["format"], data=_bytes(message["data"]))


def _camera(message: dict[str, Any]) -> SimpleNamespace:
    size = {name: int(message[name]) for name in ("height", "width")}
    return SimpleNamespace(
        header=_header(message), **size, k=_numbers(message["K"]), p=_numbers(message.get("P", []))
    )


def _transforms(message: dict[str, Any]) -> SimpleNamespace:
    rows = message["transforms"] if "transforms" in message else [message]
    return SimpleNamespace(
        transforms=[
            SimpleNamespace(
                header=SimpleNamespace(stamp=_time(row["timestamp"]), frame_id=row["parent_frame_id"]),
                child_frame_id=row["child_frame_id"],
                transform=SimpleNamespace(
                    translation=_vector(row["translation"]), rotation=_vector(row["rotation"])
                ),
            )
            for row in rows
        ]
    )


def _pose(message: dict[str, Any]) -> SimpleNamespace:
    at = message["pose"]
    pose = SimpleNamespace(position=_vector(at["position"]), orientation=_vector(at["orientation"]))
    header = SimpleNamespace(stamp=_time(message["timestamp"]), frame_id=message["frame_id"])
    return SimpleNamespace(header=header, pose=pose)


_MAKERS = {
    LASER: _laser,
    POINT_CLOUD: _cloud,
    IMAGE: _image,
    COMPRESSED_IMAGE: _compressed,
    CAMERA_INFO: _camera,
    TRANSFORMS: _transforms,
    POSE: _pose,
}


def _header(message: dict[str, Any]) -> SimpleNamespace:
    """Of a measurement, whose pose in its frame must change nothing: nobody says so of the beams' origin."""
    pose = message.get("pose") or {}
    position, turn = pose.get("position") or {}, pose.get("orientation") or {}
    if any(position.values()) or any(turn.get(axis, 0) for axis in "xyz"):
        raise ValueError(
            "a pose of the sensor in its frame, expected none, but a transform to a frame of its own"
        )
    return SimpleNamespace(stamp=_time(message["timestamp"]), frame_id=str(message["frame_id"]))


def _time(value: Any) -> SimpleNamespace:
    for seconds, rest in (("sec", "nsec"), ("sec", "nanosec"), ("secs", "nsecs")):
        if seconds in value and rest in value:
            return SimpleNamespace(sec=int(value[seconds]), nanosec=int(value[rest]))
    raise ValueError(f"a time {str(value)[:60]}, expected sec and nsec")


def _vector(value: Any) -> SimpleNamespace:
    return SimpleNamespace(**{axis: float(number) for axis, number in value.items()})


def _numbers(values: list[Any]) -> np.ndarray[Any, Any]:
    """Numbers, NaN where one is null: JSON has no other word for it."""
    return np.array([np.nan if one is None else float(one) for one in values], dtype=np.float64)


def _bytes(value: str | list[int]) -> np.ndarray[Any, Any]:
    if isinstance(value, str):
        return np.frombuffer(base64.b64decode(value, validate=True), dtype=np.uint8)
    return np.array(value, dtype=np.uint8)
