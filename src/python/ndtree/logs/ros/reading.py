# SPDX-License-Identifier: BSD-3-Clause
"""One message after the other to a scan in the map, of a recording and of a robot that drives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import itemgetter

import numpy as np

from ndtree._errors import key, located
from ndtree.base.scan import COLOR, Scan
from ndtree.base.words import number_of
from ndtree.logs.core.arrays import Points
from ndtree.logs.core.failures import NoPose
from ndtree.logs.core.rules import NO_ECHO, Rules
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.files.bag import Bag
from ndtree.logs.ros.messages.beams import IMAGES, SENSELESS, SENSOR_NAMES, SENSORS, Beams, Floats, stamp_of
from ndtree.logs.ros.messages.laser import NoiseAtLimit
from ndtree.logs.ros.placement.placement import Placement
from ndtree.logs.ros.placement.standing import Standing
from ndtree.logs.ros.plan import BagPlan
from ndtree.logs.ros.storage import Raw

_LEAST_WAY = 0.1  # Of beams that tell how a sensor is turned [m].
_TURNED_ALIKE = 0.3  # Beams of one message, at most apart [rad].
#: More than a robot turns during a scan [rad], and what that says.
_SPUN, _SPINS = 1.0, "poses turn the sensor during a scan as does not fit a robot (are turns in degrees?)"
_MOST_TURNED, _LEAST_SPREAD = 64, 1e-3  # Beams that tell of space; of their ways across each other.


class OtherFrame(ValueError):
    """A message is in a frame without a known place; what is said of all such messages of its topic."""

    def __init__(self, message: str, of_all: str) -> None:
        super().__init__(message)
        self.of_all = of_all


@dataclass(frozen=True)
class Measured:
    """What one message measured, before its pose is asked for."""

    topic: str
    number: int  # Of the message among those of its topic, from 0.
    frame: str  # In which the beams are.
    stamp: float  # By the poses' clock, without the offset of the scans' [s].
    beams: Beams  # In the sensor's frame, each with the time that counts.
    where: str  # How errors call the message.


class MessageReader:
    """Makes scans of the messages of some sensors, in the order in which they come.

    `bag`: That decodes them.
    Attributes:
    `zeros`: Beams with a range of 0.
    """

    def __init__(self, bag: Bag, plan: BagPlan, rules: Rules) -> None:
        self._bag, self._plan, self._rules = bag, plan, rules
        self._places, self._clock = plan.places, plan.clock
        self._time_offset = plan.options.time_offset
        self._sensors = {sensor.topic.name: sensor for sensor in plan.sensors}
        self._numbers = dict.fromkeys(self._sensors, -1)
        self._endless = self.zeros = self._own = 0
        self._told: dict[tuple[str, str], tuple[int, str]] = {}
        self._noise = {name: NoiseAtLimit() for name in self._sensors}
        self._watched = {
            name: Standing(sensor.is_planar)
            for name, sensor in self._sensors.items()
            if self._places[name].stands and not rules.poses_are_found
        }

    def pass_over(self, raw: Raw) -> None:
        """Count a message that is not decoded."""
        self._numbers[raw.connection.topic] += 1

    def measured(self, raw: Raw) -> Measured:
        """What a message measured.

        Raises OtherFrame if it is in a frame without a known place; ValueError if it is damaged.
        """
        name = raw.connection.topic
        sensor, place = self._sensors[name], self._places[name]
        self._numbers[name] += 1
        where = f"{self._bag.path}: {name}: message {self._numbers[name]}"
        try:
            if raw.connection.type not in SENSORS:
                raise ValueError(f"is of type {raw.connection.type}, expected {SENSOR_NAMES}")
            message = self._bag.decoded(raw)
            own = plain(message.header.frame_id)
            stamp = self._clock.stamp((name, own), 1e-9 * raw.received, stamp_of(message))
            of_laser = {"zero_is_silent": self._rules.zero_is == NO_ECHO, "noise": self._noise[name]}
            beams = sensor.beams(message, stamp, self._rules.no_return_range, **of_laser)
            beams = self._plan.sweeps[name].applied(beams)
        except ValueError as error:
            raise located(where, error) from None
        if own in (others := self._plan.elsewhere[name]):
            count = sum(sensor.seen.frames[frame] for frame in others)
            said = f"{count} of {sensor.topic.messages} messages of {name} are left out: they are in"
            said = f"{said} {', '.join(others) or 'no frame'}, and nothing says where that is"
            raise OtherFrame(f"{where}: is in {own}, expected {sensor.seen.frame}", said)
        frame = own if place.is_own else place.frame
        stamp = self._clock.time((name, own), 1e-9 * raw.received, stamp)
        return Measured(name, self._numbers[name], frame, stamp, beams, where)

    def span_of(self, one: Measured) -> tuple[float, float]:
        """First and last time at which the pose of a message's sensor is needed [s]."""
        stamp, times = one.stamp + self._time_offset, one.beams.times
        if self._places[one.topic].observer is not None or times is None or not len(times):
            return stamp, stamp
        return stamp + float(times.min()), stamp + float(times.max())

    def frames_of(self, one: Measured) -> tuple[Placement, str, float]:
        """How the pose of a message's sensor is found: its frame, and the time [s]."""
        place = self._places[one.topic]
        return place, place.observer or one.frame, one.stamp + self._time_offset

    def scan(self, one: Measured) -> Scan:
        """A message's beams in the map; raises `NoPose` where the pose at its time is not known."""
        place, beams, own = self._places[one.topic], one.beams, 0
        try:
            if self._plan.body is not None:
                where = (one.frame, self._plan.bodies[one.topic], one.stamp + self._time_offset)
                beams, own = self._plan.body.left_out(beams, place, *where)
            ends, origins = place.in_map(one.frame, beams, one.stamp + self._time_offset)
        except NoPose as error:
            raise NoPose(f"{one.where}: {error}", error.where, error.seconds) from None
        self._endless += beams.endless
        self._own += own
        for what, said in beams.odd.items():
            if said and (what != SENSELESS or (self._plan.sweeps[one.topic].is_used and not place.stands)):
                self._tell(one, what, said)
        self.zeros += beams.zeros
        if one.topic in self._watched:
            if place.stands:
                self._watched[one.topic].add(beams)
            else:  # It stood only so far.
                del self._watched[one.topic]
        sigma = self._sensors[one.topic].sigma
        sigmas = None if sigma is None else np.full(len(ends), sigma)
        dim = self._plan.dim
        turned = (beams.points, ends, origins) if place.observer is None else None
        heading = heading_of(*turned) if turned and dim == 2 else None
        if turned and dim == 2 and heading is None and origins.ndim == 2:
            turn = turn_during(*turned)
            if turn > _SPUN:
                self._tell(one, _SPINS, f"{math.degrees(turn):.0f} degrees")
        return Scan(
            ends[:, :dim],
            origins[..., :dim],
            beams.returned,
            one.stamp,
            sigmas,
            heading=heading,
            pose_covariance=self._covariance(place, one, origins),
            layers=None if beams.colors is None else {COLOR: beams.colors},
            rotation=rotation_of(*turned) if turned and dim == 3 else None,
            by_depth=self._sensors[one.topic].topic.type in IMAGES,
        )

    def _covariance(self, place: Placement, one: Measured, origins: Floats) -> Floats | None:
        """How sure the pose of a message's sensor is, where poses tell."""
        covariances = self._plan.covariances
        if place.origin != covariances.topic or not len(origins):
            return None
        stamp = one.stamp + self._time_offset
        moving = place.tree.moving(place.fixed_frame, place.observer or one.frame)
        if not moving:
            return None
        body = place.tree.pose_at(place.fixed_frame, moving[-1][1], stamp).position
        return covariances.at(stamp, np.atleast_2d(origins).mean(axis=0) - body)

    def _tell(self, one: Measured, what: str, said: str) -> None:
        """Count messages of a topic in which something is wrong that they are mapped in spite of."""
        count, first = self._told.get((one.topic, what), (0, f"message {one.number}: {said}"))
        self._told[one.topic, what] = count + 1, first

    def notes(self) -> list[str]:
        """What was seen so far that a user should know, a line each."""
        lines: list[str] = []
        if self._endless:
            lines.append(
                f"{number_of(self._endless, 'beam')} met nothing, but range_max is infinite or not given, "
                f"which says nothing; with {key('max_range')}, space up to there is free"
            )
        if self._own:
            lines.append(f"{number_of(self._own, 'beam')} ended in the robot's own body: left out")
        for name, noise in self._noise.items():
            if noise.reach:
                said = f"readings within {noise.reach:.2g} m of range_max mean that nothing was hit"
                lines.append(f"{name}: {said}")
        for (name, what), (count, first) in self._told.items():
            some = f"{name}: in {count} of {self._numbers[name] + 1} messages"
            lines.append(f"{some} {what}; the first: {first}")
        said = self._plan.covariances.note()
        lines += [said] if said else []
        for name, standing in self._watched.items():
            warning = standing.warning(name, self._places[name])
            if warning is not None:
                lines.append(warning)
        return lines


def heading_of(local: Points, ends: Floats, origins: Floats) -> float | None:
    """Yaw of a sensor's x axis [rad], also upside down; None if not all beams are turned alike.

    `local`, `ends` (n, 3): End points in the sensor's frame and in the map [m]; a sensor that turns fast may
        turn beams apart.
    `origins` (3,) or (n, 3): Of the beams in the map [m].
    """
    ways = ends - origins
    far = np.isfinite(ways).all(axis=1) & (np.hypot(local[:, 0], local[:, 1]) > _LEAST_WAY)
    if not far.any():
        return None
    across, own = (np.arctan2(those[far, 1], those[far, 0]) for those in (ways, local))
    mirrored = _spread(across + own)  # Upside down.
    apart, middle = min(_spread(across - own), mirrored, key=itemgetter(0))
    return middle if apart < _TURNED_ALIKE else None


def _spread(angles: Floats) -> tuple[float, float]:
    """How far the farthest is from the middle of angles, and the middle [rad]."""
    middle = math.atan2(float(np.sin(angles).mean()), float(np.cos(angles).mean()))
    return float(np.abs((angles - middle + math.pi) % (2 * math.pi) - math.pi).max()), middle


def turn_during(local: Points, ends: Floats, origins: Floats) -> float:
    """How far poses turn a planar sensor during a scan [rad], by angles from beam to beam, however it sits.

    Arrays as for `heading_of`.
    """

    def angles(ways: Floats) -> Floats:
        across = np.linalg.norm(np.cross(ways[1:], ways[:-1]), axis=1)
        return np.arctan2(across, (ways[1:] * ways[:-1]).sum(axis=1))

    use = np.isfinite(ends).all(axis=1) & (np.linalg.norm(local, axis=1) > _LEAST_WAY)
    own = local[use].astype(np.float64)
    return float(np.abs(angles(ends[use] - origins[use]) - angles(own)).sum())


def rotation_of(local: Points, ends: Floats, origins: Floats) -> Floats | None:
    """(3, 3) how the beams of a sensor are turned in the map, of arrays as for `heading_of`.

    The rotation that fits some of them best; None if they are in one line, or not all turned alike.
    """
    some = slice(None, None, max(1, len(local) // _MOST_TURNED))
    own = local[some].astype(np.float64)
    ways = ends[some] - (origins if origins.ndim == 1 else origins[some])
    far = np.linalg.norm(own, axis=1)
    use = np.isfinite(far) & np.isfinite(ways).all(axis=1) & (far > 10 * _LEAST_WAY)
    own, ways = own[use] / far[use, None], ways[use] / far[use, None]
    left, sizes, right = np.linalg.svd(ways.T @ own)
    if not len(own) or sizes[1] < _LEAST_SPREAD * len(own):
        return None
    rotation: Floats = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    apart = np.linalg.norm(ways - own @ rotation.T, axis=1)
    return rotation if float(apart.max()) < _TURNED_ALIKE else None
