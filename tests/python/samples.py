# SPDX-License-Identifier: BSD-3-Clause
"""A small file or folder of every kind that is read, and the real recordings where they are."""

from __future__ import annotations

import gzip
import importlib.util
import shutil
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rooms
from bags import Messages, write_bag
from conftest import arrays_of
from test_depth_folders import seven_scenes, tum
from test_octomap_graph import graph, node
from test_point_clouds import las, numbered, pcd, ply_by_meshio, pose_matrix, tum_lines
from test_sfm import bal, bal_bz2, bundler, colmap_binary, colmap_text, world

import ndtree


@dataclass(frozen=True)
class Sample:
    """How something that is read comes about.

    ``make(folder)`` writes it and says what to open. What it writes is damaged; ``pack(path)``, if there is
    one, makes after that what is opened, so that damage comes behind checksums and compression.
    """

    make: Callable[[Path], Path]
    options: tuple[str, ...] = ()
    pack: Callable[[Path], Path] | None = None


def _office(scans: int = 5) -> ndtree.Log:
    return ndtree.simulate("office", seed=3, scans=scans)


def _text(folder: Path) -> Path:
    path = folder / "office.txt"
    with open(path, "w") as file:
        for scan in _office(3):
            for end, returned in zip(scan.endpoints[::8], scan.returned[::8]):
                file.write(f"{scan.origin[0]} {scan.origin[1]} {end[0]} {end[1]} {int(returned)}\n")
    return path


def _carmen(folder: Path) -> Path:
    path = folder / "hall.log"
    lines = ["# a comment", "PARAM robot_frontlaser_offset 0.08"]
    for i in range(20):
        ranges = " ".join(f"{2 + 0.01 * ((i * k) % 50):.2f}" for k in range(60))
        lines.append(f"FLASER 60 {ranges} {0.1 * i} 0 0 {0.1 * i} 0 0 {i}.5 host {i}.5")
        lines.append(
            f"ROBOTLASER1 0 -1.57 3.14 0.0523 80 0.01 0 60 {ranges} 0 {0.1 * i} 0 0 {0.1 * i} 0 0 0 0 0 0 0 "
            f"{i}.6 host {i}.6"
        )
    path.write_text("\n".join(lines) + "\n")
    return path


def _zipped(path: Path) -> Path:
    packed = path.with_name(path.name + ".gz")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    return packed


def _gzip(make: Callable[[Path], Path]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = make(folder)
        packed = _zipped(path)
        path.unlink()
        return packed

    return write


def _arrays() -> dict[str, Any]:
    return arrays_of(_office(), stamps=np.arange(5) / 10)


def _npz(save: Callable[..., None]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / "office.npz"
        save(path, **_arrays())
        return path

    return write


def _members(folder: Path) -> Path:
    for name, array in _arrays().items():
        np.save(folder / f"{name}.npy", array)
    return folder


def _packed_members(folder: Path) -> Path:
    path = folder.with_name("office.npz")
    with zipfile.ZipFile(path, "w") as archive:
        for member in sorted(folder.glob("*.npy")):
            archive.write(member, member.name)
    return path


def _bag(kind: str, sensor: str = "laser", *, packed: bool = False) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        make = Messages(kind)
        content: list[tuple[str, float, Any]] = []
        content.append(make.fixed(0, "base", "sensor", (0.1, 0, 0.2)))
        if sensor == "image":
            info = make.camera_info(0.5, "sensor", (6, 8), (10, 10, 4, 3))
            content.append(("/camera/camera_info", 0.5, info))
        for i in range(8):
            t = 1.0 + 0.1 * i
            content.append(make.moved(t, "odom", "base", (0.1 * i, 0, 0)))
            if sensor == "laser":
                message = make.laser(t, "sensor", 2 + np.sin(np.arange(90)))
            elif sensor == "cloud":
                message = make.cloud(t, "sensor", np.random.default_rng(i).normal(size=(60, 3)))
            else:
                depth = np.full((6, 8), 1000 + i, dtype=np.uint16)
                message = make.image(t, "sensor", depth, "16UC1")
            topic = {"laser": "/scan", "cloud": "/points", "image": "/camera/image"}[sensor]
            content.append((topic, t, message))
        return write_bag(folder / "drive", make, content, packed=packed)

    return write


def _file_of_bag(kind: str, ending: str, sensor: str = "laser") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = _bag(kind, sensor)(folder)
        (data,) = path.glob(f"*{ending}")
        target = folder / f"drive{ending}"
        shutil.move(data, target)
        shutil.rmtree(path)
        return target

    return write


def _kitti(folder: Path) -> Path:
    (folder / "velodyne").mkdir()
    for i in range(3):
        points = np.random.default_rng(i).normal(0, 5, (50, 4)).astype("<f4")
        points.tofile(folder / "velodyne" / f"{i:06d}.bin")
    rows = [" ".join(repr(float(v)) for v in pose_matrix(i)[:3].ravel()) for i in range(3)]
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    (folder / "times.txt").write_text("0.0\n0.1\n0.2\n")
    (folder / "calib.txt").write_text(f"P0: {rows[0]}\nTr: {rows[1]}\n")
    return folder


def _of_world(write: Callable[..., Path]) -> Callable[[Path], Path]:
    return lambda folder: write(folder, world())


def _graph(folder: Path) -> Path:
    path = folder / "a.graph"
    points = np.random.default_rng(2).normal(0, 3, (30, 3))
    path.write_bytes(graph(*[node(points)] * 3))
    return path


def _clouds(write: Callable[..., Path]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        numbered(folder, 3, write)
        (folder / "times.txt").write_text("".join(f"{0.1 * i}\n" for i in range(6)))
        (folder / "poses.txt").write_text(tum_lines([0.1 * i for i in range(6)]))
        return folder

    return make


def _map(ending: str, dim: int = 3, **options: Any) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        kind = ndtree.FixedMap if options.pop("fixed", False) else ndtree.AdaptiveMap
        m = kind(dim=dim, **options)
        random = np.random.default_rng(4)
        for _ in range(3):
            m.insert(random.normal(0, 2, (60, dim)), np.zeros(dim))
        path = folder / f"room{ending}"
        ndtree.convert(m, path)
        return path.with_suffix(".yaml") if ending in (".png", ".pgm") else path

    return write


def _room(write: Callable[..., Any], **how: Any) -> Callable[[Path], Path]:
    return lambda folder: write(folder, rooms.scanned(3, 150), **how)


def _with_checksums(path: Path) -> Path:
    """An E57 whose pages have the checksums of their content: damage comes behind them."""
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    content = bytearray(path.read_bytes())
    for at in range(0, len(content) - 1023, 1024):
        checksum = 0xFFFFFFFF
        for byte in content[at : at + 1020]:
            checksum = (checksum >> 8) ^ table[(checksum ^ byte) & 255]
        content[at + 1020 : at + 1024] = struct.pack(">I", checksum ^ 0xFFFFFFFF)
    path.write_bytes(content)
    return path


def _packets(write: Callable[..., Path]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        packets = rooms.velodyne_packets(lambda stamp: np.eye(4), 1)[::4]
        return write(folder / "lidar.pcap", [(stamp, rooms.udp(data, 2368)) for stamp, data in packets])

    return make


def _depth_folder(folder: Path) -> Path:
    rooms.depth_images(folder, rooms.scanned(2, 10))
    rooms.open3d_log(folder / "trajectory.log", rooms.scanned(2, 10))
    rooms.camera_json(folder / "camera.json")
    return folder


def _text_cloud(write: Callable[..., None], name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        write(folder / name, rooms.scanned(1, 200)[0].points)
        return folder / name

    return make


#: Those that libraries of their own write.
_OF_LIBRARIES = {
    "pye57": {
        "e57": Sample(_room(rooms.e57)),
        "e57, invalid": Sample(_room(rooms.e57, invalid=True), pack=_with_checksums),
    },
    "velodyne_decoder": {
        "pcap": Sample(_packets(rooms.pcap), ("--still",)),
        "pcapng": Sample(_packets(rooms.pcapng), ("--still",)),
    },
    "foxglove_schemas_protobuf": {
        "mcap, protobuf": Sample(lambda folder: rooms.foxglove_mcap(folder / "a.mcap", rooms.scanned(3, 100)))
    },
}

SAMPLES: dict[str, Sample] = {
    "ptx": Sample(_room(rooms.ptx)),
    "3dtk": Sample(_room(rooms.three_dtk)),
    "3dtk, frames": Sample(_room(rooms.three_dtk, frames=True)),
    "kitti raw": Sample(_room(rooms.kitti_raw)),
    "bin, 4x4": Sample(_room(rooms.folder_of(rooms.as_floats, ".bin", rooms.blocks_of_4, "poses.txt"))),
    "xyz, g2o": Sample(_room(rooms.folder_of(rooms.as_text, ".xyz", rooms.g2o, "graph.g2o"))),
    "xyz, named matrices": Sample(
        _room(
            rooms.folder_of(
                rooms.as_text,
                ".xyz",
                rooms.named_matrices,
                "poses.csv",
                names=lambda i, one: f"{one.stamp:.1f}",
            )
        )
    ),
    "xyz, log": Sample(_room(rooms.folder_of(rooms.as_text, ".xyz", rooms.open3d_log, "trajectory.log"))),
    "old clouds": Sample(lambda folder: rooms.bag_of_old_clouds(folder / "a", rooms.scanned(2, 50), "ros1")),
    "csv alone": Sample(_text_cloud(rooms.csv_with_time_first, "a.csv"), ("--points-only",)),
    "pts alone": Sample(_text_cloud(rooms.pts, "a.pts"), ("--points-only",)),
    "decimal commas": Sample(_text_cloud(rooms.decimal_comma, "a.csv"), ("--points-only",)),
    "depth folder": Sample(_depth_folder),
    "text": Sample(_text),
    "text, packed": Sample(_gzip(_text)),
    "carmen": Sample(_carmen),
    "carmen, packed": Sample(_gzip(_carmen)),
    "carmen, packed again": Sample(_carmen, pack=_zipped),
    "npz": Sample(_npz(np.savez)),
    "npz, compressed": Sample(_npz(np.savez_compressed)),
    "npz, packed again": Sample(_members, pack=_packed_members),
    "ros1": Sample(_bag("ros1")),
    "ros1, bz2": Sample(_bag("ros1", "cloud", packed=True)),
    "ros1, images": Sample(_bag("ros1", "image")),
    "ros2 folder, sqlite3": Sample(_bag("sqlite3")),
    "ros2 folder, mcap": Sample(_bag("mcap", "cloud")),
    "db3": Sample(_file_of_bag("sqlite3", ".db3")),
    "mcap": Sample(_file_of_bag("mcap", ".mcap")),
    "7-scenes": Sample(seven_scenes),
    "tum rgb-d": Sample(tum),
    "kitti": Sample(_kitti),
    "colmap, text": Sample(_of_world(colmap_text)),
    "colmap, binary": Sample(_of_world(colmap_binary)),
    "bundler": Sample(_of_world(bundler)),
    "bal": Sample(_of_world(bal)),
    "bal, packed": Sample(_of_world(bal_bz2)),
    "octomap graph": Sample(_graph),
    "pcd, ascii": Sample(_clouds(pcd("ascii"))),
    "pcd, binary": Sample(_clouds(pcd("binary"))),
    "pcd, compressed": Sample(_clouds(pcd("binary_compressed"))),
    "ply, ascii": Sample(_clouds(ply_by_meshio(False, np.float32))),
    "ply, binary": Sample(_clouds(ply_by_meshio(True, np.float64))),
    "las": Sample(_clouds(las(".las"))),
    "laz": Sample(_clouds(las(".laz"))),
    "laz, layered": Sample(_clouds(las(".laz", 6, "1.4"))),  # Points' parts are compressed one by one.
    "map, ndt": Sample(_map(".ndt")),
    "map, ndt of 2-D": Sample(_map(".ndt", 2, fixed=True)),
    "map, bt": Sample(_map(".bt")),
    "map, ot": Sample(_map(".ot")),
    "map, pgm": Sample(_map(".pgm", 2)),
    "map, png": Sample(_map(".png", 2)),
    **{
        name: sample
        for library, samples in _OF_LIBRARIES.items()
        if importlib.util.find_spec(library)
        for name, sample in samples.items()
    },
}

#: Of $NDTREE_DATA: what is damaged, and the options to read it. Of folders, this many files of each ending.
_RECORDINGS: dict[str, tuple[str, tuple[str, ...]]] = {
    "intel": ("laser2d_intel/*.log.gz", ()),
    "freiburg": ("laser2d_freiburg_079/*.log.gz", ()),
    "malaga": ("laser2d_mrpt_sena/*.npz", ()),
    "kinect": ("kinect_7scenes/seven_scenes_format", ()),
    "kinect, tum": ("kinect_tum_fr1_rpy/tum_format", ()),
    "avia": ("lidar_avia_hku_mb/pcd_format", ("--trajectory", "odom_poses.txt")),
    "colmap": ("sfm_mono_7scenes/colmap_text", ()),
    "bag, turtlebot": ("bags/ros1_scan_tf_turtlebot_kinect/*.bag", ("--keep-going",)),
    "bag, gmapping": ("bags/ros1_scan_tf_gmapping_replay_crash/*.bag", ("--keep-going",)),
    "bag, clouds": ("bags/ros1_pointcloud2_embag/test.bag", ("--odometry", "/odom")),
    "bag, mac": ("bags/ros2_scan_tf_odom_mac_take_2", ()),
    "bag, mydata": ("bags/ros2_scan_only_db3/mydata", ()),
    "bag, mcap": ("bags/mcap_pointcloud2_pointcloudset/*.mcap", ()),
    "bag, multiecho": ("bags/ros1_multiecho_cartographer/*.bag", ()),
    "bag, ccny": ("bags/ros1_scan_ccny_2010_badindexlen/*.bag", ()),
}
_FILES_OF_A_FOLDER = 3


def recorded_samples(recordings: Path) -> dict[str, Sample]:
    """Samples of the recordings that are there."""
    samples = {}
    for name, (pattern, options) in _RECORDINGS.items():
        found = sorted(recordings.glob(pattern))
        if found:
            samples[f"recorded: {name}"] = Sample(_copied(found[0]), options)
    return samples


def _copied(source: Path) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        if source.is_file():
            return Path(shutil.copyfile(source, folder / source.name))
        target = folder / source.name
        taken: dict[str, int] = {}
        for file in sorted(path for path in source.rglob("*") if path.is_file()):
            ending = "".join(file.suffixes[-2:])
            taken[ending] = taken.get(ending, 0) + 1
            if ending in (".txt", ".yaml") or taken[ending] <= _FILES_OF_A_FOLDER:
                copy = target / file.relative_to(source)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, copy)
        return target

    return make
