# SPDX-License-Identifier: BSD-3-Clause
"""A robot explores an unknown office: it drives to the nearest frontier until there is none."""

import argparse

import numpy as np

import ndtree
from ndtree import plot

RADIUS, GRID = 0.2, 0.1  # Of the robot, and of the grid that it plans on [m].
BEAMS = np.array([(np.cos(a), np.sin(a)) for a in np.linspace(0.0, 2 * np.pi, 720, endpoint=False)])
AROUND = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])


def look(world, m, position, rng, reach=12.0):
    """Insert what a laser scanner measures there."""
    ranges = world.distance(position, BEAMS, max_range=reach)
    ends = np.where(np.isnan(ranges), reach, ranges + rng.normal(0.0, 0.02, len(ranges)))
    m.insert(position + ends[:, None] * BEAMS, position, returned=~np.isnan(ranges))


def shortest_way(start, ends, passable):
    """Cells of a grid from beside the start to the nearest end; None if there is no way."""
    waves = [np.zeros_like(passable)]
    waves[0][start] = True
    while len(waves) == 1 or not (waves[-1] & ends).any():  # The grid's border is not passable.
        wave = passable & np.any([np.roll(waves[-1], step, axis=(0, 1)) for step in AROUND], axis=0)
        if not wave.any():
            return None
        passable = passable & ~wave
        waves.append(wave)
    way = [np.argwhere(waves.pop() & ends)[0]]
    for wave in waves[:0:-1]:  # Backwards, always to a neighbour that is one step nearer.
        way.append(next(cell for cell in way[-1] + AROUND if wave[tuple(cell)]))
    return np.array(way[::-1])


def way_to_frontier(m, track, goals):
    """Points from here to the nearest frontier where the robot was not yet; None if none is in reach."""
    box = np.array(m.bounds()) + np.array([[-GRID], [GRID]])
    field = m.distance_field(box, GRID, max_distance=RADIUS + GRID)
    centers, lower = field.centers, field.lower
    here = np.linalg.norm(centers - track[-1], axis=-1) < RADIUS + GRID  # Where it is, it may be.
    free = (m.state(centers) == 0) & (here | (field.values > RADIUS))
    free[tuple(((np.array(track) - lower) // GRID).astype(int).T)] = True  # And the way that it came.
    ends = np.zeros_like(free)
    for frontier in m.frontiers(min_cells=8):
        ends[tuple(((frontier.cell_centers - lower) // GRID).astype(int).T)] = True
    for goal in goals:  # There is nothing more to be seen from there.
        ends &= np.linalg.norm(centers - goal, axis=-1) > 0.5
    way = shortest_way(tuple(((track[-1] - lower) // GRID).astype(int)), ends, free)
    return None if way is None else centers[tuple(way.T)]


def explore(world, scans=500):
    """The map, the points where the robot was, and whether it was done."""
    rng, m = np.random.default_rng(1), ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, range_sigma=0.02)
    track, goals = [world[0].origin], []
    for _ in range(scans):
        look(world, m, track[-1], rng)
        way = way_to_frontier(m, track, goals)
        if way is None:
            return m, np.array(track), True
        track.extend(way[:10])  # At most a metre, then it looks and thinks again.
        goals += [track[-1]] if len(way) <= 10 else []
    return m, np.array(track), False


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", nargs="?", default="explore.png", help="file to draw in")
    parser.add_argument("--scans", type=int, default=500, help="that the robot may take at most")
    arguments = parser.parse_args()
    m, track, done = explore(ndtree.simulate("office"), arguments.scans)
    print(f"{len(track) * GRID:.0f} m driven, {'nothing left to see' if done else 'not done'}: {m}")
    ax = plot.occupancy(m)
    ax.plot(*track.T, color="tab:red", linewidth=1.0)
    ax.figure.savefig(arguments.picture, dpi=90, bbox_inches="tight")
