#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Paths of a ball between random places by others, beside ours: needs `pip install ompl nano-astar`.

usage: ompl_planners.py MAP [--radius M] [--unknown blocked|free] [--pairs N] [--seconds 0.1,1] [--seed S]

MAP is any that ndtree reads. Pairs are drawn among the places where the body fits that one of them has a way
to. All planners ask the same exact test of the volume that the body sweeps, `Planner.first_blocked`; OMPL
from Python, some microseconds more a call. Times are of the processor, and so are the limits. RRT-Connect
stops at its first path, which is then simplified; the others go on until their time is over. In the plane,
nano-astar looks at the grid of smallest cells in whose centre the ball is free; the time to make it is told
apart, and its paths, from centre to centre, are not pulled tight.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from nano_astar import astar
from ompl import base, geometric, util

import ndtree

PLANNERS = {
    "RRT-Connect": geometric.RRTConnect,
    "RRT*": geometric.RRTstar,
    "Informed RRT*": geometric.InformedRRTstar,
}


class Motions(base.MotionValidator):
    """Straight motions, by the exact test of the swept volume."""

    def __init__(self, information, planner: ndtree.Planner, dim: int) -> None:
        super().__init__(information)
        self.planner, self.dim = planner, dim

    def checkMotion(self, a, b, last=None) -> bool:
        ends = [[state[k] for k in range(self.dim)] for state in (a, b)]
        return self.planner.first_blocked(ends) < 0


def sampled(kind: str, planner: ndtree.Planner, bounds, pair, seconds: float) -> tuple[float, float]:
    """Length of the path, inf if there is none, and the processor's time [s]."""
    dim = len(pair[0])
    space = base.RealVectorStateSpace(dim)
    limits = base.RealVectorBounds(dim)
    for k in range(dim):
        limits.setLow(k, float(bounds[0][k]))
        limits.setHigh(k, float(bounds[1][k]))
    space.setBounds(limits)
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    setup.setStateValidityChecker(
        lambda state: planner.first_blocked([[state[k] for k in range(dim)]] * 2) < 0
    )
    motions = Motions(information, planner, dim)
    information.setMotionValidator(motions)
    ends = []
    for point in pair:
        state = space.allocState()
        for k in range(dim):
            state[k] = float(point[k])
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(PLANNERS[kind](information))
    begin = time.process_time()
    over = base.PlannerTerminationCondition(lambda: time.process_time() - begin > seconds)
    setup.solve(over)
    if not setup.haveExactSolutionPath():
        return np.inf, time.process_time() - begin
    if kind == "RRT-Connect":
        setup.simplifySolution()
    return float(setup.getSolutionPath().length()), time.process_time() - begin


def pairs_of(planner: ndtree.Planner, bounds, count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Places that have a way to each other."""
    random = np.random.default_rng(seed)
    while True:
        places = random.uniform(*bounds, (20 * count, len(bounds[0])))
        places = places[[planner.first_blocked([place, place]) < 0 for place in places]]
        for start in places[:10]:
            reached = places[np.isfinite(planner.ways(start, places))]
            if len(reached) >= 2 * count:
                return list(zip(reached[:count], reached[count : 2 * count]))


def planned(planner: ndtree.Planner, pair) -> tuple[float, float]:
    """As sampled()."""
    begin = time.process_time()
    path = planner.plan(*pair)
    return (path.length if path else np.inf), time.process_time() - begin


class Grid:
    """Smallest cells of a 2-D map in whose centre the body is free."""

    def __init__(self, m, body, unknown: str) -> None:
        begin = time.process_time()
        self.unit = m.options["min_cell_size"]
        bounds = np.array(m.bounds())
        self.lower = np.floor(bounds[0] / self.unit) * self.unit
        shape = np.ceil((bounds[1] - self.lower) / self.unit).astype(int)
        centers = self.lower + (np.indices(shape).reshape(2, -1).T + 0.5) * self.unit
        poses = np.column_stack([centers, np.zeros(len(centers))])
        met = m.collides(body, poses, unknown="occupied" if unknown == "blocked" else "free")
        self.blocked = met.reshape(shape).astype(np.uint8)
        self.seconds = time.process_time() - begin

    def path(self, pair) -> tuple[float, float]:
        """As sampled()."""
        begin = time.process_time()
        ends = [tuple(((end - self.lower) / self.unit).astype(int)) for end in pair]
        try:
            found = astar(self.blocked, *ends)
        except ValueError:  # The centre of an end's cell is not free.
            found = None
        return (found[1] * self.unit if found else np.inf), time.process_time() - begin


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("map")
    parser.add_argument("--radius", type=float, default=0.35)
    parser.add_argument("--unknown", choices=("blocked", "free"), default="blocked")
    parser.add_argument("--pairs", type=int, default=30)
    parser.add_argument(
        "--seconds", type=lambda text: [float(word) for word in text.split(",")], default=[0.1, 1]
    )
    parser.add_argument("--seed", type=int, default=1)
    call = parser.parse_args()
    util.setLogLevel(util.LogLevel.LOG_NONE)
    m, body = ndtree.load(call.map), ndtree.Sphere(call.radius)
    bounds = np.array(m.bounds())
    planner = ndtree.Planner(m, body, unknown=call.unknown)
    pairs = pairs_of(planner, bounds, call.pairs, call.seed)
    rows = {"ndtree, cold": [], "ndtree, warm": []}
    for pair in pairs:
        new = ndtree.Planner(m, body, unknown=call.unknown)
        for name in rows:
            rows[name].append(planned(new, pair))
    if m.dim == 2:
        grid = Grid(m, body, call.unknown)
        print(f"grid of nano-astar: {grid.blocked.shape}, made in {1e3 * grid.seconds:.0f} ms")
        rows["nano-astar"] = [grid.path(pair) for pair in pairs]
    for kind in PLANNERS:
        for seconds in call.seconds:
            util.RNG.setSeed(call.seed + 1)
            rows[f"{kind}, {seconds:g} s"] = [sampled(kind, planner, bounds, pair, seconds) for pair in pairs]
    table = {name: np.array(row) for name, row in rows.items()}
    best = np.min([row[:, 0] for row in table.values()], axis=0)
    print(f"{call.map}, radius {call.radius:g} m, unknown {call.unknown}, {len(pairs)} pairs")
    print(f"{'planner':<22} {'found':>6} {'over the best: median, 95 %':>28} {'ms: median, 95 %':>18}")
    for name, row in table.items():
        found = np.isfinite(row[:, 0])
        over = np.quantile((row[:, 0] / best)[found], [0.5, 0.95]) if found.any() else [np.nan] * 2
        ms = 1e3 * np.quantile(row[:, 1], [0.5, 0.95])
        print(f"{name:<22} {found.sum():>6} {over[0]:>20.4f} {over[1]:>7.3f} {ms[0]:>10.1f} {ms[1]:>7.0f}")


if __name__ == "__main__":
    main()
