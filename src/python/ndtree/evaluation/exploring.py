# SPDX-License-Identifier: BSD-3-Clause
"""A simulated robot explores a world that is known exactly, by one of several strategies."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ndtree._native import _core
from ndtree.base.sensor import RangeSensor
from ndtree.logs.formats.simulated import simulate

if TYPE_CHECKING:
    from ndtree.base.typing import World

Array = NDArray[np.float64]
Strategy = Literal["information", "nearest", "random"]

#: Between looks the robot drives at most so far [m].
STRIDE = 1.0
#: Places where it may look stand on a lattice of this edge [m], hence within AT_FRONTIER of where it can see
#: a frontier's cells from beside them.
LATTICE = 0.5
AT_FRONTIER = 0.75
#: Of the range [m]; returns are drawn around the exact distance.
RANGE_SIGMA = 0.02


@dataclass(frozen=True)
class Robot:
    """What it measures with, what it expects to see by, with fewer beams, and the ball that it fits in."""

    sensor: RangeSensor
    expects: RangeSensor
    radius: float


ROBOTS = {
    # A planar laser all around.
    "office": Robot(RangeSensor.laser(max_range=12.0), RangeSensor.laser(max_range=12.0, beams=180), 0.2),
    # A depth camera that is turned around, up and down, carried at one height.
    "apartment": Robot(
        RangeSensor.lidar(max_range=5.0, rings=80, azimuths=360, lowest=-0.7, highest=0.7),
        RangeSensor.lidar(max_range=5.0, rings=20, azimuths=90, lowest=-0.7, highest=0.7),
        0.2,
    ),
}


@dataclass
class Exploration:
    """What was found, look by look.

    `track` (k, dim) float64: Points of the way [m].
    `way` (n,) float64: Driven until each look [m].
    `volume` (n,) float64: Free or occupied after it [m^dim].
    `seconds` (n,) float64: Of computing, to insert it and to decide where to go next.
    `done`: Nothing was left to look at.
    `shut_in`: No place could be reached from where it was, nor from anywhere on its track.
    """

    map: _core.AdaptiveMap
    track: Array
    way: Array
    volume: Array
    seconds: Array
    done: bool
    shut_in: bool

    def way_to(self, volume: float) -> float:
        """Driven until that much was seen [m]; inf if it never was."""
        seen = self.volume >= volume
        return float(self.way[seen.argmax()]) if seen.any() else math.inf


@dataclass
class _Explorer:
    """A robot in a world, and all that it remembers."""

    world: Any
    robot: Robot
    random: np.random.Generator
    here: Array
    map: Any
    track: list[Array] = field(default_factory=list)
    way: float = 0.0
    visited: list[Array] = field(default_factory=list)
    goal: Array | None = None  # Of the random strategy.
    gains: dict[tuple[float, ...], float] = field(default_factory=dict)  # When a place was last asked for.

    def __post_init__(self) -> None:
        self.body = _core.Sphere(self.robot.radius)
        self.track.append(self.here)
        self.planner: Any = None

    def look(self) -> None:
        sensor = self.robot.sensor
        ranges = self.world.distance(self.here, sensor.directions, max_range=sensor.max_range)
        noise = self.random.normal(0.0, RANGE_SIGMA, len(ranges))
        returned = ~np.isnan(ranges)
        ends = np.where(returned, ranges + noise, sensor.max_range)
        self.map.insert(self.here + ends[:, None] * sensor.directions, self.here, returned=returned)
        if self.planner is None:
            self.planner = _core.Planner(self.map, self.body)
        else:
            self.planner.update(self.map)

    def volume(self) -> float:
        leaves = self.map.leaves()
        return float((leaves.size[leaves.state != -1] ** self.map.dim).sum())

    def places(self) -> Array:
        """Where it may look next, if there is a way."""
        lower, upper = (np.asarray(corner) for corner in self.map.bounds())
        first, last = np.floor(lower / LATTICE), np.ceil(upper / LATTICE)
        axes = [LATTICE * np.arange(first[a], last[a] + 1.0) for a in (0, 1)]
        axes += [self.track[0][a : a + 1] for a in range(2, self.map.dim)]  # It stays at its height.
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, self.map.dim)
        places = places[self.map.state(places) == 0]
        places = places[~self.map.collides(self.body, places, unknown="occupied")]
        if self.visited and len(places):
            away = np.linalg.norm(places[:, None] - np.array(self.visited), axis=-1).min(axis=1)
            places = places[away > 0.75 * LATTICE]
        return places

    def ways(self, places: Array) -> Array:
        """From where it is; if noise put something there, from where it was before."""
        return self._ways_from_track(places, reaches_one=False)

    def backs_out(self, places: Array) -> bool:
        """Where noise shut it in, so that no place can be reached, it goes back to where one can.
        Whether there is one."""
        return bool(np.isfinite(self._ways_from_track(places, reaches_one=True)).any())

    def _ways_from_track(self, places: Array, *, reaches_one: bool) -> Array:
        """From the last point of its track where nothing is, and whence a place can be reached, if that is
        asked; it goes back to there."""
        for k in range(len(self.track) - 1, -1, -1) if len(places) else ():
            try:
                ways: Array = self.planner.ways(self.track[k], places)
            except ValueError:
                continue
            if np.isfinite(ways).any() or not reaches_one:
                self._go_back_to(k)
                return ways
        return np.full(len(places), np.inf)

    def _go_back_to(self, k: int) -> None:
        """On its track to a point of it."""
        back = self.track[k:-1][::-1]
        for point in back:
            self.way += float(np.linalg.norm(point - self.here))
            self.here = point
        self.track.extend(back)

    def drive(self, goal: Array) -> None:
        path = self.planner.plan(self.here, goal)
        left = STRIDE
        for point in path.points[1:] if path else ():
            step = float(np.linalg.norm(point - self.here))
            part = min(1.0, left / step) if step > 0.0 else 1.0
            self.here = point if part == 1.0 else self.here + part * (point - self.here)
            self.track.append(self.here)
            self.way += part * step
            left -= part * step
            if left <= 0.0:
                break
        if not path or np.array_equal(self.here, goal):
            self.visited.append(goal)

    def near_frontiers(self, places: Array) -> NDArray[np.bool_]:
        frontiers = self.map.frontiers()
        if not frontiers or not len(places):
            return np.zeros(len(places), bool)
        cells = np.concatenate([frontier.cell_centers for frontier in frontiers])
        return np.array([np.linalg.norm(cells - place, axis=1).min() < AT_FRONTIER for place in places])


def _best(
    robot: _Explorer,
    places: Array,
    worth: Callable[[Any, Array], Array],
    ask: Callable[[NDArray[np.intp]], None] = lambda some: None,
) -> Array | None:
    """The place that is worth most, by the way there. Ways are asked for only as long as the straight line
    leaves hope.

    `worth`: Of places, by their numbers, at distances; it falls with them.
    `ask`: Called for places before their ways are asked for; what they are worth may only fall by it.
    """
    batch, best, value = 16, None, -math.inf
    straight = np.linalg.norm(places - robot.here, axis=1)
    bounds = worth(slice(None), straight)
    order = np.argsort(-bounds, kind="stable")
    for first in range(0, len(order), batch):
        some = order[first : first + batch]
        if bounds[some[0]] <= value:
            break
        ask(some)
        some = some[worth(some, straight[some]) > value]
        if not len(some):
            continue
        ways = robot.ways(places[some])
        values = np.where(np.isfinite(ways), worth(some, ways), -np.inf)
        if values.max() > value:
            best, value = places[some[values.argmax()]], float(values.max())
    return best


def _nearest(robot: _Explorer, places: Array) -> Array | None:
    return _best(robot, places[robot.near_frontiers(places)], lambda _, distances: -distances)


def _random(robot: _Explorer, places: Array) -> Array | None:
    """It goes on to where it was going as long as there is a frontier."""
    near = places[robot.near_frontiers(places)]
    near = near[np.isfinite(robot.ways(near))]
    if robot.goal is None or not (near == robot.goal).all(axis=1).any():
        robot.goal = near[robot.random.integers(len(near))] if len(near) else None
    return robot.goal


def _information(robot: _Explorer, places: Array) -> Array | None:
    """The most that is seen anew by the metre; less than the robot's own volume is not worth a way.

    While unknown space occludes nothing, gains only fall as more is observed: those of before are bounds, and
    what was not worth a way before is not asked again.
    """
    dim, radius = robot.map.dim, robot.robot.radius
    least = math.pi * radius**2 if dim == 2 else 4.0 / 3.0 * math.pi * radius**3
    gains = np.array([robot.gains.get(tuple(place), math.inf) for place in places.tolist()])
    places, gains = places[gains > least], gains[gains > least]
    asked = np.zeros(len(places), dtype=np.bool_)

    def ask(some: NDArray[np.intp]) -> None:
        some = some[~asked[some]]
        asked[some] = True
        volume = robot.map.information_gain(places[some], robot.robot.expects).volume
        robot.gains.update(zip(map(tuple, places[some].tolist()), volume.tolist()))
        gains[some] = np.where(volume > least, volume, -np.inf)

    ask(np.flatnonzero(np.isinf(gains)))
    return _best(robot, places, lambda which, distances: gains[which] / (distances + STRIDE), ask)


STRATEGIES: dict[str, Callable[[_Explorer, Array], Array | None]] = {
    "information": _information,
    "nearest": _nearest,
    "random": _random,
}


def explore(
    world: World,
    strategy: Strategy = "information",
    *,
    seed: int = 1,
    start: int = 0,
    max_looks: int = 1000,
    progress: Callable[[str, int, int], None] | None = None,
) -> Exploration:
    """Explore a simulated world.

    `world` ({"office", "apartment"}): A planar laser that sees all around; or a depth camera that turns
        around, at the height of 1.4 m.
    `strategy` ({"information", "nearest", "random"}): Where to go: where the most is seen anew by the metre
        (`OccupancyMap.information_gain`); to the frontier with the shortest way; to a frontier drawn at
        random. All drive on paths of a `Planner`, look after each metre at most, and think again.
    `seed`: Of the noise of ranges, and of the random strategy.
    `start`: It begins where the world's own log has this scan.
    `max_looks`: At most, > 0.
    `progress`: Called with what is done, how much of it, and of how much.
    Raises ValueError if there is no such world, strategy or scan.
    """
    if world not in ROBOTS:
        raise ValueError(f"world = {world!r}: must be one of {', '.join(ROBOTS)}")
    if strategy not in STRATEGIES:
        raise ValueError(f"strategy = {strategy!r}: must be one of {', '.join(STRATEGIES)}")
    if max_looks < 1:
        raise ValueError(f"max_looks = {max_looks}: must be >= 1")
    log = simulate(world)
    if not 0 <= start < len(log):
        raise ValueError(f"start = {start}: must be 0 to {len(log) - 1}, a scan of the {world}'s own log")
    empty = _core.AdaptiveMap(dim=log.dim, min_cell_size=0.05, range_sigma=RANGE_SIGMA)
    origin = np.array(log[start].origin, np.float64).reshape(-1)[: log.dim]
    robot = _Explorer(log, ROBOTS[world], np.random.default_rng(seed), origin, empty)
    if log.dim == 3:  # It had room to get there, above and below, where it does not see.
        empty.mark(_core.Sphere(2.0 * ROBOTS[world].radius, origin), "free")
    ways, volumes, seconds = [], [], []
    goal: Array | None = None
    shut_in = False
    for looks in range(max_looks):
        begin = time.perf_counter()
        robot.look()
        ways.append(robot.way)
        volumes.append(robot.volume())
        places = robot.places()
        goal = STRATEGIES[strategy](robot, places)
        if goal is None:
            driven = len(robot.track)
            shut_in = not robot.backs_out(places)
            if len(robot.track) > driven:
                goal = STRATEGIES[strategy](robot, places)
        seconds.append(time.perf_counter() - begin)
        if progress is not None:
            progress("scans taken", looks + 1, max_looks)
        if goal is None:
            break
        robot.drive(goal)
    track, figures = np.array(robot.track), (np.array(each) for each in (ways, volumes, seconds))
    done = goal is None and not shut_in
    return Exploration(robot.map, track, *figures, done, shut_in)
