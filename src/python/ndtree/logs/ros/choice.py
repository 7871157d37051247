# SPDX-License-Identifier: BSD-3-Clause
"""What a bag's messages decide: which of several sensors makes a map, and what the times of beams mean."""

from __future__ import annotations

from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.ros.clock import Clock
from ndtree.logs.ros.files.bag import Bag, Topic
from ndtree.logs.ros.messages import image
from ndtree.logs.ros.messages.beams import IMAGES, PLANAR, Beams, stamp_of
from ndtree.logs.ros.messages.sweep import AS_SAID, BY_WORD, GROUP, OFF, Sweep, sharpest, turning
from ndtree.logs.ros.options import BagOptions
from ndtree.logs.ros.placement.placement import STILL, Placement
from ndtree.logs.ros.sensors import Sensor, beams_of
from ndtree.logs.ros.storage import Raw

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
            lines.append(
                f"{name}: its beams would take {lasts:.3f} s, but a scan comes every "
                f"{sensor.seen.interval:.3f} s: their times are not used"
            )
            continue
        stamps = np.array(sensor.seen.own_stamps)
        starts = turning(place.tree, place.fixed_frame, place.frame, stamps, lasts)
        groups = _groups(bag, sensor, starts, clock, options.time_offset)
        if groups:
            sweep, gain = sharpest(place.tree, place.fixed_frame, place.frame, groups, base)
            sweeps[name] = sweep
            shown.append(sweep)
            if sweep is not base:
                lines.append(
                    f"{name}: {sweep.name}; this way scans agree better than by their messages "
                    f"({100 * (1 - gain):.0f} % fewer cells)"
                )
    return sweeps, lines, shown[0] if len(set(shown)) == 1 and len(shown) == len(sensors) else None


def _duration(bag: Bag, sensor: Sensor, clock: Clock) -> tuple[float, bool]:
    """How long the beams of the first message take that has times for them [s]; whether it is a guess.

    0 where none of the first messages has.
    """
    for raw in islice(sensor.own_messages(bag), FIRST_MESSAGES):
        measured = _measured(bag, sensor, raw, clock)
        if measured is None:
            continue
        beams, _ = measured
        if beams.times is not None and len(beams.times) > 1:
            return float(np.ptp(beams.times)), beams.is_guess
    return 0.0, False


def _measured(bag: Bag, sensor: Sensor, raw: Raw, clock: Clock) -> tuple[Beams, float] | None:
    """A message's beams, and its time as the message says it [s]; None if it cannot be read."""
    stream = (sensor.topic.name, sensor.seen.frame)
    try:
        message = bag.decoded(raw)
        stamp = clock.stamp(stream, 1e-9 * raw.received, stamp_of(message))
        return sensor.beams(message, stamp), stamp
    except ValueError:
        return None


def _groups(
    bag: Bag, sensor: Sensor, starts: list[int], clock: Clock, time_offset: float
) -> list[list[tuple[Beams, float]]]:
    """Scans that follow each other from some numbers on."""
    if not starts:
        return []
    groups: dict[int, list[tuple[Beams, float]]] = {start: [] for start in starts}
    wanted = {start + i: start for start in starts for i in range(GROUP)}
    stream = (sensor.topic.name, sensor.seen.frame)
    for number, raw in enumerate(sensor.own_messages(bag)):
        if number > starts[-1] + GROUP:
            break
        if number in wanted:
            measured = _measured(bag, sensor, raw, clock)
            if measured is None:
                continue
            beams, stamp = measured
            at = clock.time(stream, 1e-9 * raw.received, stamp) + time_offset
            groups[wanted[number]].append((beams, at))
    return [group for group in groups.values() if len(group) > 1]
