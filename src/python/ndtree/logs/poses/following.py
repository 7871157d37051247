# SPDX-License-Identifier: BSD-3-Clause
"""Transforms that arrive while a robot drives: what is needed of the past is kept, the rest is forgotten.

So a day takes no more memory than a minute, and poses at times that are kept are, bit for bit, those of the
whole recording.
"""

from __future__ import annotations

from typing import NamedTuple

from numpy.typing import ArrayLike

from ndtree.logs.poses.transforms import TransformTree, plain

#: Stamps that fall by more than this from message to message begin anew [s]; less is late.
FALL = 0.5
#: And this many messages stay below, or as many as there are.
LASTS = 6
#: Poses so much older than the last that was asked for are forgotten [s], but for the last KEPT of each kind.
PAST, KEPT = 2.0, 64
#: And so much older than the newest of their kind, if nothing is asked for [s].
UNASKED = 60.0
#: After how many poses that is done.
TIDY = 256

Edge = tuple[str, str]
_BEGIN = -float("inf")


class _Row(NamedTuple):
    stamp: float
    position: ArrayLike
    quaternion: ArrayLike


class FollowedTree:
    """A tree of transforms that grows at one end and is forgotten at the other.

    Where the times of a transform fall by more than 0.5 s and stay there, its clock has begun again, and what
    was known of it is forgotten.

    `late`: Transforms that came after a pose at their time, or at a later one, was asked for.
    `fallen`: How often the clock of a transform has begun again.
    `released`: Transforms that were taken as fixed until they changed.
    """

    def __init__(self, tree: TransformTree) -> None:
        self.tree = tree
        self.late = self.fallen = self.released = 0
        self._asked = _BEGIN
        self._added = 0
        self._waiting: dict[Edge, list[_Row]] = {}
        self._used: set[Edge] = set()
        self._newest = tree.newest()

    def add(self, parent: str, child: str, stamp: float, position: ArrayLike, quaternion: ArrayLike) -> None:
        """A transform at a time [s]."""
        edge = plain(parent), plain(child)
        self.released += self.tree.release(edge, position, quaternion)
        newest = self._newest.get(edge, _BEGIN)
        if stamp < newest - FALL:
            self._fall(edge, _Row(stamp, position, quaternion))
            return
        for one in self._waiting.pop(edge, ()):  # They were late after all.
            self.tree.add(*edge, *one)
            self.late += 1
        self.late += stamp <= self._asked and edge in self._used
        self.tree.add(*edge, stamp, position, quaternion)
        self._newest[edge] = max(newest, stamp)
        self._added += 1
        if self._added % TIDY == 0:
            for one, newest in self._newest.items():
                self.tree.forget(one, max(self._asked - PAST, newest - UNASKED), KEPT)

    def _fall(self, edge: Edge, row: _Row) -> None:
        waiting = self._waiting.setdefault(edge, [])
        waiting.append(row)
        if len(waiting) < LASTS:
            return
        self.fallen += 1
        self._asked = _BEGIN
        self.tree.begin_anew(edge)
        for one in waiting:
            self.tree.add(*edge, *one)
        self._newest[edge] = max(one.stamp for one in waiting)
        del self._waiting[edge]

    def until(self, target: str, source: str) -> float:
        """Up to when the pose between frames is known [s]: infinite where nothing moves between them.

        Nothing is known, up to minus infinity, of frames that are not connected.
        """
        try:
            edges = self.tree.moving(target, source)
        except ValueError:
            return _BEGIN
        self._used.update(edges)
        return min((self._newest.get(edge, float("inf")) for edge in edges), default=float("inf"))

    def asked(self, until: float) -> None:
        """Take note that poses up to a time were asked for [s]: transforms that come later are late."""
        self._asked = max(self._asked, until)
