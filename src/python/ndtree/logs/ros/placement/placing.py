# SPDX-License-Identifier: BSD-3-Clause
"""Where the sensors are that are mapped, and which of them is taken if none is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ndtree._errors import WrongValue, key, marked
from ndtree.logs.core.failures import NoPose
from ndtree.logs.ros.files.bag import Bag, Topic
from ndtree.logs.ros.options import BagOptions, listed
from ndtree.logs.ros.placement.placement import Placement, placed
from ndtree.logs.ros.sensors import Sensor
from ndtree.logs.ros.survey import ODOMETRY, POSES, Survey

#: Makes the survey of a bag with the poses of a topic, or without any.
Surveyed = Callable[["str | None"], Survey]


@dataclass(frozen=True)
class Placed:
    """Sensors, and how the pose of each is found."""

    topics: list[Topic]
    places: dict[str, Placement]  # By topic.
    survey: Survey  # That they are from.
    notes: list[str] = field(default_factory=list)  # What was taken for granted.


def find_places(
    bag: Bag, surveyed: Surveyed, topics: list[Topic], asked: BagOptions, poor: set[str] | None
) -> Placed:
    """Where sensors are: all of them, or the first of which it is known where `poor` is not None.

    `poor` has the names of those that make no map beside the others: they are not taken in the place of a
    better one of which it is not known where it is.

    Where nothing was said of poses and the transforms do not tell, a topic with Odometry counts whose
    messages say of which frame they are, if the sensor is connected with that.

    Raises ValueError if it is not known; of the first topic.
    """
    survey = surveyed(asked.poses)
    try:
        return _placed(bag, survey, topics, asked, poor)
    except ValueError as error:
        wrong = error
    if not (asked.still or asked.poses or asked.trajectory or asked.fixed_frame):
        sources = bag.of_type(ODOMETRY)
        for source in sources:
            other = surveyed(source.name)
            if not (other.poses and (other.poses[0].child or asked.mount)):
                continue
            try:
                found = _placed(bag, other, topics, replace(asked, poses=source.name), poor)
            except ValueError:
                continue
            left = [one for one in sources if one is not source]
            note = f"/tf does not say where the sensor is: poses are those of {key('odometry')} {source.name}"
            found.notes.append(note + (f"; others are {listed(left)}" if left else ""))
            return found
    if unread := [*survey.ends, *survey.damaged]:
        raise ValueError(f"{wrong}\nnot all of the bag could be read: {unread[0]}")
    raise wrong


def _placed(
    bag: Bag, survey: Survey, topics: list[Topic], asked: BagOptions, poor: set[str] | None
) -> Placed:
    if poor is None:
        return Placed(topics, _together(bag, survey, topics, asked), survey)
    wrong: ValueError | None = None
    registered: list[tuple[Topic, dict[str, Placement]]] = []
    for topic in topics:
        try:
            places = _together(bag, survey, [topic], asked)
        except ValueError as error:
            wrong = wrong or error
            continue
        if places[topic.name].observer is None:
            if wrong is not None and topic.name in poor:
                raise WrongValue(f"{marked(wrong)}\n  {key('topic')} {topic.name}, which sees far less")
            return Placed([topic], places, survey)
        registered.append((topic, places))
    if registered:  # Of clouds in a fixed frame the rare ones are whole maps.
        topic, places = max(registered, key=lambda one: one[0].messages)
        return Placed([topic], places, survey)
    assert wrong is not None
    raise wrong


def _together(bag: Bag, survey: Survey, topics: list[Topic], asked: BagOptions) -> dict[str, Placement]:
    """Where some sensors are, all of them in the frame of the first."""
    others = {one.name: one.type.rpartition("/")[2] for one in bag.of_type(*POSES)}
    places: dict[str, Placement] = {}
    for topic in topics:
        places[topic.name] = placed(bag.path, survey, topic, asked, others)
        if asked.poses is None and asked.trajectory is None:
            asked = replace(asked, fixed_frame=places[topic.name].fixed_frame)
    return places


#: A laser is planar if it tilts no more than this at half of the times, and than that at all but 5 % [rad],
#: and keeps its height within PLANAR_HEIGHT [m]. PLANAR_LOOKS times are looked at.
PLANAR_TILT, PLANAR_MOST_TILT, PLANAR_HEIGHT, PLANAR_LOOKS = 0.05, 0.09, 0.1, 5000


def dimension_of(path: str, sensors: list[Sensor], places: dict[str, Placement], wanted: int | None) -> int:
    """2 for lasers that stay in a level plane of their own, whichever side is up."""
    for sensor in sensors:
        if not sensor.is_planar:
            if wanted == 2:
                raise WrongValue(f"{path}: {sensor.topic.type} is 3-D, expected {key('dim')}=3")
            return 3
    if wanted is not None:
        return wanted
    return 2 if all(_is_level(places[one.topic.name]) for one in sensors) else 3


def _is_level(place: Placement) -> bool:
    stamps = place.tree.stamps(place.fixed_frame, place.frame)
    looked_at = stamps[:: len(stamps) // PLANAR_LOOKS + 1] if len(stamps) else [0.0]
    tilts, heights = [], []
    for stamp in looked_at:
        try:
            pose = place.tree.pose_at(place.fixed_frame, place.frame, stamp)
        except NoPose:
            continue
        tilts.append(np.arccos(min(abs(pose.rotation[2, 2]), 1.0)))
        heights.append(pose.position[2])
    if not heights:
        return True
    usual, most = np.percentile(tilts, (50, 95))
    low, high = np.percentile(heights, (2.5, 97.5))
    return bool(usual <= PLANAR_TILT and most <= PLANAR_MOST_TILT and high - low <= PLANAR_HEIGHT)
