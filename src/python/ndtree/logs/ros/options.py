# SPDX-License-Identifier: BSD-3-Clause
"""What a user said of a bag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ndtree._errors import key
from ndtree.base.options import option
from ndtree.logs.core.failures import some_of
from ndtree.logs.core.source import WrongOption, require_one
from ndtree.logs.ros.files.bag import Bag, Topic
from ndtree.logs.ros.messages.beams import IMAGES, short
from ndtree.logs.ros.survey import ODOMETRY, POSE_NAMES, POSES


@dataclass(frozen=True)
class Wanted:
    """A topic that a user asked for, and the standard deviation of its ranges [m] if they said."""

    name: str
    sigma: float | None = None

    @staticmethod
    def of(text: str) -> Wanted:
        """From ``"/scan"`` or ``"/scan@0.02"``."""
        name, at, number = text.partition("@")
        if not at:
            return Wanted(name)
        try:
            sigma = float(number)
        except ValueError:
            sigma = -1.0
        if not 0 < sigma < np.inf:
            raise WrongOption(f"topic {text}: expected a standard deviation in metres > 0 behind the @")
        return Wanted(name, sigma)


def listed(topics: list[Topic]) -> str:
    """Topics for errors."""
    return some_of([f"{topic.name} ({short(topic.type)})" for topic in topics], 12)


def instead(topics: list[Topic]) -> str:
    """What was expected instead of a topic that is wrong."""
    return f"expected one of {listed(topics)}" if topics else "expected another bag: this has none"


@dataclass(frozen=True)
class BagOptions:
    """The options of the format, as of `ndtree.logs.ros.rosbag`; None where nothing was said."""

    topic: str | Sequence[str] | None = None
    fixed_frame: str | None = None
    odometry: str | None = None
    poses: str | None = None
    trajectory: str | None = None
    still: bool = False
    mount: str | None = None
    sensor_frame: str | None = None
    base_frame: str | None = None
    time_offset: float = 0.0
    deskew: bool = True
    sweep: str | None = None
    camera: str | None = None
    pixel_stride: int = 1
    zero_is: str | None = None
    body: str | None = None
    pose_covariance: str | None = None
    colors: bool = False

    @property
    def wanted(self) -> list[Wanted]:
        """The sensors that were named."""
        return [Wanted.of(one) for one in ([self.topic] if isinstance(self.topic, str) else self.topic or [])]

    def check(self, path: str) -> None:
        """Refuse what makes no sense for any bag; raises WrongValue or WrongOption."""
        ways = ("fixed_frame", "odometry", "poses", "trajectory")
        given = [name for name in ways if getattr(self, name) is not None]
        given += ["still"] if self.still and given != ["fixed_frame"] else []
        require_one(path, given)
        for one in fields(self):
            value = getattr(self, one.name)
            if value is not None:
                option(one.name).require(value)
        if self.sweep is not None and not self.deskew:
            raise WrongOption(f"{path}: {key('sweep')} = {self.sweep}: is for beams that are deskewed")

    def check_topics(self, path: str, topics: list[Topic]) -> None:
        """Refuse what makes no sense for some sensors; raises WrongOption."""
        names = ", ".join(one.name for one in topics)
        if self.camera is not None and not any(one.type in IMAGES for one in topics):
            raise WrongOption(f"{path}: {key('camera')}: {names} has no depth images")
        if len(self.wanted) > 1 and (self.mount is not None or self.sensor_frame is not None):
            what = "mount" if self.mount is not None else "sensor_frame"
            raise WrongOption(f"{path}: {key(what)}: is of one sensor, and there are {len(topics)}: {names}")

    def with_poses_of(self, bag: Bag) -> BagOptions:
        """With the topic that was asked for as `poses`, also of odometry; ValueError if there is none."""
        wanted, types = (self.odometry, (ODOMETRY,)) if self.odometry is not None else (self.poses, POSES)
        if wanted is None:
            return self
        topic = bag.topic(wanted)
        if topic is None or topic.type not in types or not topic.messages:
            what = "Odometry" if self.odometry is not None else f"poses ({POSE_NAMES})"
            raise ValueError(f"{bag.path}: no {what} in {wanted}, {instead(bag.of_type(*types))}")
        return replace(self, poses=topic.name)
