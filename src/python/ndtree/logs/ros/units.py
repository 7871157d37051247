# SPDX-License-Identifier: BSD-3-Clause
"""The unit of depth images that a RealSense recorded: its option Depth_Units, where the bag has it."""

from __future__ import annotations

import math
import re

from ndtree.logs.ros.files.bag import Bag

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
