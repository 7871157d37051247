# SPDX-License-Identifier: BSD-3-Clause
"""Random worlds: what stands, and a route through free space. One function a kind, by its name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from trial.scene import Floats, Scene

Random = np.random.Generator


@dataclass
class World:
    """A scene and where a robot drives in it.

    Attributes
    ----------
    scene : Scene
    route : (k, 2) float64
        Corners of a way through free space [m].
    height : float
        Of the sensor above z = 0, in space [m].
    is_tellable : bool
        Whether a scan says where it is on all axes: not in smooth corridors, nor beside equal rods.
    is_bare : bool
        Whether it is ground on which little else stands: few rings of a scan may not say that.
    """

    scene: Scene
    route: Floats
    height: float = 1.2
    is_tellable: bool = True
    ramp: Callable[[Floats], Floats] | None = field(default=None, repr=False)
    is_bare: bool = False

    def placed(self, rng: Random, cell: float) -> World:
        """Turned and shifted against a lattice of cells: exactly on it, a centimetre beside it, or anyhow."""
        turn = rng.choice([0.0, np.pi / 2, rng.uniform(-np.pi, np.pi)])
        shift = rng.choice([0.0, -0.005, 0.007, rng.uniform(-cell, cell)], 2)
        c, s = np.cos(turn), np.sin(turn)
        route = self.route @ np.array([[c, s], [-s, c]]) + shift
        ramp = None
        if self.ramp is not None:
            back, own = np.array([[c, -s], [s, c]]), self.ramp

            def ramp(at: Floats) -> Floats:
                return own((at - shift) @ back)

        return replace(self, scene=self.scene.moved(turn, shift), route=route, ramp=ramp)


def _posts(scene: Scene, rng: Random, count: int, low: Floats, high: Floats) -> None:
    for x, y in rng.uniform(low, high, (count, 2)):
        scene.circles.append((x, y, rng.uniform(0.03, 0.25)))


def corridor(rng: Random) -> World:
    """Smooth walls, ends out of sight: no scan tells the way along it."""
    half = rng.uniform(0.8, 1.5)
    scene = Scene(2)
    scene.wall((-60, half), (120, half))
    scene.wall((-60, -half), (120, -half))
    length = rng.uniform(6, 12)
    y = rng.uniform(-0.2, 0.2)
    return World(scene, np.array([[0, y], [length, y]]), is_tellable=False)


def recesses(rng: Random) -> World:
    """A corridor with door recesses, and an end."""
    half, depth = rng.uniform(0.8, 1.3), rng.uniform(0.08, 0.3)
    scene = Scene(2)
    for side in (-1, 1):
        x = -6.0
        corners = [(x, side * half)]
        while x < 24:
            x += rng.uniform(1.2, 4)
            corners += [(x, side * half), (x, side * (half + depth))]
            x += rng.uniform(0.8, 1.0)
            corners += [(x, side * (half + depth)), (x, side * half)]
        scene.wall(*corners, (26, side * half))
    scene.wall((26, -half), (26, half))
    scene.wall((-6, -half), (-6, half))
    return World(scene, np.array([[0, 0], [rng.uniform(6, 12), 0]]))


def room(rng: Random) -> World:
    """A room with a few pillars and boxes."""
    w, h = rng.uniform(4, 9), rng.uniform(3.5, 7)
    scene = Scene(2)
    scene.room(0, 0, w, h)
    for _ in range(rng.integers(1, 4)):
        x, y = rng.uniform(0.1, 0.8) * w, rng.choice([0.02, 0.9]) * h
        scene.room(x, y, x + rng.uniform(0.2, 0.8), y + rng.uniform(0.05, 0.09) * h)
    return World(scene, np.array([[0.3, 0.3], [0.7, 0.35], [0.7, 0.7], [0.3, 0.65], [0.3, 0.3]]) * [w, h])


def hall(rng: Random) -> World:
    """A hall that each scan sees whole, with pillars."""
    w, h = rng.uniform(9, 14), rng.uniform(7, 10)
    scene = Scene(2)
    scene.room(0, 0, w, h)
    for x, y in ((0.25, 0.5), (0.68, 0.12), (0.5, 0.9)):
        x, y, r = x * w + rng.uniform(-0.4, 0.4), y * h, rng.uniform(0.15, 0.4)
        scene.room(x - r, y - r, x + r, y + r)
    around = np.linspace(0, 2 * np.pi, 25)[:-1]
    return World(scene, np.c_[0.5 + 0.36 * np.cos(around), 0.52 + 0.27 * np.sin(around)] * [w, h])


def loop(rng: Random) -> World:
    """Corridors around a block."""
    w, h, half = rng.uniform(6, 9), rng.uniform(4, 7), rng.uniform(0.7, 1.0)
    scene = Scene(2)
    scene.room(-half, -half, w + half, h + half)
    scene.room(half, half, w - half, h - half)
    for _ in range(6):  # Cupboards along the outer wall tell one side from the next.
        x = rng.uniform(0.5, w - 1.2)
        y = rng.choice([-half, h + half - 0.25])
        scene.room(x, y, x + rng.uniform(0.3, 0.7), y + 0.25)
    return World(scene, np.array([[0, 0], [w, 0], [w, h], [0, h], [0, 0], [1.5, 0]], dtype=float))


def twins(rng: Random) -> World:
    """A floor of identical rooms along a corridor."""
    w, d, rooms = rng.uniform(3, 4), rng.uniform(3, 4), 3
    scene = Scene(2)
    for i in range(rooms):
        x = i * w
        scene.wall((x, 1), (x, 1 + d), (x + w, 1 + d), (x + w, 1))
        scene.wall((x, 1), (x + w / 2 - 0.5, 1))
        scene.wall((x + w / 2 + 0.5, 1), (x + w, 1))
        scene.room(x + 0.4, 1 + d - 0.9, x + 1.2, 1 + d - 0.4)
    scene.wall((0, 1), (0, -1), (rooms * w, -1), (rooms * w, 1))
    x = (np.arange(rooms) + 0.5) * w
    stops = [p for at in x[:2] for p in ([at, 0], [at, 1 + d / 2], [at, 0])]
    return World(scene, np.array([[0.6, 0], *stops], dtype=float))


def yard(rng: Random) -> World:
    """Open ground with few posts: most beams return from nowhere."""
    scene = Scene(2)
    _posts(scene, rng, int(rng.integers(5, 12)), [-8, 0.8], [12, 7])
    _posts(scene, rng, int(rng.integers(3, 8)), [-8, -7], [12, -0.8])
    return World(scene, np.array([[-2.0, 0], [6, 0]]), is_tellable=False)


def fence(rng: Random) -> World:
    """Rods before a wall: beams pass between them."""
    scene, radius, gap = Scene(2), rng.uniform(0.008, 0.03), rng.uniform(0.1, 0.3)
    at = rng.uniform(1.5, 2.8)
    scene.circles += [(x, at, radius) for x in np.arange(-6, 12, gap)]
    scene.wall((-20, at + rng.uniform(1, 2)), (30, at + rng.uniform(1, 2)))
    scene.wall((-20, -1.5), (0, -1.6), (0.2, -1.3), (30, -1.4))
    return World(scene, np.array([[-1.0, 0], [6, 0]]), is_tellable=False)


def furniture(rng: Random) -> World:
    """Legs of tables and chairs."""
    world = room(rng)
    w, h = world.scene.segments[0][1, 0], world.scene.segments[1][1, 1]
    for _ in range(3):
        x, y = 0.5 * w + rng.uniform(-0.5, 0.5), 0.5 * h + rng.uniform(-0.4, 0.4)
        size, radius = rng.uniform(0.35, 0.7), rng.uniform(0.012, 0.03)
        world.scene.circles += [(x + i * size, y + j * size, radius) for i in (0, 1) for j in (0, 1)]
    world.route = np.array([[0.2, 0.25], [0.8, 0.25]]) * [w, h]
    return world


def glass(rng: Random) -> World:
    """A room one of whose walls lets a share of the beams pass into the next one."""
    world = room(rng)
    scene = world.scene
    w, h = scene.segments[0][1, 0], scene.segments[1][1, 1]
    scene.glass, scene.passing = [1], rng.uniform(0.2, 0.6)
    scene.wall((w, 0), (w + 3, 0), (w + 3, h), (w, h))
    return world


def _ground(scene: Scene, size: float = 60.0) -> None:
    scene.block([-size, -size, -1], [size, size, 0])


def flat(rng: Random) -> World:
    """Flat ground with a few boxes, far apart."""
    scene = Scene(3)
    _ground(scene)
    for x, y in rng.uniform([-6, 2.5], [14, 9], (6, 2)):
        y = y if rng.random() < 0.5 else -1 - y
        scene.block([x, y, 0], [x + 1, y + 1, rng.uniform(0.3, 2)], yaw=rng.uniform(0, 3))
    return World(scene, np.array([[0.0, 0], [8, 0]]), rng.uniform(0.6, 1.8), is_bare=True)


def ramp(rng: Random) -> World:
    """Flat ground, then a ramp of up to 10 degrees between walls."""
    scene, pitch, length = Scene(3), np.radians(rng.uniform(3, 10)), 8.0
    _ground(scene)
    center = np.array([3 + length / 2 * np.cos(pitch), 0, length / 2 * np.sin(pitch)])
    thick = np.array([-np.sin(pitch), 0, np.cos(pitch)])
    c, s = np.cos(pitch), np.sin(pitch)
    axes = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    scene.boxes.append((center - 0.5 * thick, np.array([length / 2, 4.0, 0.5]), axes))
    for y in (-4, 4):
        scene.block([-8, y - 0.1, 0], [16, y + 0.1, 3.5])

    def rise(at: Floats) -> Floats:
        x = np.clip(at[:, 0] - 3, 0, length * np.cos(pitch))
        return np.c_[x * np.tan(pitch), np.where((x > 0) & (x < length * np.cos(pitch)), pitch, 0.0)]

    return World(scene, np.array([[-2.0, 0], [8, 0]]), rng.uniform(0.6, 1.5), ramp=rise, is_bare=True)


def street(rng: Random) -> World:
    """Houses, posts and parked cars."""
    scene = Scene(3)
    _ground(scene)
    for side in (-1, 1):
        x = -15.0
        while x < 25:
            width = rng.uniform(3, 7)
            y = rng.uniform(4.5, 6)
            low, high = sorted((side * y, side * (y + 4)))
            scene.block([x, low, 0], [x + width, high, rng.uniform(3, 9)])
            x += width + rng.choice([0, 1.5])
        for x in rng.uniform(-8, 16, 3):
            scene.cylinders.append((x, side * 3.6, rng.uniform(0.03, 0.12), 0.0, 4.0))
            scene.block([x + 1, side * 2.8 - 0.8, 0.15], [x + 4, side * 2.8 + 0.8, 1.4])
    return World(scene, np.array([[-2.0, 0.2], [8, 0.2]]), rng.uniform(1.4, 2.0))


def shelves(rng: Random) -> World:
    """An aisle between shelves, in a hall with a ceiling."""
    scene, deep = Scene(3), rng.uniform(0.4, 0.8)
    _ground(scene)
    scene.block([-4, -6, 3.4], [14, 6, 3.6])
    for x, y, w, h in ((-4, -6, 18, 0.2), (-4, 5.8, 18, 0.2), (-4, -6, 0.2, 12), (13.8, -6, 0.2, 12)):
        scene.block([x, y, 0], [x + w, y + h, 3.5])
    for side in (-1, 1):
        low, high = sorted((side * 1.6, side * (1.6 + deep)))
        for z in (0.3, 1.2, 2.1):
            scene.block([-2, low, z], [11, high, z + 0.04])
        for x in np.arange(-2, 11.1, 2.6):
            scene.block([x, low, 0], [x + 0.06, high, 2.4])
        for x in rng.uniform(-2, 10, 5):
            wide, top = rng.uniform(0.3, 0.8), rng.uniform(0.5, 1.1)
            scene.block([x, low + 0.05, 0.34], [x + wide, high - 0.05, top])
    return World(scene, np.array([[-1.0, 0], [8, 0]]), rng.uniform(0.5, 1.5))


def railing(rng: Random) -> World:
    """Upright rods in space, a wall behind them."""
    scene, radius, gap = Scene(3), rng.uniform(0.01, 0.03), rng.uniform(0.12, 0.35)
    _ground(scene)
    scene.cylinders += [(x, 2.5, radius, 0.0, 2.0) for x in np.arange(-4, 10, gap)]
    scene.block([-20, 4.5, 0], [30, 4.8, 3])
    scene.block([-20, -3.0, 0], [30, -2.7, 3])
    return World(scene, np.array([[0.0, 0], [5, 0]]), rng.uniform(0.6, 1.2), is_tellable=False)


def chamber(rng: Random) -> World:
    """A closed room with a box on the floor, and a table."""
    w, d, h = rng.uniform(4, 7), rng.uniform(3, 5), rng.uniform(2.3, 3)
    scene, t = Scene(3), 0.3
    for low, high in (
        ([-t, -t, -t], [w + t, d + t, 0]), ([-t, -t, h], [w + t, d + t, h + t]), ([-t, -t, 0], [0, d + t, h]),
        ([w, -t, 0], [w + t, d + t, h]), ([0, -t, 0], [w, 0, h]), ([0, d, 0], [w, d + t, h]),
    ):  # fmt: skip
        scene.block(low, high)
    x, y = 0.62 * w, 0.68 * d
    scene.block([x, y, 0.7], [x + 0.9, y + 0.6, 0.74])
    for i, j in ((0, 0), (0.84, 0), (0, 0.54), (0.84, 0.54)):
        scene.block([x + i, y + j, 0], [x + i + 0.06, y + j + 0.06, 0.7])
    scene.block([0.1 * w, 0.75 * d, 0], [0.1 * w + 0.5, 0.75 * d + 0.4, rng.uniform(0.3, 0.9)])
    route = np.array([[0.25, 0.3], [0.75, 0.3], [0.75, 0.45], [0.3, 0.5]]) * [w, d]
    return World(scene, route, rng.uniform(0.5, 1.4))


def passage(rng: Random) -> World:
    """A smooth corridor with a ceiling, ends out of sight."""
    half, height, scene = rng.uniform(0.8, 1.8), rng.uniform(2.2, 3), Scene(3)
    _ground(scene)
    scene.block([-60, -half, height], [70, half, height + 0.2])
    for side in (-1, 1):
        low, high = sorted((side * half, side * (half + 0.2)))
        scene.block([-60, low, 0], [70, high, height])
    y = rng.uniform(-0.2, 0.2)
    return World(scene, np.array([[0, y], [8, y]]), rng.uniform(0.5, 1.5), is_tellable=False)


def storeys(rng: Random) -> World:
    """Two equal storeys, each of two equal rooms; the robot drives on the upper one."""
    w, d, h, scene = rng.uniform(4, 7), rng.uniform(3.5, 5), rng.uniform(2.5, 3.2), Scene(3)
    x, tall = rng.uniform(0.1, 0.7) * w, rng.uniform(0.5, 1.8)
    for i in range(2):
        for j in range(2):
            at = np.array([i * (w + 0.2), 0, j * (h + 0.2)])
            for low, high in (
                ([0, 0, 0], [w, d, 0.1]), ([0, 0, h], [w, d, h + 0.1]), ([-0.1, -0.1, 0], [0, d, h]),
                ([w, -0.1, 0], [w + 0.1, 0.3 * d, h]), ([w, 0.6 * d, 0], [w + 0.1, d, h]),
                ([0, -0.1, 0], [w, 0, h]), ([0, d, 0], [w, d + 0.1, h]),
                ([x, 0.8 * d, 0], [x + 0.6, d, tall]),
            ):  # fmt: skip
                scene.block(at + low, at + high)
    route = np.array([[0.3 * w, 0.3 * d], [0.8 * w, 0.45 * d], [1.25 * w, 0.45 * d], [1.7 * w, 0.6 * d]])
    return World(scene, route, h + 0.3 + rng.uniform(0.4, 1.2), is_tellable=False)


def bend(rng: Random) -> World:
    """A street that bends, with houses, posts and cars."""
    scene, radius, side = Scene(3), rng.uniform(9, 25), rng.choice([-1, 1])
    _ground(scene)

    def at(angle: float, off: float) -> tuple[float, float]:
        return (radius + off) * np.sin(angle), side * (radius - (radius + off) * np.cos(angle))

    for off in (rng.uniform(4, 6), -rng.uniform(4, 6)):
        way = -12.0
        while way < 22:
            wide = rng.uniform(3, 6)
            x, y = at((way + wide / 2) / radius, off + np.sign(off) * 1.5)
            size = np.array([wide / 2 * (1 + off / radius), 1.5])
            low, high = np.r_[np.subtract([x, y], size), 0.0], np.r_[np.add([x, y], size), rng.uniform(3, 8)]
            scene.block(low, high, yaw=side * (way + wide / 2) / radius)
            way += wide + rng.choice([0.3, 2.0])
        for way in rng.uniform(-8, 16, 4):
            scene.cylinders.append((*at(way / radius, 0.7 * off), rng.uniform(0.04, 0.15), 0.0, 4.0))
            x, y = at((way + 2) / radius, 0.6 * off)
            scene.block([x - 1.5, y - 0.7, 0.15], [x + 1.5, y + 0.7, 1.4], yaw=side * (way + 2) / radius)
    route = np.array([at(way / radius, 0.0) for way in np.arange(-2, 9, 0.5)])
    return World(scene, route, rng.uniform(0.5, 2.0))


PLANAR = (corridor, recesses, room, hall, loop, twins, yard, fence, furniture, glass)
SPATIAL = (flat, ramp, street, shelves, railing, chamber)
WORLDS = {make.__name__: make for make in (*PLANAR, *SPATIAL, bend, passage, storeys)}
