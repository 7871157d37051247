# SPDX-License-Identifier: BSD-3-Clause
"""Where a sensor sits on its robot, as a user types it."""

from __future__ import annotations

import math

import numpy as np

from ndtree._errors import WrongValue, key
from ndtree.logs.poses.pose import Pose, about_axes

EXPECTED = "expected x,y,z,roll,pitch,yaw or x,y,yaw, lengths in metres, angles in radians or as in 90deg"


def mount_of(text: str) -> Pose:
    """The pose of a sensor on its base.

    `text`: ``"x,y,z,roll,pitch,yaw"``, or in the plane ``"x,y,yaw"``: metres, and radians or degrees with
        "deg" behind the number. As in URDF the sensor is turned about the base's x axis (roll), then about
        its y, then about its z axis.
    Raises ValueError if it is something else. An angle in radians of more than one turn is taken for a
    mistake.
    """
    fields = text.split(",")
    if len(fields) not in (3, 6):
        raise WrongValue(f"{key('mount')} = {text!r}: {len(fields)} numbers, {EXPECTED}")
    lengths = fields[:2] if len(fields) == 3 else fields[:3]
    try:
        position = [float(field) for field in lengths]
        angles = [_angle(field) for field in fields[len(lengths) :]]
    except ValueError:
        raise WrongValue(f"{key('mount')} = {text!r}: {EXPECTED}") from None
    if not all(math.isfinite(value) for value in (*position, *angles)):
        raise WrongValue(f"{key('mount')} = {text!r}: {EXPECTED}, all of them finite")
    if any(abs(angle) > 2 * math.pi + 1e-9 for angle in angles):
        raise WrongValue(f"{key('mount')} = {text!r}: an angle of more than one turn, {EXPECTED}")
    if len(fields) == 3:
        position, angles = [*position, 0.0], [0.0, 0.0, *angles]
    about_x, about_y, about_z = about_axes(*angles)
    return Pose(about_z @ about_y @ about_x, np.array(position))


def _angle(field: str) -> float:
    field = field.strip()
    if field.endswith("deg"):
        return math.radians(float(field[:-3]))
    return float(field)
