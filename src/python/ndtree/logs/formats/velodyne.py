# SPDX-License-Identifier: BSD-3-Clause
"""Packets of Velodyne lidars in recorded network traffic (pcap, pcapng), with the poses of a trajectory."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from typing import IO, Any

import numpy as np

from ndtree._lazy import needs
from ndtree.base.scan import Scan
from ndtree.logs.core.arrays import Floats, Points
from ndtree.logs.core.failures import NoPose, NotALog, one_line
from ndtree.logs.core.log import Log
from ndtree.logs.core.plain_file import open_regular
from ndtree.logs.core.silence import without_padding
from ndtree.logs.core.source import Format, Source, require_one
from ndtree.logs.poses.pose import matrices_of, rotated
from ndtree.logs.poses.trajectory import Trajectory
from ndtree.logs.poses.trajectory_files import read_trajectory

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

    def _turns(self) -> Iterator[tuple[float, Points, Floats]]:
        """Of each turn its time [s], its points in the sensor's frame, and their times since then [s]."""
        decoder = _decoder(self.path)
        try:
            for stamp, _, data in packets(self.path):
                if is_velodyne(data):
                    turn = self._decoded(partial(decoder.decode, stamp, data, True))
                    if turn is not None:
                        yield turn
        except ValueError as error:
            self.skip("ends that cannot be read", error)
        turn = self._decoded(partial(decoder.finish, True))
        if turn is not None:
            yield turn

    def _decoded(self, decode: Callable[[], Any]) -> tuple[float, Points, Floats] | None:
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
        way = _OF_OTHERS[sender].format(path=source.path)
        raise NotALog(source.path, f"packets of a lidar by {sender}", [way])
    ways = {"trajectory": trajectory, "still": still or None}
    require_one(source.path, [name for name, value in ways.items() if value is not None])
    if trajectory is None and not still:
        ways = [f"ndtree map {source.path} --trajectory FILE (poses of the sensor)", "--still (it stands)"]
        raise NotALog(source.path, "packets of a Velodyne, and no poses with them", ways)
    poses = None if trajectory is None else read_trajectory(trajectory)
    if poses is not None and poses.is_numbered:
        raise ValueError(f"{trajectory}: poses without times, expected times as packets have them [s]")
    return VelodyneLog(source.path, poses, time_offset)


#: First bytes of pcap by order of bytes and unit of time [ticks a second], and of pcapng.
_PCAP = {
    b"\xd4\xc3\xb2\xa1": ("<", 10**6),
    b"\xa1\xb2\xc3\xd4": (">", 10**6),
    b"\x4d\x3c\xb2\xa1": ("<", 10**9),
    b"\xa1\xb2\x3c\x4d": (">", 10**9),
}
_PCAPNG = b"\x0a\x0d\x0d\x0a"
MAGICS = (*_PCAP, _PCAPNG)
#: No packet and no block is longer [bytes]; as many packets tell their sender.
_LONGEST, _LOOKED_AT = 1 << 20, 2000
#: Bytes before the type of the protocol, by the kind of link.
_ETHERNET, _LINUX, _LINUX_2, _RAW, _LOOPBACK = 1, 113, 276, 101, 0
_IPV4, _VLAN, _UDP = 0x0800, (0x8100, 0x88A8), 17


def packets(path: str) -> Iterator[tuple[float, int, bytes]]:
    """UDP packets over IPv4: when each was recorded [s], its port, and its bytes.

    Fragments and other traffic are passed over. Raises ValueError where the file is damaged or cut off.
    """
    with open_regular(path) as file:
        magic = file.read(4)
        file.seek(0)
        frames = _of_pcapng(path, file) if magic == _PCAPNG else _of_pcap(path, file)
        for stamp, link, frame in frames:
            found = _udp(link, frame)
            if found is not None:
                yield stamp, *found


def sender_of(path: str) -> str | None:
    """Which lidar has sent the packets: "Velodyne", "Ouster", "Hesai", "RoboSense" or "Livox"; else None."""
    with contextlib.suppress(ValueError):
        for _, port, data in islice(packets(path), _LOOKED_AT):
            known = _sender(port, data)
            if known is not None:
                return known
    return None


def is_velodyne(data: bytes) -> bool:
    """Whether a packet has twelve blocks of firings, each with its mark."""
    return len(data) == 1206 and all(data[at : at + 1] == b"\xff" for at in range(0, 1200, 100))


def _sender(port: int, data: bytes) -> str | None:
    if is_velodyne(data):
        return "Velodyne"
    if data.startswith(b"\xee\xff"):
        return "Hesai"
    if data.startswith((b"\x55\xaa\x05\x0a\x5a\xa5\x50\xa0", b"\x55\xaa\x05\x5a")):
        return "RoboSense"
    if port in (56300, 56301, 57000, 60001) and len(data) > 1000:
        return "Livox"
    if port == 7502 or (len(data) in _OF_OUSTER and port != 2368):
        return "Ouster"
    return None


#: Sizes of Ouster's packets of 16 to 128 channels, old and new profiles [bytes].
_OF_OUSTER = (3392, 6464, 12608, 24896, 8448, 16640, 33024, 4352, 8704)


def _of_pcap(path: str, file: IO[bytes]) -> Iterator[tuple[float, int, bytes]]:
    header = file.read(24)
    if len(header) < 24 or header[:4] not in _PCAP:
        raise ValueError(f"{path}: cut off within its header, expected a whole pcap")
    order, ticks = _PCAP[header[:4]]
    (link,) = struct.unpack_from(order + "I", header, 20)
    while record := file.read(16):
        at = file.tell()
        if len(record) < 16:
            raise ValueError(f"{path}: cut off at byte {at}, expected a whole packet")
        seconds, part, size, _ = struct.unpack(order + "4I", record)
        if size > _LONGEST:
            raise ValueError(f"{path}: a packet of {size} bytes at byte {at}, expected at most {_LONGEST}")
        frame = file.read(size)
        if len(frame) < size:
            raise ValueError(f"{path}: cut off at byte {at + len(frame)}, expected a whole packet")
        yield seconds + part / ticks, link & 0xFFFF, frame


def _of_pcapng(path: str, file: IO[bytes]) -> Iterator[tuple[float, int, bytes]]:
    order = "<"
    links: list[tuple[int, float]] = []  # Of each interface its kind of link, and the unit of its times [s].
    while head := file.read(8):
        at = file.tell() - len(head)
        if len(head) < 8:
            raise ValueError(f"{path}: cut off at byte {at}, expected a whole block")
        if head[:4] == _PCAPNG:
            order = ">" if file.read(4) == b"\x1a\x2b\x3c\x4d" else "<"
            file.seek(-4, 1)
            links = []
        kind, size = struct.unpack(order + "2I", head)
        body = file.read(size - 8) if 12 <= size <= _LONGEST else b""
        if len(body) < size - 8 or size < 12:
            raise ValueError(f"{path}: a block of {size} bytes at byte {at}, expected a whole one")
        if kind == 1 and len(body) >= 12:
            links.append((struct.unpack_from(order + "H", body)[0], _unit(order, body)))
        elif kind == 6 and len(body) >= 24:
            interface, high, low, length = struct.unpack_from(order + "4I", body)
            if interface < len(links):
                link, unit = links[interface]
                yield (high << 32 | low) * unit, link, body[20 : 20 + length]


def _unit(order: str, body: bytes) -> float:
    """The unit of times of an interface [s], from its options; else microseconds."""
    at = 8
    while at + 4 <= len(body) - 4:
        code, length = struct.unpack_from(order + "2H", body, at)
        if code == 9 and length >= 1:
            exponent = body[at + 4]
            return float(2.0 ** -(exponent & 0x7F)) if exponent & 0x80 else float(10.0**-exponent)
        if code == 0:
            break
        at += 4 + (length + 3) // 4 * 4
    return 1e-6


def _udp(link: int, frame: bytes) -> tuple[int, bytes] | None:
    """Port and content of a frame's UDP packet; None where it is none, or a fragment."""
    if link == _ETHERNET:
        at, kind = 14, int.from_bytes(frame[12:14], "big")
        while kind in _VLAN:
            kind = int.from_bytes(frame[at + 2 : at + 4], "big")
            at += 4
    elif link == _LINUX:
        at, kind = 16, int.from_bytes(frame[14:16], "big")
    elif link == _LINUX_2:
        at, kind = 20, int.from_bytes(frame[0:2], "big")
    elif link in (_RAW, 12, 14):
        at, kind = 0, _IPV4
    elif link == _LOOPBACK:
        at, kind = 4, _IPV4
    else:
        return None
    if kind != _IPV4 or len(frame) < at + 20 or frame[at] >> 4 != 4 or frame[at + 9] != _UDP:
        return None
    if int.from_bytes(frame[at + 6 : at + 8], "big") & 0x3FFF:
        return None
    at += 4 * (frame[at] & 15)
    if len(frame) < at + 8:
        return None
    length = int.from_bytes(frame[at + 4 : at + 6], "big")
    return int.from_bytes(frame[at + 2 : at + 4], "big"), frame[at + 8 : at + max(length, 8)]


_OPTIONS, _IS = ("trajectory", "time_offset", "still"), "packets of a Velodyne (.pcap)"
VELODYNE = Format("velodyne", _IS, lambda source: source.head.startswith(MAGICS), _open, _OPTIONS)
