# SPDX-License-Identifier: BSD-3-Clause
"""The unit of coordinates, by the coordinate system that a file names: WKT of both versions, or GeoKeys."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

#: Lengths by their codes in EPSG's register [m].
_LENGTHS = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937, 9005: 0.3047972654, 9036: 1000.0}
_NAMES = ((0.3048, "feet"), (1200 / 3937, "US survey feet"), (1000.0, "kilometres"))
#: Relative difference of factors that are written with few digits: that of the two feet is 2e-6.
_ROUNDED = 4e-7
#: Keys of GeoTIFF: kind of system, its code as one of degrees and as one in the plane, its unit; of heights.
_MODEL, _DEGREES, _PROJECTED, _LENGTH, _LENGTH_SIZE = 1024, 2048, 3072, 3076, 3077
_UPRIGHT, _HEIGHT = 4096, 4099
_GEOGRAPHIC = 2
#: Systems of heights by their codes in EPSG's register, in the one foot, the other, and metres.
_HEIGHTS = {
    **dict.fromkeys((8228, 8050), 0.3048),
    **dict.fromkeys((6360, 5702, 8052), 1200 / 3937),
    **dict.fromkeys((5703, 5701, 5709, 5711, 5773, 5798, 3855, 5783, 7837, 5705, 5714, 6695), 1.0),
}
_OTHERS = 32767  # What has no code.
_WEB_MERCATOR = (3857, 3785, 900913, 102100, 102113)  # Codes of EPSG's, Google's and ESRI's.
_TOKEN = re.compile(r'\s*(?:"((?:[^"]|"")*)"|([A-Za-z_][A-Za-z0-9_]*)|([-+.\dEe]+)|([\[\](),]))')
_MOST_NESTED = 40


@dataclass(frozen=True)
class Units:
    """Of coordinates.

    `across`, `height`: Of x and y, and of z [m].
    """

    across: float = 1.0
    height: float = 1.0
    are_degrees: bool = False  # x and y are longitude and latitude.
    are_stretched: bool = False  # They are metres at the equator, and shorter by the latitude elsewhere.
    unknown: str = ""  # What does not say its unit: `across` and `height` are a guess.

    @property
    def note(self) -> str:
        """What a user should know, in one line; empty where all are metres."""
        if self.unknown:
            taken = _name(self.across)
            return f"{self.unknown} does not say the unit of its coordinates: they are taken as {taken}"
        names = [_name(self.across), _name(self.height)]
        if names == ["metres", "metres"]:
            return ""
        what = names[0] if names[0] == names[1] else f"{names[0]}, heights in {names[1]}"
        return f"coordinates are in {what}, as their coordinate system says: in the map they are metres"


METRES = Units()


def _name(size: float) -> str:
    if abs(size - 1.0) < _ROUNDED:
        return "metres"
    return next((name for one, name in _NAMES if abs(size / one - 1) < _ROUNDED), f"units of {size:g} m")


@dataclass
class _Node:
    """A word of WKT with what is in its brackets."""

    word: str
    values: list[str] = field(default_factory=list)
    nodes: list[_Node] = field(default_factory=list)

    def all(self, *words: str) -> Iterator[_Node]:
        """This and all below that have one of some words, from outside to inside."""
        if self.word in words:
            yield self
        for node in self.nodes:
            yield from node.all(*words)


def units_of_wkt(text: str) -> Units:
    """By a coordinate system as WKT.

    Raises ValueError if it is none.
    """
    root = _parsed(text)
    name = f"a coordinate system {root.nodes[0].word}"
    across = next(root.all(*_ACROSS), None)
    if across is None:
        return Units(unknown=name)
    cartesian = any(value.lower() == "cartesian" for node in across.all("CS") for value in node.values)
    if across.word in ("GEOGCS", "GEOGCRS", "GEODCRS", "GEOGRAPHICCRS", "GEODETICCRS") and not cartesian:
        return Units(are_degrees=True)
    if re.search(r"(pseudo|web)[ _-]mercator", across.values[0].lower() if across.values else ""):
        return Units(are_stretched=True)
    size = _length(across)
    if size is None:
        return Units(unknown=name)
    upright = next(root.all("VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS"), None)
    height = None if upright is None else _length(upright)
    return Units(size, size if height is None else height)


_ACROSS = (
    "PROJCS", "PROJCRS", "PROJECTEDCRS", "LOCAL_CS", "ENGCRS", "ENGINEERINGCRS", "GEOCCS",
    "GEOGCS", "GEOGCRS", "GEODCRS", "GEOGRAPHICCRS", "GEODETICCRS",
)  # fmt: skip


def _length(system: _Node) -> float | None:
    """The unit of its axes [m]; that of the system that it is made from is another."""
    own = [node for node in system.nodes if node.word in ("UNIT", "LENGTHUNIT", "AXIS")]
    for node in own:
        for unit in node.all("UNIT", "LENGTHUNIT"):
            try:
                size = float(unit.values[1])
            except (IndexError, ValueError):
                continue
            if 0 < size < float("inf"):
                return size
    return None


def _parsed(text: str) -> _Node:
    """WKT as a tree, in a node without a word: ESRI's programs put the system of heights beside the other."""
    whole = _Node("")
    stack = [whole]
    at = 0
    text = text.strip().rstrip("\0")
    while at < len(text):
        found = _TOKEN.match(text, at)
        if found is None or len(stack) > _MOST_NESTED:
            raise ValueError(f"found {text[at : at + 20]!r}, expected a coordinate system as WKT")
        at = found.end()
        quoted, word, number, sign = found.groups()
        if word is not None and re.match(r"\s*[\[(]", text[at:]):
            stack[-1].nodes.append(_Node(word.upper()))
        elif sign in ("[", "(") and stack[-1].nodes:
            stack.append(stack[-1].nodes[-1])
        elif sign in ("]", ")") and len(stack) > 1:
            stack.pop()
        elif sign is None:
            stack[-1].values.append(next(one for one in (quoted, word, number) if one is not None))
    if not whole.nodes or len(stack) > 1:
        raise ValueError(f"found {text[:20]!r}, expected a coordinate system as WKT")
    return whole


def units_of_keys(keys: Mapping[int, float]) -> Units:
    """By keys of GeoTIFF and their values."""
    if keys.get(_MODEL) == _GEOGRAPHIC or (_DEGREES in keys and not {_MODEL, _PROJECTED} & keys.keys()):
        return Units(are_degrees=True)
    system = int(keys.get(_PROJECTED, 0))
    if system in _WEB_MERCATOR:
        return Units(are_stretched=True)
    code, size = keys.get(_LENGTH), keys.get(_LENGTH_SIZE)
    if code is not None and code != _OTHERS:
        size = _LENGTHS.get(int(code))
    across = 1.0 if size is None else size
    upright = int(keys.get(_UPRIGHT, 0))
    height = _LENGTHS.get(int(keys.get(_HEIGHT, 0)), _HEIGHTS.get(upright))
    if size is None and system not in (0, _OTHERS) and not any(low <= system <= high for low, high in _UTM):
        return Units(unknown=f"coordinate system EPSG:{system}")
    if height is None and upright not in (0, _OTHERS) and upright not in _OLD_HEIGHTS:
        return Units(across, across, unknown=f"system of heights EPSG:{upright}")
    return Units(across, across if height is None else height)


#: Codes of before EPSG's, which name datums: the unit is that of the other coordinates.
_OLD_HEIGHTS = range(5000, 5300)
#: Codes of UTM, of several datums.
_UTM = ((25828, 25838), (26901, 26923), (32201, 32260), (32301, 32360), (32401, 32760), (6328, 6348))
