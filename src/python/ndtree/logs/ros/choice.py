# SPDX-License-Identifier: BSD-3-Clause
"""Which of several sensors makes a map, if none is named: how much of the world each sees in a second."""

from __future__ import annotations

from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.ros.files.bag import Bag, Topic
from ndtree.logs.ros.messages import image
from ndtree.logs.ros.messages.beams import IMAGES, PLANAR, Beams
from ndtree.logs.ros.sensors import beams_of

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
                counts.append(float(_cells(beams_of(topic.type, message, 0.0, SOME_RANGE))))
        except (ValueError, ImportError):
            continue
    return float(np.mean(counts)) * (PLANAR_WEIGHT if topic.type in PLANAR else 1.0) if counts else 0.0


def _cells(beams: Beams) -> int:
    points: NDArray[np.float64] = np.asarray(beams.points, dtype=np.float64)
    x, y, z = points[np.isfinite(points).all(axis=1)].T
    turn, rise = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    return len(np.unique(np.stack([turn, rise]) // STEP, axis=1).T)
