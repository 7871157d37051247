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
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import marked, spelled
from ndtree._native._core import AdaptiveMap, InsertReport, OccupancyMap
from ndtree.base.scan import Scan
from ndtree.live.corrections import Corrections
from ndtree.live.fading import Fading
from ndtree.live.figures import LiveFigures
from ndtree.live.intake import Intake, Verdict
from ndtree.live.localizing import Localization, Localizer
from ndtree.live.passing import Passing
from ndtree.live.queue import Entry, ScanQueue
from ndtree.live.robot import Robot
from ndtree.live.session import Session
from ndtree.live.slam import NOT_FOUND, Slam
from ndtree.live.way import Way
from ndtree.live.window import Window

#: Measurements that wait, and how long one waits for its pose [s].
QUEUE, PATIENCE = 100, 1.0
#: The threads look up so often although nothing happens [s].
_LOOKS = 0.05

#: A sink is left alone for this many times as long as it took of the processor.
_SINKS_REST = 5.0

Make = Callable[[int, "dict[str, Any]"], OccupancyMap]


class Sink(Protocol):
    """Who is shown the map while it grows.

    Attributes
    ----------
    period : float
        Least time from one `update` to the next [s]; 0: after each scan. A sink that takes long is shown the
        map less often, so that it takes a fifth of one processor at most.
    """

    period: float

    def update(self, m: OccupancyMap, stamp: float) -> None:
        """Look at a snapshot of the map, which stays as it is; `stamp` is that of its last scan [s]."""


def _adaptive(dim: int, options: dict[str, Any]) -> OccupancyMap:
    return AdaptiveMap(dim=dim, **options)


class LiveMapper:
    """Maps what it is given, in the order in which it comes.

    Parameters
    ----------
    intake : Intake
        What items are, and how they become scans.
    target : OccupancyMap, optional
        The map to go on with. Left out, one is made as the intake decides.
    make : callable, optional
        Makes the map of a dimension and options; else an `AdaptiveMap`.
    queue : int
        Measurements that wait at most; the oldest of more is dropped, and counted.
    patience : float
        How long a measurement waits for the poses of its time, by the clock of its source [s].
    threads : int
        That insert, as for `OccupancyMap.insert`.
    window : Window, optional
        What is kept of the map.
    fading : Fading, optional
        What is forgotten because it was not seen for long.
    sinks : sequence of Sink
    clock : callable, optional
        Says what time it is for the source [s]; left out, that is when the last item was received.
    way : Way or Robot, optional
        Is told where the sensor is.
    corrections : Corrections, optional
        Moves scans when their poses are corrected. The map is an `AdaptiveMap` then, made of scans alone: not
        with a target, a window or fading, nor changed by others.
    localizer : Localizer, optional
        Finds each scan in `target`, which is not changed then; the intake's map frame is that of odometry.
    localized : callable, optional
        Is told each `Localization`.
    slam : Slam, optional
        Makes the poses of scans, with `corrections`; the intake's map frame is that of odometry.
    passing : Passing, optional
        Is told each scan before it is mapped.

    Raises
    ------
    ValueError
        If a number is out of its limits.

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

    def __init__(
        self,
        intake: Intake,
        *,
        target: OccupancyMap | None = None,
        make: Make = _adaptive,
        queue: int = QUEUE,
        patience: float = PATIENCE,
        threads: int = 0,
        window: Window | None = None,
        fading: Fading | None = None,
        sinks: Sequence[Sink] = (),
        clock: Callable[[], float] | None = None,
        way: Way | Robot | None = None,
        corrections: Corrections | None = None,
        localizer: Localizer | None = None,
        localized: Callable[[Localization], None] | None = None,
        slam: Slam | None = None,
        passing: Passing | None = None,
    ) -> None:
        if queue < 1:
            raise ValueError(f"queue = {queue}: must be >= 1")
        if not patience >= 0:
            raise ValueError(f"patience = {patience:g} s: must be >= 0")
        others = {"target": target, "window": window, "fading": fading}
        for name, other in others.items():
            if corrections is not None and other is not None:
                raise ValueError(
                    f"{name}: expected none, as a map that follows corrections is of scans alone"
                )
        if localizer is not None and (target is None or corrections or window or fading):
            raise ValueError("localizer: expected a target, and nothing that changes it")
        if slam is not None and (corrections is None or localizer is not None):
            raise ValueError("slam: expected corrections, and no localizer")
        self._corrections, self._slam = corrections, slam
        #: Who knows where the last scan's sensor was, and what was learned of earlier ones.
        self._poser: Intake | Slam = slam or intake
        self._localizer, self._localized = localizer, localized
        self.figures = LiveFigures()
        #: Why nothing is mapped yet, and by sink the last thing that went wrong.
        self.undecided = ""
        self.failures: dict[str, str] = {}
        self._intake, self._target, self._make = intake, target, make
        self._patience, self._threads = patience, threads
        self._window, self._fading = window, fading
        #: Measurements that are mapped again if it is decided anew how, and the map to begin with.
        self._kept: list[Entry] = []
        self._may_begin_again = localizer is None
        self._again_until = -math.inf
        self._first = target.snapshot() if target is not None and intake.may_revise else None
        self._clock, self._way, self._passing = clock, way, passing
        #: Where the sensor was last [m].
        self.position: NDArray[np.float64] | None = None
        self._changed = threading.Condition()
        self._queue = ScanQueue(queue)
        self._poses: deque[tuple[Any, float]] = deque()
        self._latest = -math.inf
        self._is_closing = self._is_starved = False
        self._error: BaseException | None = None
        self._held: Entry | None = None
        self._ordered = False
        #: Of what had come before mapping began, what is not mapped yet: the queue may be longer by this.
        self._backlog = 0
        self._lock = threading.RLock()
        self._stamp = 0.0
        self._revision = 0
        self._publisher = _Publisher(self, sinks)
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
        received = time.time() if received is None else received
        with self._changed:
            self._check()
            if self._is_closing:
                raise RuntimeError("the mapper is closed, expected no more items")
            if self._intake.is_pose(item):
                self._latest = max(self._latest, received)
                self.figures.poses += 1
                self._poses.append((item, received))
            else:
                while wait and self._queue.is_full and not self._is_starved:
                    self._changed.wait(_LOOKS)
                    self._check()
                self._latest = max(self._latest, received)
                self.figures.received += 1
                self._intake.begin(received)
                if self._queue.is_full and not wait and self._may_drop():
                    self._queue.drop()
                self._queue.put(Entry(item, received, time.perf_counter()))
            self._is_starved = False
            self._changed.notify_all()

    def _may_drop(self) -> bool:
        """Whether the queue is full of more than what was looked at before mapping began."""
        oldest = self._queue.oldest()
        if self._intake.config is None:
            waits = self._intake.look + self._patience
            return oldest is not None and self._latest - oldest.received > waits
        return len(self._queue) >= self._queue.capacity + self._backlog

    def advance(self, now: float) -> None:
        """Tell what time it is for the source [s], where nothing comes: what waited long enough gives up."""
        with self._changed:
            self._latest = max(self._latest, now)
            self._is_starved = False
            self._changed.notify_all()

    def close(self) -> None:
        """Map what waits, show sinks the last map, and end.

        Raises
        ------
        ValueError
            If nothing that came tells how to map; and whatever else ended the mapper.
        """
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        self._thread.join()
        self._publisher.close()
        self._check()

    def __enter__(self) -> LiveMapper:
        return self

    def __exit__(self, kind: Any, *_: Any) -> None:
        if kind is None:
            self.close()
            return
        with self._changed:  # Something else went wrong, which is what is told.
            self._queue, self._is_closing = ScanQueue(1), True
            self._changed.notify_all()
        self._thread.join()
        self._publisher.close()

    @property
    def intake(self) -> Intake:
        """That it was made with."""
        return self._intake

    @property
    def stamp(self) -> float:
        """Of the last scan in the map [s]; 0 before the first."""
        return self._stamp

    @property
    def has_map(self) -> bool:
        """Whether mapping has begun."""
        return self._target is not None

    @contextmanager
    def locked(self) -> Iterator[OccupancyMap]:
        """The map itself, which does not change meanwhile but by who holds it.

        Raises
        ------
        RuntimeError
            If there is none yet.
        """
        with self._lock:
            if self._target is None:
                raise RuntimeError(f"there is no map yet: {spelled(self.undecided) or 'nothing was mapped'}")
            if self._corrections is not None:
                raise RuntimeError("the map follows corrections: what is changed in it would be lost")
            self._may_begin_again = False
            yield self._target
            self._revision += 1
        self._publisher.wake()

    def snapshot(self) -> OccupancyMap:
        """The map as it is now, which stays so; RuntimeError if there is none yet."""
        with self._lock:
            if self._target is None:
                raise RuntimeError(f"there is no map yet: {spelled(self.undecided) or 'nothing was mapped'}")
            return self._target.snapshot() if self._corrections is None else self._corrections.map

    def replace(self, m: OccupancyMap | None) -> None:
        """Go on with another map, or with an empty one of the same options."""
        with self._lock:
            self._may_begin_again = False
            if self._corrections is not None and m is not None:
                raise ValueError("the map follows corrections: expected no other to go on with")
            if self._corrections is not None and self._target is not None:
                if self._slam is not None:
                    self._slam.forget()
                self._begin_corrected()
            elif m is None and self._target is not None:
                assert self._intake.config is not None
                m = self._make(self._target.dim, self._intake.config.options)
            if m is None and self._corrections is None:
                return
            if m is not None and self._target is not None and m.dim != self._target.dim:
                raise ValueError(f"the map is {m.dim}-D, expected {self._target.dim}-D as its sensors")
            self._target = self._target if m is None else m
            self._revision += 1
        self._publisher.wake()

    def session(self) -> Session:
        """What slam can go on with; RuntimeError or ValueError if there is nothing yet."""
        with self._lock:
            if self._slam is None or self._corrections is None or self._intake.config is None:
                raise RuntimeError("nothing is mapped by slam yet")
            config = self._intake.config
            longest = {"max_range": config.max_range} if math.isfinite(config.max_range) else {}
            return self._slam.session(self._corrections, {**config.options, **longest})

    def _begin_corrected(self) -> None:
        """Begin with an empty map, which scans will make."""
        assert self._intake.config is not None and self._corrections is not None
        with self._lock:
            self._corrections.begin(self._intake.dim, self._intake.config.options)
            if self._slam is not None:
                self._slam.begin(self._corrections)
            self._target = self._corrections.map

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    # All of what follows runs in the mapper's thread.

    def _run(self) -> None:
        try:
            while self._step():
                pass
            self._settle()
        except BaseException as error:  # It is raised by put() and close().
            self._error = error
        with self._changed:
            self._changed.notify_all()

    def _step(self) -> bool:
        """Wait for something to do, and do it; False at the end."""
        with self._changed:
            is_idle = not self._poses and (self._is_starved or not (self._held or len(self._queue)))
            if is_idle and not self._is_closing:
                self._changed.wait(_LOOKS)
            now, closing = self._now(), self._is_closing
        if self._intake.config is None:
            self._take_poses(math.inf)
            if not self._decided(now, closing):
                return not closing
        elif self._intake.may_revise and (closing or self._intake.is_decidable(now)):
            self._revise(closing)
        if self._target is None and self._corrections is not None:
            self._begin_corrected()
        if self._target is None:
            config = self._intake.config
            assert config is not None
            self._target = self._make(self._intake.dim, config.options)
        return self._map_some(now, closing)

    def _take_poses(self, until: float, *, one: bool = False) -> bool:
        """Take note of poses that were received until a time [s], or of the first; False if there is none."""
        taken = False
        while self._poses and self._poses[0][1] <= until and not (one and taken):
            self._intake.pose(self._poses.popleft()[0], self.figures)
            taken = True
            self._correct()
        return taken

    def _correct(self) -> None:
        """Move scans by what was learned of their poses."""
        learned = [] if self._corrections is None or self._target is None else self._poser.corrections()
        if not learned:
            return
        assert self._corrections is not None
        with self._lock:
            for one in learned:
                self._corrections.correct(one)
            self._corrected()

    def _settle(self) -> None:
        if self._corrections is None or self._target is None:
            return
        with self._lock:
            if self._slam is not None:
                self._slam.finish()
                self._correct()
            self._corrections.settle()
            self._corrected()

    def _corrected(self) -> None:
        assert self._corrections is not None
        figures, done = self.figures, self._corrections
        figures.corrections, figures.moved, figures.frozen = done.applied, done.moved, done.frozen
        figures.correction_seconds = done.seconds
        self._revision += 1

    def _now(self) -> float:
        return self._latest if self._clock is None else max(self._latest, self._clock())

    def _decided(self, now: float, closing: bool) -> bool:
        if closing or self._intake.is_decidable(now):
            with self._changed:
                waiting = self._queue.entries()
            if closing and not waiting:
                return False
            try:
                self._intake.decide(waiting, closing)
            except ValueError as error:
                if closing:
                    raise
                self.undecided = marked(error)
        if self._intake.config is not None:
            self.undecided = ""
            with self._changed:
                self._backlog = len(self._queue)
            return True
        with self._changed:
            self._is_starved = True
            self._changed.notify_all()
        return False

    def _revise(self, closing: bool) -> None:
        """Decide anew by all that has come; if that is another way, map all of it so."""
        self._take_poses(math.inf)
        with self._changed:
            waiting = [*self._kept, *self._queue.entries()]
        if self._intake.decide(waiting, closing):
            if self._may_begin_again:
                self._begin_again()
            else:
                self._intake.notes.append(f"{self.figures.mapped} earlier scans stay as they were mapped")
        if not self._intake.may_revise:
            self._kept, self._first = [], None

    def _begin_again(self) -> None:
        with self._changed:
            self._queue.begin_again(self._kept)
            self._kept, self._held, self._ordered = [], None, False
            self._backlog = len(self._queue)
            self.figures.begin_again()
            self._again_until = time.perf_counter()
        with self._lock:
            for one in (self._window, self._fading, self._way, self._passing):
                if one is not None:
                    one.begin()
            config = self._intake.config
            assert config is not None
            if self._corrections is not None:
                self._begin_corrected()
            elif self._first is not None:
                self._target = self._first.snapshot()
            else:
                self._target = self._make(self._intake.dim, config.options)
            self._revision += 1

    def _map_some(self, now: float, closing: bool) -> bool:
        """Map until there is nothing, or a pose is missing; False at the end.

        Poses are taken as far as a measurement needs them, so that the map does not depend on how far the
        threads are.
        """
        self._correct()  # By what was learned before mapping began.
        while True:
            with self._changed:
                if len(self._intake.sensors) > 1 and not self._ordered:
                    self._queue.order_by(self._intake.key, self._intake.sensors)
                    self._ordered = True
                if self._held is None:
                    self._held = self._queue.take(everything=closing)
                    if self._held is not None and self._intake.may_revise:
                        self._kept.append(self._held)
                self._is_starved = self._held is None and len(self._queue) > 0
                self.figures.waiting = len(self._queue) + (self._held is not None)
                self.figures.dropped = self._queue.dropped
                self._changed.notify_all()
            entry = self._held
            if entry is None:
                self._take_poses(now)
                return not (closing and not len(self._queue) and not self._poses)
            found = self._found(entry, now, closing)
            if found is Verdict.wait:
                with self._changed:
                    self._is_starved = not self._poses
                    self._changed.notify_all()
                return True
            self._held = None
            self._backlog = max(self._backlog - 1, 0)
            if isinstance(found, Scan):
                self._insert(found, entry)
            if self._slam is not None:
                self._correct()
            if self._intake.may_revise and (closing or self._intake.is_decidable(self._now())):
                return True

    def _found(self, entry: Entry, now: float, closing: bool) -> Scan | Verdict:
        """A scan of a measurement, or why there is none."""
        until = entry.received + self._patience
        while True:
            found = self._intake.scan(entry, False, self.figures)
            if found is not Verdict.wait or not self._take_poses(until, one=True):
                break
        gives_up = closing or now >= until
        return self._intake.scan(entry, True, self.figures) if found is Verdict.wait and gives_up else found

    def _insert(self, scan: Scan, entry: Entry) -> None:
        config, figures = self._intake.config, self.figures
        assert config is not None and self._target is not None
        if self._slam is not None:
            placed = self._place(scan, self._slam, entry)
            if placed is None:
                return
            scan = placed
        origins = np.atleast_2d(scan.origin)
        self.position = origins[-1] if len(origins) else self.position
        usable = config.usable(scan)
        if self._localizer is not None:
            self._localize(usable, entry, self._localizer)
            return
        try:
            with self._lock:
                if self._passing is not None:
                    m = self._target if self._corrections is None else self._corrections.map
                    self._passing.note(m, usable)
                one = self._mapped(usable, config.max_range)
                if self._window is not None:
                    self._window.moved(self._target, scan)
                if self._fading is not None:
                    self._fading.follow(self._target, usable, config.max_range)
                self._stamp = scan.stamp
                self._revision += 1
        except ValueError:
            figures.leave_out("scans that cannot be mapped")
            return
        except MemoryError:
            figures.leave_out("no memory left for the map")
            return
        counts = {
            key: getattr(one, key)
            for key in ("beams", "returned", "not_returned", "beyond_max_range", "invalid")
        }
        ignored = len(scan) - len(usable)
        if ignored:
            counts["beams"] += ignored
            counts["ignored"] = ignored
        for key, count in counts.items():
            figures.beams[key] = figures.beams.get(key, 0) + count
        figures.insert_seconds += one.seconds
        if self._way is not None:
            self._way.add(scan)
        figures.mapped += 1
        if entry.arrived > self._again_until:
            figures.mapped_delays.append(time.perf_counter() - entry.arrived)
        self._publisher.mapped(max(entry.arrived, self._again_until))

    def _place(self, scan: Scan, slam: Slam, entry: Entry) -> Scan | None:
        """A scan where slam has it; None where it says nothing of that."""
        try:
            with self._lock:
                placed = slam.placed(scan, self._intake.motion())
        except ValueError:
            self.figures.leave_out("scans that slam cannot place")
            return None
        if placed is None:
            self.figures.leave_out(NOT_FOUND)
        elif self._localized is not None and entry.arrived > self._again_until:  # Not told before.
            self._localized(slam.located())
        return placed

    def _localize(self, scan: Scan, entry: Entry, localizer: Localizer) -> None:
        """Find a scan in the map."""
        motion, figures = self._intake.motion(), self.figures
        if motion is None or scan.dim != 2:
            figures.leave_out("scans without odometry" if motion is None else "scans that are not 2-D")
            return
        ends = scan.endpoints[scan.did_return]
        sensor, body = (pose.level().matrix(2) for pose in (motion.sensor, motion.odometry))
        ends = (ends - sensor[:2, 2]) @ sensor[:2, :2]
        found = localizer.track(ends, sensor, motion.stamp, body=body)
        self._stamp = scan.stamp
        figures.mapped += 1
        figures.lost += found.is_lost
        figures.mapped_delays.append(time.perf_counter() - entry.arrived)
        if self._localized is not None:
            self._localized(found)

    def _mapped(self, scan: Scan, max_range: float) -> InsertReport:
        if self._corrections is None:
            assert self._target is not None
            return scan.insert_into(self._target, max_range=max_range, threads=self._threads)
        motion = self._poser.motion()
        if motion is None:
            raise ValueError("nothing moves between the map and the sensor: there are no poses to follow")
        return self._corrections.insert(scan, motion, max_range)


class _Publisher:
    """A thread that shows sinks snapshots of the map."""

    def __init__(self, mapper: LiveMapper, sinks: Sequence[Sink]) -> None:
        self._mapper = mapper
        self._due = [(sink, -math.inf) for sink in sinks]  # And when it may be shown the map again [s].
        self._shown: dict[int, int] = {}
        self._wake = threading.Condition()
        self._arrived: list[float] = []
        self._is_awake = self._is_closing = False
        self._thread = threading.Thread(target=self._run, name="ndtree-live-sinks", daemon=True)
        if sinks:
            self._thread.start()

    def mapped(self, arrived: float) -> None:
        """A scan that arrived at a time is in the map."""
        if self._due:
            with self._wake:
                self._arrived.append(arrived)
                self._is_awake = True
                self._wake.notify()

    def wake(self) -> None:
        """The map has changed."""
        with self._wake:
            self._is_awake = True
            self._wake.notify()

    def close(self) -> None:
        """Show the last map to all."""
        if not self._due:
            return
        with self._wake:
            self._is_closing = True
            self._wake.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._wake:
                if not self._is_awake and not self._is_closing:
                    self._wake.wait(self._pause())
                closing, self._is_awake = self._is_closing, False
                arrived, self._arrived = self._arrived, []
            self._show(closing, arrived)
            if closing:
                return

    def _pause(self) -> float:
        """How long nothing is to be shown, if nothing happens [s]."""
        now, revision = time.monotonic(), self._mapper._revision
        behind = [at for number, (_, at) in enumerate(self._due) if self._shown.get(number) != revision]
        return min(max(min(behind, default=math.inf) - now, 0.0), _LOOKS) or 1e-3

    def _show(self, closing: bool, arrived: list[float]) -> None:
        now = time.monotonic()
        revision = self._mapper._revision
        due = [
            number
            for number, (sink, next_time) in enumerate(self._due)
            if (closing or now >= next_time) and self._shown.get(number) != revision
        ]
        if not due or not self._mapper.has_map:
            self._arrived[:0] = arrived
            return
        with self._mapper._lock:
            m, stamp, revision = self._mapper.snapshot(), self._mapper._stamp, self._mapper._revision
        at_once = False
        for number in due:
            sink, _ = self._due[number]
            begin = time.thread_time()
            try:
                sink.update(m, stamp)
            except Exception as error:  # A sink that fails does not stop the map.
                self._mapper.failures[type(sink).__name__] = f"{type(error).__name__}: {error}"
            took = time.thread_time() - begin
            self._due[number] = sink, now + max(sink.period, _SINKS_REST * took)
            self._shown[number] = revision
            at_once |= sink.period == 0
        if not at_once:
            self._arrived[:0] = arrived
        else:
            shown = time.perf_counter()
            self._mapper.figures.published_delays.extend(shown - one for one in arrived)
