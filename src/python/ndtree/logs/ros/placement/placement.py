# SPDX-License-Identifier: BSD-3-Clause
"""From where the poses of a sensor come: transforms, a topic, a trajectory, or none as it stands still."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ndtree._errors import WrongValue, key
from ndtree.logs.core.failures import NowhereKnown
from ndtree.logs.core.silence import without_zeros
from ndtree.logs.poses.trajectory import STAMP_TOLERANCE
from ndtree.logs.poses.trajectory_files import read_trajectory
from ndtree.logs.poses.transforms import TransformTree, plain
from ndtree.logs.ros.files.bag import Topic
from ndtree.logs.ros.messages.beams import CLOUDS, Beams, Floats
from ndtree.logs.ros.messages.sweep import in_map
from ndtree.logs.ros.options import BagOptions
from ndtree.logs.ros.placement.advice import (
    HOW_TO_MOUNT,
    MOUNT,
    USUAL,
    bases_in,
    listed,
    observer_of,
    standing,
    typed,
    unconnected,
)
from ndtree.logs.ros.placement.mount import mount_of
from ndtree.logs.ros.survey import PoseRow, Survey, share_within

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

    def in_map(self, frame: str, beams: Beams, stamp: float) -> tuple[Floats, Floats]:
        """As `ndtree.logs.ros.messages.sweep.in_map`, of a message in a frame."""
        if self.observer is None:
            return in_map(self.tree, self.fixed_frame, frame, beams, stamp)
        # Moving the points into a fixed frame took the time of each into account.
        beams = replace(beams, points=without_zeros(beams.points), times=None)
        ends, _ = in_map(self.tree, self.fixed_frame, frame, beams, stamp)
        return ends, self.tree.pose_at(self.fixed_frame, self.observer, stamp).position


def placed(path: str, survey: Survey, topic: Topic, asked: BagOptions, others: dict[str, str]) -> Placement:
    """Find the way from a topic's sensor to the map.

    `path`: The bag, for errors.
    `survey`: With the stamps of the topic.
    `others`: Topics with poses that the bag has and their types, for errors.
    Raises ValueError if there is none: which frames there are, and what to say.
    """
    frame = _frame_of(survey, topic, asked)
    if asked.still:
        return _still(path, survey, topic.name, frame, asked)
    if _may_be_registered(topic, asked) and any(row.parent == frame != row.child for row in survey.poses[:1]):
        return _registered(path, survey, topic.name, frame, asked)
    if asked.trajectory is not None or asked.poses is not None:
        return _by_poses(path, survey, topic.name, frame, asked)
    return _by_transforms(path, survey, topic, asked, others)


def _frame_of(survey: Survey, topic: Topic, asked: BagOptions) -> str:
    """The sensor's."""
    return survey.seen[topic.name].frame if asked.sensor_frame is None else plain(asked.sensor_frame)


def _may_be_registered(topic: Topic, asked: BagOptions) -> bool:
    """Whether points may be in the fixed frame already."""
    return topic.type in CLOUDS and asked.mount is None and asked.sensor_frame is None


def _still(path: str, survey: Survey, topic: str, frame: str, asked: BagOptions) -> Placement:
    tree = survey.tree_of(topic, frame).fixed_only()
    if asked.mount is not None:
        base = plain(asked.base_frame or _BODY)
        tree.add_fixed(base, _mounted(frame), mount_of(asked.mount))
        return Placement(tree, base, _mounted(frame), False, STILL)
    connected = tree.connected(frame)
    wanted = asked.fixed_frame or asked.base_frame
    if wanted is not None and plain(wanted) not in connected:
        raise ValueError(
            f"{path}: no fixed transform between {frame} and {wanted}, expected one of {', '.join(connected)}"
        )
    roots = tree.roots(frame, fixed=True)
    fixed = plain(wanted) if wanted is not None else (roots[0] if roots else frame)
    return Placement(tree, fixed, frame, asked.sensor_frame is None, STILL)


def _registered(path: str, survey: Survey, topic: str, frame: str, asked: BagOptions) -> Placement:
    """Points that are in the frame in which the poses of a topic are."""
    assert asked.poses is not None
    tree = TransformTree()
    body = survey.poses[0].child or _BODY
    fixed = _add_poses(path, tree, survey.poses, body, asked.poses)
    return Placement(tree, fixed, frame, False, asked.poses, (_said(topic, frame, body),), body)


def _said(topic: str, frame: str, observer: str) -> str:
    return (
        f"the points of {topic} are in the fixed frame {frame}: their beams are taken to come from "
        f"{observer}, as by {key('base_frame')}"
    )


def _by_poses(path: str, survey: Survey, topic: str, frame: str, asked: BagOptions) -> Placement:
    """Poses of a body, or of the sensor itself, from a trajectory or a topic."""
    tree = survey.tree_of(topic, frame).fixed_only()
    notes: list[str] = []
    child = survey.poses[0].child if survey.poses else ""
    body = plain(asked.base_frame or child)
    sensor = frame
    if asked.mount is not None:
        body, sensor = body or _BODY, _mounted(frame)
        tree.add_fixed(body, sensor, mount_of(asked.mount))
    elif not body and asked.poses is not None:
        roots = tree.roots(frame, fixed=True)
        body = roots[0] if roots else frame
    body = body or frame
    if asked.trajectory is not None:
        poses = read_trajectory(asked.trajectory)
        if poses.is_numbered:
            raise ValueError(
                f"{asked.trajectory}: has no times, expected t x y z qx qy qz qw for the scans of a bag"
            )
        fixed, origin = _TRAJECTORY_FRAME, asked.trajectory
        tree.add_trajectory(fixed, body, poses)
    else:
        assert asked.poses is not None
        fixed, origin = _add_poses(path, tree, survey.poses, body, asked.poses), asked.poses
    if sensor not in tree.connected(fixed):
        raise WrongValue(
            f"{path}: no transform between {frame}, the frame of {topic}, and {body}, of which {origin} has "
            "the poses, expected one of:"
            + typed(
                f"{MOUNT}, where the sensor sits on it [m, rad or 90deg]",
                f"ndtree calibrate {path} --find-mount, to measure that",
                "--sensor-frame FRAME or --base-frame FRAME, of "
                + listed([one for one in tree.connected(fixed) if one != fixed]),
            )
        )
    if body == frame != child and asked.poses is not None and asked.mount is None:
        notes.append(
            f"{origin} is taken for the poses of the sensor itself; where it is on its body: {HOW_TO_MOUNT}"
        )
    # Messages of a sensor that is the body itself may call it by any name.
    is_own = body != frame and asked.mount is None and asked.sensor_frame is None
    return Placement(tree, fixed, sensor, is_own, origin, tuple(notes))


def _add_poses(path: str, tree: TransformTree, rows: list[PoseRow], body: str, topic: str) -> str:
    """Put the poses of a topic into a tree; their fixed frame."""
    if not rows:
        raise ValueError(f"{path}: {topic}: no pose in it, expected some")
    fixed = rows[0].parent or topic
    if fixed == body:
        fixed += " at the beginning"
    for row in rows:
        if (row.parent, row.child) != (rows[0].parent, rows[0].child):
            raise ValueError(
                f"{path}: {topic}: poses of {row.child or 'a body'} in {row.parent} follow those of "
                f"{rows[0].child or 'a body'} in {rows[0].parent}, expected one of them"
            )
        tree.add(fixed, body, row.stamp, row.position, row.quaternion)
    if len(rows) > 1 and len({row.stamp for row in rows}) == 1:
        raise ValueError(f"{path}: {topic}: all {len(rows)} poses have the same time, expected their own")
    return fixed


def _by_transforms(
    path: str, survey: Survey, topic: Topic, asked: BagOptions, others: dict[str, str]
) -> Placement:
    frame = _frame_of(survey, topic, asked)
    tree, sensor = survey.tree_of(topic.name, frame), frame
    if asked.mount is not None and tree.frames():
        base = _base(path, tree, asked)
        sensor = _mounted(frame)
        tree.add_fixed(base, sensor, mount_of(asked.mount))
    connected = tree.connected(sensor)
    if len(connected) == 1:
        raise NowhereKnown(unconnected(path, tree, topic.name, frame, others))
    stamps = np.array(survey.seen[topic.name].own_stamps)
    notes: tuple[str, ...] = ()
    observer = observer_of(tree, frame, asked.base_frame) if _may_be_registered(topic, asked) else None
    if asked.base_frame is not None and asked.mount is None and plain(asked.base_frame) != observer:
        below = "" if observer is None else f", or it as one of {listed(tree.below(frame))}"
        raise WrongValue(
            f"{path}: {key('base_frame')} = {asked.base_frame}: nothing is said of it, expected a mount on "
            f"it, or poses of it{below}"
        )
    if observer is not None:
        fixed = _fixed_frame(path, tree, observer, asked.fixed_frame, stamps, others)
        return Placement(
            tree, fixed, frame, False, TRANSFORMS, (_said(topic.name, frame, observer),), observer
        )
    fixed = _fixed_frame(path, tree, sensor, asked.fixed_frame, stamps, others)
    if _share_known(tree, fixed, sensor, stamps) < ENOUGH:
        # Transforms that were said only once in a while, though nothing moves in them.
        constant = tree.fix_constant(fixed, sensor)
        if constant:
            which = ", ".join(constant)
            notes = (f"/tf says little of {which}, but never changes it: it is taken for fixed",)
            fixed = _fixed_frame(path, tree, sensor, asked.fixed_frame, stamps, others)
    is_own = asked.mount is None and asked.sensor_frame is None
    if asked.fixed_frame is None and fixed in USUAL:
        for better in USUAL[: USUAL.index(fixed)]:
            if better in connected:
                share = _share_known(tree, better, sensor, stamps)
                say = f"{better} is known for {100 * share:.0f} % of the scans: {key('fixed_frame')} {better}"
                notes = (*notes, f"{say} takes those alone, and {fixed} is taken, which drifts")
    return Placement(tree, fixed, sensor, is_own, TRANSFORMS, notes)


def _base(path: str, tree: TransformTree, asked: BagOptions) -> str:
    """The frame that a sensor is mounted on."""
    frames = tree.frames()
    if asked.base_frame is not None:
        if plain(asked.base_frame) not in frames:
            raise WrongValue(
                f"{path}: {key('base_frame')} = {asked.base_frame}: not in /tf, "
                f"expected one of {listed(frames)}"
            )
        return plain(asked.base_frame)
    for base in bases_in(frames):
        return base
    raise WrongValue(
        f"{path}: {key('mount')}: on which frame? Expected {key('base_frame')} as one of {listed(frames)}"
    )


def _fixed_frame(
    path: str,
    tree: TransformTree,
    sensor: str,
    wanted: str | None,
    stamps: np.ndarray,
    others: dict[str, str],
) -> str:
    """The frame of the map: as asked for; else the first that has poses for half of the scans, or the most.

    Candidates are the usual ones, then the roots of the tree to which the sensor moves.
    """
    connected = tree.connected(sensor)
    if wanted is not None:
        if plain(wanted) not in connected:
            raise WrongValue(
                f"{path}: no transform between {sensor} and {wanted}, "
                f"expected {key('fixed_frame')} as one of {listed(connected)}"
            )
        return plain(wanted)
    candidates = [usual for usual in USUAL if usual in connected]
    candidates += [root for root in tree.roots(sensor) if root != sensor and not tree.is_fixed(root, sensor)]
    best, most = None, -1.0
    for candidate in candidates:
        share = _share_known(tree, candidate, sensor, stamps)
        if share >= ENOUGH:
            return candidate
        if share > most:
            best, most = candidate, share
    if best is None:
        raise NowhereKnown(standing(path, sensor, connected, USUAL, others))
    return best


def _share_known(tree: TransformTree, fixed: str, sensor: str, stamps: np.ndarray) -> float:
    """The share of the scans at whose time poses are known, but for gaps."""
    first, last = tree.span(fixed, sensor)
    return share_within(stamps, (first - STAMP_TOLERANCE, last + STAMP_TOLERANCE))


def _mounted(frame: str) -> str:
    """A frame of its own for a sensor whose place was given by hand, whatever /tf says of it."""
    return f"{frame} as mounted"
