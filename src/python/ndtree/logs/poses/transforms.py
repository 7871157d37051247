# SPDX-License-Identifier: BSD-3-Clause
"""Frames of a robot and the transforms between them, some fixed and some known over time."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike

from ndtree.logs.core.arrays import Floats
from ndtree.logs.poses.pose import Pose, matrices_of, multiplied, rotated, unit_quaternions
from ndtree.logs.poses.trajectory import LEAP, Trajectory

#: The latest of transforms that come in any order is among this many.
NEWEST = 100
#: Numbers of a transform that differ no more than this are the same.
SAME = 1e-6


class TransformTree:
    """Transforms ``T_parent_child``, and through them that between any two connected frames.

    Where several ways connect two frames, the shortest counts. A transform that was ever said to be fixed
    is fixed, and holds at every time.

    `spaces`: Namespaces of the topics that its transforms are from; None: of all.
    `refused`: Of frames whose transforms are none, what one was.
    """

    def __init__(self, spaces: Collection[str] | None = None) -> None:
        self.spaces = spaces
        self.refused: dict[str, str] = {}
        self._fixed: dict[tuple[str, str], Pose] = {}
        self._rows: dict[tuple[str, str], list[tuple[float, ...]]] = {}
        self._moving: dict[tuple[str, str], Trajectory] = {}
        self._ways: dict[tuple[str, str], list[tuple[str, str]] | None] = {}
        self._taken_for_fixed: set[tuple[str, str]] = set()

    def add_fixed(self, parent: str, child: str, pose: Pose) -> None:
        """A transform that holds at every time; a later one replaces it."""
        self._fixed[plain(parent), plain(child)] = pose
        self._ways.clear()

    def add(self, parent: str, child: str, stamp: float, position: ArrayLike, quaternion: ArrayLike) -> None:
        """A transform at one time [s], in any order; of two at the same time the later counts."""
        edge = plain(parent), plain(child)
        if edge not in self._rows:
            self._rows[edge] = []
            self._ways.clear()
        self._rows[edge].append((stamp, *position, *quaternion))  # type: ignore[misc]
        self._moving.pop(edge, None)

    def add_trajectory(self, parent: str, child: str, trajectory: Trajectory) -> None:
        """A transform over time as a whole."""
        self._moving[plain(parent), plain(child)] = trajectory
        self._ways.clear()

    def moving(self, target: str, source: str) -> list[tuple[str, str]]:
        """The transforms between connected frames that change over time: parents and children."""
        return [edge for edge in self._way(target, source) if edge not in self._fixed]

    def body_of(self, target: str, source: str) -> tuple[str, str] | None:
        """Of the moving transform that is next to `source`: the frame it moves in, and the one that moves.

        None if nothing moves between connected frames.
        """
        at = plain(source)
        for edge in self._way(target, source):
            other = edge[0] if edge[1] == at else edge[1]
            if edge not in self._fixed:
                return other, at
            at = other
        return None

    def newest(self) -> dict[tuple[str, str], float]:
        """The latest time of each transform that was told one time after the other, by `add` [s]."""
        return {edge: max(row[0] for row in rows[-NEWEST:]) for edge, rows in self._rows.items()}

    def forget(self, edge: tuple[str, str], before: float, keep: int) -> None:
        """Forget what a transform was before a time [s], but for the last `keep` > 0 of all."""
        rows = self._rows[edge]
        if len(rows) > keep and rows[0][0] < before:
            self._rows[edge] = [row for row in rows[:-keep] if row[0] >= before] + rows[-keep:]
            self._moving.pop(edge, None)

    def begin_anew(self, edge: tuple[str, str]) -> None:
        """Forget all times of a transform; those that are added later are all there are."""
        self._rows[edge] = []
        self._moving.pop(edge, None)

    def fixed_only(self) -> TransformTree:
        """A tree of its own with the fixed transforms."""
        tree = TransformTree()
        tree._fixed.update(self._fixed)
        return tree

    def connected(self, frame: str) -> list[str]:
        """Sorted names of all frames that are connected with one, itself included."""
        return sorted(self._origins_of(plain(frame)))

    def stamps(self, target: str, source: str) -> Floats:
        """Times [s] at which a pose was said on the way between frames, as far as all of it is known."""
        stamps = [self._trajectory(edge).stamps for edge in self.moving(target, source)]
        every = np.unique(np.concatenate([np.zeros(0), *stamps]))
        first, last = self.span(target, source)
        return every[(every >= first) & (every <= last)]

    def pose_at(self, target: str, source: str, stamp: float) -> Pose:
        """``T_target_source`` at a time [s].

        Raises ValueError if the frames are not connected, or a transform is not known at that time.
        """
        T_at_source = Pose.identity()
        at = plain(source)
        for edge in self._way(target, source):
            fixed = self._fixed.get(edge)
            T_parent_child = self._trajectory(edge).pose_at(stamp) if fixed is None else fixed
            if at == edge[1]:
                T_at_source, at = T_parent_child @ T_at_source, edge[0]
            else:
                T_at_source, at = T_parent_child.inverse() @ T_at_source, edge[1]
        return T_at_source

    def poses_at(self, target: str, source: str, stamps: ArrayLike) -> tuple[Floats, Floats]:
        """``T_target_source`` at times (n,) [s]: rotations (n, 3, 3) and positions (n, 3) [m].

        Raises ValueError as `pose_at`, for any of the times.
        """
        times = np.asarray(stamps, dtype=np.float64)
        rotations = np.broadcast_to(np.eye(3), (len(times), 3, 3))
        positions = np.zeros((len(times), 3))
        at = plain(source)
        for edge in self._way(target, source):
            fixed = self._fixed.get(edge)
            if fixed is None:
                moved, quaternions = self._trajectory(edge).poses_at(times)
                turned = matrices_of(quaternions)
            else:
                moved, turned = fixed.position, fixed.rotation
            if at == edge[0]:
                turned = np.swapaxes(turned, -1, -2)
                moved = -rotated(turned, moved)
            rotations = multiplied(turned, rotations)
            positions = rotated(turned, positions) + moved
            at = edge[0] if at == edge[1] else edge[1]
        return rotations, positions

    def stands(self, target: str, source: str) -> bool:
        """Whether the pose between connected frames is the same at all times at which it is known."""
        return all(map(self._is_constant, self.moving(target, source)))

    def span(self, target: str, source: str) -> tuple[float, float]:
        """First and last time [s] at which the pose between connected frames is known; may be infinite."""
        first, last = -np.inf, np.inf
        for edge in self.moving(target, source):
            stamps = self._trajectory(edge).stamps
            first, last = max(first, float(stamps[0])), min(last, float(stamps[-1]))
        return first, last

    def leaps(self, target: str, source: str) -> list[str]:
        """What is said of transforms between connected frames that leap, or are fixed and others, too."""
        said = [self._trajectory(edge).leaps() for edge in self.moving(target, source)]
        for parent, child in self._way(target, source):
            fixed, rows = self._fixed.get((parent, child)), np.array(self._rows.get((parent, child), ()))
            if fixed is not None and len(rows) and (parent, child) not in self._taken_for_fixed:
                turned = np.abs(matrices_of(rows[:, 4:]) - fixed.rotation).max()
                moved = np.linalg.norm(rows[:, 1:4] - fixed.position, axis=1).max()
                if moved > LEAP or turned > LEAP:
                    what = f"transforms from {parent} to {child} are fixed in /tf_static, which counts"
                    said.append(f"{what}, and others in /tf, up to {moved:.2f} m away: expected one of both")
        return [one for one in said if one]

    def fix_constant(self, target: str, source: str) -> list[str]:
        """Take transforms between frames that never changed for fixed; which, as "a to b"."""
        fixed = []
        for edge in self.moving(target, source):
            if self._is_constant(edge):
                poses = self._trajectory(edge)
                self._fixed[edge] = Pose.from_quaternion(poses.positions[0], poses.quaternions[0])
                self._taken_for_fixed.add(edge)
                fixed.append(f"{edge[0]} to {edge[1]}")
        return fixed

    def release(self, edge: tuple[str, str], position: ArrayLike, quaternion: ArrayLike) -> bool:
        """Let a transform that was taken as fixed move if it is another one now; whether that is so."""
        if edge not in self._taken_for_fixed:
            return False
        fixed, now = self._fixed[edge], Pose.from_quaternion(position, quaternion)
        moved, turned = abs(fixed.position - now.position).max(), abs(fixed.rotation - now.rotation).max()
        if max(moved, turned) <= SAME:
            return False
        self._taken_for_fixed.remove(edge)
        del self._fixed[edge]
        self._ways.clear()
        return True

    def fixed_parent(self, frame: str) -> tuple[str, Pose]:
        """The frame to which one is fixed, and ``T_parent_frame``; ValueError if there is none."""
        for (parent, child), pose in self._fixed.items():
            if child == frame:
                return parent, pose
        raise ValueError(f"{frame} is fixed to no frame")

    def roots(self, frame: str, *, fixed: bool = False) -> list[str]:
        """Frames connected with one that are no frame's child; with `fixed` by fixed transforms alone."""
        connected = self._origins_of(plain(frame), fixed=fixed)
        edges = self._fixed if fixed else {**self._fixed, **self._rows, **self._moving}
        children = {child for _, child in edges}
        return sorted(one for one in connected if one not in children)

    def frames(self) -> list[str]:
        """Sorted names of all frames."""
        return sorted({frame for edge in self._edges() for frame in edge})

    def below(self, frame: str) -> list[str]:
        """Children of a frame, their children, and so on; the uppermost first."""
        edges = self._edges()
        found: list[str] = []
        waiting = deque([plain(frame)])
        while waiting:
            at = waiting.popleft()
            for child in sorted(child for parent, child in edges if parent == at):
                if child not in found and child != plain(frame):
                    found.append(child)
                    waiting.append(child)
        return found

    def lines(self) -> list[str]:
        """The frames as trees, a line each, indented; moving ones say so."""
        children: dict[str, list[str]] = {}
        for parent, child in self._edges():
            children.setdefault(parent, []).append(child)
        lines: list[str] = []
        seen: set[str] = set()

        def walk(frame: str, parent: str | None, depth: int) -> None:
            edge = (parent or "", frame)
            moves = parent is not None and edge not in self._fixed and not self._is_constant(edge)
            lines.append("  " * depth + frame + (" (moves)" if moves else ""))
            if frame not in seen:
                seen.add(frame)
                for child in sorted(children.get(frame, ())):
                    walk(child, frame, depth + 1)

        everyone = {child for ones in children.values() for child in ones}
        for root in sorted(children.keys() - everyone):
            walk(root, None, 0)
        for frame in sorted(children.keys() - seen):  # What goes round in circles.
            if frame not in seen:
                walk(frame, None, 0)
        return lines

    def _is_constant(self, edge: tuple[str, str]) -> bool:
        poses = self._trajectory(edge)
        apart = (np.ptp(values, axis=0).max() for values in (poses.positions, poses.quaternions))
        return bool(max(apart) <= SAME)

    def _edges(self) -> list[tuple[str, str]]:
        return list(dict.fromkeys((*self._fixed, *self._rows, *self._moving)))

    def _trajectory(self, edge: tuple[str, str]) -> Trajectory:
        if edge not in self._moving:
            rows = np.array(self._rows[edge], dtype=np.float64)
            rows = rows[np.argsort(rows[:, 0], kind="stable")]
            rows = rows[np.append(rows[1:, 0] != rows[:-1, 0], True)]
            name = f"transform from {edge[0]} to {edge[1]}"
            self._moving[edge] = Trajectory(rows[:, 0], rows[:, 1:4], rows[:, 4:], name=name)
        return self._moving[edge]

    def _way(self, target: str, source: str) -> list[tuple[str, str]]:
        key = plain(target), plain(source)
        if key not in self._ways:
            self._ways[key] = self._search(*key)
        way = self._ways[key]
        if way is None:
            others = ", ".join(self.connected(key[1])[:12])
            raise ValueError(f"no transform between {key[1]} and {key[0]}, expected one of {others}")
        return way

    def _search(self, target: str, source: str) -> list[tuple[str, str]] | None:
        origins = self._origins_of(source)
        if target not in origins:
            return None
        way: list[tuple[str, str]] = []
        at = target
        while at != source:
            edge = origins[at]
            assert edge is not None
            way.append(edge)
            at = edge[0] if edge[1] == at else edge[1]
        return way[::-1]

    def _origins_of(self, source: str, *, fixed: bool = False) -> dict[str, tuple[str, str] | None]:
        """By frame, the last transform on the shortest way to it; with `fixed` by fixed ones alone."""
        edges = list(self._fixed) if fixed else self._edges()
        by_frame: dict[str, list[tuple[str, str]]] = {}
        for edge in edges:
            for frame in edge:
                by_frame.setdefault(frame, []).append(edge)
        origins: dict[str, tuple[str, str] | None] = {source: None}
        waiting = deque([source])
        while waiting:
            at = waiting.popleft()
            for edge in by_frame.get(at, ()):
                other = edge[0] if edge[1] == at else edge[1]
                if other not in origins:
                    origins[other] = edge
                    waiting.append(other)
        return origins


def plain(frame: str) -> str:
    """A frame's name without the slash that old recordings have before it."""
    return frame.lstrip("/")


def is_transform(position: ArrayLike, quaternion: ArrayLike) -> bool:
    """Whether numbers are finite and a quaternion is of length 1."""
    try:
        unit_quaternions(np.asarray(quaternion, dtype=np.float64)[None])
    except ValueError:
        return False
    return bool(np.isfinite(np.asarray(position, dtype=np.float64)).all())
