# SPDX-License-Identifier: BSD-3-Clause
"""Where in a folder the scans are, and where their poses: in this, data sets differ."""

from __future__ import annotations

import contextlib
import os
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ndtree._errors import WrongValue, key
from ndtree.logs.core.failures import some_of
from ndtree.logs.core.plain_file import open_plain
from ndtree.logs.folders.cloud_files import BIN_CLOUD, TEXT_CLOUD, CloudFile, kind_of_name, may_be_points
from ndtree.logs.folders.folder import number_in, stem_of
from ndtree.logs.folders.text_clouds import MAYBE, columns_of
from ndtree.logs.poses.trajectory_files import read_pose, read_trajectory, trajectory_kind

#: Folders beside the scans in which poses may be.
POSE_FOLDERS = (
    "poses", "pose", "ground_truth", "groundtruth", "gt", "trajectory", "trajectories", "odometry", "odom",
)  # fmt: skip
POSE_ENDINGS = (".pose.txt", ".txt", ".pose")
TRAJECTORY_ENDINGS = (".txt", ".tum", ".kitti", ".csv", ".g2o", ".log", ".poses", ".freiburg")
TIMES = ("times.txt", "timestamps.txt")
#: How deep scans may lie, and how many folders are looked into.
_DEPTH, _MOST_FOLDERS = 2, 100
#: Files that a message names.
_SHOWN = 6
#: More bytes than 16 numbers have, however they are written.
_LARGEST_POSE = 2000


@dataclass(frozen=True)
class Scans:
    """Files of scans: the folder that they are in, their names, and what they are."""

    folder: str
    names: tuple[str, ...]
    kind: CloudFile

    @property
    def files(self) -> list[str]:
        """Their paths."""
        return [os.path.join(self.folder, name) for name in self.names]


@dataclass(frozen=True)
class FoundPoses:
    """A file with a pose for each scan, or a trajectory; at most one of both."""

    beside: tuple[str | None, ...] = ()
    trajectory: str | None = None

    def __bool__(self) -> bool:
        return bool(self.beside) or self.trajectory is not None


def scans_in(path: str, names: Sequence[str]) -> Scans | None:
    """Clouds of a folder, else those of its only subfolder that has some; None where there are none.

    Raises ValueError if several subfolders have clouds, or one has clouds of several kinds.
    """
    found = _clouds(path, names)
    if found is not None:
        return found
    below = [one for folder in _below(path, _DEPTH) if (one := _clouds(folder, _entries(folder))) is not None]
    if len(below) > 1:
        some = some_of([one.folder for one in below], 6)
        raise ValueError(f"{path}: {len(below)} folders with point clouds, expected one of them: {some}")
    return below[0] if below else None


def poses_of(path: str, scans: Scans) -> FoundPoses:
    """Poses nearest to some scans: in their folder, those above it up to `path`, or one for poses there.

    Raises ValueError if a folder has several trajectories.
    """
    for folder in _places(path, scans.folder):
        found = _poses_in(folder, scans)
        if found:
            return found
    return FoundPoses()


def poses_above(scans: Scans) -> FoundPoses:
    """Poses in the folder above that of the scans: who names the scans alone may have them beside it."""
    for folder in _above(scans.folder):
        try:
            found = _poses_in(folder, scans)
        except ValueError:  # Several trajectories: they need not be of these scans.
            continue
        if found:
            return found
    return FoundPoses()


def _poses_in(folder: str, scans: Scans) -> FoundPoses:
    names = [name for name in _entries(folder) if folder != scans.folder or name not in scans.names]
    beside = _beside(scans.names, [name for name in names if may_be_pose(os.path.join(folder, name))])
    if any(beside):
        return FoundPoses(tuple(name and os.path.join(folder, name) for name in beside))
    return FoundPoses(trajectory=only_trajectory(folder, names))


def pose_beside(scans: Scans) -> FoundPoses:
    """A pose beside the only file."""
    (name,) = scans.names
    names = [f"{stem_of(name)}{ending}" for ending in POSE_ENDINGS]
    names = [one for one in names if one != name and may_be_pose(os.path.join(scans.folder, one))]
    (beside,) = _beside(scans.names, names)
    return FoundPoses((os.path.join(scans.folder, beside),)) if beside else FoundPoses()


def times_of(path: str, scans: Scans) -> str | None:
    """A file with the time of each scan, beside them or above them."""
    for folder in (*_places(path, scans.folder), *_above(scans.folder)):
        for name in TIMES:
            if os.path.isfile(os.path.join(folder, name)):
                return os.path.join(folder, name)
    return None


def _clouds(path: str, names: Sequence[str]) -> Scans | None:
    by_kind: dict[str, list[str]] = {}
    kinds: dict[str, CloudFile] = {}
    for name in names:
        kind = kind_of_name(name)
        if kind is not None:
            kinds[kind.name] = kind
            by_kind.setdefault(kind.name, []).append(name)
    if BIN_CLOUD.name in by_kind and not may_be_points(os.path.join(path, by_kind[BIN_CLOUD.name][0])):
        del by_kind[BIN_CLOUD.name]
    if TEXT_CLOUD.name in by_kind and len(by_kind) > 1:  # Lists and notes beside clouds.
        del by_kind[TEXT_CLOUD.name]
    if not by_kind:
        maybe = [name for name in names if name.lower().endswith(MAYBE)]
        numbered = [name for name in maybe if number_in(stem_of(name)) is not None]
        if len(numbered) > 1 and all(
            _is_cloud(os.path.join(path, name)) for name in (numbered[0], numbered[-1])
        ):
            return Scans(path, tuple(numbered), TEXT_CLOUD)
        return None
    if len(by_kind) > 1:
        raise ValueError(f"{path}: {' and '.join(sorted(by_kind))} files, expected point clouds of one kind")
    name, found = next(iter(by_kind.items()))
    return Scans(path, tuple(found), kinds[name])


def _is_cloud(path: str) -> bool:
    """Whether a file of text holds points, and not poses."""
    if trajectory_kind(path) is not None or _is_pose(path):
        return False
    with open_plain(path) as file:
        columns = columns_of(file)
    return columns is not None and (columns.named or columns.count in (3, 4, 6, 7))


def _is_pose(path: str) -> bool:
    """Whether it holds nothing but a matrix of 3x4 or 4x4 numbers."""
    try:
        read_pose(path)
    except ValueError:
        return False
    return True


def _below(path: str, depth: int) -> Iterator[str]:
    """Folders in a folder, and in these; at most as many as a data set has."""
    if depth == 0:
        return
    try:
        with os.scandir(path) as entries:
            there = [one.name for one in entries if one.is_dir() and not one.name.startswith(".")]
            folders = sorted(name for name in there if name.lower() not in POSE_FOLDERS)
    except OSError:
        return
    for name in folders[:_MOST_FOLDERS]:
        folder = os.path.join(path, name)
        yield folder
        yield from _below(folder, depth - 1)


def _entries(path: str) -> list[str]:
    try:
        return sorted(os.listdir(path))
    except OSError:
        return []


def _places(path: str, folder: str) -> Iterator[str]:
    """Where poses are looked for, the nearest first: from the scans' folder up to `path`."""
    at, top = folder, os.path.abspath(path)
    while True:
        yield at
        for name in POSE_FOLDERS:
            beside = os.path.join(at, name)
            if os.path.isdir(beside):
                yield beside
        if os.path.abspath(at) == top:
            break
        at = os.path.dirname(at)


def _above(folder: str) -> Iterator[str]:
    """The folder above another, and those for poses in it."""
    above = os.path.join(folder, os.pardir)
    if not os.path.islink(folder.rstrip(os.sep)):  # Else it is above what the link is of.
        above = os.path.normpath(above)
    yield above
    for name in POSE_FOLDERS:
        if os.path.isdir(os.path.join(above, name)):
            yield os.path.join(above, name)


def _beside(scans: Sequence[str], names: Sequence[str]) -> list[str | None]:
    """For each scan the file of its pose: of its name, else where all names end in numbers, of its number."""
    there = set(names)
    stems = [os.path.splitext(name)[0] for name in scans]
    beside = [[stem + ending for ending in POSE_ENDINGS if stem + ending in there] for stem in stems]
    found = [names[0] if names else None for names in beside]
    if any(found) or len(scans) < 2:
        return found
    texts = [name for name in names if name.lower().endswith(".txt")]
    by_number = {number_in(stem_of(name).removesuffix(".pose")): name for name in texts}
    numbers = [number_in(stem_of(name)) for name in scans]
    if None in numbers or len(by_number) < len(scans) or not all(number in by_number for number in numbers):
        return found
    return [by_number[number] for number in numbers]


def only_trajectory(folder: str, names: Sequence[str]) -> str | None:
    """The only trajectory file of a folder, of some names in it."""
    found = []
    for name in names:
        path = os.path.join(folder, name)
        with contextlib.suppress(OSError):  # Not everything may be read.
            if name.lower().endswith(TRAJECTORY_ENDINGS) and os.path.isfile(path) and trajectory_kind(path):
                found.append(path)
    if len(found) > 1:
        ways = "".join(f"\n  {key('trajectory')} {shlex.quote(path)}" for path in found[:_SHOWN])
        raise WrongValue(f"{folder}: {len(found)} trajectories, expected one of them:{ways}")
    return found[0] if found else None


def unread_poses(scans: Scans) -> str:
    """What is wrong with a file beside the scans that is called poses and has none; empty without one."""
    for name in _entries(scans.folder):
        is_called = name.lower().startswith(POSE_FOLDERS) and name.lower().endswith(TRAJECTORY_ENDINGS)
        if is_called and name not in scans.names:
            try:
                read_trajectory(os.path.join(scans.folder, name))
            except (OSError, ValueError) as error:
                return f"FILE (poses of the sensor), not {error}"
    return ""


def may_be_pose(path: str) -> bool:
    """Whether a file is small enough to hold one pose and nothing else."""
    return os.path.isfile(path) and os.path.getsize(path) <= _LARGEST_POSE
