# SPDX-License-Identifier: BSD-3-Clause
"""A day of a robot in the simulated office, message by message, with what goes wrong on robots."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import Messages, write_bag
from rosbags.typesys import Stores, get_typestore

import ndtree
from ndtree.logs.ros.files.bag import open_bag
from ndtree.logs.ros.messages.beams import SENSORS
from ndtree.logs.ros.storage import Connection, Raw
from ndtree.logs.ros.survey import TF

BEGIN = 1.7e9
#: Scans in a second, and of the office until the robot turns back.
RATE, WAY = 10.0, 40
#: What can go wrong, and how often in an hour; more often in a test of a minute.
FAULTS = {"stops": 60.0, "no tf": 60.0, "ahead": 30.0, "back": 30.0}
#: What goes wrong with single scans, and what part of them has it.
ODD = {"nan": 0.1, "damaged": 0.005, "nowhere": 0.005, "late": 0.1}


class Day:
    """Two lasers that share a topic, and transforms, while the robot goes to and fro.

    Parameters
    ----------
    seed : int
    faults : collection of str
        Of `FAULTS` and `ODD`.
    often : float
        Multiplies how often faults of `FAULTS` come.

    Attributes
    ----------
    scans : int
        That were made so far.
    """

    def __init__(self, seed: int, faults: Any = (*FAULTS, *ODD), often: float = 1.0) -> None:
        self._generator = np.random.default_rng(seed)
        self._faults, self._often = set(faults), often
        self._make = Messages("mcap")
        self.scans = 0
        self._way = []
        for scan in ndtree.simulate("office", scans=WAY):
            to = scan.endpoints - scan.origin
            angles = np.unwrap(np.arctan2(to[:, 1], to[:, 0]))
            ranges = np.hypot(*to.T)
            if scan.returned is not None:
                ranges[~scan.returned] = np.inf
            step = float(angles[-1] - angles[0]) / (len(angles) - 1)
            self._way.append((scan.origin, float(angles[0]), step, ranges))

    def _row(self, topic: str, received: float, message: Any, data: bytes | None = None) -> Raw:
        type_ = message.__msgtype__
        data = bytes(self._make.store.serialize_cdr(message, type_)) if data is None else data
        return Raw(Connection(0, topic, type_, "cdr"), round(received * 1e9), data)

    def _is(self, fault: str) -> bool:
        """Whether a single scan has one."""
        return fault in self._faults and self._generator.random() < ODD[fault]

    def messages(self, seconds: float) -> Iterator[Raw]:
        """All of them, in the order in which they are received."""
        make, generator = self._make, self._generator
        fixed = [
            make.transform(BEGIN, "base", frame, [x, 0, 0.2], [0, 0, math.sin(turn / 2), math.cos(turn / 2)])
            for frame, x, turn in (("front", 0.0, 0.0), ("rear", 0.0, math.pi))
        ]
        yield self._row("/tf_static", BEGIN - 0.5, make.tf(*fixed))
        offset, silent, lost, arrives = 0.0, -1.0, -1.0, 0.0
        waiting: list[Raw] = []
        for i in range(round(seconds * RATE)):
            now = i / RATE
            begins = {
                name
                for name, often in FAULTS.items()
                if name in self._faults and now > 5 and generator.random() < often * self._often / 3600 / RATE
            }
            silent = now + generator.uniform(1, 20) if "stops" in begins else silent
            lost = now + generator.uniform(1, 5) if "no tf" in begins else lost
            offset += generator.uniform(5, 100) if "ahead" in begins else 0.0
            offset -= generator.uniform(10, 100) if "back" in begins else 0.0
            at, stamp = i % (2 * WAY - 2), BEGIN + now + offset
            origin, turn, step, ranges = self._way[at if at < WAY else 2 * WAY - 2 - at]
            half = [0, 0, math.sin(turn / 2), math.cos(turn / 2)]
            moved = make.transform(stamp, "map", "base", [*origin, 0], half)
            if now > lost:
                late = generator.uniform(0.0, 0.4) if self._is("late") else 0.0
                arrives = max(arrives, BEGIN + now + 0.01 + late)  # One after the other.
                waiting.append(self._row("/tf", arrives, make.tf(moved)))
            if now > silent:
                waiting += self._lasers(BEGIN + now, stamp, step, ranges)
            waiting.sort(key=lambda raw: raw.received)
            until = round(1e9 * (BEGIN + now))
            while waiting and waiting[0].received <= until:
                yield waiting.pop(0)
        yield from waiting

    def _lasers(self, now: float, stamp: float, step: float, ranges: Any) -> list[Raw]:
        """What both measure at a time."""
        rows = []
        for number, (frame, begin) in enumerate((("front", 0.0), ("rear", math.pi))):
            seen = np.where(self._generator.random(len(ranges)) < 0.5, np.nan, ranges)
            seen = seen if self._is("nan") else ranges
            frame = "nowhere" if self._is("nowhere") else frame
            turned = {"angle_min": -begin, "angle_increment": step, "range_max": 30.0}
            message = self._make.laser(stamp - 0.02 * number, frame, seen, **turned)
            row = self._row("/scan", now + 0.001 + 0.003 * number, message)
            if self._is("damaged"):
                row = Raw(row.connection, row.received, row.data[: len(row.data) // 2])
            rows.append(row)
            self.scans += 1
        return rows

    def write(self, path: Path, seconds: float) -> Path:
        """A bag of them."""
        content = (
            (raw.connection.topic, 1e-9 * raw.received, (raw.connection.type, raw.data))
            for raw in self.messages(seconds)
        )
        return write_bag(path, self._make, content)


def looped(path: Path, rounds: float) -> Iterator[Raw]:
    """Messages of a bag again and again, as if the clock went on: with stamps that rise by a round's time.

    Parameters
    ----------
    path : path
    rounds : float
        Infinite: for ever.
    """
    with open_bag(str(path)) as bag:
        raws = list(bag.messages([one.name for one in bag.topics]))
        store = get_typestore(Stores.ROS2_HUMBLE)
        decoded = [(raw, bag.decoded(raw)) for raw in raws if raw.connection.type in (*SENSORS, *TF)]
    stamps = [_stamp(one.header) for raw, one in decoded if raw.connection.type in SENSORS]
    span = max(stamps) - min(stamps) + 10**9 // 10
    number = 0
    while number < rounds:
        for raw, message in decoded:
            type_ = TF[0] if raw.connection.type in TF else raw.connection.type
            moved = _as_ros2(message, store, type_, number * span)
            data = bytes(store.serialize_cdr(moved, type_))
            connection = Connection(0, raw.connection.topic, type_, "cdr")
            yield Raw(connection, raw.received + number * span, data)
        number += 1


def _stamp(header: Any) -> int:
    return 10**9 * header.stamp.sec + header.stamp.nanosec


def _as_ros2(one: Any, store: Any, type_: str, later: int) -> Any:
    """A message of any version of ROS as one of ROS 2, measured later [ns]."""
    kind = store.types[type_]
    values = {}
    for field in fields(kind):
        if field.name.startswith("__"):
            continue
        value = getattr(one, field.name)
        if isinstance(value, list):
            inner = [_as_ros2(part, store, part.__msgtype__, later) for part in value]
            value = inner
        elif hasattr(value, "__msgtype__") and value.__msgtype__ == "builtin_interfaces/msg/Time":
            time = 10**9 * value.sec + value.nanosec + later
            value = store.types[value.__msgtype__](sec=time // 10**9, nanosec=time % 10**9)
        elif hasattr(value, "__msgtype__"):
            value = _as_ros2(value, store, value.__msgtype__, later)
        values[field.name] = value
    return kind(**values)
