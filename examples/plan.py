# SPDX-License-Identifier: BSD-3-Clause
"""A robot finds a way through an office by a rapidly-exploring random tree (RRT), on a map that it made."""

import argparse

import numpy as np

import ndtree
from ndtree import plot

RADIUS, MARGIN = 0.25, 0.05  # Of the robot, and what the map's walls may be beside the true ones [m].
STEP = 1.0  # Longest edge of the tree [m].
BODY = ndtree.Sphere(RADIUS + MARGIN)


def poses(points):
    """x, y and yaw, which is all the same to a disc."""
    return np.column_stack((points, np.zeros(len(points))))


def is_free(m, way):
    return m.path_collides(BODY, poses(way), unknown="occupied") < 0


def plan(m, start, goal, rng, most=20_000):
    """Points of a way from start to goal, and the tree: points, and the number of the one before each."""
    lower, upper = m.bounds()
    samples = np.where(rng.random((most, 1)) < 0.1, goal, rng.uniform(lower, upper, (most, 2)))
    points, before = np.empty((most + 1, 2)), np.zeros(most + 1, dtype=int)
    points[0], n = start, 1
    for sample in samples:
        nearest = np.linalg.norm(points[:n] - sample, axis=1).argmin()
        way = sample - points[nearest]
        points[n] = points[nearest] + way * min(1.0, STEP / max(np.linalg.norm(way), 1e-9))
        if not is_free(m, points[[nearest, n]]):
            continue
        before[n], n = nearest, n + 1
        if np.linalg.norm(points[n - 1] - goal) < 1e-9:
            back = [n - 1]
            while back[-1] > 0:
                back.append(before[back[-1]])
            return points[back[::-1]], points[:n], before[:n]
    raise ValueError(f"no way from {start} to {goal} in {most} samples")


def shortened(m, way, rng, tries=300):
    """The way with corners cut wherever a straight line between two of its points is free."""
    for _ in range(tries if len(way) > 2 else 0):
        edges = np.sort(rng.choice(len(way) - 1, 2, replace=False))
        cut = [way[i] + rng.random() * (way[i + 1] - way[i]) for i in edges]
        if is_free(m, np.array(cut)):
            way = np.vstack((way[: edges[0] + 1], cut, way[edges[1] + 1 :]))
    return way


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", nargs="?", default="plan.png", help="file to draw the map and the way in")
    parser.add_argument("--scans", type=int, help="of the log that is mapped; all unless given")
    arguments = parser.parse_args()
    world, rng = ndtree.simulate("office", scans=arguments.scans), np.random.default_rng(4)
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05)
    for scan in world:
        scan.returned_only().insert_into(m, max_range=15.0)
    rough, points, before = plan(m, np.array([2.0, 4.0]), np.array([22.0, 17.0]), rng)
    way = shortened(m, rough, rng)
    lengths = [np.linalg.norm(np.diff(one, axis=0), axis=1).sum() for one in (rough, way)]
    print(f"{len(points)} points in the tree, a way of {lengths[0]:.1f} m, {lengths[1]:.1f} m when shortened")
    ax = plot.occupancy(m)
    for end, begin in zip(points, points[before]):
        ax.plot(*np.transpose((begin, end)), color="tab:blue", linewidth=0.5)
    ax.plot(*way.T, color="tab:red", linewidth=2.0)
    ax.figure.savefig(arguments.picture, dpi=90, bbox_inches="tight")
