# SPDX-License-Identifier: BSD-3-Clause
"""The map of a live mapper: scans are inserted into it, move in it, or are found in it.

One thread changes it by scans; others look at snapshots, change it while they hold its lock, or replace it.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from ndtree._errors import Text, key, spelled
from ndtree._native._core import InsertReport, OccupancyMap
from ndtree.base.scan import Scan
from ndtree.live.corrections import Corrections
from ndtree.live.figures import LiveFigures
from ndtree.live.intake import Intake
from ndtree.live.localizing import Localizer
from ndtree.live.session import Session
from ndtree.live.settings import LiveSettings
from ndtree.live.slam import NOT_FOUND, Slam
from ndtree.tuning.config import Config

#: Scans that are compared with a saved map, and end points of each: as many tell all there is to know.
_COMPARED, _ENDS = 100, 500


class LeftOut(Exception):
    """Why a scan is not mapped, as figures name it."""


class SavedMap:
    """Whether scans fit the map that is gone on with: another frame is told by ends where it is free."""

    def __init__(self, m: OccupancyMap) -> None:
        self._map = m.snapshot()
        self._scans = self._fit = self._against = 0

    def look(self, scan: Scan) -> None:
        """Take note of a scan before it is mapped."""
        if scan.points_only or scan.dim != self._map.dim:
            return
        ends = scan.endpoints[scan.hits()]
        moved = self._map.moved(ends[:: max(1, len(ends) // _ENDS)])
        fit, against = int((moved < 0.5).sum()), int((moved > 0.5).sum())
        self._fit, self._against = self._fit + fit, self._against + against
        self._scans += 1

    @property
    def is_done(self) -> bool:
        """Whether no more scans are to be looked at."""
        return self._scans >= _COMPARED

    @property
    def doubt(self) -> Text | None:
        """Why scans and map may be in different frames."""
        if self._fit > self._against or not self._scans:
            return None
        told = self._fit + self._against
        share = f"{100 * self._against / told:.0f} % of their end points lie where it is free" if told else ""
        return Text(
            f"scans do not fit the saved map: {share or 'none ends where it was observed'}. "
            f"Its frame may be another; {key('localize')} finds the sensor in it"
        )


def target_of(intake: Intake, how: LiveSettings, figures: LiveFigures) -> Target:
    """As the settings want it."""
    if how.localizer is not None:
        return SearchedTarget(intake, how, figures, how.localizer)
    if how.corrections is not None:
        return MovingTarget(intake, how, figures, how.corrections)
    return Target(intake, how, figures)


class Target:
    """A map that scans are inserted into.

    Attributes:
    `undecided`: Why there is no map yet.
    `may_begin_again`: Whether all of it is of this mapper's scans, or of the map that it began with.
    `revision`: Another one after each change.
    `stamp`: Of the last scan [s]; 0 before the first.
    """

    def __init__(self, intake: Intake, how: LiveSettings, figures: LiveFigures) -> None:
        self._intake, self._how, self._figures = intake, how, figures
        self.undecided = ""
        self.may_begin_again = True
        self.revision = 0
        self.stamp = 0.0
        self.lock = threading.RLock()
        self._map = how.target
        self._saved = None if how.target is None else SavedMap(how.target)
        self._first = None if how.target is None or not intake.may_revise else how.target.snapshot()

    @property
    def config(self) -> Config:
        """How scans are mapped, which is decided."""
        assert self._intake.config is not None
        return self._intake.config

    @property
    def has_map(self) -> bool:
        """Whether mapping has begun."""
        return self._map is not None

    def _there(self) -> OccupancyMap:
        if self._map is None:
            raise RuntimeError(f"there is no map yet: {spelled(self.undecided) or 'nothing was mapped'}")
        return self._map

    def snapshot(self) -> OccupancyMap:
        """The map as it is now, which stays so; RuntimeError if there is none yet."""
        with self.lock:
            return self._there().snapshot()

    @contextmanager
    def changed(self) -> Iterator[OccupancyMap]:
        """The map itself, to change it; RuntimeError if there is none yet, or it follows corrections."""
        with self.lock:
            m = self._changeable()
            self.may_begin_again = False
            yield m
            self.revision += 1

    def _changeable(self) -> OccupancyMap:
        return self._there()

    def replace(self, m: OccupancyMap | None) -> None:
        """Go on with another map, or with an empty one of the same options."""
        with self.lock:
            self.may_begin_again = False
            if m is not None and self._map is not None and m.dim != self._map.dim:
                raise ValueError(f"the map is {m.dim}-D, expected {self._map.dim}-D as its sensors")
            self._saved = None if m is None else SavedMap(m)
            if m is None and self._map is not None:
                m = self._how.make(self._map.dim, self.config.options)
            self._map = m
            self.revision += 1

    def session(self) -> Session:
        """What slam can go on with; RuntimeError or ValueError if there is nothing yet."""
        raise RuntimeError("nothing is mapped by slam yet")

    def begin(self) -> None:
        """Begin with an empty map, if there is none."""
        if self._map is None:
            self._map = self._how.make(self._intake.dim, self.config.options)

    def begin_again(self) -> None:
        """Begin with the map that it began with, as it was, or with an empty one."""
        with self.lock:
            for one in (self._how.window, self._how.fading, self._how.way, self._how.passing):
                if one is not None:
                    one.begin()
            self._map = None if self._first is None else self._first.snapshot()
            self._saved = None if self._first is None else SavedMap(self._first)
            self.begin()
            self.revision += 1

    def decide(self) -> None:
        """Never begin again."""
        self._first = None

    def learn(self) -> None:
        """Move scans by what was learned of their poses."""

    def settle(self) -> None:
        """Nothing more comes."""
        self._compared()

    def _compared(self) -> None:
        """Say once whether scans fit the map that is gone on with."""
        saved, self._saved = self._saved, None
        if saved is not None and saved.doubt is not None:
            self._intake.notes.append(saved.doubt)

    def placed(self, scan: Scan, is_new: bool) -> Scan:
        """A scan in the map's frame; raises LeftOut. Before it begins again, `is_new` is true."""
        return scan

    def add(self, scan: Scan, usable: Scan) -> InsertReport | None:
        """Map what is usable of a scan, or look for that; raises LeftOut, and leaves the map as it was."""
        how = self._how
        try:
            with self.lock:
                if how.passing is not None:
                    how.passing.note(self._seen(), usable)
                if self._saved is not None:
                    self._saved.look(usable)
                report = self._inserted(usable)
                if how.window is not None:
                    how.window.moved(self._there(), scan)
                if how.fading is not None:
                    how.fading.follow(self._there(), usable, self.config.max_range)
                self.stamp = scan.stamp
                self.revision += 1
                if self._saved is not None and self._saved.is_done:
                    self._compared()
        except ValueError as error:
            raise LeftOut("scans that cannot be mapped") from error
        except MemoryError as error:
            raise LeftOut("no memory left for the map") from error
        if how.way is not None:
            how.way.add(scan)
        return report

    def _seen(self) -> OccupancyMap:
        """The map, to look at."""
        return self._there()

    def _inserted(self, scan: Scan) -> InsertReport:
        return scan.insert_into(self._there(), max_range=self.config.max_range, threads=self._how.threads)


class MovingTarget(Target):
    """A map whose scans move as the source, or slam, corrects their poses."""

    def __init__(
        self, intake: Intake, how: LiveSettings, figures: LiveFigures, corrections: Corrections
    ) -> None:
        super().__init__(intake, how, figures)
        self._corrections = corrections
        #: Knows where the last scan's sensor was, and what was learned of earlier ones.
        self._poser: Intake | Slam = how.slam or intake

    def snapshot(self) -> OccupancyMap:
        with self.lock:
            self._there()
            return self._corrections.map

    _seen = snapshot

    def _changeable(self) -> OccupancyMap:
        self._there()
        raise RuntimeError("the map follows corrections: changes made by hand would be lost")

    def replace(self, m: OccupancyMap | None) -> None:
        with self.lock:
            self.may_begin_again = False
            if m is not None:
                raise ValueError("the map follows corrections: expected no other to go on with")
            if self._how.slam is not None and self.has_map:
                self._how.slam.forget()
            if self.has_map:
                self._map = None
                self.begin()
                self.revision += 1

    def session(self) -> Session:
        with self.lock:
            if self._how.slam is None or self._intake.config is None:
                return super().session()
            longest = {"max_range": self.config.max_range} if math.isfinite(self.config.max_range) else {}
            return self._how.slam.session(self._corrections, {**self.config.options, **longest})

    def begin(self) -> None:
        if self._map is not None:
            return
        with self.lock:
            self._corrections.begin(self._intake.dim, self.config.options)
            if self._how.slam is not None:
                self._how.slam.begin(self._corrections)
            self._map = self._corrections.map

    def learn(self) -> None:
        learned = self._poser.corrections() if self.has_map else []
        if not learned:
            return
        with self.lock:
            for one in learned:
                self._corrections.correct(one)
            self._tell()

    def settle(self) -> None:
        if not self.has_map:
            return
        with self.lock:
            if self._how.slam is not None:
                self._how.slam.finish()
                self.learn()
            self._corrections.settle()
            self._tell()

    def _tell(self) -> None:
        figures, done = self._figures, self._corrections
        figures.corrections, figures.moved, figures.frozen = done.applied, done.moved, done.frozen
        figures.correction_seconds = done.seconds
        self.revision += 1

    def placed(self, scan: Scan, is_new: bool) -> Scan:
        slam = self._how.slam
        if slam is None:
            return scan
        try:
            with self.lock:
                placed = slam.placed(scan, self._intake.motion())
        except ValueError as error:
            raise LeftOut(f"scans that slam cannot place: {error}") from error
        if placed is None:
            raise LeftOut(NOT_FOUND)
        if self._how.localized is not None and is_new:
            self._how.localized(slam.located())
        return placed

    def _inserted(self, scan: Scan) -> InsertReport:
        motion = self._poser.motion()
        if motion is None:
            raise ValueError("nothing moves between the map and the sensor: there are no poses to follow")
        return self._corrections.insert(scan, motion, self.config.max_range)


class SearchedTarget(Target):
    """A map that scans are found in, which they do not change."""

    def __init__(self, intake: Intake, how: LiveSettings, figures: LiveFigures, localizer: Localizer) -> None:
        super().__init__(intake, how, figures)
        self._localizer = localizer
        self.may_begin_again = False

    def add(self, scan: Scan, usable: Scan) -> InsertReport | None:
        motion, dim = self._intake.motion(), self._localizer.dim
        if motion is None or scan.dim != dim:
            raise LeftOut("scans without odometry" if motion is None else f"scans that are not {dim}-D")
        ends = usable.endpoints[usable.did_return]
        poses = motion.sensor, motion.odometry
        sensor, body = ((pose.level() if dim == 2 else pose).matrix(dim) for pose in poses)
        ends = (ends - sensor[:dim, dim]) @ sensor[:dim, :dim]
        found = self._localizer.track(ends, sensor, motion.stamp, body=body)
        self.stamp = scan.stamp
        self._figures.lost += found.is_lost
        if self._how.localized is not None:
            self._how.localized(found)
        return None
