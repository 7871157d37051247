# SPDX-License-Identifier: BSD-3-Clause
"""How alignments of any dimension are written: the trajectory, the picture, and whether to trust them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ndtree.alignment.planar import Floats
from ndtree.base.files import begins_with, replaced


def is_trajectory(path: str) -> bool:
    """Whether a file begins with a pose of TUM's, comments apart."""
    return begins_with(path, rb"(?:[ \t]*(?:#[^\n]*)?\n)*(?:[-+.\deE]+[ \t]+){7}[-+.\deE]+\s")


def write_trajectory(
    path: str | os.PathLike[str], stamps: Floats, places: Floats, quaternions: Floats
) -> None:
    """As TUM's, whole or not at all: a line of stamp [s], place [m], quaternion (x, y, z, w) a scan."""
    rows = np.column_stack((stamps, places, quaternions))
    with replaced(path, is_trajectory) as part:
        np.savetxt(part, rows, fmt=["%.6f"] + ["%.9g"] * 7)


def draw_before_and_after(
    path: str | os.PathLike[str], before: tuple[Floats, Floats], after: tuple[Floats, Floats]
) -> None:
    """Two pictures side by side, from above, each of end points and the sensor's way [m]."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 7), layout="constrained")
    for axes, name, (points, way) in zip(figure.subplots(1, 2), ("before", "after"), (before, after)):
        axes.plot(points[:, 0], points[:, 1], ",", color="black")
        axes.plot(way[:, 0], way[:, 1], "-", color="tab:red", linewidth=0.6)
        axes.set(title=name, aspect="equal", xlabel="x [m]", ylabel="y [m]")
    with replaced(path) as part:
        figure.savefig(part, dpi=110, format=Path(path).suffix.lower().lstrip(".") or "png")


def compared(after: int, before: int) -> str:
    """How many cells end points fill, beside how many they filled before: "3 % more", say."""
    percent = round(100 * (after / max(before, 1) - 1))
    return "as many" if percent == 0 else f"{abs(percent)} % {'more' if percent > 0 else 'fewer'}"


def verdict(doubts: list[str]) -> str:
    """Whether to trust poses, in words."""
    return f"doubtful: {'; '.join(doubts)}" if doubts else "no reason to doubt them"
