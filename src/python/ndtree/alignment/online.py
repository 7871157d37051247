# SPDX-License-Identifier: BSD-3-Clause
"""The alignment of scans that come one by one.

Strategy: the tracker and the graph are those of `align`. A scan is placed when it comes. When a submap is
complete, a thread looks for it in older ones; what it finds counts some key scans later, however long it
took, so that the same scans give the same poses. After `finish` the poses are those of `align`, but for
rounding, and for scans of a stall that a loop had counted with before it ended.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ndtree.alignment.aligning import MAX_RANGE, is_confirmed, scale_of, told_scale
from ndtree.alignment.loops import SUBMAP_SCANS, SUBMAP_WAY, Graph, Loop
from ndtree.alignment.motion import NO_ODOMETRY, Motion
from ndtree.alignment.planar import Floats, between, composed
from ndtree.alignment.result import Alignment, between_keys
from ndtree.alignment.sensor_scans import SensorScan, Track, sensor_scan
from ndtree.alignment.tracking import Tracker
from ndtree.base.scan import Scan

_CELL = 0.05  # Of the matched map, as `align` has it [m].
_TAKEN = 5  # Key scans after which loops count that were looked for.
_TELL = 100  # Motions that tell odometry's scale.
_MOST_KEPT = 2000  # Scans that may be matched once more with it.


@dataclass(frozen=True)
class Drive:
    """Scans that were placed, with the loops that were found; the track's poses are those in the map."""

    track: Track
    loops: list[Loop]
    stamps: list[float]


class OnlineAlignment:
    """Poses of scans, each as soon as it comes, and those of all when a place was seen again.

    `odometry`: Whether scans' poses say how the sensor moved.
    `earlier`: That is gone on with.
    Attributes:
    `state`: How things stood when loops were looked for last.
    `covariance` (3, 3) float64: Of the last scan's x, y [m] and yaw [rad], in what was seen shortly before.
    """

    def __init__(self, *, odometry: bool = True, earlier: Drive | None = None) -> None:
        self._how = _CELL, Motion() if odometry else NO_ODOMETRY, odometry
        track = None if earlier is None else earlier.track.copy()
        self._tracker = Tracker(*self._how, track=track)
        self._first: list[SensorScan] = []  # Until they have told odometry's scale.
        self._is_told = not odometry or earlier is not None
        self._stamps = [] if earlier is None else list(earlier.stamps)
        self._odometry = list(self.track.poses)
        self.state: Alignment | None = None
        self._begin_graph([] if earlier is None else earlier.loops)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="ndtree-loops")

    def _begin_graph(self, loops: list[Loop]) -> None:
        self._graph = Graph(self.track, loops)  # The thread's, while there is a job.
        self._solved = np.zeros((0, 3))  # Key scans in the map, where loops have moved them.
        self._is_new = False
        self._job: Future[Alignment] | None = None
        self._taken_at = self._looked_at = max(len(self.track.keys) - 1, 0)

    @property
    def track(self) -> Track:
        return self._tracker.track

    @property
    def covariance(self) -> Floats:
        return self._tracker.covariance

    def add(self, scan: Scan, covariance: Floats | None = None) -> Floats:
        """Place a scan, in 2-D.

        `scan`: Its pose is that of odometry.
        `covariance` (3, 3) float64, optional: Of its pose in the map, where only that connects it with the
            scans before: the first of a drive.
        Returns (3,) float64: x, y [m] and yaw [rad] of its sensor in the map.
        """
        keys = len(self.track.keys)
        found = sensor_scan(scan, MAX_RANGE)
        self._stamps.append(scan.stamp)
        self._odometry.append(found.pose)
        if covariance is None:
            self._tracker.add(found)
        else:
            self._tracker.begin(found, covariance)
        self._is_new = self._is_new or self._tracker.is_smoothed
        self._tracker.is_smoothed = False
        self._learn_scale(found)
        if len(self.track.keys) > keys:
            self._look()
        return self._last_in_map()

    def _last_in_map(self) -> Floats:
        pose = self.track.poses[-1]
        if not len(self._solved):
            return pose
        key = len(self._solved) - 1
        return composed(self._solved[key], between(self.track.poses[self.track.keys[key]], pose))

    def corrected(self) -> Floats | None:
        """Poses of all scans in the map, (n, 3), if earlier ones have changed since the last call."""
        is_new, self._is_new = self._is_new, False
        return self._placed(np.array(self.track.poses), self._solved) if is_new else None

    def finish(self) -> Alignment:
        """Look for the last loops; what all that came says."""
        self._take()
        if not self._is_told:
            self._match_again()
        self._found(self._searched(len(self.track.keys), True))
        self._thread.shutdown()
        return self._state_of(len(self.track.poses), len(self.track.keys))

    def drive(self) -> Drive:
        """What can be gone on with."""
        loops = [] if self.state is None else self.state.loops
        poses = self._placed(np.array(self.track.poses), self._solved)
        return Drive(replace(self.track, poses=list(poses)), loops, self._stamps)

    def _placed(self, poses: Floats, keys: Floats) -> Floats:
        """Poses of scans as tracked, moved with the first key scans to where these are."""
        return between_keys(poses, self.track.keys[: len(keys)], keys) if len(keys) else poses

    def _learn_scale(self, scan: SensorScan) -> None:
        """Keep the first scans, until they tell how long odometry's ways are."""
        if self._is_told:
            return
        self._first.append(scan)
        if len(self.track.ratios) >= _TELL or len(self._first) >= _MOST_KEPT:
            self._match_again()

    def _match_again(self) -> None:
        """Match the first scans once more, if odometry's ways have another length."""
        motion, first = self._how[1], self._first
        scale = told_scale(self.track.ratios, motion)
        self._first, self._is_told = [], True
        if scale == 1.0:
            return
        again = Tracker(*self._how, scale)
        for one in first:
            again.add(one)
        if is_confirmed(again.track.ratios, scale, motion):
            self._take()
            self._tracker, self.state = again, None
            self._begin_graph([])
            self._is_new = True

    def _look(self) -> None:
        """Take what was found, and look for the next submap when it is complete."""
        keys, way = len(self.track.keys), self.track.way
        if self._job is not None and keys >= self._taken_at:
            self._take()
        since = way[-1] - way[self._looked_at]
        if self._job is None and (since >= SUBMAP_WAY or keys - self._looked_at >= SUBMAP_SCANS):
            self._looked_at, self._taken_at = keys - 1, keys + _TAKEN
            self.track.final = keys
            self._job = self._thread.submit(self._searched, keys, False)

    def _searched(self, keys: int, is_whole: bool) -> Alignment:
        """How things stand after a look for loops among the first key scans."""
        if self._graph.grow(keys, is_whole=is_whole):
            self._graph.close()
        state = self._state_of(self.track.keys[keys - 1] + 1, keys)
        _ = state.doubts  # They are kept there, ready when asked for.
        return state

    def _take(self) -> None:
        if self._job is not None:
            job, self._job = self._job, None
            self._found(job.result())

    def _found(self, state: Alignment) -> None:
        before, self.state = self.state, state
        if len(state.loops) > (0 if before is None else len(before.loops)):
            self._solved = self._graph.poses.copy()
            self._is_new = True

    def _state_of(self, scans: int, keys: int) -> Alignment:
        """Of the first scans and key scans."""
        track, graph = self.track, self._graph
        return Alignment(
            source=None,
            poses=self._placed(np.array(track.poses[:scans]), graph.poses),
            odometry=np.array(self._odometry[:scans]),
            stamps=np.array(self._stamps[:scans]),
            key_scans=np.array(track.keys[:keys]),
            loops=list(graph.loops),
            tested=graph.tested,
            contradicted=graph.contradicted,
            lost=track.lost,
            has_odometry=self._how[2],
            against=[step for step in track.against if step.scan < scans],
            unfixed=np.array(track.unfixed[:scans]),
            through=np.array(track.through[:keys]),
            odometry_scale=scale_of(track.ratios),
            seconds=0.0,
            _scans=track.scans[:keys],
        )
