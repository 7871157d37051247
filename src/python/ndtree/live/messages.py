# SPDX-License-Identifier: BSD-3-Clause
"""Messages of ROS as they come, judged as those of a recording, by the same code.

Strategy: the messages of the first seconds are a bag in memory. What a log decides of a whole bag, it decides
of that one: which topics are mapped, in which frame, where sensors sit, what times of beams mean, and with
which options. Then these messages are mapped, and all that follow.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

from ndtree.base.scan import Scan
from ndtree.live.corrections import Correction, Jumps, Motion
from ndtree.live.figures import LiveFigures
from ndtree.live.intake import PosedIntake, Verdict, motion_in
from ndtree.live.queue import Entry
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.clock import Clock
from ndtree.logs.ros.files.bag import Bag
from ndtree.logs.ros.files.memory import bag_of
from ndtree.logs.ros.following import Follower
from ndtree.logs.ros.messages.beams import SENSORS
from ndtree.logs.ros.messages.head import head_of
from ndtree.logs.ros.placement.placement import STILL, TRANSFORMS
from ndtree.logs.ros.reading import Measured, MessageReader, OtherFrame
from ndtree.logs.ros.rosbag import RosbagLog
from ndtree.logs.ros.storage import Raw
from ndtree.logs.ros.survey import POSES_STREAM, TF, is_static, poses_in
from ndtree.tuning.settings import settle

#: What is decided is decided of the first messages of so long [s].
LOOK = 2.0
#: If that is too little, so much more is waited for, at most [s].
MOST_STEP = 10.0
#: Poses and the like that are kept until then, at most; fixed transforms are all kept.
MOST_EARLY = 100_000


class MessagesIntake(PosedIntake):
    """Takes `Raw` messages: of sensors, with poses and transforms, and of cameras.

    Parameters
    ----------
    name : str
        How errors call the source.
    options : dict, optional
        Of the map.
    reading : dict, optional
        As for `ndtree.read` of a ROS bag: ``topic``, ``fixed_frame``, ``mount`` and so on.
    dim : int, optional
        2 or 3; else what the sensors say.
    max_range : float
        Longer beams are free up to there [m].
    no_return : {"auto", "free", "ignore"}
        What beams without return say.
    follow : str
        A topic with a SLAM's ``nav_msgs/Path``, whose poses correct earlier ones, or "tf" for what changes
        of the map's transform to the odometry's frame tell of them; "" for neither.
    body : str
        The frame that the poses of the Path are of; else the one that moves and is next to the sensor.
    look : float
        Nothing is mapped until measurements of so long have come [s].

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
        *,
        options: dict[str, Any] | None = None,
        reading: dict[str, Any] | None = None,
        dim: int | None = None,
        max_range: float = math.inf,
        no_return: str = "auto",
        follow: str = "",
        body: str = "",
        look: float = LOOK,
    ) -> None:
        super().__init__()
        if not look >= 0:
            raise ValueError(f"look = {look:g} s: must be >= 0")
        self.log: RosbagLog | None = None
        self._name, self._options, self._reading = name, dict(options or {}), dict(reading or {})
        self._wanted_dim, self._max_range, self._no_return, self.look = dim, max_range, no_return, look
        topics = self._reading.get("topic") or []
        names = [topics] if isinstance(topics, str) else topics
        self._topics = {plain(one.partition("@")[0]) for one in names}
        self._follow, self._body = plain(follow), plain(body)
        self._path: Raw | None = None
        self._bag: Bag | None = None
        self._jumps = Jumps() if self._follow == "tf" else None
        self._corrections: list[Correction] = []
        self._fixed: list[Raw] = []
        self._early: deque[Raw] = deque(maxlen=MOST_EARLY)
        self._until: float | None = None
        self._step = look
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
        if self._follow and plain(item.connection.topic) == self._follow:
            self._path = item
            self._correct()
        elif self._follower is not None:
            self._follower.add(item)
            figures.late_poses = self._follower.late
            if self._jumps is not None and item.connection.type in TF:
                self._look_for_jumps()
        elif item.connection.type in TF and is_static(item.connection.topic):
            self._fixed.append(item)
        else:
            self._early.append(item)

    def _correct(self) -> None:
        """Take the newest Path, once it is decided what is mapped."""
        if self._path is None or self._clock is None or self._bag is None:
            return
        raw, self._path = self._path, None
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

    def _look_for_jumps(self) -> None:
        assert self.log is not None and self._jumps is not None
        place = self.log.places[self.sensors[0]]
        found = place.tree.body_of(place.fixed_frame, place.observer or place.frame)
        if found is None or found[0] == place.fixed_frame:
            return
        assert self._follower is not None
        until = self._follower.until(self.sensors[0], found[0])
        if math.isfinite(until):
            correction = self._jumps.add(until, place.tree.pose_at(place.fixed_frame, found[0], until))
            self._corrections += [] if correction is None else [correction]

    def corrections(self) -> list[Correction]:
        taken, self._corrections = self._corrections, []
        return taken

    def motion(self) -> Motion | None:
        assert self._reader is not None and self._measured is not None
        place, frame, stamp = self._reader.frames_of(self._measured)
        return motion_in(place.tree, place.fixed_frame, frame, stamp, self._body)

    def key(self, item: Any) -> tuple[str, float]:
        assert self._clock is not None
        received = 1e-9 * item.received
        stamp, frame = head_of(item) or (received, "")
        return item.connection.topic, self._clock.time((item.connection.topic, frame), received, stamp)

    def is_decidable(self, now: float) -> bool:
        return self._until is not None and now >= self._until

    def begin(self, received: float) -> None:
        if self._until is None:
            self._until = received + self.look

    def decide(self, waiting: Sequence[Entry], everything: bool = False) -> None:
        """As of `Intake`; of what was received until a time, so that it does not depend on threads."""
        assert self._until is not None
        until = math.inf if everything else self._until
        raws = [*self._fixed, *self._early, *(entry.item for entry in waiting)]
        raws = sorted((raw for raw in raws if 1e-9 * raw.received <= until), key=lambda raw: raw.received)
        # If that is too little, the next time is not too soon: each look takes longer than the one before.
        self._step = min(2 * self._step, MOST_STEP) or LOOK
        self._until += self._step
        bag = bag_of(self._name, raws)
        log = RosbagLog(self._name, dim=self._wanted_dim, bag=bag, **self._reading)
        if math.isfinite(self._max_range):
            log.no_return_range = self._max_range
        log.keep_going = True
        settings = settle(
            log,
            options=self._options,
            max_range=self._max_range,
            no_return=self._no_return,
            with_sigma=True,
        )
        self._take(log, bag, until)
        self.settings, self.dim = settings, log.dim
        self.notes = [f"uses {log.uses}", *settings.lines(), *log.notes]

    def _take(self, log: RosbagLog, bag: Bag, until: float) -> None:
        self.log, self._clock, self._bag = log, log.clock, bag
        self._reader = log.reader(bag)
        self._follower = Follower(log.places, log.clock, bag.decoded, log.covariances)
        self.sensors = [sensor.topic.name for sensor in log.sensors]
        self._topics = {plain(sensor.topic.name) for sensor in log.sensors}
        for raw in (*self._fixed, *self._early):
            if 1e-9 * raw.received > until:
                self._follower.add(raw)
        self._fixed.clear()
        self._early.clear()
        self._correct()

    def scan(self, entry: Entry, give_up: bool, figures: LiveFigures) -> Scan | Verdict:
        reader, follower, log = self._reader, self._follower, self.log
        assert reader is not None and follower is not None and log is not None
        if entry is not self._entry:
            self._entry, self._measured = entry, None
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
            return log.completed(reader.scan(measured))

        return self._posed(first, last, until, give_up, place, figures)

    @property
    def pose_topics(self) -> list[str]:
        if self.log is None:
            return []
        path = [self._follow] if self._follow and self._jumps is None else []
        return path + [
            place.origin for place in self.log.places.values() if place.origin not in (TRANSFORMS, STILL)
        ]

    def said(self) -> list[str]:
        return [*self.notes, *(self._reader.notes() if self._reader is not None else [])]
