# SPDX-License-Identifier: BSD-3-Clause
"""Poses and transforms in messages that arrive while a robot drives, for sensors whose places are found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ndtree.logs.poses.covariances import PoseCovariances
from ndtree.logs.poses.following import Edge, FollowedTree
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.clock import Clock
from ndtree.logs.ros.placement.placement import TRANSFORMS, Placement
from ndtree.logs.ros.storage import Raw
from ndtree.logs.ros.survey import POSES_STREAM, TF, is_static, poses_in, space_of, transforms_in


class Follower:
    """Adds the poses in messages to the trees of sensors' places.

    `places`: By the sensors' topics.
    `decoded`: Makes a message of a Raw; raises ValueError.
    `covariances`: Takes what comes with the poses of its topic.
    Attributes:
    `damaged`: Messages that could not be read.
    """

    def __init__(
        self,
        places: Mapping[str, Placement],
        clock: Clock,
        decoded: Callable[[Raw], Any],
        covariances: PoseCovariances | None = None,
    ) -> None:
        self._places, self._clock, self._decoded = places, clock, decoded
        self._covariances = covariances
        self.damaged = 0
        self._trees = {id(one.tree): FollowedTree(one.tree) for one in places.values()}
        self._by_tf: dict[int, FollowedTree] = {}
        self._by_topic: dict[str, list[tuple[FollowedTree, Edge]]] = {}
        for place in places.values():
            tree = self._trees[id(place.tree)]
            if place.origin == TRANSFORMS:
                self._by_tf[id(place.tree)] = tree
                continue
            for edge in place.tree.moving(place.fixed_frame, place.observer or place.frame):
                self._by_topic.setdefault(place.origin, []).append((tree, edge))

    # As of `FollowedTree`, of all.
    late = property(lambda self: sum(tree.late for tree in self._trees.values()))
    fallen = property(lambda self: sum(tree.fallen for tree in self._trees.values()))
    released = property(lambda self: sum(tree.released for tree in self._trees.values()))

    def add(self, raw: Raw) -> None:
        """Take note of a message with poses or transforms; one that is damaged is counted."""
        topic, received = raw.connection.topic, 1e-9 * raw.received
        if raw.connection.type not in TF and topic not in self._by_topic:
            return
        try:
            message = self._decoded(raw)
        except ValueError:
            self.damaged += 1
            return
        if topic in self._by_topic:
            for row in poses_in(message):
                stamp = self._clock.time(POSES_STREAM, received, row.stamp)
                for tree, edge in self._by_topic[topic]:
                    tree.add(*edge, stamp, row.position, row.quaternion)
                if self._covariances is not None and self._covariances.topic == topic:
                    self._covariances.add(stamp, row.covariance)
            return
        space = space_of(topic)
        trees = [one for one in self._by_tf.values() if one.tree.spaces is None or space in one.tree.spaces]
        for row in transforms_in(message):
            if is_static(topic):
                pose = Pose.from_quaternion(row.position, row.quaternion)
                for tree in trees:
                    tree.tree.add_fixed(row.parent, row.child, pose)
                continue
            stamp = self._clock.time((topic, row.parent, row.child), received, row.stamp)
            for tree in trees:
                tree.add(plain(row.parent), plain(row.child), stamp, row.position, row.quaternion)

    def until(self, topic: str, frame: str) -> float:
        """Up to when the pose of a topic's sensor is known, whose messages are in a frame [s]."""
        place = self._places[topic]
        tree = self._trees[id(place.tree)]
        until = tree.until(place.fixed_frame, frame)
        return until if place.observer is None else min(until, tree.until(place.fixed_frame, place.observer))

    def asked(self, topic: str, until: float) -> None:
        """Take note that the poses of a topic's sensor up to a time were asked for [s]."""
        self._trees[id(self._places[topic].tree)].asked(until)
