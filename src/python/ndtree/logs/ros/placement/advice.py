# SPDX-License-Identifier: BSD-3-Clause
"""What to say to a user whose bag does not tell where its sensor is."""

from __future__ import annotations

from ndtree._errors import key
from ndtree.logs.poses.transforms import TransformTree
from ndtree.logs.ros.files.bag import Topic
from ndtree.logs.ros.messages.beams import SENSOR_NAMES, short
from ndtree.logs.ros.messages.image import DEPTH_ENCODINGS
from ndtree.logs.ros.placement.registered import bases_in

#: Types in which drivers record what lidars sent.
PACKETS = (
    "VelodyneScan",
    "VelodynePacket",
    "PacketMsg",
    "PandarScan",
    "HesaiScan",
    "RslidarScan",
    "RslidarPacket",
)
#: What to type for a sensor whose place on its base is not known.
MOUNT = f"{key('mount')} X,Y,Z,ROLL,PITCH,YAW"
HOW_TO_MOUNT = f"{MOUNT} (metres, and radians or degrees as in 90deg; ndtree calibrate --find-mount finds it)"
_TRAJECTORY = f"{key('trajectory')} FILE"
_STILL = f"{key('still')}, if the sensor does not move"


def unconnected(path: str, tree: TransformTree, topic: str, frame: str, others: dict[str, str]) -> str:
    """The error of a sensor whose frame hangs nowhere: what there is, and what to say."""
    frames = tree.frames()
    say = _sources(others)
    what = f"no transform to {frame}, the frame of {topic}" if frame else f"{topic} names no frame of its own"
    if not frames:
        begin = f"{path}: {what}: there is no /tf"
        if not say:
            return f"{begin}, nor any other poses, expected one of:" + typed(_TRAJECTORY, _STILL)
        sources = [f"{one}, and {MOUNT} where the sensor is not in their place" for one in say]
        return f"{begin}, expected one of:" + typed(*sources, _TRAJECTORY, _STILL)
    base = next(bases_in(frames), "FRAME")
    frames_are = f"the frames of /tf are {listed(frames)}"
    return f"{path}: {what}, expected one of:" + typed(
        f"{key('base_frame')} {base} {MOUNT}, where the sensor sits [m, rad or 90deg]",
        f"{key('sensor_frame')} FRAME, if it sits in one of these frames",
        f"ndtree calibrate {path} --find-mount, to measure where it sits",
        said=frames_are,
    )


def without_sensors(
    path: str, topics: list[Topic], encodings: dict[str, str], unread: list[tuple[Topic, str]]
) -> str:
    """The error of a bag that has nothing to map.

    `encodings` are those of its images, by topic, and `unread` are topics that cannot be read, each with how
    its messages are packed.
    """
    held = ", ".join(_named(one, encodings.get(one.name)) for one in topics[:12]) + (
        ", ..." if len(topics) > 12 else ""
    )
    packets = next((one.name for one in topics if one.messages and short(one.type) in PACKETS), None)
    remedy = (
        ""
        if packets is None
        else f"; {packets} has a lidar's raw packets: its driver makes PointCloud2 of them"
    )
    if unread:
        some = ", ".join(f"{one.name} ({one.type} as {packing})" for one, packing in unread[:6])
        some += ", ..." if len(unread) > 6 else ""
        remedy += f"; not read: {some}; expected ros1, cdr, json of ROS's or Foxglove's types, "
        remedy += "or protobuf of Foxglove's"
    if encodings:
        remedy += f"; images with depths are {', '.join(DEPTH_ENCODINGS)}, or PNG of 16 bits and one channel"
    return f"{path}: no {SENSOR_NAMES} in it, found {held or 'none'}{remedy}"


def _named(topic: Topic, encoding: str | None) -> str:
    return f"{topic.name} ({short(topic.type)}{f' of {encoding}' if encoding else ''})"


def standing(
    path: str, sensor: str, connected: list[str], usual: tuple[str, ...], others: dict[str, str]
) -> str:
    """The error of a sensor that is fixed to all that it is connected with."""
    return (
        f"{path}: {sensor} is connected to none of {', '.join(usual)}, nor to a frame in which it moves, "
        "expected one of:"
    ) + typed(*_sources(others), _TRAJECTORY, _STILL, f"{key('fixed_frame')} FRAME, of {listed(connected)}")


def _sources(others: dict[str, str]) -> list[str]:
    """How to ask for the poses of each topic that has some."""
    return [f"{key('odometry' if type == 'Odometry' else 'poses')} {name}" for name, type in others.items()]


def typed(*lines: str, said: str = "") -> str:
    """What to type, each on a line of its own, to follow a message's first line; then what else is known."""
    return "".join(f"\n  {line}" for line in lines) + (f"\n{said}" if said else "")


def listed(frames: list[str]) -> str:
    """Names for errors."""
    return ", ".join(frames[:24] + ["..."] * (len(frames) > 24))
