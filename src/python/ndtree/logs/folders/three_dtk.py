# SPDX-License-Identifier: BSD-3-Clause
"""Folders of 3DTK (slam6D): ``scan000.3d`` and ``scan000.pose``, in centimetres and a left-handed frame."""

from __future__ import annotations

import math
import os
import re

import numpy as np

from ndtree.logs.core.arrays import Floats, Points
from ndtree.logs.core.failures import at_place
from ndtree.logs.core.plain_file import text_lines
from ndtree.logs.core.source import Format, Source
from ndtree.logs.folders.folder import FolderLog, number_in, stem_of
from ndtree.logs.folders.text_clouds import text_points
from ndtree.logs.poses.pose import Pose, about_axes

_SCAN = re.compile(r"scan\d+\.3d")
#: The map has x ahead, y to the left and z up; 3DTK has x to the right, y up and z ahead.
_MAP_FROM_3DTK = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
_METRES = 0.01


class ThreeDtkLog(FolderLog):
    """Scans with the poses that matching has found (``scan000.frames``, its last line), else those before it.

    In ``scan000.pose`` are the position [cm] and three angles [deg], about x, y and z: the rotation is that
    about x times that about y times that about z.
    """

    format = "3dtk"
    may_be_cut_off = True

    def __init__(self, source: Source) -> None:
        found = [name for name in source.names if _SCAN.fullmatch(name)]
        names = sorted(found, key=lambda name: number_in(stem_of(name)) or 0)
        super().__init__(source.path, [source.inside(name) for name in names])
        stems = [os.path.splitext(file)[0] for file in self._files]
        self._matched = [os.path.isfile(f"{stem}.frames") for stem in stems]
        if any(self._matched):
            some = f"{sum(self._matched)} of {len(stems)} poses"
            self._decided.append(f"{some} are those of the matching, the last in .frames")

    def _pose(self, i: int) -> Pose:
        stem = os.path.splitext(self._files[i])[0]
        rotation, position = _frames_in(f"{stem}.frames") if self._matched[i] else _pose_in(f"{stem}.pose")
        turned = _MAP_FROM_3DTK @ rotation @ _MAP_FROM_3DTK.T
        return Pose(turned, _METRES * (_MAP_FROM_3DTK @ position))

    def _points(self, i: int) -> Points:
        return _METRES * (text_points(self._files[i]) @ _MAP_FROM_3DTK.T)


def _pose_in(path: str) -> tuple[Floats, Floats]:
    rows = [line.split() for _, line in text_lines(path) if line.strip()]
    with at_place(path, "a line with the position [cm], and one with three angles [deg]"):
        position, degrees = ([float(field) for field in row] for row in rows)
        if not (len(position) == len(degrees) == 3 and np.isfinite([*position, *degrees]).all()):
            raise ValueError("not three finite numbers each")
    about_x, about_y, about_z = about_axes(*map(math.radians, degrees))
    return about_x @ about_y @ about_z, np.array(position)


def _frames_in(path: str) -> tuple[Floats, Floats]:
    """The last matrix of the file: 16 numbers, column by column, and a number of its colour."""
    last: list[str] = []
    for _, line in text_lines(path):
        last = line.split() or last
    with at_place(f"{path}: last line", "16 numbers of a matrix"):
        pose = Pose.from_matrix(np.array([float(field) for field in last[:16]]).reshape(4, 4).T)
    return pose.rotation, pose.position


def _recognises(source: Source) -> bool:
    names = set(source.names)
    return any(_SCAN.fullmatch(name) and f"{name[:-3]}.pose" in names for name in source.names)


THREE_DTK = Format("3dtk", "a folder of 3DTK", _recognises, ThreeDtkLog, stored_as="folder")
