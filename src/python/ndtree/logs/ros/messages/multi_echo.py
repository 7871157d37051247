# SPDX-License-Identifier: BSD-3-Clause
"""Scans of lasers that hear several echoes of a beam, decoded here: each echo is an object to others."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.ros.messages.beams import MULTI_ECHO_LASER
from ndtree.logs.ros.messages.head import Header, header_of, order_of

TYPES = (MULTI_ECHO_LASER,)
_NUMBERS = 7


@dataclass(frozen=True)
class MultiEchoLaserScan:
    """What is used of the message: the echoes of all beams, and the number of each one's beam."""

    header: Header
    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    beams: int
    echoes: NDArray[np.float32]
    numbers: NDArray[np.intp]


def decoded(data: bytes, *, is_ros1: bool) -> MultiEchoLaserScan:
    """The message in some bytes; ValueError if they are too few."""
    order = order_of(data, is_ros1)
    header, at = header_of(data, is_ros1)
    if not is_ros1:
        at = 4 + (at - 4 + 3) // 4 * 4
    words = np.frombuffer(data, order + "u4", (len(data) - at) // 4, at) if at < len(data) else np.zeros(0)
    if len(words) <= _NUMBERS:
        raise ValueError(f"the scan has {len(data)} bytes, expected a whole MultiEchoLaserScan")
    numbers = struct.unpack_from(f"{order}{_NUMBERS}f", data, at)
    count = int(words[_NUMBERS])
    begins, sizes = _lists(words, _NUMBERS + 1, count)
    numbers_of_beams = np.repeat(np.arange(count), sizes)
    place = np.arange(len(numbers_of_beams)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    echoes = words.view(order + "f4")[begins[numbers_of_beams] + place].astype(np.float32)
    return MultiEchoLaserScan(header, *numbers, count, echoes, numbers_of_beams)


def _lists(words: NDArray[np.uint32], at: int, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Where `count` lists that follow each other begin, and their sizes; each has its size before it."""
    if count > len(words) - at:
        raise ValueError(f"the scan has {len(words) - at} numbers, expected {count} lists of echoes")
    every = words.tolist()
    begins = []
    for number in range(count):
        begins.append(at + 1)
        at += 1 + every[at]
        if at > len(every) or (at == len(every) and number < count - 1):
            raise ValueError(f"the scan ends in the echoes of beam {number}, expected {count} beams")
    begin = np.array(begins, dtype=np.intp)
    return begin, np.diff(np.append(begin, at + 1)) - 1
