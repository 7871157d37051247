# SPDX-License-Identifier: BSD-3-Clause
"""A drive in a file: its scans, where they were, and the loops, so that it can be gone on with."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ndtree.alignment.aligning import MAX_RANGE
from ndtree.alignment.loops import Loop
from ndtree.alignment.online import Drive
from ndtree.alignment.planar import placed, seen_from
from ndtree.alignment.sensor_scans import Step, Track, sensor_scan
from ndtree.base.files import replaced
from ndtree.base.scan import Scan
from ndtree.live.corrections import Corrections, Motion
from ndtree.logs.poses.pose import Pose

_VERSION = 1
#: Of the track, what is an array of numbers.
_LISTS = "keys", "way", "relations", "covariances", "unfixed", "through", "ratios"


@dataclass(frozen=True)
class Session:
    """A drive with its scans.

    `drive`: Its poses and loops; key scans are made of the scans.
    `options`: Of the map, and `max_range`, if there is one.
    `arrays`: As in the file; scans are in the frame of their sensor [m].
    """

    drive: Drive
    options: dict[str, float]
    arrays: dict[str, Any]

    @staticmethod
    def of(drive: Drive, corrections: Corrections, options: dict[str, float]) -> Session:
        """Of a drive and its map; ValueError if scans are frozen, RuntimeError if there are none."""
        rows: dict[str, list[Any]] = {
            name: [] for name in ("counts", "numbers", "points", "starts", "returned", "sigmas")
        }
        poses = []
        for motion, scan in corrections.scans():
            pose = np.array([*motion.sensor.position[:2], motion.sensor.yaw])
            each = (len(scan), 2)
            rows["counts"].append(len(scan))
            rows["numbers"].append(int(motion.stamp))
            rows["points"].append(seen_from(pose, scan.endpoints.astype(np.float64)))
            rows["starts"].append(seen_from(pose, np.broadcast_to(scan.origin, each).astype(np.float64)))
            rows["returned"].append(scan.did_return)
            sigma = np.nan if scan.range_sigma is None else scan.range_sigma
            rows["sigmas"].append(np.broadcast_to(sigma, len(scan)))
            poses.append(pose)
        if not poses:
            raise RuntimeError("no scan is mapped yet: there is nothing to go on with")
        arrays: dict[str, Any] = {name: np.array(rows[name], np.int64) for name in ("counts", "numbers")}
        for name in ("points", "starts", "sigmas"):
            arrays[name] = np.concatenate(rows[name]).astype(np.float32)
        arrays["returned"] = np.concatenate(rows["returned"])
        arrays["mapped_at"] = np.array(poses).reshape(-1, 3)
        return Session(drive, options, arrays)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it as .npz; the file appears whole or not at all."""
        track, loops = self.drive.track, self.drive.loops
        arrays: dict[str, Any] = {}
        for name in _LISTS:
            arrays[f"track_{name}"] = np.array(getattr(track, name), np.float64)
        arrays["poses"] = np.array(track.poses).reshape(-1, 3)
        arrays["stamps"] = np.array(self.drive.stamps)
        arrays["against"] = np.array([(one.scan, one.is_sure) for one in track.against], np.int64).reshape(
            -1, 2
        )
        arrays["loops"] = np.array([(one.older, one.newer) for one in loops], np.int64).reshape(-1, 2)
        arrays["loop_relations"] = np.array([one.relation for one in loops]).reshape(-1, 3)
        arrays["loop_information"] = np.array([one.information for one in loops]).reshape(-1, 3, 3)
        head = {"version": _VERSION, "lost": track.lost, "options": self.options}
        arrays["head"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
        with replaced(path) as part, open(part, "wb") as file:
            np.savez(file, **arrays, **self.arrays)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Session:
        """Of a file; ValueError if it is none of a drive, OSError if it cannot be read."""
        try:
            with np.load(path) as file:
                arrays = {name: file[name] for name in file.files}
            head = json.loads(arrays.pop("head").tobytes())
            if head["version"] != _VERSION:
                raise ValueError(f"{path}: is of version {head['version']}, expected {_VERSION}")
            return _restored(head, arrays)
        except (KeyError, IndexError, TypeError, EOFError) as error:
            raise ValueError(
                f"{path}: {error} is missing or damaged, expected the scans of a drive"
            ) from error

    def scans(self) -> Iterator[tuple[Motion, Scan]]:
        """All of them, where they are in the map, with where their sensors are."""
        return _scans_of(self.arrays, self.drive.stamps)


def _restored(head: dict[str, Any], arrays: dict[str, Any]) -> Session:
    track = Track(lost=int(head["lost"]), poses=list(arrays.pop("poses")))
    for name in _LISTS:
        setattr(track, name, list(arrays.pop(f"track_{name}")))
    track.keys = [int(key) for key in track.keys]
    track.against = [Step(int(scan), bool(is_sure)) for scan, is_sure in arrays.pop("against")]
    rows = zip(arrays.pop("loops").tolist(), arrays.pop("loop_relations"), arrays.pop("loop_information"))
    loops = [Loop(older, newer, relation, information) for (older, newer), relation, information in rows]
    stamps = arrays.pop("stamps").tolist()
    keys = set(track.keys)
    seen = {}
    for motion, scan in _scans_of(arrays, stamps):
        number = int(motion.stamp)
        if number in keys:
            seen[number] = replace(sensor_scan(scan, MAX_RANGE), pose=track.poses[number])
    if seen.keys() != keys or not keys:
        raise ValueError(f"{len(seen)} of {len(keys)} key scans have points, expected all")
    track.scans = [seen[key] for key in track.keys]
    return Session(Drive(track, loops, stamps), head["options"], arrays)


def _scans_of(arrays: dict[str, Any], stamps: list[float]) -> Iterator[tuple[Motion, Scan]]:
    ends = np.cumsum(arrays["counts"])
    for end, count, number, pose in zip(
        ends, arrays["counts"], arrays["numbers"].tolist(), arrays["mapped_at"]
    ):
        part = slice(end - count, end)
        sensor = Pose.planar(*pose)
        starts = placed(pose, arrays["starts"][part].astype(np.float64))
        one = len(starts) and (arrays["starts"][part] == arrays["starts"][part][0]).all()
        sigmas = arrays["sigmas"][part]
        scan = Scan(
            placed(pose, arrays["points"][part].astype(np.float64)),
            starts[0] if one else starts,
            arrays["returned"][part],
            stamps[number],
            range_sigma=None if np.isnan(sigmas).all() else sigmas,
            heading=float(pose[2]),
        )
        yield Motion(float(number), sensor, sensor, Pose.identity()), scan
