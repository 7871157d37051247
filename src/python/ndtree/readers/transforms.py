# SPDX-License-Identifier: BSD-3-Clause
"""Frames of a robot and the transforms between them, some fixed and some known over time."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree.readers.trajectory import Pose, Trajectory, unit_quaternions

Floats = NDArray[np.float64]


class TransformTree:
    """Transforms ``T_parent_child``, and through them that between any two connected frames.

    Where several ways connect two frames, the shortest counts. A transform that was ever said to be fixed
    is fixed, and holds at every time.
    """

    def __init__(self) -> None:
        self._fixed: dict[tuple[str, str], Pose] = {}
        self._rows: dict[tuple[str, str], list[tuple[float, ...]]] = {}
        self._moving: dict[tuple[str, str], Trajectory] = {}
        self._ways: dict[tuple[str, str], list[tuple[str, str]] | None] = {}

    def add_fixed(self, parent: str, child: str, pose: Pose) -> None:
        """A transform that holds at every time; a later one replaces it."""
        self._fixed[plain(parent), plain(child)] = pose
        self._ways.clear()

    def add(self, parent: str, child: str, stamp: float, position: ArrayLike, quaternion: ArrayLike) -> None:
        """A transform at one time [s], in any order; of two at the same time the later counts."""
        edge = plain(parent), plain(child)
        self._rows.setdefault(edge, []).append((stamp, *position, *quaternion))  # type: ignore[misc]
        self._moving.pop(edge, None)
        self._ways.clear()

    def add_trajectory(self, parent: str, child: str, trajectory: Trajectory) -> None:
        """A transform over time as a whole."""
        self._moving[plain(parent), plain(child)] = trajectory
        self._ways.clear()

    def connected(self, frame: str) -> list[str]:
        """Sorted names of all frames that are connected with one, itself included."""
        return sorted(self._origins_of(plain(frame)))

    def stamps(self, target: str, source: str) -> Floats:
        """Times [s] at which a pose was said on the way between frames, as far as all of it is known."""
        moving = [self._trajectory(edge) for edge in self._way(target, source) if edge not in self._fixed]
        if not moving:
            return np.zeros(0)
        first = max(trajectory.stamps[0] for trajectory in moving)
        last = min(trajectory.stamps[-1] for trajectory in moving)
        every = np.unique(np.concatenate([trajectory.stamps for trajectory in moving]))
        return every[(every >= first) & (every <= last)]

    def pose_at(self, target: str, source: str, stamp: float) -> Pose:
        """``T_target_source`` at a time [s].

        Raises
        ------
        ValueError
            If the frames are not connected, or a transform is not known at that time.
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
            raise ValueError(
                f"no transform between {key[1]} and {key[0]}, "
                f"{key[1]} is connected with {', '.join(self.connected(key[1])[:12])}"
            )
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

    def _origins_of(self, source: str) -> dict[str, tuple[str, str] | None]:
        """By frame, the last transform on the shortest way to it."""
        edges = dict.fromkeys((*self._fixed, *self._rows, *self._moving))
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
