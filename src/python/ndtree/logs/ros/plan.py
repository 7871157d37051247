# SPDX-License-Identifier: BSD-3-Clause
"""What is decided of a bag before it is read: its sensors, where they are, and what their messages mean."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ndtree._errors import WrongValue, key, marked
from ndtree.logs.core.failures import NoPose
from ndtree.logs.core.rules import MEASURED, Decision
from ndtree.logs.core.source import WrongOption
from ndtree.logs.poses.covariances import AUTO, IGNORE, REMEMBERED, USE, PoseCovariances
from ndtree.logs.ros.clock import Clock
from ndtree.logs.ros.files.bag import Bag, Topic
from ndtree.logs.ros.messages.beams import short
from ndtree.logs.ros.messages.sweep import BY_WORD, Sweep
from ndtree.logs.ros.options import BagOptions, Wanted, listed
from ndtree.logs.ros.placement.body import Body
from ndtree.logs.ros.placement.placement import TRANSFORMS, Finder, Placement, without_sensors
from ndtree.logs.ros.sensors import Sensor, chosen, encodings_in, poor, readable, sights, understood
from ndtree.logs.ros.sensors import in_order as in_order_of_sight
from ndtree.logs.ros.survey import ODOMETRY, POSES, Survey

#: Stamps and poses that are further apart are of two clocks [s].
TWO_CLOCKS = 1.0


@dataclass(frozen=True)
class BagPlan:
    """All that a reader of a bag's messages obeys; what goes by topic has its name as the key.

    `body`, `bodies`: The robot's, whose beams are left out, and the frame that it is in.
    `damaged`, `damage`: An error for each message with poses that is not whole, and why files were read
        without their index.
    `decisions`: The options by which the next bag of the robot is read alike.
    """

    options: BagOptions
    sensors: list[Sensor]
    places: dict[str, Placement]  # How poses are found.
    sweeps: dict[str, Sweep]  # What the times of beams mean.
    clock: Clock
    covariances: PoseCovariances  # Of the topic of the first sensor's poses.
    elsewhere: dict[str, list[str]]  # Frames of messages without a known place.
    dim: int
    body: Body | None
    bodies: dict[str, str]
    damaged: list[ValueError]
    damage: list[str]
    notes: list[str]
    spans: dict[str, tuple[float, float]]  # Of all scans, and of the first sensor's poses unless it stands.
    hint: str  # What may help where no scan has a pose.
    decisions: dict[str, Decision] = field(default_factory=dict)

    @property
    def place(self) -> Placement:
        """How the first sensor's poses are found."""
        return self.places[self.sensors[0].topic.name]


def planned(bag: Bag, options: BagOptions, dim: int | None, *, so_far: bool, in_memory: bool) -> BagPlan:
    """Look at a bag once, and decide how it is read; where `so_far`, more of its messages may follow."""
    try:
        body = None if options.body is None else Body.of(options.body)
    except ValueError as error:
        raise WrongOption(f"{bag.path}: {marked(error)}") from None
    wanted = options.wanted
    topics = chosen(bag, wanted) if wanted else readable(bag)
    seen = sights(bag, topics) if not wanted and len(topics) > 1 else {}
    topics = in_order_of_sight(topics, seen) if seen else topics
    if not topics:
        raise WrongValue(without_sensors(bag, encodings_in(bag)))
    options.check_topics(bag.path, topics)
    found = _Placer(bag, topics, options.with_poses_of(bag), None if wanted else poor(seen))
    survey, places = found.survey, found.places
    used = [one for one in topics if one.name in places]
    wanted = wanted or [Wanted(one.name) for one in used]
    sensors = [Sensor(bag, one, survey, options, want.sigma) for one, want in zip(used, wanted)]
    sweeps, said, shown = understood(bag, sensors, places, survey.clock, options, so_far=so_far)
    place = places[used[0].name]
    dim = dimension_of(bag.path, sensors, places, dim)
    covariances = _covariances(bag.path, place, survey, options.pose_covariance or AUTO, dim, in_memory)
    again = "what follows is mapped as if it came later"
    notes = [f"the clock begins again at {stamp:.3f} s: {again}" for stamp in survey.clock.falls]
    clock = survey.clock
    unstamped = [one for one in used if any(one.name == stream[0] for stream in clock.unstamped)]
    if unstamped:
        notes.append(
            f"stamps of {listed(unstamped)} are 0: messages count as measured when they were recorded"
        )
    notes += found.notes
    left = [one for one in topics if one not in used]
    if left:
        notes.append(f"{key('topic')} would take another sensor than {used[0].name}: {listed(left)}")
    notes += [sensor.note for sensor in sensors if sensor.note]
    notes += dict.fromkeys(said for one in places.values() for said in one.leaps())
    spans = _spans(sensors, place)
    bodies = {name: body.frame_of(one, options.base_frame) for name, one in places.items() if body}
    return BagPlan(
        options=options,
        sensors=sensors,
        places=places,
        sweeps=sweeps,
        clock=survey.clock,
        covariances=covariances,
        elsewhere={one.topic.name: _unplaced(one, places[one.topic.name], options) for one in sensors},
        dim=dim,
        body=body,
        bodies=bodies,
        damaged=survey.damaged,
        damage=bag.damage,
        notes=[*notes, *place.notes, *bag.damage, *said],
        spans=spans,
        hint=_clocks(sensors[0], survey, spans),
        decisions=_decisions(options, wanted, place, shown, covariances),
    )


def _unplaced(sensor: Sensor, place: Placement, options: BagOptions) -> list[str]:
    """Frames of some of a topic's messages without a pose."""
    if options.sensor_frame is not None:  # Whatever the messages say.
        return []
    known = place.tree.connected(place.fixed_frame) if place.is_own else []
    return sorted(sensor.seen.frames.keys() - {sensor.seen.frame} - set(known))


def _covariances(
    path: str, place: Placement, survey: Survey, use: str, dim: int, in_memory: bool
) -> PoseCovariances:
    """Those of the topic that the poses of the first sensor are of."""
    covariances = PoseCovariances(place.origin, use, dim, REMEMBERED if in_memory else None)
    for row in survey.poses:
        covariances.add(row.stamp, row.covariance)
    if use == USE and not covariances.are_used and not in_memory:
        raise WrongOption(
            f"{path}: {key('pose_covariance')} = {use}: the poses of {place.origin} have no covariance, "
            "expected --odometry or --poses with a topic whose poses have some"
        )
    return covariances


def _decisions(
    options: BagOptions,
    wanted: list[Wanted],
    place: Placement,
    shown: Sweep | None,
    covariances: PoseCovariances,
) -> dict[str, Decision]:
    """What was found, as a user would say it."""
    found: dict[str, Decision] = {}
    if options.topic is None:
        found["topic"] = Decision([one.name for one in wanted], MEASURED, "sees most of the world")
    if options.still or options.trajectory is not None or options.poses is not None:
        pass
    elif place.origin == TRANSFORMS and options.fixed_frame is None:
        found["fixed_frame"] = Decision(place.fixed_frame, MEASURED, "/tf has poses in it for most scans")
    elif place.origin != TRANSFORMS and options.odometry is None:
        found["odometry"] = Decision(place.origin, MEASURED, "/tf does not say where the sensor is")
    if place.origin == TRANSFORMS and place.observer is not None and options.base_frame is None:
        found["base_frame"] = Decision(place.observer, MEASURED, "points are in a fixed frame already")
    if shown is not None:
        word = next(word for word, sweep in BY_WORD.items() if sweep == shown)
        found["sweep"] = Decision(word, MEASURED, "so scans agree best")
    if covariances.told and options.pose_covariance is None:
        use = USE if covariances.are_used else IGNORE
        found["pose_covariance"] = Decision(use, MEASURED, "whether they change and fall")
    return found


def _spans(sensors: list[Sensor], place: Placement) -> dict[str, tuple[float, float]]:
    stamps = [stamp for sensor in sensors for stamp in sensor.seen.own_stamps]
    spans = {"scans": (min(stamps), max(stamps))} if stamps else {}
    first, last = place.tree.span(place.fixed_frame, place.observer or place.frame)
    return {**spans, "poses": (first, last)} if np.isfinite(first) else spans


def _clocks(sensor: Sensor, survey: Survey, spans: dict[str, tuple[float, float]]) -> str:
    """What to say where scans and poses have no time in common, though they were recorded together."""
    scans, poses = spans.get("scans"), spans.get("poses")
    if scans is None or poses is None or not sensor.seen.lags or not survey.lags:
        return ""
    apart = float(np.median(sensor.seen.lags) - np.median(survey.lags))
    if (scans[0] <= poses[1] and poses[0] <= scans[1]) or abs(apart) < TWO_CLOCKS:
        return ""
    way = f"{key('time_offset')} {apart:.3f}"
    return f"their stamps are of two clocks, which the times of recording bring together by {way}"


class _Placer:
    """Finds where sensors are, of topics of a bag.

    `poor`: Topics that make no map beside the others: none replaces a better one whose place is not known.
        None: all topics are wanted, else the first with a known place.
    Attributes:
    `survey`, `places`, `notes`: What was found: where places are from, places by topic, and what was taken
        for granted.
    """

    def __init__(self, bag: Bag, topics: list[Topic], asked: BagOptions, poor: set[str] | None) -> None:
        self._bag, self._topics, self._asked, self._poor = bag, topics, asked, poor
        self._others = {one.name: short(one.type) for one in bag.of_type(*POSES)}
        self.notes: list[str] = []
        self.survey = self._surveyed(asked.poses)
        self.places = self._placed()

    def _surveyed(self, poses: str | None) -> Survey:
        return Survey(self._bag, [one.name for one in self._topics], poses, self._asked.time_offset)

    def _placed(self) -> dict[str, Placement]:
        """Places of all sensors, or of one; ValueError if it is not known, of the first.

        Where nothing was said of poses and the transforms do not tell, a topic with Odometry counts if its
        messages name a frame, and the sensor is connected with that.
        """
        asked, survey = self._asked, self.survey
        try:
            return self._first(survey, asked)
        except ValueError as error:
            wrong = error
        sources = self._bag.of_type(ODOMETRY)
        if asked.still or asked.poses or asked.trajectory or asked.fixed_frame:
            sources = []
        for source in sources:
            self.survey = self._surveyed(source.name)
            if not (self.survey.poses and (self.survey.poses[0].child or asked.mount)):
                continue
            try:
                found = self._first(self.survey, replace(asked, poses=source.name))
            except ValueError:
                continue
            left = [one for one in sources if one is not source]
            note = f"/tf does not say where the sensor is: poses are those of {key('odometry')} {source.name}"
            self.notes.append(note + (f"; others are {listed(left)}" if left else ""))
            return found
        if unread := [*survey.ends, *survey.damaged]:
            raise ValueError(f"{wrong}\nnot all of the bag could be read: {unread[0]}")
        raise wrong

    def _first(self, survey: Survey, asked: BagOptions) -> dict[str, Placement]:
        if self._poor is None:
            return self._together(survey, self._topics, asked)
        wrong: ValueError | None = None
        registered: list[tuple[int, dict[str, Placement]]] = []
        for topic in self._topics:
            try:
                places = self._together(survey, [topic], asked)
            except ValueError as error:
                wrong = wrong or error
                continue
            if places[topic.name].observer is None:
                if wrong is not None and topic.name in self._poor:
                    raise WrongValue(f"{marked(wrong)}\n  {key('topic')} {topic.name}, which sees far less")
                return places
            registered.append((topic.messages, places))
        if registered:  # Of clouds in a fixed frame the rare ones are whole maps.
            return max(registered, key=lambda one: one[0])[1]
        assert wrong is not None
        raise wrong

    def _together(self, survey: Survey, topics: list[Topic], asked: BagOptions) -> dict[str, Placement]:
        """Where some sensors are, all of them in the frame of the first."""
        places: dict[str, Placement] = {}
        for topic in topics:
            places[topic.name] = Finder(self._bag.path, survey, topic, asked, self._others).placement()
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
