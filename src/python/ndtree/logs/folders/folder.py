# SPDX-License-Identifier: BSD-3-Clause
"""Folders with a file for each scan: what all of them have in common."""

from __future__ import annotations

import contextlib
import os
import re
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from ndtree.base.scan import Scan
from ndtree.base.words import number_of
from ndtree.logs.core.arrays import Floats, Points
from ndtree.logs.core.failures import NoPose
from ndtree.logs.core.log import SizedLog
from ndtree.logs.core.silence import CutOff, CutOffSearch
from ndtree.logs.poses.pose import Pose
from ndtree.logs.poses.trajectory import Trajectory
from ndtree.logs.poses.trajectory_files import read_times, read_trajectory

#: Files that are looked at for where the ranges of all end.
_SAMPLE = 8
#: Larger times are seconds since 1970.
_MOST_FILES = 10_000_000


class FolderLog(SizedLog):
    """One file a scan, of which one is in memory at a time.

    A scan at a time outside of the poses is left out; a pose that should be there, and is not, is an error.

    `path`: The folder.
    `files`: Paths, in the order of the scans.
    """

    _poses: PosesOfFiles | None = None

    def __init__(self, path: str, files: Sequence[str]) -> None:
        super().__init__(path, dim=3)
        self._files = files
        self.file: str | None = None  # Of the scan that was read last.

    def __len__(self) -> int:
        return len(self._files)

    @property
    def knows_no_returns(self) -> bool:  # type: ignore[override]
        """Where ranges are cut off: of beams without return there is no point in a file."""
        return self.limit() is not None

    @property
    def needs_search(self) -> bool:
        """Some of the files tell."""
        return False

    def _scans(self) -> Iterator[Scan]:
        for i in range(len(self)):
            try:
                T_map_sensor = self._pose(i)
            except NoPose as error:
                self._leave_out_unposed(error)
                continue
            except (ValueError, OSError) as error:
                self.skip("scans without a pose", error)
                continue
            nothing = self._passed_over()
            if nothing is not None:
                yield nothing
                continue
            try:
                points = self._points(i)
            except (ValueError, OSError) as error:
                self.skip("damaged scans", error)
                continue
            self.file = self._files[i]
            yield self._scan(i, points, T_map_sensor)
        unused = self._poses.unused() if self._poses is not None else ""
        self._seen += [unused] if unused else []

    def _search(self) -> CutOff | None:
        """From some of the files, evenly spread: they may be large."""
        chosen = sorted({i * (len(self) - 1) // max(_SAMPLE - 1, 1) for i in range(_SAMPLE)})
        search = CutOffSearch(says_itself=False, least_scans=min(2, len(chosen)))
        for i in chosen:
            with contextlib.suppress(ValueError, OSError):
                pose = self._pose(i)
                search.add(Scan(self._in_map(self._points(i), pose), pose.position))
        return search.found()

    def _pose(self, i: int) -> Pose:
        """T_map_sensor of a scan."""
        assert self._poses is not None
        return self._poses.pose(i)

    @abstractmethod
    def _points(self, i: int) -> Points:
        """(n, 3): what a scan measured [m]."""

    def _stamp(self, i: int) -> float:
        """Time of a scan [s]; 0 where there is none."""
        return 0.0 if self._poses is None else self._poses.stamp(i)

    def _scan(self, i: int, points: Points, T_map_sensor: Pose) -> Scan:
        ends, stamp = self._in_map(points, T_map_sensor), self._stamp(i)
        return Scan(
            ends,
            T_map_sensor.position,
            stamp=stamp,
            rotation=T_map_sensor.rotation,
            by_depth=self.is_depth_camera,
        )

    def _in_map(self, points: Points, T_map_sensor: Pose) -> Points:
        return T_map_sensor.apply(points)


class PosesOfFiles:
    """Which pose of a trajectory belongs to which file of a folder.

    Of poses with numbers (KITTI's lines count from 0, a graph's vertices as it says), the pose of the number
    at the end of the file's name; where there are as many poses as files, and a number has none, all count by
    their order. Of a TUM trajectory (poses with times), the pose at the file's time, which is its whole name
    (see `stamps_in`), or the time on the line of its number; where nothing says times, and those of the poses
    are whole numbers, they are the files' numbers. Files without a number are counted in their order, and
    there must be a line for each.

    `trajectory`: Its file, which is read when the first pose is asked for.
    `files`: Paths, in their order.
    `times`: File of times, one a line [s].
    `time_offset`: Added to the files' times before their poses are looked up [s].
    `stamps`: The files' times [s], where their names or `times` do not say them.
    """

    def __init__(
        self,
        trajectory: str,
        files: Sequence[str],
        times: str | None = None,
        time_offset: float = 0.0,
        stamps: Sequence[float] = (),
    ) -> None:
        self._path = trajectory
        self._files = files
        self._times_path = times
        self._time_offset = time_offset
        stems = [stem_of(file) for file in files]
        self._stamps = [stamp for stamp in stamps or stamps_in(stems) if stamp is not None]
        self._named_by_stamps = len(self._stamps) == len(files) > 0
        numbers = [number_in(stem) for stem in stems]
        known = [number for number in numbers if number is not None]
        self._numbered = len(known) == len(files) and not self._named_by_stamps
        self._lines = known if self._numbered else list(range(len(files)))

    def pose(self, i: int) -> Pose:
        """T_map_sensor of file i; ValueError where there is none."""
        trajectory = self._trajectory
        if trajectory.is_numbered:
            return trajectory.pose_at(self._number(i, trajectory))
        if self._are_counted:
            return trajectory.pose_at(float(self._lines[i]))
        if not self._named_by_stamps and self._times is None:
            expected = "expected a time as its name, or times.txt beside it"
            raise ValueError(f"{self._files[i]}: has no time for its pose in {self._path}, {expected}")
        return trajectory.pose_at(self.stamp(i) + self._time_offset)

    @property
    def count(self) -> int:
        """Of all poses of the trajectory."""
        return len(self._trajectory.stamps)

    def fit(self, by_name: bool = False) -> bool:
        """Whether they are surely of these files: one for each, or at all their times.

        `by_name`: The files' names have numbers or times, too; as many poses as files can be chance.
        """
        trajectory = self._trajectory
        if trajectory.is_numbered:
            return self.count == len(self._files) and (self._numbered or not by_name)
        if not self._named_by_stamps and self._times is None:
            return False
        times = [self.stamp(i) + self._time_offset for i in range(len(self._files))]
        return bool(trajectory.stamps[0] <= min(times) and max(times) <= trajectory.stamps[-1])

    def unused(self) -> str:
        """What is said of poses whose numbers are before or behind those of all files; "" without any."""
        if not self._trajectory.is_numbered or not self._are_known:
            return ""
        first, last = min(self._lines), max(self._lines)
        left = sorted(number for number in self._known if not first <= number <= last)
        if not left:
            return ""
        more = f"{number_of(len(left), 'more pose')}, such as number {left[0]:.0f}"
        return f"files have numbers {first} to {last}, and {self._path} has {more}: do both count alike?"

    def stamp(self, i: int) -> float:
        """Time of file i [s]; 0 where there is none."""
        if self._named_by_stamps:
            return self._stamps[i]
        if self._times is None:
            return 0.0
        line, count, path = self._lines[i], len(self._times), self._times_path
        if not self._numbered and count != len(self._files):
            files = number_of(len(self._files), "file")
            raise ValueError(f"{path}: {count} times for {files} without a number, expected as many")
        if line >= count:
            raise ValueError(f"{self._files[i]}: number {line}, but {path} has times 0 to {count - 1}")
        return float(self._times[line])

    def _number(self, i: int, trajectory: Trajectory) -> float:
        """Which pose of those with numbers."""
        known = self._known
        if self._are_known and float(self._lines[i]) in known:
            return float(self._lines[i])
        if len(known) == len(self._files):
            return float(trajectory.stamps[i])
        if not self._numbered:
            some = f"{number_of(len(known), 'pose')} for {number_of(len(self._files), 'file')}"
            raise ValueError(f"{self._path}: {some} without a number, expected as many")
        first, last = int(min(known)), int(max(known))
        said = f"number {self._lines[i]}, but {self._path} has poses {first} to {last}"
        raise ValueError(f"{self._files[i]}: {said}")

    @cached_property
    def _are_known(self) -> bool:
        """Whether numbers of files count: there is a pose for each, or not one for each in their order."""
        if not self._numbered or len(self._known) != len(self._files):
            return self._numbered
        return all(float(line) in self._known for line in self._lines)

    @cached_property
    def _are_counted(self) -> bool:
        """Whether times of poses are numbers of files: whole, small, and nothing else tells."""
        if self._named_by_stamps or self._times is not None or not self._numbered:
            return False
        stamps = self._trajectory.stamps
        return bool((stamps == np.rint(stamps)).all() and 0 <= stamps[0] and stamps[-1] < _MOST_FILES)

    @cached_property
    def _known(self) -> frozenset[float]:
        return frozenset(self._trajectory.stamps.tolist())

    @cached_property
    def _trajectory(self) -> Trajectory:
        return read_trajectory(self._path)

    @cached_property
    def _times(self) -> Floats | None:
        return None if self._times_path is None else read_times(self._times_path)


def stem_of(path: str) -> str:
    """A file's name without its ending; nuScenes' files have two, ``.pcd.bin``."""
    return os.path.splitext(os.path.basename(path))[0].removesuffix(".pcd")


def number_in(stem: str) -> int | None:
    """The number at the end of a name."""
    found = re.search(r"\d+$", stem)
    return int(found.group()) if found else None


def stamps_in(stems: Sequence[str]) -> list[float | None]:
    """The times that the names of a folder's files are or end in [s]; None where a name has none.

    Seconds with a point, or 13 digits of milliseconds, 16 of microseconds, 19 of nanoseconds, each behind
    a word or not; or seconds and nanoseconds as in ``cloud_1583836591_182590976``. Nanoseconds may lack
    leading zeros.

    Raises ValueError if names end in seconds since 1970 and another number that is too short for nanoseconds
    in all.
    """
    stamps = [stamp_in(stem) for stem in stems]
    if None not in stamps:
        return stamps
    pairs = [re.fullmatch(r"(?:.*[^0-9])?(\d{1,10})[_-](\d{1,9})", stem) for stem in stems]
    found = [pair for pair in pairs if pair]
    are_epoch = [len(pair.group(1)) == 10 for pair in found]
    if not found or len(found) < len(stems):
        return stamps
    digits = {len(pair.group(2)) for pair in found}
    if max(digits) < 7:
        if not all(are_epoch):
            return stamps
        if digits not in ({3}, {6}):
            raise ValueError(
                f"{stems[0]}: a name of seconds and a number of {max(digits)} digits or fewer, expected "
                "milliseconds (3), microseconds (6) or nanoseconds (up to 9)"
            )
    elif not all(are_epoch) and (max(digits) != 9 or max(int(pair.group(2)) for pair in found) < 10**7):
        return stamps  # Numbers with many zeros in front.
    per_second = 10 ** (max(digits) if digits in ({3}, {6}) else 9)
    return [int(pair.group(1)) + int(pair.group(2)) / per_second for pair in found]


def stamp_in(stem: str) -> float | None:
    """The time that a name alone tells [s]."""
    if re.fullmatch(r"\d+\.\d+", stem):
        return float(stem)
    behind_word = re.fullmatch(r"(?:.*[^0-9.])?(\d{9,10}\.\d+)", stem)
    if behind_word:
        return float(behind_word.group(1))
    count = re.fullmatch(r"(?:.*[^0-9])?(\d{13}|\d{16}|\d{19})", stem)
    if count:
        return int(count.group(1)) / 10 ** (len(count.group(1)) - 10)
    return None
