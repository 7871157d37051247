# SPDX-License-Identifier: BSD-3-Clause
"""The robot's own body: what a sensor sees of it is no obstacle."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ndtree._errors import WrongValue, key
from ndtree.base.words import numbers_in
from ndtree.logs.core.arrays import Bools, Floats
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.messages.beams import Beams
from ndtree.logs.ros.placement.placement import Placement, bases_in

EXPECTED = (
    "expected box:LX,LY,LZ[,X,Y,Z], sphere:R[,X,Y,Z], capsule:R,X,Y,Z,X,Y,Z or "
    "footprint:X,Y,X,Y,X,Y,...[/LOW,HIGH] in metres, several with + between them, and @FRAME behind all"
)


@dataclass(frozen=True)
class Body:
    """Shapes that a robot consists of, in one of its frames.

    `parts`: Each says which points (n, 3) are in it [m]; its border is in it.
    """

    parts: tuple[Callable[[Floats], Bools], ...]
    frame: str  # "" for the robot's base.

    @staticmethod
    def of(text: str) -> Body:
        """From ``"box:0.6,0.5,0.4,0,0,0.2+sphere:0.3@base_link"``; ValueError if it is something else."""
        shapes, _, frame = text.partition("@")
        return Body(tuple(_part(text, one) for one in shapes.split("+")), plain(frame))

    def frame_of(self, place: Placement, base: str | None) -> str:
        """The frame of the body of a placed sensor; ValueError if the two are not connected."""
        connected = place.tree.connected(place.frame)
        frame = self.frame or plain(base or "") or next(bases_in(connected), place.frame)
        if frame not in connected:
            some = ", ".join(connected[:12])
            said = f"no transform between {place.frame} and {frame}"
            raise WrongValue(f"{key('body')}: {said}, expected one of {some}")
        return frame

    def left_out(
        self, beams: Beams, place: Placement, frame: str, body: str, stamp: float
    ) -> tuple[Beams, int]:
        """The beams, without a word of those that end in the body, and how many these are.

        `frame`, `body`: That the beams, and the body, are in.
        """
        points = place.tree.pose_at(body, frame, stamp).apply(beams.points)
        inside = np.zeros(len(points), dtype=bool)
        with np.errstate(invalid="ignore"):
            for part in self.parts:
                inside |= part(points)
        if beams.returned is not None:
            inside &= beams.returned
        count = int(np.count_nonzero(inside))
        if not count:
            return beams, 0
        ends = beams.points.copy()
        ends[inside] = np.nan
        return replace(beams, points=ends), count


def _part(text: str, one: str) -> Callable[[Floats], Bools]:
    kind, _, rest = one.partition(":")
    if kind == "footprint":
        return _footprint(text, one, rest)
    numbers = numbers_in(rest)
    counts = {"box": (3, 6), "sphere": (1, 4), "capsule": (7,)}.get(kind, ())
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
        raise WrongValue(f"{key('body')} = {text!r}: {one!r}: {EXPECTED}")
    size = 3 if kind == "box" else 1
    if min(numbers[:size]) <= 0:
        raise WrongValue(f"{key('body')} = {text!r}: {one!r}: lengths must be > 0 m")
    if kind == "box":
        half, center = np.array(numbers[:3]) / 2, np.array(numbers[3:] or [0.0] * 3)
        return lambda points: (np.abs(points - center) <= half).all(axis=1)
    radius, begin = numbers[0], np.array(numbers[1:4] or [0.0] * 3)
    way = np.array(numbers[4:]) - begin if kind == "capsule" else np.zeros(3)
    square = float(way @ way)

    def is_near(points: Floats) -> Bools:
        share = np.clip((points - begin) @ way / square, 0, 1) if square else np.zeros(len(points))
        return np.linalg.norm(points - begin - share[:, None] * way, axis=1) <= radius

    return is_near


def _footprint(text: str, one: str, rest: str) -> Callable[[Floats], Bools]:
    """A polygon seen from above, of all heights or between two; as navigation has it: ``[[x, y], ...]``."""
    corners, _, heights = rest.translate(str.maketrans("", "", "[] ")).partition("/")
    numbers, limits = numbers_in(corners), numbers_in(heights)
    is_finite = all(map(math.isfinite, (*numbers, *limits)))
    if len(numbers) < 6 or len(numbers) % 2 or len(limits) != (2 if "/" in rest else 0) or not is_finite:
        raise WrongValue(f"{key('body')} = {text!r}: {one!r}: {EXPECTED}")
    x, y = np.array(numbers).reshape(-1, 2).T
    if not abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) > 0:
        raise WrongValue(f"{key('body')} = {text!r}: {one!r}: its corners lie on a line: must have an area")
    low, high = limits or (-math.inf, math.inf)
    if not low < high:
        raise WrongValue(f"{key('body')} = {text!r}: {one!r}: heights must be from low to high")
    edges = [((x[i - 1], y[i - 1]), (x[i], y[i])) for i in range(len(x))]

    def is_in(points: Floats) -> Bools:
        px, py, pz = points.T
        inside, border = np.zeros(len(points), dtype=bool), np.zeros(len(points), dtype=bool)
        for (x0, y0), (x1, y1) in edges:
            side = (x1 - x0) * (py - y0) - (y1 - y0) * (px - x0)
            # A ray to the right of a point crosses the edge upwards, the point on its left, or downwards.
            inside ^= ((y0 <= py) & (py < y1) & (side > 0)) | ((y1 <= py) & (py < y0) & (side < 0))
            border |= (
                (side == 0)
                & (px >= min(x0, x1)) & (px <= max(x0, x1)) & (py >= min(y0, y1)) & (py <= max(y0, y1))
            )  # fmt: skip
        return (inside | border) & (pz >= low) & (pz <= high)

    return is_in
