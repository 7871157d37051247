# SPDX-License-Identifier: BSD-3-Clause
"""What a user says of how a live map is made: the same for the command line and the nodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from ndtree._errors import WrongOption, key
from ndtree._native._core import OccupancyMap
from ndtree.base.options import options_of
from ndtree.live.corrections import Corrections
from ndtree.live.fading import Fading, Window
from ndtree.live.localizing import ODOMETRY, Localizer, place_of
from ndtree.live.messages import MessagesIntake
from ndtree.live.session import Session
from ndtree.live.settings import LiveSettings
from ndtree.live.slam import Slam, scans_beside
from ndtree.tuning.config import Config

#: What does not go together with what, and why.
_ALONE = "whose map is of scans alone, with adaptive cells"
_EXCLUDES = {
    "localize": (("window", "fade", "resume", "fixed", "follow", "slam"), "which makes no map"),
    "slam": (("window", "fade", "fixed", "follow"), _ALONE),
    "follow": (("window", "fade", "resume", "fixed"), _ALONE),
}


class LiveOptions(SimpleNamespace):
    """How a live map is made, as far as a `Config` does not say it: what ``ndtree live`` takes, by the table.

    `given`: What a user said, by the names of options; None and what is not there is as the table has it.
    Raises WrongOption if two do not go together.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        said = {name: value for name, value in given.items() if value is not None}
        super().__init__(threads=said.get("threads", 0))
        for row in options_of("live"):
            setattr(self, row.name, said.get(row.name, row.default))
        for way, (others, why) in _EXCLUDES.items():
            for name in others if getattr(self, way) else ():
                if getattr(self, name) not in (None, "", False):
                    why = "which corrects poses itself" if name == "follow" and way == "slam" else why
                    raise WrongOption(f"{key(name)}: not with {key(way)}, {why}")

    @property
    def finds_poses(self) -> bool:
        """Whether scans are placed in the frame of odometry, and found in the map."""
        return bool(self.slam or self.localize is not None)

    def beginning(
        self, given: Config, load: Callable[[Path], OccupancyMap]
    ) -> tuple[Config, OccupancyMap | Session | None]:
        """What was given and a saved map says, and the map, or the drive, that is gone on with or searched.

        `load`: Opens a map; what it raises is raised.
        """
        file = self.localize or self.resume
        if file is None:
            return given, None
        begun = Session.load(scans_beside(file)) if self.slam else load(Path(file))
        dim = {} if self.localize is None or isinstance(begun, Session) else {"dim": begun.dim}
        return given.overridden(Config.of(**begun.options, **dim).values), begun

    def intake(self, name: str, given: Config) -> MessagesIntake:
        """Of messages; ValueError if a number is out of its limits."""
        if self.finds_poses:
            dim = given.get("dim", 2) if self.localize is not None else 2
            given = Config.of(fixed_frame=ODOMETRY).overridden({**given.values, **Config.of(dim=dim).values})
        return MessagesIntake(
            name,
            given,
            look=self.look,
            follow=self.follow or "",
            body=self.follow_frame or "",
            poses_are_found=self.slam,
        )

    def settings(
        self, given: Config, begun: OccupancyMap | Session | None, *, odometry: bool | None = None
    ) -> LiveSettings:
        """Of a mapper, of what `beginning` has, and `odometry` for `Slam`; ValueError for wrong numbers."""
        target = begun if isinstance(begun, OccupancyMap) else None
        dim = target.dim if self.localize and target is not None else 2
        place = place_of(self.initial_pose, dim) if self.initial_pose else None
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
