# SPDX-License-Identifier: BSD-3-Clause
"""A robot finds a short path through an office that it mapped, and another when something stands in it."""

import argparse

import numpy as np

import ndtree
from ndtree import plot

RADIUS, MARGIN = 0.25, 0.05  # Of the robot, and what it keeps from the map's walls [m].
START, GOAL = np.array([2.0, 4.0]), np.array([22.0, 17.0])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "picture", nargs="?", default="plan.png", help="file to draw the map and the paths in"
    )
    parser.add_argument("--scans", type=int, help="of the log that is mapped; all unless given")
    arguments = parser.parse_args()
    world, m = ndtree.simulate("office", scans=arguments.scans), ndtree.AdaptiveMap(dim=2, min_cell_size=0.05)
    for scan in world:
        scan.returned_only().insert_into(m, max_range=15.0)
    planner = ndtree.Planner(m, ndtree.Sphere(RADIUS), clearance=MARGIN)
    first = planner.plan(START, GOAL)
    print(
        f"a path of {first.length:.1f} m, {first.clearance:.2f} m from walls, {first.expanded} cells expanded"
    )

    driven = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(first.points, axis=0), axis=1)))
    middle = [np.interp(0.5 * first.length, driven, along) for along in first.points.T]
    m.mark(ndtree.Sphere(0.3), "occupied", [*middle, 0.0])  # Something stands there.
    planner.update(m)
    print(f"blocked in segment {planner.first_blocked(first.points)}")
    second = planner.plan(START, GOAL)
    print(f"a path of {second.length:.1f} m" if second else "no other path")

    ax = plot.occupancy(m)
    for path, color in ((first, "tab:blue"), (second, "tab:red")):
        ax.plot(*path.points.T, color=color, linewidth=2.0)
    ax.figure.savefig(arguments.picture, dpi=90, bbox_inches="tight")
