# SPDX-License-Identifier: BSD-3-Clause
"""What to say to a user whose bag does not tell where its sensor is."""

from __future__ import annotations

import posixpath
from collections.abc import Iterator

import numpy as np

from ndtree._errors import key
from ndtree.logs.core.failures import NoPose
from ndtree.logs.poses.transforms import TransformTree, plain
from ndtree.logs.ros.files.bag import Bag, Topic
from ndtree.logs.ros.messages.beams import SENSOR_NAMES, short
from ndtree.logs.ros.messages.image import DEPTH_ENCODINGS

#: Frames that do not move with a robot, and those that are one; the best first.
USUAL = ("map", "odom", "world")
BASES = ("base_link", "base_footprint", "base")
#: What moves no further than this [m] in a frame is no robot on its way; LOOKS times are looked at.
LEAST_WAY, LOOKS = 0.1, 200


def observer_of(tree: TransformTree, frame: str, wanted: str | None) -> str | None:
    """The frame whose place the points of a cloud were seen from, if the cloud's frame stands still itself.

    SLAM publishes clouds that it has moved into the frame of its map, in which the robot drives: that frame
    is no sensor's. It is a usual fixed one, or the root of the tree, and a frame below it moves about. Of
    these the one that was asked for counts, else a robot's usual base, else the uppermost.

    `frame`: Of the cloud.
    `wanted`: Asked for.
    Returns: None where the frame may be that of a sensor.
    """
    if posixpath.basename(frame) in BASES:
        return None
    roots = [root for root in tree.roots(frame) if tree.is_fixed(root, frame)]
    if not roots and posixpath.basename(frame) not in USUAL:
        return None
    below = tree.below(frame)
    if posixpath.basename(frame) not in USUAL and any(posixpath.basename(one) in USUAL for one in below):
        return None  # The tree stands on its head.
    below = [one for one in below if _moves_about(tree, frame, one)]
    if not below:
        return None
    if wanted is not None and plain(wanted) in below:
        return plain(wanted)
    return next(bases_in(below), below[0])


def bases_in(frames: list[str]) -> Iterator[str]:
    """Those of some frames that are usual bases of robots, whatever stands before their names."""
    for base in BASES:
        for one in frames:
            if posixpath.basename(one) == base:
                yield one


def _moves_about(tree: TransformTree, frame: str, other: str) -> bool:
    stamps = tree.stamps(frame, other)
    if len(stamps) < 2:
        return False
    positions = []
    for stamp in stamps[:: len(stamps) // LOOKS + 1]:
        try:
            positions.append(tree.pose_at(frame, other, stamp).position)
        except NoPose:
            continue
    return bool(positions) and float(np.linalg.norm(np.ptp(positions, axis=0))) > LEAST_WAY


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
    if frame in tree.refused:
        what += f" ({tree.refused[frame]}, expected finite numbers, a quaternion of length 1)"
    if not frames:
        begin = f"{path}: {what}: there is no /tf"
        if not say:
            return f"{begin}, nor any other poses, expected one of:" + typed(_TRAJECTORY, _STILL)
        sources = [f"{one}, and {MOUNT} unless the poses are those of the sensor" for one in say]
        return f"{begin}, expected one of:" + typed(*sources, _TRAJECTORY, _STILL)
    base = next(bases_in(frames), "FRAME")
    frames_are = f"the frames of /tf are {listed(frames)}"
    return f"{path}: {what}, expected one of:" + typed(
        f"{key('base_frame')} {base} {MOUNT}, where the sensor sits [m, rad or 90deg]",
        f"{key('sensor_frame')} FRAME, if it sits in one of these frames",
        f"ndtree calibrate {path} --find-mount, to measure where it sits",
        said=frames_are,
    )


def without_sensors(bag: Bag, encodings: dict[str, str]) -> str:
    """The error of a bag that has nothing to map; `encodings` are those of its images, by topic."""
    held = ", ".join(_named(one, encodings.get(one.name)) for one in bag.topics[:12]) + (
        ", ..." if len(bag.topics) > 12 else ""
    )
    packets = next((one.name for one in bag.topics if one.messages and short(one.type) in PACKETS), None)
    remedy = (
        ""
        if packets is None
        else f"; {packets} has a lidar's raw packets: its driver makes PointCloud2 of them"
    )
    if bag.unread:
        some = ", ".join(f"{one.name} ({one.type} as {packing})" for one, packing in bag.unread[:6])
        some += ", ..." if len(bag.unread) > 6 else ""
        remedy += f"; not read: {some}; expected ros1, cdr, json of ROS's or Foxglove's types, "
        remedy += "or protobuf of Foxglove's"
    if encodings:
        remedy += f"; images with depths are {', '.join(DEPTH_ENCODINGS)}, or PNG of 16 bits and one channel"
    remedy = "; ".join([remedy, *bag.damage])
    return f"{bag.path}: no {SENSOR_NAMES} in it, found {held or 'none'}{remedy}"


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
