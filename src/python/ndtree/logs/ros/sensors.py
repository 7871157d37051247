# SPDX-License-Identifier: BSD-3-Clause
"""Which topics of a bag are mapped, how the messages of each become beams, and what their times mean."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Collection, Iterator
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from ndtree._errors import WrongValue, key
from ndtree.logs.core.source import WrongOption
from ndtree.logs.folders.depth_image import Camera, camera_of
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.clock import Clock
from ndtree.logs.ros.files.bag import Bag, Topic
from ndtree.logs.ros.messages import image
from ndtree.logs.ros.messages.beams import (
    IMAGES,
    LASER,
    MULTI_ECHO_LASER,
    PACKED_CLOUD,
    PLANAR,
    POINT_CLOUD,
    RANGE,
    SENSOR_NAMES,
    SENSORS,
    Beams,
    short,
    stamp_of,
)
from ndtree.logs.ros.messages.cloud import cloud_beams
from ndtree.logs.ros.messages.foxglove import head_of
from ndtree.logs.ros.messages.laser import laser_beams, multi_echo_beams, range_beams
from ndtree.logs.ros.messages.own import point_beams
from ndtree.logs.ros.messages.sweep import AS_SAID, BY_WORD, GROUP, OFF, Sweep, in_map, sharpest, turning
from ndtree.logs.ros.options import BagOptions, Wanted, instead
from ndtree.logs.ros.placement.placement import STILL, Placement
from ndtree.logs.ros.storage import Raw
from ndtree.logs.ros.survey import Survey

FLOAT = "std_msgs/msg/Float32"
_SENSOR = re.compile(r"/?((device_\d+)/sensor_\d+)/")
_OPTION = re.compile(r"/option/depth[_ ]units/value$", re.IGNORECASE)


def recorded_unit(bag: Bag, topic: str) -> tuple[float, str] | None:
    """How many metres an integer of a depth image is, and the topic that says so.

    The recorder of the RealSense SDK writes the options of each sensor beside its images. That of the same
    sensor counts, else that of the same device. None where it is not stated; ValueError if it is no length.
    """
    own = _SENSOR.match(topic)
    if own is None:
        return None
    options = [one for one in bag.of_type(FLOAT) if _OPTION.search(one.name)]
    for which in (1, 2):
        for one in options:
            found = _SENSOR.match(one.name)
            if found is not None and found[which] == own[which]:
                unit = float(f"{bag.first(one.name).data:.7g}")  # 0.001 is not quite a float32.
                if not 0 < unit < 1:
                    said = f"{one.name}: {unit:g} m, expected the unit of depth images"
                    raise ValueError(f"{bag.path}: {said}, > 0 and < 1 m")
                return unit, one.name
    return None


class Sensor:
    """One topic with measurements.

    `options`: Of them the camera, the pixel stride and the colours.
    `sigma`: Of its ranges [m].
    Attributes:
    `camera_topic`: Where its cameras are from.
    `note`: What was found out of the unit of its depths.
    """

    def __init__(
        self, bag: Bag, topic: Topic, survey: Survey, options: BagOptions, sigma: float | None = None
    ) -> None:
        self.topic, self.sigma = topic, sigma
        self.seen = survey.seen[topic.name]
        self.camera_topic: str | None = None
        self.note = ""
        self._options = options
        self._cameras: tuple[np.ndarray[Any, Any], list[Camera]] | None = None
        if topic.type in IMAGES:
            first = bag.first(topic.name)
            scale = image.scale_of(first)
            is_integer = image.DEPTH_ENCODINGS[image.encoding_of(first)][0] != "f4"
            if is_integer and (recorded := recorded_unit(bag, topic.name)) is not None:
                scale = 1 / recorded[0]
                self.note = f"{topic.name}: depths are in units of {recorded[0]:g} m, as {recorded[1]} says"
            if options.camera is not None:
                self._cameras = np.zeros(1), [camera_of(options.camera, scale=scale)]
            else:
                self.camera_topic, self._cameras = _cameras(bag, survey, topic.name, first, scale)

    @property
    def is_planar(self) -> bool:
        """Whether it measures in one plane."""
        return self.topic.type in PLANAR

    @property
    def description(self) -> str:
        """For reports."""
        return f"{self.topic.name} ({short(self.topic.type)} in {self.seen.frame or 'no frame'})"

    def own_messages(self, bag: Bag) -> Iterator[Raw]:
        """Those that are not another sensor's in the same topic, up to where the bag is damaged."""
        for raw in bag.messages([self.topic.name], on_damage=lambda error: None):
            head = head_of(raw)
            if head is not None and head[1] == self.seen.frame:
                yield raw

    def beams(
        self, message: Any, stamp: float, no_return_range: float | None = None, **of_laser: Any
    ) -> Beams:
        """What a message measured; ValueError if it contradicts itself.

        `no_return_range` is up to where a beam without return is free if the message does not say [m];
        `of_laser`, what `laser_beams` takes beside.
        """
        if self.topic.type in (POINT_CLOUD, PACKED_CLOUD):
            return cloud_beams(message, stamp, colored=self._options.colors)
        if self._cameras is None:
            return beams_of(self.topic.type, message, stamp, no_return_range, **of_laser)
        stamps, cameras = self._cameras
        camera = cameras[int(np.abs(stamps - stamp).argmin())]
        return image.depth_beams(message, camera, self._options.pixel_stride)


def beams_of(kind: str, message: Any, stamp: float, no_return_range: float | None, **of_laser: Any) -> Beams:
    """What a message of a type measured that is no image, as of `Sensor.beams`."""
    if kind == LASER:
        return laser_beams(message, no_return_range, **of_laser)
    if kind in (MULTI_ECHO_LASER, RANGE):
        return (range_beams if kind == RANGE else multi_echo_beams)(message, no_return_range)
    if kind in (POINT_CLOUD, PACKED_CLOUD):
        return cloud_beams(message, stamp)
    return point_beams(message)


def readable(bag: Bag) -> list[Topic]:
    """Topics with measurements, the default one first.

    By type: lasers, clouds, depth images, single ranges. Of one type the one whose name has the fewest parts,
    and then by the alphabet.
    """
    topics = [
        one
        for one in bag.of_type(*SENSORS)
        if one.type not in IMAGES or image.encoding_of(bag.first(one.name)) in image.DEPTH_ENCODINGS
    ]
    return sorted(topics, key=lambda one: (SENSORS.index(one.type), plain(one.name).count("/"), one.name))


def encodings_in(bag: Bag) -> dict[str, str]:
    """How the pixels of each topic with images are encoded, by the first message that is whole."""
    found = {}
    for topic in bag.of_type(*IMAGES):
        try:
            found[topic.name] = image.encoding_of(bag.first(topic.name))
        except ValueError:
            continue
    return found


def chosen(bag: Bag, wanted: list[Wanted]) -> list[Topic]:
    """The topics that were asked for."""
    found = []
    for one in wanted:
        topic = bag.topic(one.name)
        if topic is None:
            raise ValueError(f"{bag.path}: no topic {one.name}, {instead(bag.of_type(*SENSORS))}")
        if topic.type not in SENSORS:
            raise ValueError(f"{bag.path}: {topic.name} is of type {topic.type}, expected {SENSOR_NAMES}")
        if not topic.messages:
            raise ValueError(f"{bag.path}: {topic.name}: no message, expected at least one")
        if topic in found:
            raise WrongOption(f"{bag.path}: topic {one.name}: is there twice")
        found.append(topic)
    return found


def _cameras(
    bag: Bag, survey: Survey, topic: str, first: Any, scale: float
) -> tuple[str, tuple[np.ndarray[Any, Any], list[Camera]]]:
    """The topic with an image's cameras, and stamps and cameras in it."""
    frame = plain(first.header.frame_id)
    size = image.size_of(first)
    by_topic: dict[str, tuple[list[float], list[Camera]]] = {}
    wrong = ""
    for name, infos in survey.infos.items():
        for stamp, message in infos:
            is_alike = (message.width, message.height) == size
            if is_alike and (image.is_beside(name, topic) or plain(message.header.frame_id) == frame):
                try:
                    camera = image.camera_of_info(message, scale)
                except ValueError as error:  # As of uncalibrated cameras.
                    wrong = f"; of {name}: {error}"
                    continue
                stamps, cameras = by_topic.setdefault(name, ([], []))
                stamps.append(stamp)
                cameras.append(camera)
    if not by_topic:
        found = ", ".join(survey.infos) or "none"
        raise WrongValue(
            f"{bag.path}: no CameraInfo of {size[0]} x {size[1]} pixels beside {topic} or in frame "
            f"{frame}, expected one, or {key('camera')} fx,fy,cx,cy; found {found}{wrong}"
        )
    best = min(by_topic, key=lambda name: (not image.is_beside(name, topic), name))
    return best, (np.array(by_topic[best][0]), by_topic[best][1])


#: LOOKS messages of each topic are looked at, every EVERY-th if there are enough.
LOOKS, EVERY = 8, 5
#: Beams without return look somewhere, too: how far [m] does not matter here.
SOME_RANGE = 1.0
#: Edge of a direction's cell [rad]; beams in one cell see the same.
STEP = np.radians(1.0)
#: In a plane there are far fewer directions than in space, and its map needs no more.
PLANAR_WEIGHT = 20.0
#: A whole depth image has about this many directions, of 60 by 45 degrees.
IMAGE_DIRECTIONS = 2700
#: A sensor that sees so much less than the best is poor.
POOR = 0.1


def sights(bag: Bag, topics: list[Topic]) -> dict[str, float]:
    """How much each topic with measurements tells of the world around it.

    That is the number of directions in which a message measured, in the mean of some, times the messages
    in a second, and for sensors that measure in one plane times 20. A radar's targets are few, and a sonar
    has one direction.
    """
    span = max(bag.end - bag.start, 1e-3)
    return {one.name: _directions(bag, one) * one.messages / span for one in topics}


def poor(sights: dict[str, float]) -> set[str]:
    """Topics that see less than a tenth of what the best one does."""
    best = max(sights.values(), default=0.0)
    return {name for name, sight in sights.items() if sight < POOR * best}


def in_order(topics: list[Topic], sights: dict[str, float]) -> list[Topic]:
    """Topics in the order in which they are tried: as given, the poor ones last, the best of these first."""
    behind = poor(sights)
    good = [one for one in topics if one.name not in behind]
    return good + sorted((one for one in topics if one.name in behind), key=lambda one: -sights[one.name])


def _directions(bag: Bag, topic: Topic) -> float:
    """In how many directions a message of a topic measures, in the mean of some that are whole."""
    counts = []
    every = min(max(topic.messages // LOOKS, 1), EVERY)
    messages = bag.messages([topic.name], on_damage=lambda error: None)
    for raw in islice(messages, 0, LOOKS * every, every):
        try:
            message = bag.decoded(raw)
            if topic.type in IMAGES:
                counts.append(IMAGE_DIRECTIONS * float(np.mean(np.nan_to_num(image.depth_of(message)) > 0)))
            else:
                points = np.asarray(beams_of(topic.type, message, 0.0, SOME_RANGE).points, dtype=np.float64)
                x, y, z = points[np.isfinite(points).all(axis=1)].T
                turn, rise = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
                counts.append(float(len(np.unique(np.stack([turn, rise]) // STEP, axis=1).T)))
        except (ValueError, ImportError):
            continue
    return float(np.mean(counts)) * (PLANAR_WEIGHT if topic.type in PLANAR else 1.0) if counts else 0.0


#: A sweep that lasts so much longer than the time from scan to scan is none.
LONGER_THAN_INTERVAL = 1.2
#: The length of a sweep is taken from this many messages of a topic.
FIRST_MESSAGES = 20


def understood(
    bag: Bag,
    sensors: list[Sensor],
    places: dict[str, Placement],
    clock: Clock,
    options: BagOptions,
    *,
    so_far: bool = False,
) -> tuple[dict[str, Sweep], list[str], Sweep | None]:
    """What the times of each sensor's beams mean, a line for each that is not what its messages say, and what
    scans have shown of all.

    Times by which a scan would last longer than it takes until the next are none. Of the others a sample of
    scans decides in which the sensor turns, see `ndtree.logs.ros.messages.sweep.sharpest`. A user's word of
    `BY_WORD` overrules both. If the bag is what a robot has measured `so_far`, a sensor that stands may move
    later.
    """
    sweeps: dict[str, Sweep] = {}
    shown: list[Sweep] = []
    deskew, word = options.deskew, options.sweep
    lines: list[str] = []
    for sensor in sensors:
        name = sensor.topic.name
        place = places[name]
        sweeps[name] = (AS_SAID if word is None else BY_WORD[word]) if deskew else OFF
        if not deskew or word is not None or sensor.topic.type in IMAGES:
            continue
        may_move = so_far and place.origin != STILL
        # Of a sensor that stands it does not matter when a beam was measured.
        if (place.stands and not may_move) or place.observer is not None:
            sweeps[name] = OFF
            continue
        lasts, is_guess = _duration(bag, sensor, clock)
        if not lasts:
            continue
        base = OFF if is_guess else AS_SAID
        sweeps[name] = base
        if sensor.seen.interval and lasts > LONGER_THAN_INTERVAL * sensor.seen.interval:
            sweeps[name] = OFF
            said = f"its beams would take {lasts:.3f} s, but a scan comes every {sensor.seen.interval:.3f} s"
            lines.append(f"{name}: {said}: their times are not used")
            continue
        stamps = np.array(sensor.seen.own_stamps)
        frames = place.tree, place.fixed_frame, place.frame
        groups = _groups(bag, sensor, turning(*frames, stamps, lasts), clock, options.time_offset)
        if groups:
            sweeps[name], gain = sharpest(partial(in_map, *frames), groups, base)
            sweep = sweeps[name]
            shown.append(sweep)
            if sweep is not base:
                said = "scans agree better this way than as their messages say"
                lines.append(f"{name}: {sweep.name}; {said} ({100 * (1 - gain):.0f} % fewer cells)")
    return sweeps, lines, shown[0] if len(set(shown)) == 1 and len(shown) == len(sensors) else None


def _duration(bag: Bag, sensor: Sensor, clock: Clock) -> tuple[float, bool]:
    """How long the beams of the first message take that has times for them [s]; whether it is a guess.

    0 where none of the first messages has.
    """
    for _, beams, _ in _measured(bag, sensor, clock, range(FIRST_MESSAGES)):
        if beams.times is not None and len(beams.times) > 1:
            return float(np.ptp(beams.times)), beams.is_guess
    return 0.0, False


def _groups(
    bag: Bag, sensor: Sensor, starts: list[int], clock: Clock, time_offset: float
) -> list[list[tuple[Beams, float]]]:
    """Scans that follow each other from some numbers on."""
    groups: dict[int, list[tuple[Beams, float]]] = {start: [] for start in starts}
    wanted = {start + i: start for start in starts for i in range(GROUP)}
    for number, beams, stamp in _measured(bag, sensor, clock, wanted):
        groups[wanted[number]].append((beams, stamp + time_offset))
    return [group for group in groups.values() if len(group) > 1]


def _measured(
    bag: Bag, sensor: Sensor, clock: Clock, wanted: Collection[int]
) -> Iterator[tuple[int, Beams, float]]:
    """Of messages with some numbers that can be read: the number, the beams, and their time [s]."""
    stream = (sensor.topic.name, sensor.seen.frame)
    for number, raw in enumerate(islice(sensor.own_messages(bag), max(wanted, default=-1) + 1)):
        if number in wanted:
            with contextlib.suppress(ValueError):
                message, received = bag.decoded(raw), 1e-9 * raw.received
                stamp = clock.stamp(stream, received, stamp_of(message))
                yield number, sensor.beams(message, stamp), clock.time(stream, received, stamp)
