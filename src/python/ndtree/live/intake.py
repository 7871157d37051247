# SPDX-License-Identifier: BSD-3-Clause
"""What a live mapper is given, and how that becomes scans in the map's frame."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any, NamedTuple

from ndtree.base.scan import Scan
from ndtree.live.corrections import Correction, Motion
from ndtree.live.figures import LiveFigures
from ndtree.live.queue import Entry
from ndtree.logs.core.failures import NoPose
from ndtree.logs.core.log import Log
from ndtree.logs.poses.following import FALL
from ndtree.logs.poses.transforms import TransformTree
from ndtree.tuning.config import Config


class Verdict(Enum):
    """Why there is no scan."""

    wait = "its pose is not known yet"
    left_out = "it was counted, and is not mapped"


class Intake(ABC):
    """Makes scans of items. The mapper calls it from one thread, but for `is_pose` and `begin`.

    `config`: How scans are mapped; None until it is decided.
    `dim`: Of the scans, once it is decided.
    `sensors`: Of several, items are put into the order of their stamps.
    `look`: For how long measurements are looked at before it is decided [s].
    `may_revise`: Whether what was decided may be decided anew: measurements are kept until then.
    `notes`: What was decided, and a user should know, each in one line.
    """

    config: Config | None = None
    dim: int
    sensors: Sequence[str] = ()
    look = 0.0
    may_revise = False

    def __init__(self) -> None:
        self.notes: list[str] = []

    def is_pose(self, item: Any) -> bool:
        """Whether an item is no measurement, but says where something is."""
        return False

    def pose(self, item: Any, figures: LiveFigures) -> None:
        """Take note of a pose."""
        raise TypeError(f"{item!r}: takes no poses")

    def key(self, item: Any) -> tuple[str, float]:
        """The sensor of an item, and its stamp [s]."""
        return "", 0.0

    def said(self) -> list[str]:
        """What was decided, and what was seen since that a user should know."""
        return self.notes

    def begin(self, received: float) -> None:
        """Take note of when a measurement came [s]."""
        return

    def moved(self, item: Any, received: float) -> Any:
        """An item as if it had come at another time [s]."""
        return item

    def is_decidable(self, now: float) -> bool:
        """Whether enough was seen to decide how to map, or to decide it anew."""
        return True

    def decide(self, waiting: Sequence[Entry], everything: bool = False) -> bool:
        """Decide how to map; whether that is another way than before.

        `waiting`: Measurements that wait or were kept, and poses that wait.
        `everything`: Nothing more comes.
        Raises ValueError if what came does not tell, and more may.
        """
        raise ValueError(f"{type(self).__name__}: expected its config to be given")

    def too_early(self) -> list[tuple[Any, float]]:
        """Poses that were taken to decide, to be taken again when a scan needs them, and when they came."""
        return []

    def motion(self) -> Motion | None:
        """Where the sensor of the last scan was; None where nothing moves, or poses are of the map alone."""
        return None

    def corrections(self) -> list[Correction]:
        """What was learned of earlier poses since the last call."""
        return []

    @abstractmethod
    def scan(self, entry: Entry, give_up: bool, figures: LiveFigures) -> Scan | Verdict:
        """A scan of a measurement.

        `give_up`: Nothing is worth waiting for any longer.
        `figures`: Counts what is left out.
        """


class ScansIntake(Intake):
    """Takes `Scan`: measurements whose poses are known already, of a log if that is given."""

    config: Config

    def __init__(self, config: Config, dim: int, log: Log | None = None) -> None:
        super().__init__()
        self.config, self.dim, self._log = config, dim, log

    def said(self) -> list[str]:
        log = self._log
        uses = [] if log is None or not log.uses else [f"uses {log.uses}"]
        chosen = [] if log is None else [*uses, *self.config.notes, *log.notes]
        return [*chosen, *self.notes]

    def scan(self, entry: Entry, give_up: bool, figures: LiveFigures) -> Scan | Verdict:
        scan = entry.item
        if not isinstance(scan, Scan):
            raise TypeError(f"found {type(scan).__name__}, expected Scan")
        return scan


def motion_in(tree: TransformTree, fixed: str, sensor: str, stamp: float, body: str = "") -> Motion | None:
    """Where a sensor was at a time [s].

    `fixed`, `sensor`: Frames of the map and of the sensor.
    `body`: The robot's frame; else the one that moves and is next to the sensor.
    """
    found = tree.body_of(fixed, body or sensor)
    if found is None:
        return None
    odometry, moving = found
    body = body or moving
    return Motion(
        stamp,
        tree.pose_at(fixed, sensor, stamp),
        tree.pose_at(odometry, body, stamp),
        tree.pose_at(body, sensor, stamp),
    )


#: What scans without a pose are called, by where their time is.
UNPOSED = {
    "before": "before the first pose",
    "after": "no pose in time",
    "in a gap": "in a gap of the poses",
}


class Times(NamedTuple):
    """When a measurement began and last needs a pose, and up to when poses are known [s]."""

    stamp: float
    last: float
    until: float


class PosedIntake(Intake):
    """Takes measurements that may come before the poses of their time."""

    def __init__(self) -> None:
        super().__init__()
        self._latest: dict[str, float] = {}
        self._corrections: list[Correction] = []

    def corrections(self) -> list[Correction]:
        taken, self._corrections = self._corrections, []
        return taken

    def _posed(
        self,
        sensor: str,
        times: Times,
        give_up: bool,
        place: Callable[[], Scan],
        figures: LiveFigures,
    ) -> Scan | Verdict:
        """A scan with poses, if they are known or nothing is worth waiting for.

        `sensor`: That measured; the clock of each may begin again.
        `give_up`: As for `scan`.
        `place`: Makes the scan; raises NoPose.
        """
        stamp, last, until = times
        if last > until and not give_up:
            return Verdict.wait
        latest = self._latest.get(sensor, -math.inf)
        has_fallen = stamp < latest - FALL
        # A clock that begins again does so for scans before it does for poses, or after: then poses of this
        # time are of the time before.
        is_ahead = has_fallen and last + FALL < until < math.inf
        if is_ahead and not give_up:
            return Verdict.wait
        try:
            scan = place()
        except NoPose as error:
            if error.where == "before" and has_fallen and not give_up:
                return Verdict.wait
            self._latest[sensor] = stamp if has_fallen else max(latest, stamp)
            figures.leave_out(UNPOSED[error.where])
            return Verdict.left_out
        self._latest[sensor] = stamp if has_fallen else max(latest, stamp)
        figures.unsure += last > until or is_ahead
        return scan
