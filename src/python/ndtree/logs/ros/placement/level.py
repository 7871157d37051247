# SPDX-License-Identifier: BSD-3-Clause
"""Whether sensors make a map of a plane or of space."""

from __future__ import annotations

import numpy as np

from ndtree._errors import WrongValue, key
from ndtree.logs.core.failures import NoPose
from ndtree.logs.ros.placement.placement import Placement
from ndtree.logs.ros.sensors import Sensor

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
