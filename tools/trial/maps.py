# SPDX-License-Identifier: BSD-3-Clause
"""Judges of maps: what they claim of walls, of what no beam saw, of what was seen, and of what left."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache

import numpy as np

import ndtree
from trial import faults
from trial.outcome import Case, Outcome, limit
from trial.robots import Recording, poses_along, record, sensor_of
from trial.scene import Bools, Floats, Scene
from trial.worlds import Random, World

Mover = Callable[[int], "Scene | None"]

_POINTS = 1500  # That are asked of each kind.
_RAYS = 1500
_STEEPEST = {2: np.radians(80), 3: np.radians(70)}  # Angle of incidence of rays.


class Truth:
    """What a recording can tell of a world, and what the world is.

    `margin` is the distance from surfaces within which a map may say anything [m]; `endless`, how far beams
    without echo are said to pass [m].
    """

    def __init__(self, world: World, recording: Recording, cell: float, rng: Random) -> None:
        self.world, self.recording, self.cell, self.rng = world, recording, cell, rng
        self.margin = limit("beside a surface") * cell + 3 * recording.sensor.sigma
        self.dim, self.endless = recording.dim, recording.sensor.max_range
        self._opaque = wide(world.scene, 0.0)
        self.origins = recording.true[:, : self.dim, 3]
        hit = np.isfinite(recording.exact)
        rotations = recording.true[:, : self.dim, : self.dim]
        directions = np.einsum("sij,bj->sbi", rotations, recording.sensor.directions)
        length = np.where(hit, recording.exact, 0.0)
        self.directions = directions
        self.ends = (self.origins[:, None] + directions * length[..., None])[hit & ~recording.moving]
        low, high = np.percentile(self.ends if len(self.ends) else self.origins, [2, 98], axis=0)
        self.low = np.minimum(low, self.origins.min(0)).clip(self.origins.min(0) - 8) - 0.5
        self.high = np.maximum(high, self.origins.max(0)).clip(max=self.origins.max(0) + 8) + 0.5

    def points(self, count: int) -> Floats:
        """Uniform in the box of what was seen."""
        return self.rng.uniform(self.low, self.high, (count, self.dim))

    def beams_to(self, points: Floats, scan: int) -> tuple[Floats, Floats]:
        """Of each point: how far the nearest beam is aside, and how far that goes past the point [m]."""
        to = points - self.origins[scan]
        cosine = to.astype(np.float32) @ self.directions[scan].T.astype(np.float32)
        nearest = cosine.argmax(1)
        along = cosine[np.arange(len(points)), nearest].astype(float)
        aside = np.sqrt(np.maximum((to**2).sum(1) - along**2, 0.0))
        exact = self.recording.exact[scan]
        reach = np.where(np.isfinite(exact), exact, self.endless)
        return aside, reach[nearest] - along

    def passing(self, points: Floats, scans: Iterable[int]) -> Floats:
        """(n,) how many scans have a beam within a quarter of a cell that goes past the point by the margin.

        Of a cell's center, that beam is surely one of the cell's.
        """
        count = np.zeros(len(points), int)
        for scan in scans:
            aside, past = self.beams_to(points, int(scan))
            count += (aside < 0.25 * self.cell) & (past > self.margin)
        return count

    def centers(self, points: Floats) -> Floats:
        """Of the smallest cells that points are in."""
        return (np.floor(points / self.cell) + 0.5) * self.cell

    def is_hidden(self, points: Floats) -> Bools:
        """Whether a surface stands the margin before a point and all around it, from each origin."""
        hidden = np.ones(len(points), bool)
        steps = self.margin * np.r_[np.zeros((1, self.dim)), np.eye(self.dim), -np.eye(self.dim)]
        for origin in np.unique(self.origins, axis=0):
            for step in steps:
                left = np.flatnonzero(hidden)
                to = points[left] + step - origin
                far = np.linalg.norm(to, axis=1)
                met = self._opaque.cast(origin, to / np.maximum(far, 1e-9)[:, None])
                hidden[left] = met < far - self.margin
        return hidden

    def is_clear(self, points: Floats) -> Bools:
        """Whether no beam ended within the margin of a point."""
        return ~near(points, self.ends, self.margin)

    def rays(self, count: int) -> tuple[Floats, Floats, Floats]:
        """Origins, directions and distances of rays to cells in which at least five beams ended, not along
        the surface; of things wider than two cells, and not at their edges."""
        scene = self.world.scene
        solid = wide(scene, 2 * self.cell)
        scan = self.rng.integers(len(self.recording), size=4 * count)
        beam = self.rng.integers(len(self.recording.sensor.directions), size=4 * count)
        origin, direction = self.origins[scan], self.directions[scan, beam]
        if self.dim == 2:  # Not the very rays that were mapped.
            a = self.rng.normal(0, 0.01, len(scan))
            c, s = np.cos(a), np.sin(a)
            x, y = direction.T
            direction = np.c_[c * x - s * y, s * x + c * y]
        far = scene.cast(origin, direction)
        with np.errstate(invalid="ignore"):
            is_wide = np.abs(solid.cast(origin, direction) - far) < 1e-6
        keep = np.isfinite(far) & (far < self.recording.sensor.max_range) & is_wide
        origin, direction, far = origin[keep], direction[keep], far[keep]
        end = origin + direction * far[:, None]
        keep = count_in(end, self.ends, self.cell) >= 5
        steepest = _STEEPEST[self.dim]
        widest = self.margin + 2 * self.cell * np.tan(steepest)
        for side in _across(direction):
            for shift in (-1.5 * self.cell, 1.5 * self.cell):
                keep &= scene.cast(origin + shift * side, direction) < far + widest
        keep &= _incidence(scene, origin, direction, far) < steepest
        return origin[keep][:count], direction[keep][:count], far[keep][:count]


def wide(scene: Scene, least: float) -> Scene:
    """A scene without glass and things that are thinner than this."""
    solid = [one for i, one in enumerate(scene.segments) if i not in scene.glass]
    solid = [one for one in solid if np.linalg.norm(one[1] - one[0]) >= least]
    return Scene(
        scene.dim,
        solid,
        [one for one in scene.circles if 2 * one[2] >= least],
        [one for one in scene.boxes if 2 * one[1].min() >= least],
        [one for one in scene.cylinders if 2 * one[2] >= least],
    )


def _across(direction: Floats) -> list[Floats]:
    """Unit vectors at right angles to directions: one in the plane, two in space."""
    if direction.shape[1] == 2:
        return [np.c_[-direction[:, 1], direction[:, 0]]]
    flat = np.c_[-direction[:, 1], direction[:, 0], np.zeros(len(direction))]
    flat /= np.maximum(np.linalg.norm(flat, axis=1), 1e-9)[:, None]
    return [flat, np.cross(direction, flat)]


def _incidence(scene: Scene, origin: Floats, direction: Floats, far: Floats) -> Floats:
    """Angle to the surface's normal, from how the distance changes with the direction [rad]."""
    turn, slopes = 1e-4, []
    for side in _across(direction):
        other = direction + turn * side
        other /= np.linalg.norm(other, axis=1)[:, None]
        with np.errstate(invalid="ignore"):
            slopes.append((scene.cast(origin, other) - far) / (turn * far))
    slope = np.linalg.norm(np.nan_to_num(np.array(slopes), nan=1e9, posinf=1e9), axis=0)
    return np.arctan(slope)


def _keys(points: Floats, edge: float) -> np.ndarray:
    cells = np.floor(points / edge).astype(np.int64)
    return _packed(cells)


def _packed(cells: np.ndarray) -> np.ndarray:
    key = np.zeros(cells.shape[:-1], np.int64)
    for axis in range(cells.shape[-1]):
        key = key * 2_000_003 + cells[..., axis] + 1_000_000
    return key


def _neighbours(points: Floats, edge: float) -> np.ndarray:
    """(n, 3^dim) keys of the cells around points."""
    dim = points.shape[1]
    offsets = np.stack(np.meshgrid(*[[-1, 0, 1]] * dim, indexing="ij"), -1).reshape(-1, dim)
    return _packed(np.floor(points / edge).astype(np.int64)[:, None] + offsets)


def near(points: Floats, others: Floats, distance: float) -> Bools:
    """Whether a point has another one in the cubes around its own, of edge `distance`."""
    if not len(points) or not len(others):
        return np.zeros(len(points), bool)
    return np.isin(_neighbours(points, distance), _keys(others, distance)).any(1)


def count_in(points: Floats, others: Floats, cell: float) -> np.ndarray:
    """How many others are in the cell of a lattice that a point is in."""
    return _counts(_keys(points, cell), others, cell)


def count_near(points: Floats, others: Floats, distance: float) -> np.ndarray:
    """How many others are in the cubes around a point's own."""
    return _counts(_neighbours(points, distance), others, distance).sum(1)


def distance_to(points: Floats, others: Floats) -> Floats:
    """(n,) to the nearest of the others; inf where there are none [m]."""
    nearest = np.full(len(points), np.inf)
    for part in np.array_split(others, max(1, len(others) // 500)):
        if len(part):
            nearest = np.minimum(nearest, ((points[:, None] - part[None]) ** 2).sum(2).min(1))
    return np.sqrt(nearest)


def _counts(cells: np.ndarray, others: Floats, edge: float) -> np.ndarray:
    """How many others are in each of some cells, given by keys."""
    keys, counts = np.unique(_keys(others, edge), return_counts=True)
    if not len(keys):
        return np.zeros(cells.shape, int)
    at = np.searchsorted(keys, cells).clip(max=len(keys) - 1)
    return np.where(keys[at] == cells, counts[at], 0)


def judge_map(m: ndtree.OccupancyMap, truth: Truth, outcome: Outcome, last: int | None = None) -> None:
    """Hold a map against the truth. `last`: the scan from which on nothing moves.

    Rays that cells of one size let pass, too, and points that these call free, are not counted: so much the
    beams do not say.
    """
    control = cache(lambda: mapped(truth.recording, truth.cell, is_fixed=True))  # Made where it is asked.
    scans = range(len(truth.recording))
    origin, direction, far = truth.rays(_RAYS)
    if len(far) >= 100:
        found = np.asarray(m.cast_rays(origin, direction, max_range=float(far.max()) + 5.0))
        passes = ~(found <= far + truth.margin + 0.2)
        if passes.mean() > limit("rays that pass") / 100:
            found = np.asarray(control().cast_rays(origin, direction, max_range=float(far.max()) + 5.0))
            passes &= found <= far + truth.margin + 0.2
        outcome.expect("rays that pass", 100 * passes.mean())
        outcome.drawn["rays that pass"] = (origin + direction * far[:, None])[passes]
    points = truth.points(3 * _POINTS)
    state = np.asarray(m.state(points))
    free = np.flatnonzero(state == 0)
    if len(free) >= 200:
        hidden = truth.is_hidden(points[free])
        hidden[hidden] &= ~near(points[free][hidden], truth.ends, truth.margin)
        if hidden.mean() > limit("free but hidden") / 100:
            hidden[hidden] &= np.asarray(control().state(points[free][hidden])) != 0
        outcome.expect("free but hidden", 100 * hidden.mean())
        outcome.drawn["free but hidden"] = points[free][hidden]
    counted = truth.centers(points[:_POINTS])
    counted = counted[truth.is_clear(counted)]
    seen = counted[truth.passing(counted, scans if last is None else range(last, len(scans))) >= 3]
    if len(seen) >= 50:
        state = np.asarray(m.state(seen))
        outcome.expect("seen but unknown", 100 * np.mean(state == -1))
        outcome.expect("false occupied", 100 * np.mean(state == 1))
        outcome.drawn["seen but unknown"] = seen[state == -1]
        outcome.drawn["false occupied"] = seen[state == 1]


def judge_lost(m: ndtree.OccupancyMap, truth: Truth, outcome: Outcome, ends: Floats) -> None:
    """Whether surfaces that were met often are in a map, within the margin."""
    gone = np.asarray(m.nearest_occupied(ends, max_distance=1.0).distance) > truth.margin
    outcome.expect("walls lost", 100 * gone.mean())
    outcome.drawn["walls lost"] = ends[gone]


def judge_ghosts(m: ndtree.OccupancyMap, truth: Truth, outcome: Outcome, last: int) -> None:
    """Of the points of what was there before a scan and left: those passed often enough must be gone."""
    r = truth.recording
    scan, beam = np.nonzero(r.moving)
    if not len(scan) or last >= len(r):
        return
    points = truth.origins[scan] + truth.directions[scan, beam] * r.exact[scan, beam][:, None]
    points = truth.centers(points[truth.rng.choice(len(points), min(500, len(points)), replace=False)])
    clear = truth.is_clear(points)
    passed = truth.passing(points, range(last, len(r))) >= np.minimum(last, 12)
    counted = points[clear & passed]
    if len(counted) >= 20:
        left = np.asarray(m.state(counted)) == 1
        outcome.expect("ghosts", 100 * left.mean())
        outcome.drawn["ghosts"] = counted[left]


def map_trial(case: Case) -> tuple[Recording, Outcome]:
    """The map of exact poses, with default options but cells and noise."""
    r, cell, last = recorded(case)
    truth, outcome = Truth(case.world, r, cell, case.rng), Outcome()
    branching = int(case.rng.choice([2, 2, 3]))
    m = mapped(r, cell, branching, case.is_fixed)
    judge_map(m, truth, outcome, last)
    if last is not None:
        judge_ghosts(m, truth, outcome, last)
    outcome.drawn["map"] = m
    return r, outcome


def recorded(
    case: Case,
    planar: tuple[int, int] = (30, 60),
    spatial: tuple[int, int] = (12, 24),
    motion: str | None = None,
) -> tuple[Recording, float, int | None]:
    """By exact poses, with the size of the map's cells, and the scan from which on nothing moves.

    `planar`, `spatial`: How many scans, from the first number to before the second.
    """
    world, rng, dim = case.world, case.rng, case.dim
    cell = float(rng.choice([0.05, 0.1])) if dim == 2 else 0.1
    sensor = sensor_of(rng, dim)
    scans = int(rng.integers(*(planar if dim == 2 else spatial)))
    mover, last = mover_of(case, scans)
    return record(world.scene, sensor, poses_along(world, rng, scans, motion), rng, mover), cell, last


def mover_of(case: Case, scans: int) -> tuple[Mover, int | None]:
    """What moves, and the scan from which on it is gone."""
    if case.fault not in ("person", "stood_and_left"):
        return (lambda i: None), None
    mover: Mover = getattr(faults, case.fault)(case.world, case.rng, scans, case.dim)
    return mover, next(i for i in range(scans + 1) if i == scans or mover(i) is None)


def mapped(r: Recording, cell: float, branching: int = 2, is_fixed: bool = False) -> ndtree.OccupancyMap:
    sigma = max(r.sensor.sigma, 0.01)
    if is_fixed:
        m: ndtree.OccupancyMap = ndtree.FixedMap(dim=r.dim, min_cell_size=cell, range_sigma=sigma)
    else:
        m = ndtree.AdaptiveMap(dim=r.dim, branching=branching, min_cell_size=cell, range_sigma=sigma)
    for i in range(len(r)):
        points, origin, returned = r.beams(i)
        m.insert(points, origin, returned=returned)
    return m
