# SPDX-License-Identifier: BSD-3-Clause
"""A picture of one trial: what stands, where the robot was, what the map has, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trial.outcome import Outcome
from trial.robots import Recording, planar
from trial.scene import Scene

_STATES = {"free": "#e8f0fa", "occupied": "#8a8f98"}
_WAYS = {"true": ("k", "-"), "told": ("tab:orange", ":"), "found": ("tab:red", "-")}


def draw(path: Path, title: str, scene: Scene, r: Recording, outcome: Outcome) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.collections import LineCollection, PatchCollection
    from matplotlib.patches import Circle, Rectangle

    figure, axes = pyplot.subplots(figsize=(11, 8), layout="constrained")
    m = outcome.drawn.get("map")
    for state, colour in _STATES.items() if m is not None else ():
        leaves = m.leaves(states=(state,))
        if m.dim == 3:  # A slice at the sensor's height.
            z = float(np.median(r.true[:, 2, 3]))
            inside = (leaves.lower[:, 2] <= z) & (z < leaves.lower[:, 2] + leaves.size)
        else:
            inside = np.ones(len(leaves.size), bool)
        cells = [Rectangle(low[:2], s, s) for low, s in zip(leaves.lower[inside], leaves.size[inside])]
        axes.add_collection(PatchCollection(cells, facecolor=colour, edgecolor="white", linewidth=0.2))
    axes.add_collection(LineCollection([s for s in scene.segments], colors="tab:blue", linewidths=1))
    round_things = [Circle(xy, radius) for *xy, radius in (c[:3] for c in [*scene.circles, *scene.cylinders])]
    axes.add_collection(PatchCollection(round_things, facecolor="none", edgecolor="tab:blue"))
    for center, half, turn in scene.boxes:
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half[:2]
        axes.plot(*(center[:2] + corners @ turn[:2, :2]).T, color="tab:blue", linewidth=0.8)
    ways = {"true": planar(r.true)[:, :2]}
    ways.update({name: outcome.drawn[name] for name in _WAYS if name in outcome.drawn})
    for name, way in ways.items():
        colour, style = _WAYS[name]
        axes.plot(way[:, 0], way[:, 1], style, color=colour, linewidth=1.2, label=name)
    for name, points in outcome.drawn.items():
        if name not in (*_WAYS, "map") and len(points):
            axes.plot(points[:, 0], points[:, 1], ".", markersize=5, label=f"{name}: {len(points)}")
    seen = np.concatenate([*ways.values(), *[r.beams(i)[0][r.beams(i)[2], :2] for i in range(0, len(r), 5)]])
    low, high = np.percentile(seen, 1, axis=0) - 0.5, np.percentile(seen, 99, axis=0) + 0.5
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(f"{title}\n{outcome}", fontsize=9, wrap=True)
    axes.legend(loc="upper right", fontsize=8)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
