# SPDX-License-Identifier: BSD-3-Clause
"""Messages of ROS as they come, judged as those of a recording, by the same code.

Strategy: the messages of the first seconds are a bag in memory. What a log decides of a whole bag, it decides
of that one: which topics are mapped, in which frame, where sensors sit, what times of beams mean, and with
which options. Then these messages are mapped, and all that follow.

The decision stands on little, so it is made anew of all that came, after some seconds more, when a transform
contradicts it, and at the end of what is shorter than that. If it is another one, all is mapped again by it:
the map is then that of a recording up to there. Messages are kept until the last of these looks, or until
they are too many bytes. Which sensors are mapped stays.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ndtree.base.options import default_of
from ndtree.base.scan import Scan
from ndtree.live.corrections import Correction, Jumps, Motion
from ndtree.live.figures import LiveFigures
from ndtree.live.intake import PosedIntake, Times, Verdict, motion_in
from ndtree.live.queue import Entry
from ndtree.logs.core.rules import OneByOne, Selection
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.clock import Clock
from ndtree.logs.ros.files.bag import Bag, bag_of
from ndtree.logs.ros.following import Follower
from ndtree.logs.ros.messages.beams import SENSORS
from ndtree.logs.ros.messages.foxglove import head_of
from ndtree.logs.ros.options import BagOptions
from ndtree.logs.ros.placement.placement import STILL, TRANSFORMS
from ndtree.logs.ros.reading import Measured, MessageReader, OtherFrame
from ndtree.logs.ros.rosbag import RosbagLog
from ndtree.logs.ros.storage import Raw
from ndtree.logs.ros.survey import PATH, POSES_STREAM, TF, is_static, poses_in
from ndtree.tuning.config import Config
from ndtree.tuning.inspection import inspect

#: What is decided is decided of the first messages of so long [s].
LOOK: float = default_of("look", "node")
#: And anew of those of so long [s], as long as messages are of no more bytes together.
LATER = (5.0, 15.0, 60.0)
KEPT = 1 << 28
#: If that is too little, so much more is waited for, at most [s].
MOST_STEP = 10.0
#: What scans outside what is selected are called.
NOT_SELECTED = "not selected"
#: Poses and the like that are kept until then, at most; fixed transforms are all kept.
MOST_EARLY = 100_000


class MessagesIntake(PosedIntake):
    """Takes `Raw` messages: of sensors, with poses and transforms, and of cameras.

    Parameters
    ----------
    name : str
        How errors call the source.
    given : Config, optional
        What is decided already of how messages are read, selected and mapped.
    follow : str
        A topic with a SLAM's ``nav_msgs/Path``, whose poses correct earlier ones, or "tf" for what changes
        of the map's transform to the odometry's frame tell of them; "" for neither.
    body : str
        The frame that the poses of the Path are of; else the one that moves and is next to the sensor.
    look : float
        Nothing is mapped until measurements of so long have come [s].
    poses_are_found : bool
        By slam: a sensor that has no poses may move.

    Attributes
    ----------
    log : RosbagLog or None
        What was decided of sensors and frames.
    pose_topics : list of str
        That tell poses in the place of transforms.
    """

    def __init__(
        self,
        name: str,
        given: Config | None = None,
        *,
        follow: str = "",
        body: str = "",
        look: float = LOOK,
        poses_are_found: bool = False,
    ) -> None:
        super().__init__()
        if not look >= 0:
            raise ValueError(f"look = {look:g} s: must be >= 0")
        self.log: RosbagLog | None = None
        self._name, self._given, self.look = name, given or Config(), look
        self._poses_are_found = poses_are_found
        self._reading = self._given.reading
        topics = self._reading.get("topic") or []
        names = [topics] if isinstance(topics, str) else topics
        self._topics = {plain(one.partition("@")[0]) for one in names}
        self._body = plain(body)
        self._follows_jumps = plain(follow) == "tf"
        self._follow = "" if self._follows_jumps else plain(follow)
        self._path: Raw | None = None
        self._no_path = f"follow = {follow}: no {PATH} came on it, and no scan moves" if self._follow else ""
        self._bag: Bag | None = None
        self._jumps = Jumps()
        self.may_revise = True
        self._began, self._looked_at = math.inf, -math.inf
        self._bytes = self._released = 0
        self._decided: Any = None
        self._selected: OneByOne | None = None
        self._fixed: list[Raw] = []
        self._early: deque[Raw] = deque(maxlen=MOST_EARLY)
        self._until = math.inf
        self._step = look
        #: What the log knows of poses [s], and poses that came later, to be taken when a scan needs them.
        self._known_until = -math.inf
        self._later: list[Raw] = []
        self._entry: Entry | None = None
        self._measured: Measured | None = None
        self._span = 0.0, 0.0
        self._unconnected: set[str] = set()
        self._reader: MessageReader | None = None
        self._follower: Follower | None = None
        self._clock: Clock | None = None

    def is_pose(self, item: Any) -> bool:
        return item.connection.type not in SENSORS or bool(
            self._topics and plain(item.connection.topic) not in self._topics
        )

    def pose(self, item: Any, figures: LiveFigures) -> None:
        is_transforms = item.connection.type in TF
        if self._is_followed(item):
            self._path, self._no_path = item, ""
            self._correct()
            return
        if self.may_revise and self._may_tell(item):
            self._keep(item)
            (self._fixed if is_transforms and is_static(item.connection.topic) else self._early).append(item)
        if self._follower is not None and 1e-9 * item.received > self._known_until:
            self._add(item)
            figures.late_poses = self._follower.late
            if self._follows_jumps and is_transforms:
                self._look_for_jumps()

    def _is_followed(self, item: Any) -> bool:
        connection = item.connection
        return bool(self._follow) and plain(connection.topic) == self._follow and connection.type == PATH

    def _may_tell(self, item: Any) -> bool:
        """Whether what is no measurement may tell how to map."""
        is_other = self.log is not None and item.connection.type in SENSORS
        return not is_other and not self._is_followed(item)

    def _add(self, raw: Raw) -> None:
        """Take note of poses; what contradicts the decision is looked at at once."""
        assert self._follower is not None
        self._follower.add(raw)
        if self._follower.released > self._released:
            self._released = self._follower.released
            self._until = min(self._until, 1e-9 * raw.received)

    def _keep(self, raw: Raw) -> None:
        """Look at once, and never again, where too many bytes came since the last look."""
        received = 1e-9 * raw.received
        if received > self._looked_at:
            self._bytes += len(raw.data)
            if self._bytes > KEPT:
                self._until = min(self._until, received)

    def _correct(self) -> None:
        """Take the newest Path, once it is decided what is mapped."""
        if self._path is None or self._clock is None or self._bag is None:
            return
        raw = self._path
        try:
            rows = poses_in(self._bag.decoded(raw))
        except ValueError:  # A damaged one: the next says the same.
            return
        if rows:
            self._corrections.append(
                Correction(
                    [self._clock.time(POSES_STREAM, 1e-9 * raw.received, row.stamp) for row in rows],
                    [row.position for row in rows],
                    [row.quaternion for row in rows],
                )
            )

    def _look_for_jumps(self, *, everywhere: bool = False) -> None:
        """What the newest transforms tell of earlier poses, or all of them."""
        assert self.log is not None
        place = self.log.plan.places[self.sensors[0]]
        found = place.tree.body_of(place.fixed_frame, place.observer or place.frame)
        if found is None or found[0] == place.fixed_frame:
            return
        assert self._follower is not None
        stamps = [self._follower.until(self.sensors[0], found[0])]
        if everywhere:
            stamps = place.tree.stamps(place.fixed_frame, found[0]).tolist()
        for stamp in stamps:
            if math.isfinite(stamp):
                correction = self._jumps.add(stamp, place.tree.pose_at(place.fixed_frame, found[0], stamp))
                self._corrections += [] if correction is None else [correction]

    def motion(self) -> Motion | None:
        assert self._reader is not None and self._measured is not None
        place, frame, stamp = self._reader.frames_of(self._measured)
        return motion_in(place.tree, place.fixed_frame, frame, stamp, self._body)

    def key(self, item: Any) -> tuple[str, float]:
        assert self._clock is not None
        received = 1e-9 * item.received
        stamp, frame = head_of(item) or (received, "")
        return item.connection.topic, self._clock.time((item.connection.topic, frame), received, stamp)

    def too_early(self) -> list[tuple[Any, float]]:
        later, self._later = self._later, []
        return [(raw, 1e-9 * raw.received) for raw in later]

    def moved(self, item: Any, received: float) -> Any:
        return replace(item, received=round(1e9 * received))

    def is_decidable(self, now: float) -> bool:
        return now >= self._until

    def begin(self, received: float) -> None:
        if self._began == math.inf:
            self._began, self._until = received, received + self.look

    def decide(self, waiting: Sequence[Entry], everything: bool = False) -> bool:
        """As of `Intake`; of what was received until a time, so that it does not depend on threads."""
        until = math.inf if everything else self._until
        new = [entry.item for entry in waiting]
        new = [raw for raw in new if not self.is_pose(raw) or self._may_tell(raw)]
        raws = [*self._fixed, *self._early, *new]
        raws = sorted((raw for raw in raws if 1e-9 * raw.received <= until), key=lambda raw: raw.received)
        if self.log is None:
            # If that is too little, the next time is not too soon: each look takes longer than the last.
            self._step = min(2 * self._step, MOST_STEP) or LOOK
            self._until += self._step
            log, bag, config = self._looked(raws, everything)
        else:
            try:
                log, bag, config = self._looked(raws, everything)
            except ValueError:  # What was decided still stands.
                log = None
        self._looked_at, self._bytes = until, sum(len(raw.data) for raw in raws)
        later = [self._began + seconds for seconds in LATER if self._began + seconds > until]
        is_last = everything or self._bytes > KEPT or not later
        self._until = math.inf if is_last else later[0]
        before, self._decided = self._decided, self._decided if log is None else _ways_of(log, config)
        is_other = self._decided != before
        if log is not None and is_other:
            seconds = 1e-9 * raws[-1].received - self._began
            anew = f"chosen anew after {seconds:.0f} s; all earlier scans were mapped again"
            self.config, self.dim = config, log.dim
            self.notes = [f"uses {log.uses}", *config.notes, *log.notes, *([anew] if before else [])]
            self._take(log, bag, until)
        if is_last:
            self.may_revise = False
            self._fixed.clear()
            self._early.clear()
        return is_other

    def _looked(self, raws: list[Raw], everything: bool) -> tuple[RosbagLog, Bag, Config]:
        bag = bag_of(self._name, raws)
        dim = self._given.get("dim")
        log = RosbagLog(self._name, BagOptions(**self._reading), dim=dim, bag=bag, so_far=not everything)
        log = self._given.ruled(log).ruled(keep_going=True, poses_are_found=self._poses_are_found)
        parts = self._given.parts(log.dim)
        config = inspect(log.select(**parts) if parts else log, self._given)
        return config.ruled(log), bag, config

    def _take(self, log: RosbagLog, bag: Bag, until: float) -> None:
        self.log, self._clock, self._bag = log, log.plan.clock, bag
        self._reader = MessageReader(bag, log.plan, log.rules)
        self._follower = Follower(log.plan.places, log.plan.clock, bag.decoded, log.plan.covariances)
        self.sensors = [sensor.topic.name for sensor in log.sensors]
        if not self._topics:
            self._reading["topic"] = list(self.sensors)
        self._topics = {plain(sensor.topic.name) for sensor in log.sensors}
        self._latest, self._entry, self._released = {}, None, 0
        self._corrections, self._jumps = [], Jumps()
        parts = self._given.parts(log.dim)
        self._selected = OneByOne(Selection(log.dim, **parts), self._name) if parts else None
        self._known_until = until
        came = sorted((*self._fixed, *self._early), key=lambda raw: raw.received)
        self._later = [raw for raw in came if 1e-9 * raw.received > until]
        for kept in (self._fixed, self._early):
            known = [raw for raw in kept if 1e-9 * raw.received <= until]
            kept.clear()
            kept.extend(known)
        self._correct()
        if self._follows_jumps:
            self._look_for_jumps(everywhere=True)

    def scan(self, entry: Entry, give_up: bool, figures: LiveFigures) -> Scan | Verdict:
        reader, follower, log = self._reader, self._follower, self.log
        assert reader is not None and follower is not None and log is not None
        if entry is not self._entry:
            self._entry, self._measured = entry, None
            if self.may_revise:
                self._keep(entry.item)
            if self.is_pose(entry.item):
                figures.leave_out("other sensors")
                return Verdict.left_out
            try:
                self._measured = reader.measured(entry.item)
            except OtherFrame:
                figures.leave_out("messages in other frames")
                return Verdict.left_out
            except ValueError:
                figures.leave_out("damaged messages")
                return Verdict.left_out
            self._span = reader.span_of(self._measured)
        measured = self._measured
        assert measured is not None
        first, last = self._span
        until = follower.until(measured.topic, measured.frame)
        if until == -math.inf and (give_up or measured.frame in self._unconnected):
            self._unconnected.add(measured.frame)  # The next of them is not worth waiting for.
            figures.leave_out("messages in other frames")
            return Verdict.left_out

        def place() -> Scan:
            follower.asked(measured.topic, last)
            return log.completed(reader.scan(measured), log.limit())

        found = self._posed(measured.topic, Times(first, last, until), give_up, place, figures)
        if self._selected is None or not isinstance(found, Scan):
            return found
        part = self._selected.part(found)
        if part is None:
            figures.leave_out(NOT_SELECTED)
        return Verdict.left_out if part is None else part

    @property
    def pose_topics(self) -> list[str]:
        if self.log is None:
            return []
        path = [self._follow] if self._follow else []
        return path + [
            place.origin for place in self.log.plan.places.values() if place.origin not in (TRANSFORMS, STILL)
        ]

    def said(self) -> list[str]:
        path = [self._no_path] if self._no_path else []
        return [*self.notes, *path, *(self._reader.notes() if self._reader is not None else [])]


def _ways_of(log: RosbagLog, config: Config) -> Any:
    """All by which messages become a map; of two looks that are equal in it, the maps are equal."""
    places = {
        name: (place.fixed_frame, place.frame, place.is_own, place.observer, place.origin, place.moving())
        for name, place in log.plan.places.items()
    }
    is_cut_off = log.limit() is not None
    how = config.options, config.max_range, config.no_return, log.rules.zero_is, is_cut_off, log.dim
    return log.uses, places, log.plan.sweeps, log.plan.covariances.are_used, how
