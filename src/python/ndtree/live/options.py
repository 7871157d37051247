# SPDX-License-Identifier: BSD-3-Clause
"""What a user says of how a live map is made: the same for the command line and the nodes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ndtree._errors import WrongOption, key
from ndtree._native._core import OccupancyMap
from ndtree.live.corrections import MEMORY, Corrections
from ndtree.live.fading import Fading
from ndtree.live.localizing import ODOMETRY, Localizer, place_of
from ndtree.live.messages import LOOK, MessagesIntake
from ndtree.live.session import Session
from ndtree.live.settings import PATIENCE, QUEUE, LiveSettings
from ndtree.live.slam import Slam, scans_beside
from ndtree.live.window import Window
from ndtree.tuning.config import Config

#: What does not go together with what, and why.
_ALONE = "whose map is of scans alone, with adaptive cells"
_EXCLUDES = {
    "localize": (("window", "fade", "resume", "fixed", "follow", "slam"), "which makes no map"),
    "slam": (("window", "fade", "fixed", "follow"), _ALONE),
    "follow": (("window", "fade", "resume", "fixed"), _ALONE),
}


@dataclass(frozen=True)
class LiveOptions:
    """How a live map is made, as far as a `Config` does not say it; WrongOption if two do not go together."""

    look: float = LOOK  # As of `MessagesIntake` [s].
    queue: int = QUEUE  # As of `LiveSettings`, ...
    patience: float = PATIENCE
    threads: int = 0
    window: float | None = None  # Of a `Window` [m].
    fade: float | None = None  # Of `Fading` [s].
    follow: str = ""  # As of `MessagesIntake`; the frame is its `body`.
    follow_frame: str = ""
    follow_memory: float = MEMORY / 2**20  # Of scans that can move [MiB].
    slam: bool = False  # Poses are found.
    localize: str | os.PathLike[str] | None = None  # A map that the sensor is found in; nothing is mapped.
    initial_pose: str = ""  # X,Y,YAW of the sensor in a saved map; else it is looked for.
    resume: str | os.PathLike[str] | None = None  # A map that is gone on with.
    fixed: bool = False  # All cells have one size.

    def __post_init__(self) -> None:
        for way, (others, why) in _EXCLUDES.items():
            for name in others if getattr(self, way) else ():
                if getattr(self, name) not in (None, "", False):
                    why = "which corrects poses itself" if name == "follow" and way == "slam" else why
                    raise WrongOption(f"{key(name)}: not with {key(way)}, {why}")

    @property
    def finds_poses(self) -> bool:
        """Whether scans are placed in the frame of odometry, and found in the map."""
        return self.slam or self.localize is not None

    def beginning(
        self, given: Config, load: Callable[[Path], OccupancyMap]
    ) -> tuple[Config, OccupancyMap | Session | None]:
        """What was given and a saved map says, and the map, or the drive, that is gone on with or searched.

        `load`: Opens a map; what it raises is raised.
        """
        file = self.localize or self.resume
        given = given.overridden(Config.of(fixed=self.fixed or None).values)
        if file is None:
            return given, None
        begun = Session.load(scans_beside(file)) if self.slam else load(Path(file))
        return given.overridden(Config.of(**begun.options).values), begun

    def intake(self, name: str, given: Config) -> MessagesIntake:
        """Of messages; ValueError if a number is out of its limits."""
        if self.finds_poses:
            given = Config.of(fixed_frame=ODOMETRY).overridden({**given.values, **Config.of(dim=2).values})
        return MessagesIntake(
            name,
            given,
            look=self.look,
            follow=self.follow,
            body=self.follow_frame,
            poses_are_found=self.slam,
        )

    def settings(
        self, given: Config, begun: OccupancyMap | Session | None, *, odometry: bool | None = None
    ) -> LiveSettings:
        """Of a mapper.

        `given`, `begun`: As `beginning` has them.
        `odometry`: As for `Slam`.
        Raises ValueError if a number is out of its limits.
        """
        place = place_of(self.initial_pose) if self.initial_pose else None
        target = begun if isinstance(begun, OccupancyMap) else None
        session = begun if isinstance(begun, Session) else None
        memory = int(self.follow_memory * 2**20)
        moves = bool(self.slam or self.follow)
        return LiveSettings(
            target=target,
            make=given.new_map,
            queue=self.queue,
            patience=self.patience,
            threads=self.threads,
            window=None if self.window is None else Window(self.window),
            fading=None if self.fade is None else Fading(self.fade),
            corrections=Corrections(memory=memory, threads=self.threads) if moves else None,
            localizer=None if self.localize is None or target is None else Localizer(target, place),
            slam=Slam(odometry=odometry, earlier=session, guess=place) if self.slam else None,
        )
