# SPDX-License-Identifier: BSD-3-Clause
"""Sequences of KITTI's odometry benchmark: scans of a Velodyne, and the poses of a camera beside it."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ndtree.logs.core.failures import one_line
from ndtree.logs.core.plain_file import open_regular, text_lines
from ndtree.logs.core.source import Format, Source, require_dim
from ndtree.logs.folders.folder import TIME_OFFSET, FolderLog, PosesOfFiles
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.trajectory_files import TRAJECTORY

SCANS = "velodyne"
CALIBRATION = "calib.txt"
POSES = "poses.txt"
TIMES = "times.txt"


class KittiLog(FolderLog):
    """``velodyne/000000.bin`` and so on (float32 x y z intensity), with ``times.txt`` if it is there.

    Other data sets have such folders with a ring, a time or both behind the intensity: whether a point has
    3 to 8 numbers is told from the content (`floats_a_point`).

    ``poses.txt`` has the poses of the camera, and ``calib.txt`` where the Velodyne sits beside it (``Tr``,
    from the Velodyne to the camera); the map's frame is where the Velodyne would be at the pose that changes
    nothing, so that z points up. Without ``poses.txt``, the poses are looked for where the benchmark has
    them: ``../../poses/NN.txt``.

    Parameters
    ----------
    source : Source
    trajectory : str, optional
        Poses of the Velodyne itself, TUM or KITTI; ``poses.txt`` and ``calib.txt`` are not read then.
    time_offset : float
        Added to ``times.txt`` before poses of a TUM trajectory are looked up [s].
    """

    format = "kitti"
    may_be_cut_off = True

    def __init__(self, source: Source, trajectory: str | None = None, time_offset: float = 0.0) -> None:
        folder = source.inside(SCANS)
        names = sorted(name for name in os.listdir(folder) if name.endswith(".bin"))
        if not names:
            raise ValueError(f"{folder}: no scans, expected 000000.bin and so on")
        super().__init__(source.path, [os.path.join(folder, name) for name in names])
        times = source.inside(TIMES) if TIMES in source.names else None
        self._calibration = source.inside(CALIBRATION) if trajectory is None else None
        self._poses = PosesOfFiles(
            trajectory if trajectory is not None else _poses_of(source), self._files, times, time_offset
        )

    @cached_property
    def _T_camera_velodyne(self) -> Pose:
        return Pose.identity() if self._calibration is None else _velodyne_in(self._calibration)

    def _pose(self, i: int) -> Pose:
        T_camera_velodyne = self._T_camera_velodyne
        return T_camera_velodyne.inverse() @ self._poses.pose(i) @ T_camera_velodyne

    def _points(self, i: int) -> NDArray[np.floating]:
        path = self._files[i]
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            width = self._width
            if size % (4 * width):
                raise ValueError(
                    f"{path}: {size} bytes, expected a multiple of {4 * width} (float32 {_WIDTHS[width]})"
                )
            return np.fromfile(file, dtype="<f4").reshape(-1, width)[:, :3]

    @cached_property
    def _width(self) -> int:
        """How many numbers a point has, in all files."""
        width = floats_a_point(self._files)
        if width != 4:
            self.notes.append(f"{width} numbers a point in {SCANS}, as the content tells: {_WIDTHS[width]}")
        return width

    def _stamp(self, i: int) -> float:
        return self._poses.stamp(i)


def floats_a_point(files: Sequence[str]) -> int:
    """How many float32 a point has, told from files of one kind: 4 where nothing speaks against it.

    With the right number, each column is one quantity; with another one, columns mix coordinates, intensity
    and rings, and spread more. Compared is the mean logarithm of the columns' standard deviations. Where all
    files hold whole points of 4, a number of which most files do not is none.

    Raises
    ------
    ValueError
        If another number than 4 fits better, though not clearly.
    """
    samples, sizes, path = [], [], files[0]
    for path in _spread_out(files):
        with open_regular(path) as file:
            sizes.append(os.fstat(file.fileno()).st_size)
            part = np.fromfile(file, dtype="<f4", count=_SAMPLE)
        if len(part) >= _FEWEST:
            samples.append(np.clip(np.nan_to_num(part.astype(np.float64), posinf=0.0, neginf=0.0), -1e4, 1e4))
    if not samples:
        return 4
    spreads = {width: float(np.mean([_spread(one, width) for one in samples])) for width in _WIDTHS}
    noise = max(_CLEARLY / 4, _SURE / math.sqrt(2 * sum(map(len, samples))))
    clearly = max(_CLEARLY, 1.5 * noise)
    misfits = {width: sum(size % (4 * width) != 0 for size in sizes) for width in _WIDTHS}
    possible = [width for width in _WIDTHS if 2 * misfits[width] <= len(sizes) or misfits[4]]
    best = min(possible, key=lambda width: spreads[width])
    if best in (6, 8) and spreads[best // 2] - spreads[best] <= clearly:
        best //= 2  # Every second point of the same is as good.
    gain = spreads[4] - spreads[best]
    if gain <= 0.0:
        return 4
    if gain > clearly:
        return best
    fitting = [width for width in _WIDTHS if not misfits[width]]
    if 4 in fitting and (gain < noise or best not in fitting):
        return 4
    if fitting == [best]:
        return best
    raise ValueError(
        f"{path}: cannot tell whether points have 4 or {best} numbers, expected float32 {_WIDTHS[4]}"
    )


#: What the numbers of a point are.
_WIDTHS = {
    3: "x y z",
    4: "x y z intensity",
    5: "x y z intensity and one more",
    6: "x y z intensity and two more",
    7: "x y z and four more",
    8: "x y z and five more",
}
#: Numbers that are looked at in a file, and how many there must be.
_SAMPLE, _FEWEST = 60_000, 60
#: Mean logarithm by which columns spread less with the right number.
_CLEARLY = 0.1
#: Standard errors of that mean that are no chance; one is 1 / sqrt(2 n) of n numbers.
_SURE = 2.5


def _spread_out(files: Sequence[str], count: int = 5) -> list[str]:
    """Up to `count` files, from the first to the last."""
    return [files[i] for i in sorted({round(i * (len(files) - 1) / (count - 1)) for i in range(count)})]


def _spread(sample: NDArray[np.float64], width: int) -> float:
    """Mean logarithm of the columns' standard deviations; that of a constant one is 0.001 of the sample's."""
    table = sample[: len(sample) // width * width].reshape(-1, width)
    floor = max(1e-3 * float(sample.std()), 1e-12)
    return float(np.log(np.maximum(table.std(axis=0), floor)).mean())


def _poses_of(source: Source) -> str:
    here = source.inside(POSES)
    if POSES in source.names:
        return here
    sequence = os.path.abspath(source.path)
    dataset = os.path.dirname(os.path.dirname(sequence))
    there = os.path.join(dataset, "poses", f"{os.path.basename(sequence)}.txt")
    if os.path.isfile(there):
        return there
    raise ValueError(f"{source.path}: no poses, expected {POSES} in it, {there}, or a trajectory")


def _velodyne_in(path: str) -> Pose:
    """T_camera_velodyne of a calibration file."""
    for number, line in text_lines(path):
        name, _, values = line.partition(":")
        if name.strip() != "Tr":
            continue
        try:
            return Pose.from_matrix(np.array([float(field) for field in values.split()]).reshape(3, 4))
        except ValueError as error:
            raise ValueError(
                f"{path}: line {number}: Tr: expected a 3x4 matrix ({one_line(error)})"
            ) from None
    raise ValueError(f"{path}: no line Tr, expected where the Velodyne sits beside the camera")


def _recognises(source: Source) -> bool:
    if SCANS not in source.names or not os.path.isdir(source.inside(SCANS)):
        return False
    return any(name.endswith(".bin") for name in os.listdir(source.inside(SCANS)))


def _open(
    source: Source, *, dim: int | None = None, trajectory: str | None = None, time_offset: float = 0.0
) -> KittiLog:
    require_dim(source, KITTI, 3, dim)
    return KittiLog(source, trajectory, time_offset)


KITTI = Format(
    "kitti", "a KITTI odometry sequence", _recognises, _open, (TRAJECTORY, TIME_OFFSET), stored_as="folder"
)
