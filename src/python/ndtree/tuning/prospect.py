# SPDX-License-Identifier: BSD-3-Clause
"""What will come of mapping a log: with which options, whether its poses reach, how long it takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ndtree.base.progress import Progress
from ndtree.logs.core.log import Log
from ndtree.tuning.config import Config
from ndtree.tuning.inspection import BEYOND_MEMORY, inspect


@dataclass(frozen=True)
class Prospect:
    """What was decided of a log, when its scans and poses were [s], and what mapping costs [s, bytes]."""

    config: Config
    spans: dict[str, tuple[float, float]]
    cost: tuple[float, float] | None

    def figures(self) -> dict[str, Any]:
        """All of it as plain numbers, ready for JSON."""
        look = self.config.look
        return {
            "chosen": None if look is None else look.figures(),
            "flags": self.config.chosen,
            "spans": {name: list(span) for name, span in self.spans.items()},
            "cost": None if self.cost is None else dict(zip(("seconds", "memory_bytes"), self.cost)),
        }

    def lines(self) -> list[str]:
        """For people."""
        lines = []
        scans, poses = self.spans.get("scans"), self.spans.get("poses")
        if scans is not None and poses is not None:
            lines.append(
                f"scans from {scans[0]:.3f} to {scans[1]:.3f} s, "
                f"poses from {poses[0]:.3f} to {poses[1]:.3f} s "
                f"(scans begin {_away(scans[0] - poses[0])} and end {_away(scans[1] - poses[1])})"
            )
        lines += self.config.notes
        if self.cost is not None:
            seconds, memory = self.cost
            lines.append(f"mapping will take about {_rounded(seconds)} s, and {_rounded(memory / 2**20)} MiB")
        return lines


def prospect_of(log: Log, given: Config | None = None, *, progress: Progress | None = None) -> Prospect:
    """What `inspect` decides of a log, and what that will cost."""
    config = inspect(log, given, progress=progress)
    try:
        cost = None if config.look is None else config.look.cost()
    except MemoryError:
        raise ValueError(f"{log.name}: {BEYOND_MEMORY}") from None
    return Prospect(config, log.spans, cost)


def _away(seconds: float) -> str:
    return f"{abs(seconds):.2f} s {'earlier' if seconds < 0 else 'later'}"


def _rounded(value: float) -> str:
    return f"{value:.1g}" if value < 1 else f"{value:.2g}" if value < 100 else f"{value:.0f}"
