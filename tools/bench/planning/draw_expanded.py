#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Draw the cells that searches for a path look at: the planner's beside Lazy Theta*'s on the smallest cells.

usage: draw_expanded.py BENCH PICTURE [--seed S]

BENCH is the program ndtree-bench-planning. The map is that of a simulated office, the pair of places the
first that BENCH draws.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image

import ndtree
from ndtree import plot

COLORS = {"coarse": "#9ecae1", "planner": "#3182bd", "grid": "#9ecae1"}


def expanded(bench: str, m, seed: int) -> dict[str, np.ndarray]:
    """Lower corner and edge of cells (n, 3), of each search, and the path."""
    with tempfile.TemporaryDirectory() as folder:
        file, cells = Path(folder) / "office.ndt", Path(folder) / "cells.txt"
        m.save(file)
        options = ["--radius", "0.15", "--pairs", "1", "--seed", str(seed), "--expanded", str(cells)]
        subprocess.run([bench, str(file), *options], check=True, stdout=subprocess.DEVNULL)
        lines = [line.split() for line in cells.read_text().splitlines()]
    return {
        name: np.array([line[1:] for line in lines if line[0] == name], float)
        for name in ("coarse", "planner", "grid", "path")
    }


def draw(ax, m, looks: dict[str, np.ndarray], names: tuple[str, ...], title: str) -> None:
    plot.occupancy(m, ax)
    for name in names:
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        cells = looks[name][:, None, :2] + corners * looks[name][:, None, 2:]
        ax.add_collection(PolyCollection(cells, facecolor=COLORS[name], edgecolor="white", linewidth=0.05))
    ax.plot(*looks["path"][:, :2].T, color="tab:red", linewidth=1.2)
    ax.plot(*looks["path"][[0, -1], :2].T, "o", color="tab:red", markersize=4)
    ax.set(title=title, xlabel="x [m]", ylabel="y [m]")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bench")
    parser.add_argument("picture", type=Path)
    parser.add_argument("--seed", type=int, default=5)
    call = parser.parse_args()
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05)
    for scan in ndtree.simulate("office"):
        scan.returned_only().insert_into(m, max_range=15.0)
    looks = expanded(call.bench, m, call.seed)
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    coarse, fine, grid = (len(looks[name]) for name in ("coarse", "planner", "grid"))
    draw(left, m, looks, ("coarse", "planner"), f"planner: {coarse:,} coarse cells, then {fine:,} cells")
    draw(right, m, looks, ("grid",), f"Lazy Theta* on the smallest cells: {grid:,}")
    figure.savefig(call.picture, dpi=100)
    with Image.open(call.picture) as picture:
        few = picture.convert("RGB").quantize(64, dither=Image.Dither.NONE)
    few.save(call.picture, optimize=True)


if __name__ == "__main__":
    main()
