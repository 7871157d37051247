# SPDX-License-Identifier: BSD-3-Clause
"""A robot finds a short path through an office, on a map that it made, and another one when a door closes."""

import argparse

import numpy as np

import ndtree
from ndtree import plot

RADIUS, MARGIN = 0.25, 0.05  # Of the robot, and what it keeps from the map's walls [m].
START, GOAL = np.array([2.0, 4.0]), np.array([22.0, 17.0])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", nargs="?", default="plan.png", help="file to draw the map and the ways in")
    parser.add_argument("--scans", type=int, help="of the log that is mapped; all unless given")
    arguments = parser.parse_args()
    world, m = ndtree.simulate("office", scans=arguments.scans), ndtree.AdaptiveMap(dim=2, min_cell_size=0.05)
    for scan in world:
        scan.returned_only().insert_into(m, max_range=15.0)
    planner = ndtree.Planner(m, ndtree.Sphere(RADIUS), clearance=MARGIN)
    first = planner.plan(START, GOAL)
    print(
        f"a way of {first.length:.1f} m, {first.clearance:.2f} m from walls, {first.expanded} cells expanded"
    )

    middle = first.points[len(first) // 2]
    m.mark(ndtree.Sphere(0.3), "occupied", [*middle, 0.0])  # Something stands in the way.
    planner.update(m)
    print(f"blocked in segment {planner.first_blocked(first.points)}")
    second = planner.plan(START, GOAL)
    print(f"a way of {second.length:.1f} m" if second else "no other way")

    ax = plot.occupancy(m)
    for path, color in ((first, "tab:blue"), (second, "tab:red")):
        ax.plot(*path.points.T, color=color, linewidth=2.0)
    ax.figure.savefig(arguments.picture, dpi=90, bbox_inches="tight")
