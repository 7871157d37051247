# SPDX-License-Identifier: BSD-3-Clause
"""Folders of point clouds, a file each scan, with a trajectory, a pose for each file, or a pose in each."""

from __future__ import annotations

import contextlib
import os
import shlex
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from ndtree.base.scan import Scan
from ndtree.base.words import number_of
from ndtree.logs.core.arrays import Points
from ndtree.logs.core.silence import without_zeros
from ndtree.logs.core.source import Format, Source, Unplaced, source_of, without_sensor
from ndtree.logs.folders import cloud_files, scan_folder
from ndtree.logs.folders.cloud_files import BIN_CLOUD, TEXT_CLOUD, CloudFile, kind_of_file, kind_of_name
from ndtree.logs.folders.folder import FolderLog, PosesOfFiles, number_in, stamps_in, stem_of
from ndtree.logs.folders.scan_folder import FoundPoses, Scans
from ndtree.logs.folders.text_clouds import ENDINGS, MAYBE, columns_in, ends_as_points
from ndtree.logs.formats.text import dimension_of, first_fields, looks_like_points
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.trajectory_files import read_pose, trajectory_kind

_PCD = kind_of_name("a.pcd")


class PointCloudLog(FolderLog):
    """PCD, PLY, LAS, LAZ, text or bare numbers, a file each scan, in the order of numbers or times.

    The files are in the folder, or in a subfolder of it. Poses come from one of these, the first that is
    there:

    - ``trajectory``;
    - a pose for each file, 3x4 or 4x4 numbers in ``000000.pose.txt`` or ``000000.txt``, beside it or in a
      folder ``poses``;
    - the only trajectory file beside the files, above them, or in a folder for poses there, whatever its name
      (``times.txt`` has the times of numbered files); see `PosesOfFiles` for which pose is whose;
    - VIEWPOINT of PCD files, or the element camera that PCL writes to PLY files, unless it is the identity in
      all: so it is where it was not said;
    - poses in the folder above, if there is one for each file, or they are there at all its times.

    Points without poses need `origin_of_scan` or `points_only`.

    With `points_in` "map" only the positions of the poses are used, as origins of the beams. `time_offset`
    [s] is added to the files' times before their poses are looked up.
    """

    format = "point_clouds"
    may_be_cut_off = True

    def __init__(
        self,
        source: Source,
        trajectory: str | None = None,
        time_offset: float = 0.0,
        points_in: str = "sensor",
        origin_of_scan: str | Sequence[float] | None = None,
        points_only: bool = False,
    ) -> None:
        unplaced = Unplaced.of(source.path, origin_of_scan, points_only, trajectory=trajectory)
        self._points_in, self._unplaced = points_in, unplaced
        self.has_sensor = not unplaced.points_only
        scans = _scans_of(source)
        if scans is None:
            raise ValueError(f"{source.path}: no point clouds, expected PCD, PLY, LAS, LAZ, text or .bin")
        scans = replace(scans, names=tuple(_in_order(list(scans.names))))
        self._kind = scans.kind
        super().__init__(source.path, scans.files)
        self._stamps = stamps_in([stem_of(file) for file in self._files])
        self._beside: tuple[str | None, ...] = ()
        if self._kind.note is not None:
            with contextlib.suppress(ValueError, OSError):  # Reading says it.
                said = self._kind.note(self._files[0])
                self._decided += [said] if said else []
        if unplaced:
            self.may_be_cut_off = unplaced.origin is not None
            return
        if trajectory is not None:
            self._poses = self._poses_in(trajectory, scans, time_offset)
        else:
            self._find_poses(source, scans, time_offset)

    def _poses_in(self, trajectory: str, scans: Scans, time_offset: float) -> PosesOfFiles:
        return PosesOfFiles(trajectory, self._files, scan_folder.times_of(scans.folder, scans), time_offset)

    def _find_poses(self, source: Source, scans: Scans, time_offset: float) -> None:
        """Poses by where they are; raises the error of points without any."""
        found = (
            scan_folder.poses_of(source.path, scans) if source.is_folder else scan_folder.pose_beside(scans)
        )
        # Those above may be of other scans, and those beside one map of the scans that it was made of.
        must_fit = len(self) == 1 and number_in(stem_of(self._files[0])) is None
        is_above = not found and not self._have_viewpoints() and source.is_folder
        if is_above:
            found, must_fit = scan_folder.poses_above(scans), True
        others = ""
        if found.trajectory is not None:
            poses = self._poses_in(found.trajectory, scans, time_offset)
            others = _misfit(poses, found.trajectory, is_above) if must_fit else ""
            self._poses, found = (None, FoundPoses()) if others else (poses, found)
        if not found and not self._have_viewpoints():
            raise without_sensor(
                source.path, self._said(), more=self._more(others or scan_folder.unread_poses(scans))
            )
        self._beside = found.beside
        one = found.trajectory or next((name for name in found.beside if name), None)
        if one is not None and os.path.dirname(one) != scans.folder:
            self._decided.append(f"poses are from {one if found.trajectory else os.path.dirname(one)}")

    @property
    def knows_no_returns(self) -> bool:  # type: ignore[override]
        """As of other folders; points without a sensor have no beams."""
        return not self._unplaced.points_only and super().knows_no_returns

    def _have_viewpoints(self) -> bool:
        """Identities are no poses: the header has them where none was given."""
        if self._kind.viewpoint is None:
            return False
        for path in self._files:
            try:
                pose = self._kind.viewpoint(path)
            except ValueError:
                return True  # Said by somebody; the error is that of the scan.
            if not np.allclose(pose.matrix(3), np.eye(4), rtol=0.0, atol=1e-6):  # Within float32's rounding.
                return True
        return False

    def _said(self) -> str:
        """What the files are, for the error of those without poses."""
        kind = self._kind.name
        why = " (VIEWPOINT is the identity{})" if self._kind is _PCD else ""
        if len(self) > 1:
            kinds = {"text": "files of points in text", "bin": "files of float32 numbers, as KITTI's scans"}
            return f"{len(self)} {kinds.get(kind, f'{kind} files')} without poses{why.format(' in all')}"
        if self._kind is BIN_CLOUD:
            return f"a laser scan as KITTI's (.bin, {self._width} float32 numbers a point) without its pose"
        if self._kind is TEXT_CLOUD:
            source = source_of(self._files[0], "points")
            why = looks_like_points(source) if _may_be_beams(source) else None  # Where it has to be told.
            return "points in text without a pose" + (f" ({why})" if why else "")
        kind = "LAZ" if self._files[0].lower().endswith("z") else kind
        return f"a {kind} of points without a pose{why.format('')}"

    def _more(self, others: str) -> list[str]:
        """Further ways to say the poses; `others` are in a file that need not be of these scans."""
        ways = [f"--trajectory {others or 'FILE (poses of the sensor)'}"]
        if self._kind is TEXT_CLOUD and len(self) == 1 and _may_be_beams(source_of(self._files[0], "")):
            ways.append("--format text (each line is a beam: origin and end point)")
        return ways

    def _pose(self, i: int) -> Pose:
        if self._poses is not None:
            return self._poses.pose(i)
        if self._unplaced:
            return Pose.identity()
        if not self._beside:
            assert self._kind.viewpoint is not None
            return self._kind.viewpoint(self._files[i])
        beside = self._beside[i]
        if beside is None:
            wanted = f"{stem_of(self._files[i])}.pose.txt"
            raise ValueError(f"{self._files[i]}: no pose beside it as others have, expected {wanted}")
        return read_pose(beside)

    def _points(self, i: int) -> Points:
        if self._kind is BIN_CLOUD:
            return cloud_files.bin_points(self._files[i], self._width)
        return cloud_files.points_of_file(self._files[i], self._kind)

    @cached_property
    def _width(self) -> int:
        """How many numbers a point has, in all files of bare numbers."""
        width = cloud_files.floats_a_point(self._files)
        self._decided.append(
            f"{width} numbers a point in .bin, as the content tells: {cloud_files.WIDTHS[width]}"
        )
        return width

    def _scan(self, i: int, points: Points, T_map_sensor: Pose) -> Scan:
        if self._unplaced:
            return self._unplaced.scan(points, self._stamp(i))
        return super()._scan(i, points, T_map_sensor)

    def _stamp(self, i: int) -> float:
        return self._poses.stamp(i) if self._poses else self._stamps[i] or 0.0

    def _in_map(self, points: Points, T_map_sensor: Pose) -> Points:
        return T_map_sensor.apply(points) if self._points_in == "sensor" else without_zeros(points)


def _misfit(poses: PosesOfFiles, path: str, by_name: bool) -> str:
    """A file of poses and why they need not be of these scans; empty where they fit."""
    try:
        return "" if poses.fit(by_name) else f"{shlex.quote(path)} (has {number_of(poses.count, 'pose')})"
    except ValueError:
        return f"{shlex.quote(path)} (cannot be read)"


def _scans_of(source: Source) -> Scans | None:
    if source.is_folder:
        return scan_folder.scans_in(source.path, source.names)
    kind = kind_of_file(source.head) or _kind_without_magic(source)
    if kind is None:
        return None
    return Scans(os.path.dirname(source.path), (os.path.basename(source.path),), kind)


def _kind_without_magic(source: Source) -> CloudFile | None:
    """Of a file that its first bytes do not tell: points in text, or bare numbers in a .bin."""
    if b"\0" not in source.head:
        return TEXT_CLOUD if _is_text_cloud(source) else None
    if kind_of_name(source.path) is BIN_CLOUD and cloud_files.may_be_points(source.path):
        return BIN_CLOUD
    return None


def _is_text_cloud(source: Source) -> bool:
    """Whether text has points; beams have 4 to 7 columns, too, and poses 8 and more."""
    columns = columns_in(source)
    if columns is None or trajectory_kind(source.path) is not None:
        return False
    if ends_as_points(source.path) and columns.count not in (4, 5, 6, 7):
        return True
    if (
        columns.named
        or columns.counted
        or columns.count == 3
        or source.path.lower().endswith((".pts", ".asc"))
    ):
        return True
    if columns.worded:
        return source.path.lower().endswith((*ENDINGS, *MAYBE))
    return columns.count in (4, 5, 6, 7) and looks_like_points(source) is not None


def _may_be_beams(source: Source) -> bool:
    """Whether lines have as many numbers as beams; commas that are decimal points are no separators."""
    columns = columns_in(source)
    return not (columns and columns.decimal_comma) and dimension_of(first_fields(source)) is not None


def _in_order(names: list[str]) -> list[str]:
    """Names by the times that they are, else by their numbers."""
    stems = [stem_of(name) for name in names]
    numbers = [number_in(stem) or 0 for stem in stems]
    keys = [one if one is not None else float(number) for one, number in zip(stamps_in(stems), numbers)]
    return [name for _, name in sorted(zip(keys, names))]


def _recognises(source: Source) -> bool:
    if source.is_folder:
        return scan_folder.scans_in(source.path, source.names) is not None
    return kind_of_file(source.head) is not None or _kind_without_magic(source) is not None


_IS = "a folder of PCD, PLY, LAS, LAZ, text or .bin files"
_OPTIONS = ("trajectory", "time_offset", "points_in", "origin_of_scan", "points_only")
POINT_CLOUDS = Format("point_clouds", _IS, _recognises, PointCloudLog, _OPTIONS, stored_as="either")
