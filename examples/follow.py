# SPDX-License-Identifier: BSD-3-Clause
"""A car keeps a map of what is around it, and forgets what it has passed: memory stays what it is."""

import argparse

import numpy as np
from matplotlib.figure import Figure

import ndtree

WINDOW, REACH = 20.0, 30.0  # What is kept around the car, and what a scan may change [m].


def follow(scans, window=WINDOW):
    """The map at the end; and after each scan how far the car came [m], and the map's bytes."""
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=0.2, max_cell_size=3.2)
    places, memory = [], []
    for scan in scans:
        scan.insert_into(m, max_range=REACH)
        m.keep_near(scan.origin, window)
        places.append(scan.origin)
        memory.append(m.stats().memory_bytes)
    steps = np.diff(places, axis=0, prepend=places[:1])
    return m, np.cumsum(np.linalg.norm(steps, axis=1)), np.array(memory)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "picture", nargs="?", default="follow.png", help="file to draw the map and its size in"
    )
    parser.add_argument("--scans", type=int, default=40, help="of the drive along the street")
    arguments = parser.parse_args()
    scans = [scan.returned_only() for scan in ndtree.simulate("street", scans=arguments.scans)]
    m, far, memory = follow(scans)
    whole, _, of_whole = follow(scans, window=1e6)
    print(f"after {far[-1]:.0f} m: {memory[-1] / 1e6:.1f} MB, at most {memory.max() / 1e6:.1f} MB; ", end="")
    print(f"the whole street has {of_whole[-1] / 1e6:.1f} MB")
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    for one, color in ((whole, "0.8"), (m, "tab:red")):
        walls = one.leaves(states=["occupied"])
        walls = walls[walls.lower[:, 2] > 0.3]  # Not the ground.
        left.scatter(*walls.center[:, :2].T, s=0.3, color=color, linewidths=0)
    left.set_aspect("equal")
    left.set(title="seen from above: kept and forgotten", xlabel="[m]")
    right.plot(far, of_whole / 1e6, color="0.6", label="the whole street")
    right.plot(far, memory / 1e6, color="tab:red", label=f"{WINDOW:g} m around the car")
    right.set(title="memory", xlabel="driven [m]", ylabel="[MB]", ylim=0.0)
    right.legend()
    figure.savefig(arguments.picture, dpi=90)
