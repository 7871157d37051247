# SPDX-License-Identifier: BSD-3-Clause
"""From where the poses of a sensor come: transforms, a topic, a trajectory, or none as it stands still."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ndtree._errors import WrongValue, key
from ndtree.logs.core.failures import NoPose, NowhereKnown, some_of
from ndtree.logs.core.silence import without_zeros
from ndtree.logs.poses.pose import mount_of
from ndtree.logs.poses.trajectory import STAMP_TOLERANCE
from ndtree.logs.poses.trajectory_files import read_trajectory
from ndtree.logs.poses.transforms import TransformTree, plain
from ndtree.logs.ros.files.bag import Bag, Topic
from ndtree.logs.ros.messages.beams import CLOUDS, SENSOR_NAMES, Beams, Floats, short
from ndtree.logs.ros.messages.image import DEPTH_ENCODINGS
from ndtree.logs.ros.messages.sweep import in_map
from ndtree.logs.ros.options import BagOptions
from ndtree.logs.ros.survey import Survey

#: Where poses come from of a sensor that has but one.
STILL = "standing still"
#: And of one whose poses are transforms.
TRANSFORMS = "/tf"
_TRAJECTORY_FRAME = "the trajectory's frame"
_BODY = "the body"
#: A frame that has poses for this share of the scans is good enough.
ENOUGH = 0.5


@dataclass(frozen=True)
class Placement:
    """How the pose of a sensor is found.

    `observer`: The frame that beams come from, where `frame` is a fixed one into which points were moved
        already.
    """

    tree: TransformTree
    fixed_frame: str  # That of the map.
    frame: str  # The sensor's.
    is_own: bool  # Each message's own frame counts; else all have `frame`.
    origin: str  # Where the poses come from, for reports.
    notes: tuple[str, ...] = ()  # What was taken for granted.
    observer: str | None = None

    @property
    def stands(self) -> bool:
        """Whether the sensor has one pose for all times."""
        return self.observer is None and self.tree.stands(self.fixed_frame, self.frame)

    def moving(self) -> list[tuple[str, str]]:
        """The transforms between the sensor and the map that change over time: parents and children."""
        return self.tree.moving(self.fixed_frame, self.observer or self.frame)

    def leaps(self) -> list[str]:
        """What is said of leaps in these transforms."""
        return self.tree.leaps(self.fixed_frame, self.observer or self.frame)

    def in_map(self, frame: str, beams: Beams, stamp: float) -> tuple[Floats, Floats]:
        """As `ndtree.logs.ros.messages.sweep.in_map`, of a message in a frame."""
        if self.observer is None:
            return in_map(self.tree, self.fixed_frame, frame, beams, stamp)
        # Moving the points into a fixed frame took the time of each into account.
        beams = replace(beams, points=without_zeros(beams.points), times=None)
        ends, _ = in_map(self.tree, self.fixed_frame, frame, beams, stamp)
        return ends, self.tree.pose_at(self.fixed_frame, self.observer, stamp).position


class Finder:
    """Finds the way from a topic's sensor to the map.

    `path`: The bag, for errors.
    `survey`: With the stamps of the topic.
    `others`: Topics with poses that the bag has and their types, for errors.
    """

    def __init__(
        self, path: str, survey: Survey, topic: Topic, asked: BagOptions, others: dict[str, str]
    ) -> None:
        self.path, self.asked, self.topic = path, asked, topic.name
        self.poses, self.stamps = survey.poses, np.array(survey.seen[topic.name].own_stamps)
        named = survey.seen[topic.name].frame
        self.frame = named if asked.sensor_frame is None else plain(asked.sensor_frame)  # The sensor's.
        self.tree = survey.tree_of(topic.name, self.frame)
        self.is_said = asked.mount is None and asked.sensor_frame is None  # By messages alone.
        self.may_be_registered = topic.type in CLOUDS and self.is_said  # Points in a fixed frame already.
        #: How to ask for the poses of each topic that has some.
        self.sources = [
            f"{key('odometry' if type == 'Odometry' else 'poses')} {name}" for name, type in others.items()
        ]

    def placement(self) -> Placement:
        """How its pose is found; ValueError if there is no way: which frames there are, and what to say."""
        if self.asked.still:
            return self.still()
        is_child = any(row.parent == self.frame != row.child for row in self.poses[:1])
        if self.may_be_registered and is_child:
            return self.registered()
        if self.asked.trajectory is not None or self.asked.poses is not None:
            return self.by_poses()
        return self.by_transforms()

    def still(self) -> Placement:
        """Of a sensor that stands."""
        tree, frame, asked = self.tree.fixed_only(), self.frame, self.asked
        if asked.mount is not None:
            base = plain(asked.base_frame or _BODY)
            return Placement(tree, base, _mounted(tree, base, frame, asked.mount), False, STILL)
        connected = tree.connected(frame)
        wanted = asked.fixed_frame or asked.base_frame
        if wanted is not None and plain(wanted) not in connected:
            some = some_of(connected)
            raise ValueError(f"{self.path}: {frame} is not fixed to {wanted}, expected one of {some}")
        roots = tree.roots(frame, fixed=True)
        fixed = plain(wanted) if wanted is not None else (roots[0] if roots else frame)
        return Placement(tree, fixed, frame, asked.sensor_frame is None, STILL)

    def registered(self) -> Placement:
        """Of points that are in the frame in which the poses of a topic are."""
        assert self.asked.poses is not None
        tree = TransformTree()
        body = self.poses[0].child or _BODY
        fixed = self._add_poses(tree, body)
        return Placement(tree, fixed, self.frame, False, self.asked.poses, (self._said(body),), body)

    def _said(self, observer: str) -> str:
        said = f"the points of {self.topic} are in the fixed frame {self.frame}"
        return f"{said}: their beams are taken to come from {observer}, as by {key('base_frame')}"

    def by_poses(self) -> Placement:
        """By the poses of a body, or of the sensor itself, from a trajectory or a topic."""
        tree, frame, asked = self.tree.fixed_only(), self.frame, self.asked
        notes: list[str] = []
        child = self.poses[0].child if self.poses else ""
        body = plain(asked.base_frame or child)
        sensor = frame
        if asked.mount is not None:
            body = body or _BODY
            sensor = _mounted(tree, body, frame, asked.mount)
        elif not body and asked.poses is not None:
            roots = tree.roots(frame, fixed=True)
            body = roots[0] if roots else frame
        body = body or frame
        if asked.trajectory is not None:
            poses = read_trajectory(asked.trajectory)
            if poses.is_numbered:
                expected = "expected t x y z qx qy qz qw for the scans of a bag"
                raise ValueError(f"{asked.trajectory}: has no times, {expected}")
            fixed, origin = _TRAJECTORY_FRAME, asked.trajectory
            tree.add_trajectory(fixed, body, poses)
        else:
            assert asked.poses is not None
            fixed, origin = self._add_poses(tree, body), asked.poses
        if sensor not in tree.connected(fixed):
            frames = f"{frame}, the frame of {self.topic}, and {body}, of which {origin} has the poses"
            others = some_of([one for one in tree.connected(fixed) if one != fixed])
            raise WrongValue(
                f"{self.path}: no transform between {frames}, expected one of:"
                + typed(
                    f"{MOUNT}, where the sensor sits on it [m, rad or 90deg]",
                    f"ndtree calibrate {self.path} --find-mount, to measure that",
                    f"--sensor-frame FRAME or --base-frame FRAME, of {others}",
                )
            )
        if body == frame != child and asked.poses is not None and asked.mount is None:
            said = f"{origin} is taken as the poses of the sensor itself"
            notes.append(f"{said}; where it is on its body: {HOW_TO_MOUNT}")
        # Messages of a sensor that is the body itself may call it by any name.
        return Placement(tree, fixed, sensor, body != frame and self.is_said, origin, tuple(notes))

    def _add_poses(self, tree: TransformTree, body: str) -> str:
        """Put the poses of a topic into a tree; their fixed frame."""
        rows, where = self.poses, f"{self.path}: {self.asked.poses}"
        if not rows:
            raise ValueError(f"{where}: no pose in it, expected some")
        fixed = rows[0].parent or str(self.asked.poses)
        if fixed == body:
            fixed += " at the beginning"
        for row in rows:
            if (row.parent, row.child) != (rows[0].parent, rows[0].child):
                one, first = (f"{found.child or 'a body'} in {found.parent}" for found in (row, rows[0]))
                raise ValueError(f"{where}: poses of {one} follow those of {first}, expected one of them")
            tree.add(fixed, body, row.stamp, row.position, row.quaternion)
        if len(rows) > 1 and len({row.stamp for row in rows}) == 1:
            raise ValueError(f"{where}: all {len(rows)} poses have the same time, expected their own")
        return fixed

    def by_transforms(self) -> Placement:
        """By /tf alone."""
        tree, frame, asked = self.tree, self.frame, self.asked
        sensor = frame
        if asked.mount is not None and tree.frames():
            sensor = _mounted(tree, self._base(), frame, asked.mount)
        connected = tree.connected(sensor)
        if len(connected) == 1:
            raise self._unconnected()
        notes: tuple[str, ...] = ()
        observer = observer_of(tree, frame, asked.base_frame) if self.may_be_registered else None
        if asked.base_frame is not None and asked.mount is None and plain(asked.base_frame) != observer:
            below = "" if observer is None else f", or it as one of {some_of(tree.below(frame))}"
            said = f"{key('base_frame')} = {asked.base_frame}: nothing is said of it"
            raise WrongValue(f"{self.path}: {said}, expected a mount on it, or poses of it{below}")
        if observer is not None:
            fixed = self._fixed_frame(observer)
            return Placement(tree, fixed, frame, False, TRANSFORMS, (self._said(observer),), observer)
        if self.may_be_registered and posixpath.basename(frame) in USUAL:
            said = f"{self.path}: the points of {self.topic} are in {frame}, which is no sensor's frame"
            base = f"{key('base_frame')} FRAME, where the sensor is, of {some_of(tree.below(frame))}"
            raise NowhereKnown(f"{said}, expected one of:{typed(base, _TRAJECTORY, _STILL)}")
        fixed = self._fixed_frame(sensor)
        if self._share_known(fixed, sensor) < ENOUGH:
            # Transforms that were said only once in a while, though nothing moves in them.
            constant = tree.fix_constant(fixed, sensor)
            if constant:
                which = ", ".join(constant)
                notes = (f"/tf says little of {which}, but never changes it: it is taken as fixed",)
                fixed = self._fixed_frame(sensor)
        if asked.fixed_frame is None and fixed in USUAL:
            for better in USUAL[: USUAL.index(fixed)]:
                if better in connected:
                    known = f"{100 * self._share_known(better, sensor):.0f} % of the scans"
                    say = f"{better} is known for {known}: {key('fixed_frame')} {better}"
                    notes = (*notes, f"{say} takes those alone, and {fixed} is taken, which drifts")
        return Placement(tree, fixed, sensor, self.is_said, TRANSFORMS, notes)

    def _base(self) -> str:
        """The frame that a sensor is mounted on."""
        frames, wanted = self.tree.frames(), self.asked.base_frame
        expected = f"one of {some_of(frames)}"
        if wanted is not None:
            if plain(wanted) not in frames:
                said = f"{key('base_frame')} = {wanted}: not in /tf"
                raise WrongValue(f"{self.path}: {said}, expected {expected}")
            return plain(wanted)
        for base in bases_in(frames):
            return base
        raise WrongValue(f"{self.path}: {key('mount')}: expected {key('base_frame')}, {expected}")

    def _fixed_frame(self, sensor: str) -> str:
        """The frame of the map: as asked; else the first that has poses for half of the scans, or the most.

        Candidates are the usual ones, then the roots of the tree to which the sensor moves.
        """
        tree, wanted = self.tree, self.asked.fixed_frame
        connected = tree.connected(sensor)
        if wanted is not None:
            if plain(wanted) not in connected:
                expected = f"expected {key('fixed_frame')} as one of {some_of(connected)}"
                raise WrongValue(f"{self.path}: no transform between {sensor} and {wanted}, {expected}")
            return plain(wanted)
        candidates = [usual for usual in USUAL if usual in connected]
        roots = (root for root in tree.roots(sensor) if root != sensor)
        candidates += [root for root in roots if tree.moving(root, sensor)]
        if not candidates:
            said = f"{sensor} is connected to none of {', '.join(USUAL)}, nor to a frame in which it moves"
            frames = f"{key('fixed_frame')} FRAME, of {some_of(connected)}"
            ways = typed(*self.sources, _TRAJECTORY, _STILL, frames)
            raise NowhereKnown(f"{self.path}: {said}, expected one of:{ways}")
        shares = {candidate: self._share_known(candidate, sensor) for candidate in candidates}
        enough = (candidate for candidate in candidates if shares[candidate] >= ENOUGH)
        return next(enough, max(candidates, key=lambda one: shares[one]))

    def _unconnected(self) -> NowhereKnown:
        """The error of a sensor whose frame hangs nowhere: what there is, and what to say."""
        frame, frames = self.frame, self.tree.frames()
        if not (frame or self.stamps.size):
            return NowhereKnown(f"{self.path}: {self.topic}: none of its messages can be read, expected some")
        what = f"no transform to {frame}, the frame of {self.topic}"
        what = f"{self.path}: {what if frame else f'{self.topic} names no frame of its own'}"
        if frame in self.tree.refused:
            refused = self.tree.refused[frame]
            what += f" ({refused}, expected finite numbers, a quaternion of length 1)"
        by_scans = f"ndtree align {self.path} -o poses.txt, to find poses by the scans alone"
        found = [by_scans] if os.path.exists(self.path) else []  # And no messages of a robot that drives.
        if frames:
            base = next(bases_in(frames), "FRAME")
            ways = typed(
                f"{key('base_frame')} {base} {MOUNT}, where the sensor sits [m, rad or 90deg]",
                f"{key('sensor_frame')} FRAME, if it sits in one of these frames",
                f"ndtree calibrate {self.path} --find-mount, to measure where it sits",
                *found,
            )
            return NowhereKnown(f"{what}, expected one of:{ways}\nthe frames of /tf are {some_of(frames)}")
        none = "" if self.sources else ", nor any other poses"
        sources = [f"{one}, and {MOUNT} unless the poses are those of the sensor" for one in self.sources]
        ways = typed(*sources, _TRAJECTORY, _STILL, *([] if sources else found))
        return NowhereKnown(f"{what}: there is no /tf{none}, expected one of:{ways}")

    def _share_known(self, fixed: str, sensor: str) -> float:
        """The share of the scans at whose time poses are known, but for gaps; 1 where there are none."""
        first, last = self.tree.span(fixed, sensor)
        known = (self.stamps >= first - STAMP_TOLERANCE) & (self.stamps <= last + STAMP_TOLERANCE)
        return float(np.mean(known)) if len(known) else 1.0


def _mounted(tree: TransformTree, base: str, frame: str, mount: str) -> str:
    """A frame of its own for a sensor whose place was given by hand, whatever /tf says of it."""
    sensor = f"{frame} as mounted"
    tree.add_fixed(base, sensor, mount_of(mount))
    return sensor


#: Frames that do not move with a robot, and those that are one; the best first.
USUAL = ("map", "odom", "world")
BASES = ("base_link", "base_footprint", "base")
#: What moves no further than this [m] in a frame is no robot on its way; LOOKS times are looked at.
LEAST_WAY, LOOKS = 0.1, 200


def observer_of(tree: TransformTree, frame: str, wanted: str | None) -> str | None:
    """The frame whose place the points of a cloud were seen from, if the cloud's frame stands still itself.

    SLAM publishes clouds that it has moved into the frame of its map, in which the robot drives: that frame
    is no sensor's. It is a usual fixed one, or the root of the tree, and a frame below it moves about. Of
    these the one that is `wanted` counts, else a robot's usual base, else the uppermost. Below a usual fixed
    one the robot may stand, too. None where the cloud's frame may be that of a sensor, or no frame is one's.
    """
    if posixpath.basename(frame) in BASES:
        return None
    roots = [root for root in tree.roots(frame) if not tree.moving(root, frame)]
    if not roots and posixpath.basename(frame) not in USUAL:
        return None
    below = tree.below(frame)
    is_usual = posixpath.basename(frame) in USUAL
    if not is_usual and any(posixpath.basename(one) in USUAL for one in below):
        return None  # The tree stands on its head.
    moving = [one for one in below if _moves_about(tree, frame, one)]
    if wanted is not None and plain(wanted) in (below if is_usual else moving):
        return plain(wanted)
    if moving:
        return next(bases_in(moving), moving[0])
    return next(bases_in(below), None) if is_usual else None


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
PACKETS = tuple(
    "VelodyneScan VelodynePacket PacketMsg PandarScan HesaiScan RslidarScan RslidarPacket".split()
)
#: What to type for a sensor whose place on its base is not known.
MOUNT = f"{key('mount')} X,Y,Z,ROLL,PITCH,YAW"
HOW_TO_MOUNT = f"{MOUNT} (metres, and radians or degrees as in 90deg; ndtree calibrate --find-mount finds it)"
_TRAJECTORY = f"{key('trajectory')} FILE"
_STILL = f"{key('still')}, if the sensor does not move"


def without_sensors(bag: Bag, encodings: dict[str, str]) -> str:
    """The error of a bag that has nothing to map; `encodings` are those of its images, by topic."""

    def described(topic: Topic) -> str:
        encoding = encodings.get(topic.name)
        return f"{topic.name} ({short(topic.type)}{f' of {encoding}' if encoding else ''})"

    held = some_of([described(one) for one in bag.topics], 12)
    packets = next((one.name for one in bag.topics if one.messages and short(one.type) in PACKETS), None)
    remedy = f"; {packets} has a lidar's raw packets: its driver makes PointCloud2 of them" if packets else ""
    if bag.unread:
        some = some_of([f"{one.name} ({one.type} as {packing})" for one, packing in bag.unread], 6)
        remedy += f"; not read: {some}; expected ros1, cdr, json of ROS's or Foxglove's types, "
        remedy += "or protobuf of Foxglove's"
    if encodings:
        remedy += f"; images with depths are {', '.join(DEPTH_ENCODINGS)}, or PNG of 16 bits and one channel"
    remedy = "; ".join([remedy, *bag.damage])
    return f"{bag.path}: no {SENSOR_NAMES} in it, found {held or 'none'}{remedy}"


def typed(*lines: str) -> str:
    """What to type, each on a line of its own, to follow a message's first line."""
    return "".join(f"\n  {line}" for line in lines)
