# SPDX-License-Identifier: BSD-3-Clause
"""Which columns of a table of poses hold the time, the position and the quaternion, and the time's unit."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ndtree.logs.core.arrays import Floats

#: How many of a unit are a second.
PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds", "millis"), "ms"),
    **dict.fromkeys(("us", "usec", "usecs", "microsecond", "microseconds", "micros", "µs", "μs"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosecond", "nanoseconds", "nanosec", "nanos"), "ns"),
}
_TIMES = frozenset("t time timestamp timestamps stamp stamps".split())
_POSITIONS = frozenset("p pos position t trans translation".split())
_ROTATIONS = frozenset("q quat quaternion quaternions o ori orient orientation r rot rotation".split())
_OTHERS = frozenset(
    "v vel velocity twist linear angular b bias ba bg a acc accel w omega gyro cov euler".split()
)
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")

#: Stamps since 1970 lie between these [s]: 2001 and 2096.
EPOCH = (1e9, 4e9)
#: Poses further apart than this are stamped in something smaller than seconds [s].
LONGEST_STEP = 86400.0


@dataclass(frozen=True)
class PoseColumns:
    """Where in a row the parts of a pose stand.

    `time`, `part`: Columns of the time and of the nanoseconds behind its seconds.
    """

    count: int  # Columns of a row.
    time: int
    pose: tuple[int, ...]  # Columns of x y z qx qy qz qw.
    part: int | None = None
    unit: str | None = None  # Unit of the time, as the header says.


TUM = PoseColumns(8, 0, (1, 2, 3, 4, 5, 6, 7))


def columns_named(line: str) -> PoseColumns | None:
    """What a header line names; None if it does not name a time, a position and a quaternion."""
    text = line.strip().lstrip("#%/").strip()
    for candidate in (text.rpartition(":")[2], text):  # "columns: t x y z ..."
        found = _columns(candidate)
        if found is not None:
            return found
    return None


def order_in_doubt(line: str) -> str | None:
    """Names of a line that are not qx qy qz qw, where `columns_named` has found nothing; else None."""
    names = _names(line.strip().lstrip("#%/").strip())
    roles = [_role(name, unit)[0] for name, unit in names]
    if "qw" in roles and "qx" in roles and roles.index("qw") < roles.index("qx"):
        return "qw before qx"
    angles = [name for name, _ in names if re.search(r"(?:^|[^a-z])(?:roll|pitch|yaw)$", name)]
    if len(angles) > 1:
        return " ".join(angles)
    numbered = [name for name, _ in names if re.fullmatch(r"(?:.*[^a-z])?q(?:uat)?[_.\[]?[0-4]\]?", name)]
    return " ".join(numbered) if len(numbered) == 4 else None


def _columns(text: str) -> PoseColumns | None:
    words = [name for name, _ in _names(text)]
    names = [_role(name, unit) for name, unit in _names(text)]
    roles = [role for role, _ in names]
    if all(word in words for word in "ijk"):
        imaginary = {"i": "qx", "j": "qy", "k": "qz"}
        roles = [imaginary.get(word, "qw" if role == "w" else role) for word, role in zip(words, roles)]
    if "w" in roles:  # x y z w behind px py pz, or behind another x y z.
        roles = _with_bare_quaternion(roles)
    roles = [role if role in (*_POSE, "time", "sec", "nsec") else _BARE.get(role, "") for role in roles]
    if any(roles.count(role) != 1 for role in _POSE):
        return None
    pose = tuple(roles.index(role) for role in _POSE)
    if roles.count("sec") == roles.count("nsec") == 1:
        return PoseColumns(len(roles), roles.index("sec"), pose, roles.index("nsec"), "s")
    parts = [i for i, (role, unit) in enumerate(names) if (role, unit) == ("time", "ns")]
    if roles.count("sec") == len(parts) == 1:  # stamp_sec and stamp_nanosec
        return PoseColumns(len(roles), roles.index("sec"), pose, parts[0], "s")
    times = [i for i, role in enumerate(roles) if role in ("time", "sec", "nsec")]
    if len(times) > 1:  # A message's own stamp rather than the time at which it came.
        times = [i for i in times if roles[i] == "time" and words[i].endswith("stamp")]
    if len(times) != 1:
        return None
    return PoseColumns(len(roles), times[0], pose, None, names[times[0]][1])


_COMPLEX = {"qi": "qx", "qj": "qy", "qk": "qz", "qr": "qw"}
_BARE = {"bare x": "x", "bare y": "y", "bare z": "z"}


def _with_bare_quaternion(roles: list[str]) -> list[str]:
    """Roles where the x y z beside a single w are the quaternion's."""
    at = roles.index("w")
    for first in (at - 3, at + 1):
        window = range(first, first + 3)
        if all(0 <= i < len(roles) and roles[i] in _BARE for i in window):
            named = {at: "qw", **{i: "q" + _BARE[roles[i]] for i in window}}
            return [named.get(i, role) for i, role in enumerate(roles)]
    return roles


def _names(text: str) -> list[tuple[str, str | None]]:
    """Names of a header, each with the unit in brackets behind it."""
    bracketed = re.compile(r"\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")
    splitter = r"[,;\t]" if re.search(r"[,;]", text) else r"\s+"
    if splitter == r"\s+":  # A unit belongs to the name before it.
        text = re.sub(r"\s+(?=\[)", "", text)
        units = "|".join([*_UNITS, "m"])
        text = re.sub(rf"\s+(?=\((?:{units})\))", "", text)
        text = re.sub(r"\[[^\]]*\]", lambda found: re.sub(r"\s", "", found.group()), text)
    names = []
    for field in re.split(splitter, text.strip().strip(",;")):
        unit = bracketed.search(field)
        name = bracketed.sub("", field) if unit and unit.start() > 0 else field.strip("()[] ")
        names.append((name.strip("()\"' ").lower(), unit.group(1).lower() if unit else None))
    return names


def _role(name: str, unit: str | None) -> tuple[str, str | None]:
    """What a column's name says of it, and the unit of a time."""
    words = [word for word in re.split(r"[^0-9a-zµμ]+", name) if word]
    if not words:
        return "", None
    if len(words) > 1 and words[-1] in ("m", "meters", "metres"):
        words = words[:-1]
    last = words[-1]
    known = _UNITS.get(unit) if unit else None
    if last in _TIMES and words[0] not in _POSITIONS - _TIMES:
        return "time", known
    if last in _UNITS:
        if any(word in _TIMES for word in words[:-1]) and _UNITS[last] != "s" and len(words) <= 2:
            return "time", _UNITS[last]
        return {"s": "sec", "ns": "nsec"}.get(_UNITS[last], "time"), known or _UNITS[last]
    if last == "utime":
        return "time", "us"
    if last in _COMPLEX:
        return _COMPLEX[last], None
    if last in ("x", "y", "z"):
        if len(words) == 1:
            return f"bare {last}", None
        kind = next((word for word in words[:-1] if word in _POSITIONS | _ROTATIONS | _OTHERS), None)
        if kind in _POSITIONS:
            return last, None
        return (f"q{last}" if kind in _ROTATIONS else ""), None
    if last == "w":
        is_rotation = any(word in _ROTATIONS for word in words[:-1])
        return ("w" if len(words) == 1 else "qw" if is_rotation else ""), None
    short = re.fullmatch(r"(p|t|pos|q|quat|rot|r)([xyzw])|([xyz])(pos)|([wxyz])(q)", last)
    if short:
        kind, axis = (next(filter(None, short.group(*which))) for which in ((1, 4, 6), (2, 3, 5)))
        if kind in ("p", "t", "pos"):
            return (axis if axis != "w" else ""), None
        return f"q{axis}", None
    return "", None


def seconds_of(stamps: Floats, unit: str | None, path: str) -> Floats:
    """Stamps in seconds; without a unit in the header, it is told from their size and their steps.

    Raises ValueError if poses would be more than a day apart, and the size does not tell the unit.
    """
    if unit is not None:
        return stamps / PER_SECOND[unit]
    if not len(stamps) or not np.isfinite(stamps).all():
        return stamps
    size = float(np.median(np.abs(stamps)))
    steps = np.abs(np.diff(stamps))
    steps = steps[steps > 0]
    step = float(np.median(steps)) if len(steps) else 0.0
    for name, count in PER_SECOND.items():
        if EPOCH[0] <= size / count < EPOCH[1] and step / count <= LONGEST_STEP / (1 if name == "s" else 24):
            return stamps / count
    if step > LONGEST_STEP or size > 1e3 * EPOCH[1]:
        raise ValueError(
            f"{path}: poses are {step:.6g} apart at times around {size:.6g}, expected seconds, or a first "
            "line that names the columns and the unit, as '# timestamp [ns], x, y, z, qw, qx, qy, qz'"
        )
    return stamps
