# SPDX-License-Identifier: BSD-3-Clause
"""What a trial's answer is worth, and from when on it is wrong."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from trial.worlds import Random, World

RIGHT, DOUBTED, REFUSED, WRONG = VERDICTS = ("right", "doubted", "refused", "wrong")

#: Name: limit, unit, and why that much. Chosen before anything was measured.
TOLERANCES: dict[str, tuple[float, str, str]] = {
    "beside a surface": (2.0, "cells, and 3 sigma", "a wall takes its own cell, noise the next"),
    "rays that pass": (0.5, "% of rays to what 5 beams met", "where cells of one size stop them"),
    "free but hidden": (
        0.2,
        "% of the free points",
        "nobody looked there, and cells of one size are not free",
    ),
    "seen but unknown": (
        2.0,
        "% of points that 3 scans passed",
        "a planner goes round what is not known; if it is said that what beams without return alone "
        "crossed stays unknown, that and nothing else is doubted",
    ),
    "false occupied": (0.2, "% of points that 3 scans passed", "a planner goes round it for ever"),
    "ghosts": (1.0, "% of the points of what left", "as many scans passed as it stood for, or a dozen"),
    "walls lost": (2.0, "% of walls that 5 beams met", "what stands is in the map, within a cell"),
    "displaced walls": (10.0, "% of the occupied area", "walls are double where it is seen"),
    "noise": (2.0, "times too much or too little, and 5 mm", "tests at 3 sigma become tests at 1.5 or 6"),
    "mount place": (0.05, "m, or 3 sigma", "a cell"),
    "mount yaw": (1.0, "degrees, or 3 sigma", "a cell at 3 m"),
    "mount time": (0.1, "s, or 3 sigma", "a scan"),
    "poses": (0.15, "m, and 1 % of the way", "three cells: walls double"),
    "normalized error": (1.5, "times what is told", "one in 1,000 of 30 true standard deviations is above"),
    "told place": (0.15, "m, or 3 sigma", "a door is missed"),
    "told in a row": (10.0, "scans", "a second at 10 Hz, in which a step of odometry may be noticed"),
    "standing removed": (0.2, "% of standing points", "a map without its fences is no map"),
    "moved kept": (10.0, "% of moving points that a later scan passes", "nobody's noise is as large"),
    "no claim": (
        0.1,
        "of a probability, from one half",
        "odds of 2 to 3 say neither that it stands nor that it moved",
    ),
    "standing undecided": (
        20.0,
        "% of standing points",
        "who says of a fifth that it may go says too little",
    ),
    "told clearance": (1.0, "cells, and 3 sigma, too large", "surfaces are known up to a cell"),
    "through hidden": (0.0, "paths through hidden space", "unknown space is blocked"),
    "longer than a known way": (2.0, "% than the robot's own", "which went through what it saw"),
    "no way": (0.0, "ways that the robot went", "through what three scans passed"),
    "other after a change": (0.005, "m in length", "a planner that follows is as a new one"),
    "grid": (1.0, "% of columns", "a robot that drives by it"),
}


def limit(name: str) -> float:
    return TOLERANCES[name][0]


@dataclass(frozen=True)
class Case:
    """One trial: a world, what goes wrong in it, and where all else is drawn from.

    `is_fixed` asks the map with cells of one size instead, which is the control of the judges.
    """

    world: World
    fault: str
    rng: Random
    dim: int
    is_fixed: bool = False


@dataclass
class Outcome:
    """One trial's answer.

    Attributes
    ----------
    faults : list of str
        What is wrong with it; empty if it is right.
    words : list of str
        The doubts that came with it.
    refused : str
        Why there is no answer.
    figures : dict
        What was measured.
    drawn : dict
        For a picture.
    may_doubt : bool
        The world does not tell: a doubt of a right answer is right, too.
    """

    faults: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    refused: str = ""
    figures: dict[str, Any] = field(default_factory=dict)
    drawn: dict[str, Any] = field(default_factory=dict, repr=False)
    may_doubt: bool = False

    @property
    def verdict(self) -> str:
        if self.refused:
            return REFUSED
        if self.words:
            return DOUBTED
        return WRONG if self.faults else RIGHT

    @property
    def is_needless(self) -> bool:
        """Whether it is doubted although it is right."""
        return bool(self.words) and not (self.faults or self.refused or self.may_doubt)

    def expect(self, name: str, value: float, what: str = "", most: float | None = None) -> None:
        """A figure that may not be above its limit; nan, where there was nothing to measure, is none."""
        self.figures[name] = round(float(value), 4)
        if value > (limit(name) if most is None else most):
            self.faults.append(f"{name} {value:.3g} {what or TOLERANCES[name][1].split(' ')[0]}")

    def excuse(self, unknown: list[str]) -> None:
        """Count what is said of space that stays unknown as a doubt, if that alone is wrong."""
        if self.faults and all(one.startswith("seen but unknown") for one in self.faults):
            self.words += unknown

    def __str__(self) -> str:
        why = self.refused or "; ".join(self.faults) or ", ".join(f"{k} {v}" for k, v in self.figures.items())
        said = f" | says: {'; '.join(self.words)}" if self.words else ""
        return f"{self.verdict}: {why}{said}"
