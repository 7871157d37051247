# SPDX-License-Identifier: BSD-3-Clause
"""A mapper in a thread of its own: measurements and poses in, a map that others look at out.

Strategy: `put` only queues, so that the thread that receives messages is never held up. One thread takes
poses first, then measurements in their order; the head of the queue waits until the poses of its time are
known, or until it has waited for long enough by the clock of the source. A second thread gives sinks
snapshots of the map, which cost little: a slow one holds up neither. Both spend their time in compiled code,
which releases the interpreter's lock.

Invariants: measurements are mapped in the order in which a recording of them would be read, so that the map
is that of the recording, byte for byte, if nothing was dropped. Each measurement is counted once.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import marked
from ndtree._native._checked import settings_of
from ndtree._native._core import OccupancyMap
from ndtree.base.scan import Scan
from ndtree.live.feed import Feed
from ndtree.live.figures import LiveFigures
from ndtree.live.intake import Intake, Verdict
from ndtree.live.publisher import Publisher
from ndtree.live.queue import Entry
from ndtree.live.session import Session
from ndtree.live.settings import LiveSettings
from ndtree.live.target import LeftOut, target_of

_USUAL = LiveSettings()


class LiveMapper:
    """Maps what it is given, in the order in which it comes.

    Parameters
    ----------
    intake : Intake
        What items are, and how they become scans.
    how : LiveSettings, optional
        The map, what happens to it, and who looks at it.
    **given
        Fields of `LiveSettings` that differ from `how`: ``target``, ``queue``, ``window``, ``sinks`` ...

    Attributes
    ----------
    figures : LiveFigures
        What became of measurements.
    failures : dict of str to str
        By sink, the last thing that went wrong.
    position : (dim,) float64 or None
        Where the sensor was last [m].

    Raises
    ------
    ValueError
        If a number is out of its limits, or two settings do not go together.

    Examples
    --------
    >>> import numpy as np
    >>> from ndtree import Scan
    >>> from ndtree.live import LiveMapper, ScansIntake
    >>> from ndtree.tuning.config import Config
    >>> with LiveMapper(ScansIntake(Config.of(max_range=30.0, no_return="free"), 2)) as mapper:
    ...     mapper.put(Scan(np.array([[2.0, 0.5]]), np.zeros(2)))
    >>> mapper.figures.mapped
    1
    """

    def __init__(self, intake: Intake, how: LiveSettings = _USUAL, **given: Any) -> None:
        how = settings_of(how, "LiveMapper", given)
        self.figures = LiveFigures()
        self.position: NDArray[np.float64] | None = None
        self.intake, self._patience = intake, how.patience
        self._target = target_of(intake, how, self.figures)
        self._feed = Feed(intake, how, self.figures)
        #: Measurements that arrived before are mapped again [s].
        self._again_until = -math.inf
        self._publisher = Publisher(self._target, how.sinks, self.figures)
        self.failures = self._publisher.failures
        self._thread = threading.Thread(target=self._run, name="ndtree-live", daemon=True)
        self._thread.start()

    def put(self, item: Any, received: float | None = None, *, wait: bool = False) -> None:
        """Give it a measurement or a pose.

        Parameters
        ----------
        item : object
            What the intake takes.
        received : float, optional
            When it came, by the clock of its source [s]; else now.
        wait : bool
            Wait while the queue is full, instead of dropping the oldest, unless that waits for what comes.

        Raises
        ------
        RuntimeError
            If the mapper is closed.
        BaseException
            What ended the mapper, if something did.
        """
        self._feed.put(item, time.time() if received is None else received, wait=wait)

    def advance(self, now: float) -> None:
        """Tell what time it is for the source [s], where nothing comes: what waited long enough gives up."""
        self._feed.advance(now)

    def close(self) -> None:
        """Map what waits, show sinks the last map, and end.

        Raises
        ------
        ValueError
            If nothing that came tells how to map; and whatever else ended the mapper.
        """
        self._end()
        self._feed.check()

    def _end(self, *, drop: bool = False) -> None:
        self._feed.close(drop=drop)
        self._thread.join()
        self._publisher.close()

    def __enter__(self) -> LiveMapper:
        return self

    def __exit__(self, kind: Any, *_: Any) -> None:
        if kind is None:
            self.close()
        else:  # Something else went wrong, which is what is told.
            self._end(drop=True)

    @property
    def undecided(self) -> str:
        """Why nothing is mapped yet."""
        return self._target.undecided

    @property
    def stamp(self) -> float:
        """Of the last scan in the map [s]; 0 before the first."""
        return self._target.stamp

    @property
    def has_map(self) -> bool:
        """Whether mapping has begun."""
        return self._target.has_map

    @contextmanager
    def locked(self) -> Iterator[OccupancyMap]:
        """The map itself, which does not change meanwhile but by who holds it.

        RuntimeError if there is none yet, or it follows corrections.
        """
        with self._target.changed() as m:
            yield m
        self._publisher.wake()

    def snapshot(self) -> OccupancyMap:
        """The map as it is now, which stays so; RuntimeError if there is none yet."""
        return self._target.snapshot()

    def replace(self, m: OccupancyMap | None) -> None:
        """Go on with another map, or with an empty one of the same options."""
        self._target.replace(m)
        self._publisher.wake()

    def session(self) -> Session:
        """What slam can go on with; RuntimeError or ValueError if there is nothing yet."""
        return self._target.session()

    # All of what follows runs in the mapper's thread.

    def _run(self) -> None:
        try:
            while self._step():
                pass
            self._target.settle()
            self._feed.end()
        except BaseException as error:  # It is raised by put() and close().
            self._feed.end(error)

    def _step(self) -> bool:
        """Wait for something to do, and do it; False at the end."""
        now, closing = self._feed.pause()
        if self.intake.config is None:
            self._take_poses(math.inf)
            if not self._decided(now, closing):
                return not closing
        elif self.intake.may_revise and (closing or self.intake.is_decidable(now)):
            self._revise(closing)
        self._target.begin()
        return self._map_some(now, closing)

    def _take_poses(self, until: float) -> None:
        while self._take_pose(until):
            pass

    def _take_pose(self, until: float) -> bool:
        pose = self._feed.take_pose(until)
        if pose is None:
            return False
        self.intake.pose(pose, self.figures)
        self._target.learn()
        return True

    def _decided(self, now: float, closing: bool) -> bool:
        if closing or self.intake.is_decidable(now):
            try:
                self.intake.decide(self._feed.entries(), closing)
            except ValueError as error:
                if closing:
                    raise
                self._target.undecided = marked(error)
        if self.intake.config is None:
            self._feed.starve()
            return False
        self._target.undecided = ""
        self._feed.give_back(self.intake.too_early())
        self._feed.begin()
        return True

    def _revise(self, closing: bool) -> None:
        """Decide anew by all that has come; if that is another way, map all of it so."""
        if self.intake.decide([*self._feed.poses(), *self._feed.entries()], closing):
            self._feed.give_back(self.intake.too_early())
            if self._target.may_begin_again:
                self._again_until = self._feed.begin_again()
                self._target.begin_again()
            else:
                self.intake.notes.append(f"{self.figures.mapped} earlier scans stay as they were mapped")
        if not self.intake.may_revise:
            self._feed.decide()
            self._target.decide()

    def _map_some(self, now: float, closing: bool) -> bool:
        """Map until there is nothing, or a pose is missing; False at the end.

        Poses are taken as far as a measurement needs them, so that the map does not depend on how far the
        threads are.
        """
        self._target.learn()  # What was told before mapping began.
        while True:
            entry = self._feed.head(closing=closing)
            if entry is None:
                self._take_poses(now)
                return not (closing and self._feed.is_empty)
            found = self._found(entry, now, closing)
            if found is Verdict.wait:
                self._feed.starve(but_for_poses=True)
                return True
            self._feed.done()
            if isinstance(found, Scan):
                self._map(found, entry)
            self._target.learn()  # What slam has found.
            if self.intake.may_revise and (closing or self.intake.is_decidable(self._feed.now)):
                return True

    def _found(self, entry: Entry, now: float, closing: bool) -> Scan | Verdict:
        until = entry.received + self._patience
        while True:
            found = self.intake.scan(entry, False, self.figures)
            if found is not Verdict.wait or not self._take_pose(until):
                break
        gives_up = closing or now >= until
        return self.intake.scan(entry, True, self.figures) if found is Verdict.wait and gives_up else found

    def _map(self, scan: Scan, entry: Entry) -> None:
        figures, is_new = self.figures, entry.arrived > self._again_until
        try:
            scan = self._target.placed(scan, is_new)
            origins = np.atleast_2d(scan.origin)
            self.position = origins[-1] if len(origins) else self.position
            usable = self._target.config.usable(scan)
            report = self._target.add(scan, usable)
        except LeftOut as error:
            figures.leave_out(str(error))
            return
        figures.mapped += 1
        if is_new:
            figures.mapped_delays.append(time.perf_counter() - entry.arrived)
        if report is not None:
            figures.count(report, len(scan) - len(usable))
            self._publisher.wake(max(entry.arrived, self._again_until))
