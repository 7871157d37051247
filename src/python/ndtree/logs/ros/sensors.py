# SPDX-License-Identifier: BSD-3-Clause
"""Which topics of a bag are mapped, and how the messages of each become beams."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from ndtree._errors import WrongValue, key
from ndtree.logs.core.source import WrongOption
from ndtree.logs.folders.depth_image import Camera, camera_of
from ndtree.logs.poses.transforms import plain
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
)
from ndtree.logs.ros.messages.cloud import cloud_beams
from ndtree.logs.ros.messages.head import head_of
from ndtree.logs.ros.messages.laser import NoiseAtLimit, laser_beams, multi_echo_beams, range_beams
from ndtree.logs.ros.messages.own import point_beams
from ndtree.logs.ros.options import BagOptions, Wanted, listed
from ndtree.logs.ros.storage import Raw
from ndtree.logs.ros.survey import Survey

FLOAT = "std_msgs/msg/Float32"
_SENSOR = re.compile(r"/?((device_\d+)/sensor_\d+)/")
_OPTION = re.compile(r"/option/depth[_ ]units/value$", re.IGNORECASE)


def recorded_unit(bag: Bag, topic: str) -> tuple[float, str] | None:
    """How many metres an integer of a depth image is, and the topic that says so.

    The recorder of the RealSense SDK writes the options of each sensor beside its images. That of the same
    sensor counts, else that of the same device.

    `topic`: With the images.
    Returns (float, str), or None: None where it is not stated.
    Raises ValueError if the option is no length.
    """
    own = _SENSOR.match(topic)
    if own is None:
        return None
    options = [one for one in bag.of_type(FLOAT) if _OPTION.search(one.name)]
    for which in (1, 2):
        for one in options:
            found = _SENSOR.match(one.name)
            if found is not None and found[which] == own[which]:
                return _length(bag, one.name), one.name
    return None


def _length(bag: Bag, topic: str) -> float:
    unit = float(f"{bag.first(topic).data:.7g}")  # A float of 32 bits: 0.001 is not quite that.
    if not (0 < unit < 1 and math.isfinite(unit)):
        raise ValueError(f"{bag.path}: {topic}: {unit:g} m, expected the unit of depth images, > 0 and < 1 m")
    return unit


class Sensor:
    """One topic with measurements.

    `options`: Of them the camera, the pixel stride and the colours.
    `sigma`: Of its ranges [m].
    Attributes:
    `camera_topic`: Where its cameras are from.
    `note`: What was found out of the unit of its depths.
    """

    def __init__(
        self,
        bag: Bag,
        topic: Topic,
        survey: Survey,
        options: BagOptions,
        sigma: float | None = None,
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
            if image.is_integer(first) and (recorded := recorded_unit(bag, topic.name)) is not None:
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
        self,
        message: Any,
        stamp: float,
        no_return_range: float | None = None,
        zero_is_silent: bool = False,
        noise: NoiseAtLimit | None = None,
    ) -> Beams:
        """What a message measured; ValueError if it contradicts itself.

        `no_return_range` is up to where a beam without return is free if the message does not say [m];
        `zero_is_silent`, whether a LaserScan's range of 0 is one; `noise` has seen its earlier messages.
        """
        if self.topic.type in (POINT_CLOUD, PACKED_CLOUD):
            return cloud_beams(message, stamp, colored=self._options.colors)
        if self._cameras is None:
            return beams_of(self.topic.type, message, stamp, no_return_range, zero_is_silent, noise)
        stamps, cameras = self._cameras
        camera = cameras[int(np.abs(stamps - stamp).argmin())]
        return image.depth_beams(message, camera, self._options.pixel_stride)


def beams_of(
    kind: str,
    message: Any,
    stamp: float,
    no_return_range: float | None,
    zero_is_silent: bool = False,
    noise: NoiseAtLimit | None = None,
) -> Beams:
    """What a message of a type measured that is no image, as of `Sensor.beams`."""
    if kind == LASER:
        return laser_beams(message, no_return_range, zero_is_silent, noise)
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
        topic
        for topic in bag.of_type(*SENSORS)
        if topic.type not in IMAGES or image.has_depth(bag.first(topic.name))
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
            raise ValueError(
                f"{bag.path}: no topic {one.name}, expected one of {listed(bag.of_type(*SENSORS))}"
            )
        if topic.type not in SENSORS:
            raise ValueError(
                f"{bag.path}: topic {topic.name} is of type {topic.type}, expected {SENSOR_NAMES}"
            )
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
