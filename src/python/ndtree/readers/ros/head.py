# SPDX-License-Identifier: BSD-3-Clause
"""Stamp and frame of a message, from its first bytes alone."""

from __future__ import annotations

import struct

from ndtree.readers.ros.storage import Raw
from ndtree.readers.transforms import plain


def head_of(raw: Raw) -> tuple[float, str] | None:
    """Stamp [s] and frame of a message that begins with a Header; None where it is too short to have one.

    In ROS 1 a Header begins with a number of 4 bytes, in ROS 2 a message begins with 4 bytes that say how it
    is packed: all that follows stands in the same place.
    """
    data = raw.data
    if len(data) < 16:
        return None
    order = ">" if raw.connection.encoding == "cdr" and not data[1] & 1 else "<"
    seconds, nanoseconds, length = struct.unpack_from(order + "3I", data, 4)
    if 16 + length > len(data):
        return None
    frame = data[16 : 16 + length].rstrip(b"\0").decode("utf-8", "replace")
    stamp = seconds + 1e-9 * nanoseconds
    return stamp if stamp else 1e-9 * raw.received, plain(frame)
