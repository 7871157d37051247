# SPDX-License-Identifier: BSD-3-Clause
"""Places that were seen before, and poses that fit all of them.

Strategy: key scans in a row are a submap. Each submap is looked for in older ones that may be near, in a
window as large as the way between them in the graph allows drift. It is found where its points fit, no other
pose of the window fits nearly as well, and its scans agree with theirs: hardly a point lies where others saw
through. Each that is found becomes a relation with a robust kernel, and the graph is solved, before the
next submap is looked for.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ndtree._native._core import Matcher, solve_pose_graph
from ndtree.alignment.planar import Floats, between, composed, placed, pose_of, thinned
from ndtree.alignment.sensor_scans import Outline, Track
from ndtree.base.progress import Progress, no_progress

SUBMAP_WAY = 4.0  # Of a submap [m],
SUBMAP_SCANS = 60  # and its key scans, at most.
_NEAR = 6.0  # Submaps whose middles may be nearer are looked at [m].
_MOST = 8  # Of these the nearest.
_DRIFT = (0.3, 0.03)  # How far a place may be wrong: at once, and for a way [m, 1].
_DRIFT_ANGLE = (0.05, 0.004)  # The same of the yaw [rad, rad/m].
_LARGEST = (6.0, 0.7)  # Window [m, rad].
_LOOP_WAY = 0.5  # What a relation between submaps counts as a way [m].
_SCORE = 0.4  # Of a submap that is found.
_AGREE = 0.85  # Of points, that do not lie where others saw through.
_FEWEST = 100  # Points that were compared.
_APART = 1.0  # Farther poses of the window are others [m].
_WIDER = 4.0  # Covariance of a relation, times: points next to each other are wrong alike.
_LEAST = np.diag([0.02, 0.02, 0.003]) ** 2  # Added to it: submaps are bent a little.
_KERNEL = 3.0  # Standard deviations.
_KEPT = 64  # Submaps whose points are ready to be matched with: about 1 MB each.
_CONTRADICTED = 0.2  # Weight of a relation that the others contradict.


@dataclass(frozen=True)
class Loop:
    """A submap that was found in an older one: a relation between two key scans."""

    older: int
    newer: int
    relation: Floats
    information: Floats


class Graph:
    """Key scans of a track and relations between their poses; it takes what is added to the track by `grow`.

    Of loops that are given, the track's poses are already where they fit, and its submaps were looked for.

    `poses` (n, 3) float64: Of the key scans.
    `loops`: Found so far.
    `tested`: Pairs of submaps that were looked at.
    """

    def __init__(self, track: Track, loops: Sequence[Loop] = ()) -> None:
        self._track = track
        self._scans = track.scans
        self.poses = np.zeros((0, 3))
        self.loops = list(loops)
        self.tested = 0
        self._looked = 0  # Submaps that were looked for.
        self._matchers: dict[int, Matcher] = {}
        self._outlines: dict[int, Outline] = {}
        self._joined: dict[int, list[int]] = {}
        self.grow()
        if loops:
            self._looked = len(self._submaps)
            firsts = [ids[0] for ids in self._submaps]
            for one in loops:
                self._join(*(np.searchsorted(firsts, [one.older, one.newer], side="right") - 1).tolist())

    def grow(self, count: int | None = None, *, is_whole: bool = True) -> int:
        """Take the track's first key scans; how many submaps are not looked for yet.

        `count`: Of key scans; else all.
        `is_whole`: Whether nothing follows: else the last submap is not complete.
        """
        track, known = self._track, len(self.poses)
        count = len(track.keys) if count is None else count
        keys = track.keys[known:count]
        new = np.array([track.poses[key] for key in keys]).reshape(-1, 3)
        if known:  # They are where they were matched, seen from the last.
            new = composed(self.poses[-1], between(track.poses[track.keys[known - 1]], new))
        self.poses = np.concatenate((self.poses, new))
        self._way = np.asarray(track.way[:count])
        self._relations = np.array(track.relations[: count - 1]).reshape(-1, 3)
        self._information = np.linalg.inv(np.array(track.covariances[: count - 1]).reshape(-1, 3, 3))
        self._submaps = _in_rows(self._way, is_whole)
        self._middles = np.array([ids[len(ids) // 2] for ids in self._submaps])
        return len(self._submaps) - self._looked

    def close(self, progress: Progress = no_progress) -> bool:
        """Look for new submaps in older ones; whether one was found."""
        before = len(self.loops)
        for newer in range(self._looked, len(self._submaps)):
            found = [
                loop for older, near in self._candidates(newer) if (loop := self._find(older, newer, near))
            ]
            if found:
                self.loops += found
                self.solve()
            progress("closing loops", newer + 1, len(self._submaps))
        self._looked = len(self._submaps)
        return len(self.loops) > before

    def solve(self) -> None:
        """Move the poses to where all relations fit best."""
        count = len(self._relations)
        numbers = np.arange(count)
        pairs = [np.column_stack((numbers, numbers + 1))] + [[(one.older, one.newer)] for one in self.loops]
        self.poses = solve_pose_graph(
            self.poses,
            np.concatenate(pairs),
            np.concatenate([self._relations] + [one.relation[None] for one in self.loops]),
            np.concatenate([self._information] + [one.information[None] for one in self.loops]),
            np.array([0.0] * count + [_KERNEL] * len(self.loops)),
        )[0]

    @property
    def contradicted(self) -> int:
        """Loops that others contradict, and that hardly count."""
        total = 0
        for loop in self.loops:
            off = between(self.poses[loop.older], self.poses[loop.newer]) - loop.relation
            square = float(off @ loop.information @ off)
            total += 1 / (1 + square / _KERNEL**2) < _CONTRADICTED
        return total

    def _candidates(self, newer: int) -> list[tuple[int, float]]:
        """Older submaps that may be near, the nearest first, and how long the way to each is."""
        ways = self._ways_from(newer)
        first = self._way[self._submaps[newer][0]]
        here = self.poses[self._middles[newer], :2]
        near = []
        for older in range(newer - 1):
            if first - self._way[self._submaps[older][-1]] < 1.5 * SUBMAP_WAY:
                continue
            away = float(np.hypot(*(self.poses[self._middles[older], :2] - here)))
            least = away - (_DRIFT[0] + _DRIFT[1] * ways[older])
            if least < _NEAR:
                near.append((max(0.0, least) + 0.1 * away, older, float(ways[older])))
        return [(older, way) for _, older, way in sorted(near)[:_MOST]]

    def _ways_from(self, submap: int) -> Floats:
        """The shortest way in the graph to each submap [m]."""
        way = self._way[self._middles]
        ways = np.full(len(way), np.inf)
        ways[submap] = 0.0
        queue = [(0.0, submap)]
        while queue:
            so_far, at = heapq.heappop(queue)
            if so_far > ways[at]:
                continue
            steps = [(to, abs(way[to] - way[at])) for to in (at - 1, at + 1) if 0 <= to < len(way)]
            for to, length in steps + [(to, _LOOP_WAY) for to in self._joined.get(at, ())]:
                if so_far + length < ways[to]:
                    ways[to] = so_far + length
                    heapq.heappush(queue, (float(ways[to]), to))
        return ways

    def _find(self, older: int, newer: int, way: float) -> Loop | None:
        """A submap in an older one, if it is surely there."""
        self.tested += 1
        near = min(_DRIFT[0] + _DRIFT[1] * way, _LARGEST[0])
        angle = min(_DRIFT_ANGLE[0] + _DRIFT_ANGLE[1] * way, _LARGEST[1])
        a, b = int(self._middles[older]), int(self._middles[newer])
        points = thinned(self._points(self._submaps[newer], b), 0.1)
        match = self._matcher(older).match(
            points, between(self.poses[a], self.poses[b]), window=(near, near, angle), apart=_APART
        )
        if match.score < _SCORE or not match.is_unique:
            return None
        relation = pose_of(match.pose)
        if not self._agree(older, newer, relation):
            return None
        self._join(older, newer)
        # The covariance is in the frame of the older, as the match is.
        return Loop(a, b, relation, np.linalg.inv(_WIDER * match.covariance + _LEAST))

    def _join(self, older: int, newer: int) -> None:
        self._joined.setdefault(older, []).append(newer)
        self._joined.setdefault(newer, []).append(older)

    def _agree(self, older: int, newer: int, relation: Floats) -> bool:
        """Whether scans of two submaps see the same."""
        a, b = self._middles[older], self._middles[newer]
        theirs = self._around(older)[::3]
        places = between(self.poses[a], self.poses[theirs])
        same = through = 0
        for key in self._submaps[newer][::4]:
            pose = composed(relation, between(self.poses[b], self.poses[key]))
            off = between(places, pose[None])
            for i in np.argsort(np.hypot(off[:, 0], off[:, 1]) + np.abs(off[:, 2]), kind="stable")[:2]:
                hits, misses = self._outline(int(theirs[i])).judge(placed(off[i], self._scans[key].points))
                same += hits
                through += misses
        return same >= _FEWEST and same >= _AGREE * (same + through)

    def _around(self, submap: int) -> Sequence[int]:
        """Key scans of a submap and of those beside it."""
        return np.arange(
            self._submaps[max(0, submap - 1)][0],
            self._submaps[min(len(self._submaps) - 1, submap + 1)][-1] + 1,
        )

    def _matcher(self, submap: int) -> Matcher:
        """Of a submap and those beside it, in the frame of its middle; the last that were used are kept."""
        found = self._matchers.pop(submap, None)
        if found is None:
            points = self._points(self._around(submap), int(self._middles[submap]))
            found = Matcher(points, sigma=0.075)
        self._matchers[submap] = found
        if len(self._matchers) > _KEPT:
            del self._matchers[next(iter(self._matchers))]
        return found

    def _outline(self, key: int) -> Outline:
        if key not in self._outlines:
            self._outlines[key] = Outline(self._scans[key])
        return self._outlines[key]

    def _points(self, keys: Sequence[int], middle: int) -> Floats:
        """End points of key scans in the frame of one."""
        frame = self.poses[middle]
        return np.concatenate(
            [placed(between(frame, self.poses[key]), self._scans[key].points) for key in keys]
        )


def _in_rows(way: Floats, is_whole: bool) -> list[range]:
    """Key scans in submaps; the last may be incomplete if the way `is_whole`."""
    rows: list[range] = []
    first = 0
    for key in range(1, len(way) + is_whole):
        if key == len(way) or way[key] - way[first] >= SUBMAP_WAY or key - first >= SUBMAP_SCANS:
            rows.append(range(first, key))
            first = key
    if is_whole and len(rows) > 1 and len(rows[-1]) < 5:
        rows[-2:] = [range(rows[-2].start, rows[-1].stop)]
    return rows
