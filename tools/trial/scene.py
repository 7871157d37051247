# SPDX-License-Identifier: BSD-3-Clause
"""What stands in a world, and where beams meet it: ray casting of its own, so that the library cannot hide.

Everything is exact but for rounding, in metres. Nothing here imports the library.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_BEHIND = 1e-9  # A surface nearer than this is the one that the ray starts on [m].


@dataclass
class Scene:
    """Segments and circles in the plane; boxes and upright cylinders in space.

    Attributes
    ----------
    dim : int
        2 or 3.
    segments : list of (2, 2) float64
        Walls without thickness.
    circles : list of (x, y, radius)
        Posts of a plane.
    boxes : list of (center (3,), half (3,), axes (3, 3))
        `axes` has the box's unit vectors as rows.
    cylinders : list of (x, y, radius, z0, z1)
    glass : list of int
        Segments that let `passing` of the beams through.
    """

    dim: int
    segments: list[Floats] = field(default_factory=list)
    circles: list[tuple[float, float, float]] = field(default_factory=list)
    boxes: list[tuple[Floats, Floats, Floats]] = field(default_factory=list)
    cylinders: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    glass: list[int] = field(default_factory=list)
    passing: float = 0.0

    def wall(self, *corners: tuple[float, float]) -> None:
        """A line through corners."""
        self.segments += [np.array(pair, dtype=float) for pair in zip(corners[:-1], corners[1:])]

    def room(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Four walls."""
        self.wall((x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0))

    def block(self, low: Floats, high: Floats, yaw: float = 0.0) -> None:
        """A box between two corners, turned about its center."""
        low, high = np.asarray(low, float), np.asarray(high, float)
        c, s = np.cos(yaw), np.sin(yaw)
        axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        self.boxes.append(((low + high) / 2, (high - low) / 2, axes))

    def moved(self, turn: float, shift: Floats) -> Scene:
        """The same, turned about z and shifted: walls at any angle and offset to a map's lattice."""
        c, s = np.cos(turn), np.sin(turn)
        plane = np.array([[c, -s], [s, c]])
        space = np.eye(3)
        space[:2, :2] = plane
        shift = np.asarray(shift, float)
        at = [plane @ (x, y) + shift[:2] for x, y, *_ in self.circles]
        foot = [plane @ (x, y) + shift[:2] for x, y, *_ in self.cylinders]
        return Scene(
            self.dim,
            [segment @ plane.T + shift[:2] for segment in self.segments],
            [(*xy, r) for xy, (_, _, r) in zip(at, self.circles)],
            [(space @ m + np.append(shift[:2], 0.0), h, axes @ space.T) for m, h, axes in self.boxes],
            [(*xy, *rest) for xy, (_, _, *rest) in zip(foot, self.cylinders)],
            list(self.glass),
            self.passing,
        )

    def cast(self, origins: Floats, directions: Floats, rng: np.random.Generator | None = None) -> Floats:
        """(n,) distances along unit directions to the first surface; inf where there is none.

        With a generator, glass lets its share of the beams pass.
        """
        directions = np.atleast_2d(np.asarray(directions, float))
        origins = np.broadcast_to(np.asarray(origins, float), directions.shape)
        nearest = np.full(len(directions), np.inf)
        with np.errstate(all="ignore"):
            if self.segments:
                met = _meet_segments(np.array(self.segments), origins, directions)
                if rng is not None and self.glass:
                    passes = rng.random((len(met), len(self.glass))) < self.passing
                    met[:, self.glass] = np.where(passes, np.inf, met[:, self.glass])
                nearest = np.minimum(nearest, met.min(1))
            if self.circles:
                nearest = np.minimum(
                    nearest, _meet_circles(np.array(self.circles), origins, directions).min(1)
                )
            for center, half, axes in self.boxes:
                nearest = np.minimum(nearest, _meet_box(center, half, axes, origins, directions))
            if self.cylinders:
                nearest = np.minimum(nearest, _meet_cylinders(np.array(self.cylinders), origins, directions))
        return nearest

    def nearest(self, points: Floats) -> Floats:
        """(n, 3) the nearest points of the surfaces of boxes and cylinders."""
        best, found = np.full(len(points), np.inf), points.copy()
        for center, half, axes in self.boxes:
            local = (points - center) @ axes.T
            on = _onto(local, -half, half)
            _keep_nearer(best, found, points, on @ axes + center)
        for x, y, r, z0, z1 in self.cylinders:
            aside = points[:, :2] - (x, y)
            off = np.linalg.norm(aside, axis=1)
            on = _onto(np.c_[off, points[:, 2]], np.array([-r, z0]), np.array([r, z1]))
            out = aside / np.maximum(off, 1e-9)[:, None] * on[:, :1] + (x, y)
            _keep_nearer(best, found, points, np.c_[out, on[:, 1]])
        return found

    def is_inside(self, points: Floats) -> Bools:
        """(n,) whether points are inside a post, a box or a cylinder: a plane's walls have no inside."""
        points = np.atleast_2d(points)
        inside = np.zeros(len(points), bool)
        for x, y, r in self.circles:
            inside |= np.hypot(points[:, 0] - x, points[:, 1] - y) < r
        for center, half, axes in self.boxes:
            inside |= (np.abs((points - center) @ axes.T) < half).all(1)
        for x, y, r, z0, z1 in self.cylinders:
            within = (z0 < points[:, 2]) & (points[:, 2] < z1)
            inside |= (np.hypot(points[:, 0] - x, points[:, 1] - y) < r) & within
        return inside


def _onto(points: Floats, low: Floats, high: Floats) -> Floats:
    """Nearest points of the faces of an upright box."""
    on = points.clip(low, high)
    inside = np.flatnonzero(((points > low) & (points < high)).all(1))
    depths = np.c_[points[inside] - low, high - points[inside]]
    face = depths.argmin(1)
    axis = face % len(low)
    on[inside, axis] = np.r_[low, high][face]
    return on


def _keep_nearer(best: Floats, found: Floats, points: Floats, others: Floats) -> None:
    apart = np.linalg.norm(others - points, axis=1)
    nearer = apart < best
    best[nearer], found[nearer] = apart[nearer], others[nearer]


def _meet_segments(segments: Floats, origins: Floats, directions: Floats) -> Floats:
    """(n, segments) distances."""
    along = segments[:, 1] - segments[:, 0]
    to = segments[:, 0] - origins[:, None]
    across = directions[:, None, 0] * along[:, 1] - directions[:, None, 1] * along[:, 0]
    t = (to[..., 0] * along[:, 1] - to[..., 1] * along[:, 0]) / across
    u = (to[..., 0] * directions[:, None, 1] - to[..., 1] * directions[:, None, 0]) / across
    return np.where((t > _BEHIND) & (u >= 0) & (u <= 1), t, np.inf)


def _meet_circles(circles: Floats, origins: Floats, directions: Floats) -> Floats:
    """(n, circles) distances along unit directions."""
    x, y = (circles[:, k] - origins[:, k : k + 1] for k in (0, 1))
    along = x * directions[:, :1] + y * directions[:, 1:]
    left = circles[:, 2] ** 2 - (x**2 + y**2) + along**2
    t = along - np.sqrt(left)
    return np.where((left > 0) & (t > _BEHIND), t, np.inf)


def _meet_box(center: Floats, half: Floats, axes: Floats, origins: Floats, directions: Floats) -> Floats:
    near, far = np.full(len(directions), -np.inf), np.full(len(directions), np.inf)
    outside = np.zeros(len(directions), bool)
    for o, d, side in zip(axes @ (origins - center).T, axes @ directions.T, half):
        one, other = (-side - o) / d, (side - o) / d
        near = np.maximum(near, np.where(d == 0, -np.inf, np.minimum(one, other)))
        far = np.minimum(far, np.where(d == 0, np.inf, np.maximum(one, other)))
        outside |= (d == 0) & (np.abs(o) > side)
    met = (near <= far) & (near > _BEHIND) & ~outside
    return np.where(met, near, np.inf)


def _meet_cylinders(cylinders: Floats, origins: Floats, directions: Floats) -> Floats:
    """(n,) distances."""
    length = np.linalg.norm(directions[:, :2], axis=1)
    flat = np.where(length > 0, length, np.nan)[:, None]
    x, y = (cylinders[:, k] - origins[:, k : k + 1] for k in (0, 1))
    aside = np.abs(x * directions[:, 1:2] - y * directions[:, :1])
    # Of vertical ones, only the ends are met.
    ray, which = np.nonzero(~(aside > 1.001 * cylinders[:, 2] * flat))
    o, d, flat = origins[ray], directions[ray], flat[ray, 0]
    x, y, r, low, high = cylinders[which].T
    nearest = np.full(len(directions), np.inf)
    dx, dy = d[:, 0] / flat, d[:, 1] / flat
    x, y = x - o[:, 0], y - o[:, 1]
    along = x * dx + y * dy
    left = r**2 - (x**2 + y**2) + along**2
    t = along - np.sqrt(left)
    t = np.where((left > 0) & (t > _BEHIND), t, np.inf) / flat
    z = o[:, 2] + t * d[:, 2]
    np.minimum.at(nearest, ray, np.where((z >= low) & (z <= high), t, np.inf))
    for height in (low, high):
        t = (height - o[:, 2]) / d[:, 2]
        away = np.hypot(t * d[:, 0] - x, t * d[:, 1] - y)
        np.minimum.at(nearest, ray, np.where((t > _BEHIND) & (away < r), t, np.inf))
    return nearest
