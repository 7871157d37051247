# SPDX-License-Identifier: BSD-3-Clause
"""Packets of Velodyne lidars in recorded network traffic, with the poses of a trajectory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import key
from ndtree._lazy import needs
from ndtree.base.scan import Scan
from ndtree.logs.core.failures import NoPose, NotALog, one_line
from ndtree.logs.core.log import Log
from ndtree.logs.core.silence import without_padding
from ndtree.logs.core.source import Format, Source, WrongOption
from ndtree.logs.formats.packets import MAGICS, is_velodyne, packets, sender_of
from ndtree.logs.poses.pose import matrices_of, rotated
from ndtree.logs.poses.trajectory import Trajectory
from ndtree.logs.poses.trajectory_files import read_trajectory

Floats = NDArray[np.float64]

#: What helps with packets of other lidars.
_OF_OTHERS = {
    "Ouster": "ouster-cli source {path} save scans.csv (pip install ouster-sdk), then their folder",
    "Hesai": "a bag that Hesai's ROS driver has recorded from them: ndtree map BAG",
    "RoboSense": "a bag that rslidar_sdk has recorded from them: ndtree map BAG",
    "Livox": "a bag that livox_ros_driver2 has recorded from them: ndtree map BAG",
}
#: Turns take between a twentieth and a fifth of a second: times of points that say more are wrong [s].
_LONGEST_TURN = 1.0


class VelodyneLog(Log):
    """Turns of a Velodyne, each beam from the pose of its own time.

    `trajectory`: Of the sensor, by the time of recording; None for one that stands at 0.
    `time_offset`: Added to the times of the beams before their poses are looked up [s].
    """

    format = "velodyne"
    knows_no_returns = False
    path: str

    def __init__(self, path: str, trajectory: Trajectory | None, time_offset: float) -> None:
        super().__init__(path, dim=3)
        _library(path)
        self._trajectory, self._time_offset = trajectory, time_offset

    def _scans(self) -> Iterator[Scan]:
        for stamp, points, since in self._turns():
            if self._trajectory is None:
                yield Scan(points, np.zeros(3), stamp=stamp)
                continue
            try:
                at = np.clip(since, -_LONGEST_TURN, _LONGEST_TURN) + stamp + self._time_offset
                positions, quaternions = self._trajectory.poses_at(at)
            except NoPose as error:
                self._leave_out_unposed(error)
                continue
            turned = rotated(matrices_of(quaternions), points.astype(np.float64))
            yield Scan(turned + positions, positions, stamp=stamp)

    def _turns(self) -> Iterator[tuple[float, NDArray[np.floating[Any]], Floats]]:
        """Of each turn its time [s], its points in the sensor's frame, and their times since then [s]."""
        decoder = _decoder(self.path)
        try:
            for packet in packets(self.path):
                if is_velodyne(packet.data):
                    turn = self._decoded(partial(decoder.decode, packet.stamp, packet.data, True))
                    if turn is not None:
                        yield turn
        except ValueError as error:
            self.skip("ends that cannot be read", error)
        turn = self._decoded(partial(decoder.finish, True))
        if turn is not None:
            yield turn

    def _decoded(self, decode: Callable[[], Any]) -> tuple[float, NDArray[np.floating[Any]], Floats] | None:
        try:
            result = decode()
        except Exception as error:  # A library at the mercy of foreign bytes.
            wrong = ValueError(f"{self.path}: packets that cannot be decoded ({one_line(error)})")
            self.skip("damaged packets", wrong)
            return None
        if result is None or not len(result[1]):
            return None
        stamp, table = result
        points = np.stack([table[axis] for axis in "xyz"], axis=1)
        return float(stamp.host), without_padding(points), table["time"].astype(np.float64)


def _library(path: str) -> Any:
    with needs(f"{path}: packets of a Velodyne, which need velodyne-decoder", "velodyne"):
        import velodyne_decoder
    return velodyne_decoder


def _decoder(path: str) -> Any:
    """One that knows the sensor; the calibration of an HDL-64E is in its packets."""
    library = _library(path)
    config = library.Config()
    try:
        model, calibration = library.hdl64e.detect_hdl64e(path)
        config.model, config.calibration = model or config.model, calibration or config.calibration
    except Exception:  # Of pcapng, and of damaged files: the packets tell the model, too.
        pass
    return library.StreamDecoder(config)


def _open(
    source: Source, trajectory: str | None = None, time_offset: float = 0.0, still: bool = False
) -> VelodyneLog:
    sender = sender_of(source.path)
    if sender is None:
        raise NotALog(source.path, "recorded network traffic without packets of a lidar that is known")
    if sender != "Velodyne":
        raise NotALog(
            source.path, f"packets of a lidar by {sender}", [_OF_OTHERS[sender].format(path=source.path)]
        )
    if trajectory is not None and still:
        raise WrongOption(f"{source.path}: {key('trajectory')} and {key('still')}: expected one of them")
    if not math.isfinite(time_offset):
        raise WrongOption(f"{key('time_offset')} = {time_offset:g} s: must be finite")
    if trajectory is None and not still:
        raise NotALog(
            source.path,
            "packets of a Velodyne, and no poses with them",
            [f"ndtree map {source.path} --trajectory FILE (poses of the sensor)", "--still (it stands)"],
        )
    poses = None if trajectory is None else read_trajectory(trajectory)
    if poses is not None and poses.is_numbered:
        raise ValueError(f"{trajectory}: poses without times, expected times as packets have them [s]")
    return VelodyneLog(source.path, poses, time_offset)


VELODYNE = Format(
    "velodyne",
    "packets of a Velodyne (.pcap)",
    lambda source: source.head.startswith(MAGICS),
    _open,
    ("trajectory", "time_offset", "still"),
)
