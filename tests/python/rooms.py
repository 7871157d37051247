# SPDX-License-Identifier: BSD-3-Clause
"""A room, scanned from poses that are known, and the files of others that such scans are written into.

Each writer takes a folder that is empty and the scans, and returns what is to be read. None of them uses the
package: foreign libraries write where there are some, and else the bytes are put together here.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

#: The walls of the room [m]: lower and upper corner, off the borders of cells, where rounding would decide.
ROOM = np.array([[-3.03, -2.54, -1.23], [3.47, 2.04, 1.66]])
START = 1_700_000_000.0  # A quarter of a second before the first scan, which is a second before the next [s].


@dataclass(frozen=True)
class Placed:
    """A scan: its points in the sensor's frame (n, 3), and T_map_sensor (4, 4)."""

    points: np.ndarray
    pose: np.ndarray
    stamp: float

    @property
    def in_map(self) -> np.ndarray:
        return self.points @ self.pose[:3, :3].T + self.pose[:3, 3]

    @property
    def quaternion(self) -> np.ndarray:
        """x, y, z, w."""
        rotations = pytest.importorskip("scipy.spatial.transform", reason="no SciPy: no rotations").Rotation
        return rotations.from_matrix(self.pose[:3, :3]).as_quat()


def turned(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """The rotation about x by roll, then y by pitch, then z by yaw [rad]."""
    (sx, cx), (sy, cy), (sz, cz) = ((math.sin(a), math.cos(a)) for a in (roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def ranges_to_walls(origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """How far the walls are from a point in the room along unit vectors (n, 3) [m]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = (ROOM[:, None, :] - origin) / directions[None]
    return np.where(ways > 0, ways, np.inf).min(axis=(0, 2))


def scanned(count: int = 4, beams: int = 5000, seed: int = 3) -> list[Placed]:
    """Scans of the room in all directions, from poses that are turned about all axes."""
    random = np.random.default_rng(seed)
    found = []
    for i in range(count):
        pose = np.eye(4)
        pose[:3, :3] = turned(0.8 * i, 0.1 * i, -0.15 * i)
        pose[:3, 3] = (0.5 * i - 0.7, 0.4 - 0.3 * i, 0.1 * i)
        directions = random.normal(size=(beams, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        ranges = ranges_to_walls(pose[:3, 3], directions @ pose[:3, :3].T)
        found.append(Placed(directions * ranges[:, None], pose, START + i + 0.25))
    return found


# --- Poses ------------------------------------------------------------------------------------------


def tum(path: Path, scans: Sequence[Placed]) -> None:
    np.savetxt(path, [[one.stamp, *one.pose[:3, 3], *one.quaternion] for one in scans], fmt="%.12f")


def kitti(path: Path, scans: Sequence[Placed]) -> None:
    np.savetxt(path, [one.pose[:3].ravel() for one in scans])


def rows_of_16(path: Path, scans: Sequence[Placed]) -> None:
    np.savetxt(path, [one.pose.ravel() for one in scans])


def blocks_of_4(path: Path, scans: Sequence[Placed]) -> None:
    np.savetxt(path, np.concatenate([one.pose for one in scans]))


def timed_matrices(path: Path, scans: Sequence[Placed]) -> None:
    np.savetxt(path, [[one.stamp, *one.pose[:3].ravel()] for one in scans], fmt="%.12f")


def named_matrices(path: Path, scans: Sequence[Placed]) -> None:
    """As ETH's laser scans have them."""
    names = [f"T{i}{j}" for i in range(4) for j in range(4)]
    rows = [[i, one.stamp, *one.pose.ravel()] for i, one in enumerate(scans)]
    header = ", ".join(["poseId", "timestamp", *names])
    np.savetxt(path, rows, fmt="%.12f", delimiter=", ", header=header, comments="")


def euroc(path: Path, scans: Sequence[Placed]) -> None:
    names = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    names += ", v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1]"
    names += ", b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2]"
    lines = [names + ", b_a_RS_S_z [m s^-2]"]
    for one in scans:
        x, y, z, w = one.quaternion
        numbers = [*one.pose[:3, 3], w, x, y, z, *[0.0] * 9]
        lines.append(",".join([f"{round(one.stamp * 1e9)}", *(f"{value:.12f}" for value in numbers)]))
    path.write_text("\r\n".join(lines) + "\r\n")


def newer_college(path: Path, scans: Sequence[Placed]) -> None:
    lines = ["#sec,nsec,x,y,z,qx,qy,qz,qw"]
    for one in scans:
        numbers = ",".join(f"{value:.12f}" for value in (*one.pose[:3, 3], *one.quaternion))
        lines.append(f"{int(one.stamp)},{round(one.stamp % 1 * 1e9)},{numbers}")
    path.write_text("\n".join(lines) + "\n")


def g2o(path: Path, scans: Sequence[Placed]) -> None:
    lines = ["# a graph"]
    for i, one in reversed(list(enumerate(scans))):  # Graphs have any order.
        numbers = " ".join(f"{value:.12f}" for value in (*one.pose[:3, 3], *one.quaternion))
        lines.append(f"VERTEX_SE3:QUAT {i} {numbers}")
    lines.append("FIX 0")
    lines.append("EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 " + " ".join(["1"] * 21))
    path.write_text("\n".join(lines) + "\n")


def open3d_log(path: Path, scans: Sequence[Placed]) -> None:
    lines = []
    for i, one in enumerate(scans):
        lines.append(f"{i} {i} {i + 1}")
        lines += [" ".join(f"{value:.12f}" for value in row) for row in one.pose]
    path.write_text("\n".join(lines) + "\n")


# --- Clouds -----------------------------------------------------------------------------------------


def as_text(path: Path, points: np.ndarray, **how: Any) -> None:
    np.savetxt(path, points, fmt="%.6f", **how)


def as_floats(path: Path, points: np.ndarray, width: int = 4) -> None:
    random = np.random.default_rng(0)
    table = np.column_stack([points, random.uniform(0, 255, (len(points), width - 3))])
    table[:, 4:] = np.arange(len(points))[:, None] % 32  # The ring.
    table.astype("<f4").tofile(path)


def folder_of(
    cloud: Callable[[Path, np.ndarray], None],
    ending: str,
    poses: Callable[[Path, Sequence[Placed]], None],
    name: str,
    *,
    scans_in: str = ".",
    names: Callable[[int, Placed], str] = lambda i, one: f"{i:06d}",
    points: Callable[[Placed], np.ndarray] = lambda one: one.points,
) -> Callable[[Path, Sequence[Placed]], Path]:
    """A file each scan, and one of poses."""

    def write(folder: Path, scans: Sequence[Placed]) -> Path:
        (folder / scans_in).mkdir(parents=True, exist_ok=True)
        for i, one in enumerate(scans):
            cloud(folder / scans_in / f"{names(i, one)}{ending}", points(one))
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        poses(folder / name, scans)
        return folder

    return write


def seconds_and_nanoseconds(_: int, one: Placed) -> str:
    return f"cloud_{int(one.stamp)}_{round(one.stamp % 1 * 1e9):09d}"


def pose_each(folder: Path, scans: Sequence[Placed]) -> None:
    folder.mkdir()
    for i, one in enumerate(scans):
        np.savetxt(folder / f"{i:06d}.txt", one.pose)


def decimal_comma(path: Path, points: np.ndarray) -> None:
    lines = [";".join(f"{value:.6f}".replace(".", ",") for value in point) for point in points]
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(["x;y;z", *lines, ""]).encode())


def pts(path: Path, points: np.ndarray) -> None:
    lines = [f"{x:.6f} {y:.6f} {z:.6f} -1034 12 200 7" for x, y, z in points]
    path.write_text("\n".join([str(len(points)), *lines]) + "\n")


def asc(path: Path, points: np.ndarray) -> None:
    """As CloudCompare writes it."""
    lines = [f"{x:.6f} {y:.6f} {z:.6f} 12 200 7 0.5" for x, y, z in points]
    path.write_text("\n".join(["//X Y Z R G B Intensity", *lines]) + "\n")


def csv_with_time_first(path: Path, points: np.ndarray) -> None:
    lines = [f"{i},{x:.6f},{y:.6f},{z:.6f},{i % 7}" for i, (x, y, z) in enumerate(points)]
    path.write_text("\n".join(["timestamp,x,y,z,intensity", *lines]) + "\n")


def ouster_csv(path: Path, points: np.ndarray) -> None:
    """As ouster-cli writes it: two comments, of which the second names the columns."""
    names = "TIMESTAMP (ns), ROW, COLUMN, RANGE (mm), X1 (m), Y1 (m), Z1 (m), FLAGS, NEAR_IR (photons)"
    lines = ["# frame num: 0", f"# {names}"]
    lines += [f"{i},0,{i},1500,{x:.6f},{y:.6f},{z:.6f},0,12" for i, (x, y, z) in enumerate(points)]
    path.write_text("\n".join(lines) + "\n")


# --- Files of several scans -------------------------------------------------------------------------


def e57(
    folder: Path,
    scans: Sequence[Placed],
    *,
    with_pose: bool = True,
    invalid: bool = False,
) -> Path:
    pye57 = pytest.importorskip("pye57", reason="no pye57: no E57 can be written")
    path = folder / "a.e57"
    file = pye57.E57(str(path), mode="w")
    for one in scans:
        points = one.points
        data = {f"cartesian{axis}": np.ascontiguousarray(points[:, i]) for i, axis in enumerate("XYZ")}
        x, y, z, w = one.quaternion
        pose = {"rotation": [w, x, y, z], "translation": one.pose[:3, 3]} if with_pose else {}
        if invalid:  # Each third beam has not returned.
            data["cartesianInvalidState"] = (np.arange(len(points)) % 3 == 0).astype(np.int8)
        file.write_scan_raw(data, **pose)
    file.close()
    return path


def e57_in_angles(folder: Path, scans: Sequence[Placed]) -> Path:
    """With ranges, azimuths and elevations, for which the library has no function: node by node."""
    pye57 = pytest.importorskip("pye57", reason="no pye57: no E57 can be written")
    lib = pye57.libe57
    path = folder / "a.e57"
    file = pye57.E57(str(path), mode="w")

    def numbers(**values: float) -> Any:
        node = lib.StructureNode(file.image_file)
        for name, value in values.items():
            node.set(name, lib.FloatNode(file.image_file, float(value), lib.E57_DOUBLE, -1e6, 1e6))
        return node

    for one in scans:
        x, y, z = one.points.T
        level = np.hypot(x, y)
        columns = {
            "sphericalRange": np.hypot(level, z),
            "sphericalAzimuth": np.arctan2(y, x),
            "sphericalElevation": np.arctan2(z, level),
        }
        arrays, buffers = file.make_buffers(list(columns), len(x))
        for name, values in columns.items():
            arrays[name][:] = values
        qx, qy, qz, qw = one.quaternion
        pose = lib.StructureNode(file.image_file)
        pose.set("rotation", numbers(w=qw, x=qx, y=qy, z=qz))
        pose.set("translation", numbers(**dict(zip("xyz", one.pose[:3, 3]))))
        codecs = lib.VectorNode(file.image_file, True)
        points = lib.CompressedVectorNode(file.image_file, numbers(**dict.fromkeys(columns, 0.0)), codecs)
        scan = lib.StructureNode(file.image_file)
        scan.set("guid", lib.StringNode(file.image_file, "{scan}"))
        scan.set("pose", pose)
        scan.set("points", points)
        file.data3d.append(scan)
        writer = points.writer(buffers)
        writer.write(len(x))
        writer.close()
    file.close()
    return path


def ptx(folder: Path, scans: Sequence[Placed], *, registered: bool = False, width: int = 4) -> Path:
    lines = []
    for one in scans:
        points = one.in_map if registered else one.points
        matrix = np.eye(4) if registered else one.pose.T
        lines += ["2", str((len(points) + 1) // 2)]
        lines += [" ".join(f"{value:.9f}" for value in row) for row in (one.pose[:3, 3], *one.pose[:3, :3].T)]
        lines += [" ".join(f"{value:.12f}" for value in row) for row in matrix]
        rows = [f"{x:.6f} {y:.6f} {z:.6f} 0.5" + " 1 2 3" * (width == 7) for x, y, z in points]
        rows += ["0 0 0 0.5" + " 1 2 3" * (width == 7)] * (len(points) % 2)
        lines += rows
    path = folder / "a.ptx"
    path.write_text("\n".join(lines) + "\n")
    return path


def three_dtk(folder: Path, scans: Sequence[Placed], *, frames: bool = False) -> Path:
    """In a left-handed frame: x to the right, y up, z ahead, in centimetres."""
    rotations = pytest.importorskip("scipy.spatial.transform", reason="no SciPy: no rotations").Rotation
    mirror = np.array([[0, -1, 0], [0, 0, 1], [1, 0, 0]])  # From x ahead, y to the left, z up.
    for i, one in enumerate(scans):
        np.savetxt(
            folder / f"scan{i:03d}.3d", 100 * one.points @ mirror.T, fmt="%.6f", header="2 2500", comments=""
        )
        rotation, position = mirror @ one.pose[:3, :3] @ mirror.T, 100 * mirror @ one.pose[:3, 3]
        # The rotation is that about x times that about y times that about z: angles about the turned axes.
        angles = rotations.from_matrix(rotation).as_euler("XYZ", degrees=True)
        wrong = 30.0 if frames else 0.0  # Where odometry was before matching.
        text = " ".join(f"{value + wrong:.9f}" for value in position)
        (folder / f"scan{i:03d}.pose").write_text(
            text + "\n" + " ".join(f"{value:.9f}" for value in angles) + "\n"
        )
        if frames:
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = rotation, position
            columns = " ".join(f"{value:.12f}" for value in matrix.T.ravel())
            first = " ".join(f"{value:.12f}" for value in np.eye(4).ravel())
            (folder / f"scan{i:03d}.frames").write_text(f"{first} 0\n{columns} 2\n")
    return folder


def kitti_raw(folder: Path, scans: Sequence[Placed]) -> Path:
    """A day with its calibration and one drive. The map begins at the first position of the GPS/IMU."""
    drive = folder / "2011_09_26" / "2011_09_26_drive_0001_sync"
    (drive / "velodyne_points" / "data").mkdir(parents=True)
    (drive / "oxts" / "data").mkdir(parents=True)
    mount = MOUNT
    inverse = np.linalg.inv(mount)  # The calibration moves points of the IMU to the Velodyne.
    (drive.parent / "calib_imu_to_velo.txt").write_text(
        "calib_time: 25-May-2012 16:47:16\n"
        + "R: " + " ".join(f"{v:.12f}" for v in inverse[:3, :3].ravel()) + "\n"
        + "T: " + " ".join(f"{v:.12f}" for v in inverse[:3, 3]) + "\n"
    )  # fmt: skip
    latitude, longitude, radius = 49.0150, 8.4340, 6378137.0
    scale = math.cos(math.radians(latitude))
    east = scale * radius * math.radians(longitude)
    north = scale * radius * math.log(math.tan(math.radians(90 + latitude) / 2))
    times = []
    for i, one in enumerate(scans):
        imu = one.pose @ inverse
        x, y, z = imu[:3, 3] - (scans[0].pose @ inverse)[:3, 3]
        yaw, pitch = math.atan2(imu[1, 0], imu[0, 0]), math.asin(-imu[2, 0])
        roll = math.atan2(imu[2, 1], imu[2, 2])
        lon = math.degrees((east + x) / (scale * radius))
        lat = math.degrees(2 * math.atan(math.exp((north + y) / (scale * radius)))) - 90
        numbers = [f"{v:.15f}" for v in (lat, lon, 100 + z, roll, pitch, yaw)] + ["0"] * 24
        (drive / "oxts" / "data" / f"{i:010d}.txt").write_text(" ".join(numbers) + "\n")
        as_floats(drive / "velodyne_points" / "data" / f"{i:010d}.bin", one.points)
        times.append(f"2023-11-14 22:13:{20 + i:02d}.250000000")
    (drive / "velodyne_points" / "timestamps.txt").write_text("\n".join(times) + "\n")
    return drive


#: T_imu_velodyne of the drive.
MOUNT = np.eye(4)
MOUNT[:3, :3], MOUNT[:3, 3] = turned(0.02, -0.01, 0.03), (0.81, -0.32, 0.80)


# --- Recorded packets -------------------------------------------------------------------------------

#: Elevation of the lasers of a VLP-16, in the order in which they fire [deg].
VLP16 = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
#: How much higher than its middle each of them is [mm], by the manual.
VLP16_UP = (11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2)
FIRING, SEQUENCE = 2.304e-6, 55.296e-6  # Time from laser to laser, and from round to round [s].


def velodyne_packets(pose: Callable[[float], np.ndarray], turns: int) -> list[tuple[float, bytes]]:
    """Packets of a VLP-16 in the room by its manual, each with its time of recording [s]."""
    found = []
    azimuths = np.arange(0, turns * 36000, 40)  # A block every 0.4 degrees, two rounds each [0.01 deg].
    per_block = 2 * SEQUENCE
    for first in range(0, len(azimuths) - 11, 12):
        blocks = b""
        begin = START + first * per_block
        for at in range(first, first + 12):
            azimuth = int(azimuths[at])
            firings = b""
            for which in range(32):
                since = at * per_block + (which // 16) * SEQUENCE + (which % 16) * FIRING
                turn = math.radians((azimuth + 40 * (since - at * per_block) / per_block) / 100)
                rise = math.radians(VLP16[which % 16])
                # The manual has y ahead and x to the right; drivers turn it to x ahead and y to the left.
                ahead, right = math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn)
                direction = np.array([ahead, -right, math.sin(rise)])
                here = pose(START + since)
                laser = here[:3, 3] + here[:3, 2] * VLP16_UP[which % 16] / 1000
                distance = ranges_to_walls(laser, (here[:3, :3] @ direction)[None])[0]
                firings += struct.pack("<HB", round(distance / 0.002), 100)
            blocks += struct.pack("<HH", 0xEEFF, azimuth % 36000) + firings
        microseconds = round((begin % 3600) * 1e6)
        found.append((begin, blocks + struct.pack("<IBB", microseconds, 0x37, 0x22)))
    return found


def udp(data: bytes, port: int, source: int = 2368) -> bytes:
    """An Ethernet frame with an IPv4 packet with a UDP packet."""
    payload = struct.pack(">HHHH", source, port, 8 + len(data), 0) + data
    header = struct.pack(
        ">BBHHHBBH4s4s", 0x45, 0, 20 + len(payload), 1, 0x4000, 64, 17, 0, b"\xc0\xa8\1\xc9", b"\xff" * 4
    )
    return b"\xff" * 6 + b"\x60\x76\x88\0\0\1" + b"\x08\x00" + header + payload


def pcap(
    path: Path, frames: Sequence[tuple[float, bytes]], *, order: str = "<", nanoseconds: bool = False
) -> Path:
    magic, ticks = (0xA1B23C4D, 10**9) if nanoseconds else (0xA1B2C3D4, 10**6)
    parts = [struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, 1)]
    for stamp, frame in frames:
        parts += [
            struct.pack(order + "IIII", int(stamp), round(stamp % 1 * ticks) % ticks, len(frame), len(frame)),
            frame,
        ]
    path.write_bytes(b"".join(parts))
    return path


def pcapng(path: Path, frames: Sequence[tuple[float, bytes]]) -> Path:
    def block(kind: int, body: bytes) -> bytes:
        body += b"\0" * (-len(body) % 4)
        return struct.pack("<II", kind, 12 + len(body)) + body + struct.pack("<I", 12 + len(body))

    parts = [
        block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)),
        block(1, struct.pack("<HHI", 1, 0, 0)),
    ]
    for stamp, frame in frames:
        ticks = round(stamp * 1e6)
        parts.append(
            block(
                6, struct.pack("<IIIII", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame)) + frame
            )
        )
    path.write_bytes(b"".join(parts))
    return path


# --- Depth images -----------------------------------------------------------------------------------

CAMERA = (120.0, 118.0, 79.5, 59.5)  # fx, fy, cx, cy [px], of 160 x 120.


def depth_images(folder: Path, scans: Sequence[Placed]) -> list[Placed]:
    """Depth images of the room in ``depth/`` [mm], from the scans' poses; returns what they measured."""
    image_module = pytest.importorskip("PIL.Image", reason="no Pillow: no PNG can be written")
    (folder / "depth").mkdir()
    fx, fy, cx, cy = CAMERA
    v, u = np.mgrid[0:120, 0:160]
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], axis=2).reshape(-1, 3)
    found = []
    for i, one in enumerate(scans):
        length = np.linalg.norm(rays, axis=1)
        ranges = ranges_to_walls(one.pose[:3, 3], (rays / length[:, None]) @ one.pose[:3, :3].T)
        depth = np.rint(1000 * ranges / length).astype(np.uint16)
        depth[::97], depth[5::97] = 0, 65535  # No depth there.
        image_module.fromarray(depth.reshape(120, 160)).save(folder / "depth" / f"{i:05d}.png")
        found.append(
            Placed((rays * depth[:, None] / 1000)[(depth > 0) & (depth < 65535)], one.pose, one.stamp)
        )
    return found


def camera_json(path: Path) -> None:
    fx, fy, cx, cy = CAMERA
    matrix = [fx, 0, 0, 0, fy, 0, cx, cy, 1]  # Column by column.
    path.write_text(json.dumps({"width": 160, "height": 120, "intrinsic_matrix": matrix}))


# --- Bags -------------------------------------------------------------------------------------------


def foxglove_mcap(path: Path, scans: Sequence[Placed]) -> Path:
    """Clouds and transforms of Foxglove's types, packed by protobuf, written by the library of the format."""
    writer_module = pytest.importorskip("mcap_protobuf.writer", reason="no mcap-protobuf-support")
    pytest.importorskip("foxglove_schemas_protobuf", reason="no foxglove-schemas-protobuf")
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

    with path.open("wb") as file, writer_module.Writer(file) as writer:
        for i, one in enumerate(scans):
            nanoseconds = round(one.stamp * 1e9)
            transform = FrameTransform(parent_frame_id="map", child_frame_id="lidar")
            transform.timestamp.FromNanoseconds(nanoseconds)
            for axis, value in zip("xyz", one.pose[:3, 3]):
                setattr(transform.translation, axis, value)
            for axis, value in zip("xyzw", one.quaternion):
                setattr(transform.rotation, axis, value)
            writer.write_message("/tf", transform, nanoseconds, nanoseconds, i)
            table = np.zeros(len(one.points), dtype=[("i", "<u2"), ("xyz", "<f4", 3), ("rest", "<u2")])
            table["xyz"] = one.points
            cloud = PointCloud(frame_id="lidar", point_stride=table.itemsize, data=table.tobytes())
            cloud.timestamp.FromNanoseconds(nanoseconds)
            cloud.pose.orientation.w = 1.0
            for number, name in enumerate("xyz"):
                cloud.fields.add(name=name, offset=2 + 4 * number, type=PackedElementField.FLOAT32)
            writer.write_message("/points", cloud, nanoseconds, nanoseconds, i)
    return path


def bag_of_old_clouds(path: Path, scans: Sequence[Placed], kind: str) -> Path:
    """sensor_msgs/PointCloud and /tf, in frames of different lengths so that numbers begin anywhere."""
    bags = pytest.importorskip("bags")
    messages = bags.Messages(kind)
    rows = []
    for one in scans:
        points = [messages.of("geometry_msgs/msg/Point32", x=x, y=y, z=z) for x, y, z in one.points.tolist()]
        channel = messages.of(
            "sensor_msgs/msg/ChannelFloat32", name="intensity", values=np.ones(len(points), dtype=np.float32)
        )
        cloud = messages.of(
            "sensor_msgs/msg/PointCloud",
            header=messages.header(one.stamp, "laser"), points=points, channels=[channel],
        )  # fmt: skip
        moved = messages.transform(one.stamp, "map", "laser", one.pose[:3, 3], one.quaternion)
        rows += [(one.stamp, "/tf", messages.tf(moved)), (one.stamp, "/cloud", cloud)]
    return bags.write_bag(path, messages, [(topic, stamp, message) for stamp, topic, message in rows])
