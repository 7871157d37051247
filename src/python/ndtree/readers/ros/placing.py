# SPDX-License-Identifier: BSD-3-Clause
"""Where the sensors are that are mapped, and which of them is taken if nobody says."""

from __future__ import annotations

from dataclasses import replace

from ndtree.readers.ros.bag import Bag, Topic
from ndtree.readers.ros.placement import Asked, Placement, placed
from ndtree.readers.ros.sensors import listed
from ndtree.readers.ros.survey import ODOMETRY, POSE_NAMES, POSES, Survey


def poses_topic(bag: Bag, odometry: str | None, poses: str | None) -> str | None:
    """The topic with poses that was asked for."""
    wanted, types = (odometry, (ODOMETRY,)) if odometry is not None else (poses, POSES)
    if wanted is None:
        return None
    topic = bag.topic(wanted)
    if topic is None or topic.type not in types or not topic.messages:
        what = "Odometry" if odometry is not None else f"poses ({POSE_NAMES})"
        raise ValueError(f"{bag.path}: no {what} in {wanted}, expected one of {listed(bag.of_type(*types))}")
    return topic.name


def placed_together(bag: Bag, survey: Survey, topics: list[Topic], asked: Asked) -> dict[str, Placement]:
    """Where the sensors are that were asked for, all of them in the frame of the first."""
    others = {one.name: one.type.rpartition("/")[2] for one in bag.of_type(*POSES)}
    places: dict[str, Placement] = {}
    for topic in topics:
        places[topic.name] = placed(bag.path, survey, topic.name, asked, others)
        if asked.poses is None and asked.trajectory is None:
            asked = replace(asked, fixed_frame=places[topic.name].fixed_frame)
    return places


def first_placed(
    bag: Bag, survey: Survey, topics: list[Topic], asked: Asked
) -> tuple[list[Topic], dict[str, Placement]]:
    """The first sensor of which it is known where it is; the error is that of the first of all."""
    wrong: ValueError | None = None
    for topic in topics:
        try:
            return [topic], placed_together(bag, survey, [topic], asked)
        except ValueError as error:
            wrong = wrong or error
    assert wrong is not None
    raise wrong
