# SPDX-License-Identifier: BSD-3-Clause
"""Folders of point clouds that other libraries wrote: each point lies where its scan's pose puts it."""

from __future__ import annotations

import re
import struct
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import ndtree
from ndtree._lazy import install_of
from ndtree.logs import read
from ndtree.logs.folders.folder import number_in, stamp_in, stamps_in

pypcd4 = pytest.importorskip("pypcd4", reason="no pypcd4: no PCD can be written")
laspy = pytest.importorskip("laspy", reason="no laspy: no LAS can be written")
trimesh = pytest.importorskip("trimesh", reason="no trimesh: no PLY can be read")
meshio = pytest.importorskip("meshio", reason="no meshio: no PLY can be written by a library of others")
rotations = pytest.importorskip("scipy.spatial.transform", reason="no SciPy: no rotations").Rotation


def cloud(seed: int, n: int = 30) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 5, (n, 3)).astype(np.float32)


def pose_matrix(seed: int) -> np.ndarray:
    random = np.random.default_rng(100 + seed)
    matrix = np.eye(4)
    matrix[:3, :3] = rotations.random(None, random).as_matrix()
    matrix[:3, 3] = random.normal(size=3)
    return matrix


Make = Callable[[Path], Path]

# --- Writers ----------------------------------------------------------------------------------------


def pcd(encoding: str) -> Callable[[Path, np.ndarray], Path]:
    def write(path: Path, points: np.ndarray) -> Path:
        path = path.with_name(path.name + ".pcd")
        with_intensity = np.column_stack([points, np.ones(len(points), dtype=np.float32)])
        made = pypcd4.PointCloud.from_xyzi_points(with_intensity)
        made.save(path, encoding=pypcd4.Encoding(encoding))
        return path

    write.__name__ = encoding
    return write


def with_viewpoint(path: Path, matrix: np.ndarray) -> None:
    x, y, z, w = rotations.from_matrix(matrix[:3, :3]).as_quat()
    said = " ".join(repr(float(value)) for value in (*matrix[:3, 3], w, x, y, z))
    content = path.read_bytes()
    start = content.index(b"VIEWPOINT")
    path.write_bytes(content[:start] + b"VIEWPOINT " + said.encode() + content[content.index(b"\n", start) :])


def ply_by_meshio(binary: bool, dtype: type) -> Callable[[Path, np.ndarray], Path]:
    def write(path: Path, points: np.ndarray) -> Path:
        path = path.with_name(path.name + ".ply")
        meshio.Mesh(points.astype(dtype), []).write(path, binary=binary)
        return path

    write.__name__ = f"ply_by_meshio_{'binary' if binary else 'ascii'}_{dtype.__name__}"
    return write


def ply_by_trimesh(path: Path, points: np.ndarray) -> Path:
    path = path.with_name(path.name + ".ply")
    trimesh.PointCloud(points).export(path)
    return path


def ply_with_faces(path: Path, points: np.ndarray) -> Path:
    """The last vertices belong to no face, and some vertices are there twice."""
    path = path.with_name(path.name + ".ply")
    meshio.Mesh(points, [("triangle", np.array([[0, 1, 2], [2, 1, 3]]))]).write(path)
    return path


def las(ending: str, point_format: int = 3, version: str = "1.2") -> Callable[[Path, np.ndarray], Path]:
    def write(path: Path, points: np.ndarray) -> Path:
        path = path.with_name(path.name + ending)
        header = laspy.LasHeader(point_format=point_format, version=version)
        header.offsets, header.scales = np.zeros(3), np.full(3, 1e-6)
        made = laspy.LasData(header)
        made.x, made.y, made.z = points.astype(np.float64).T
        made.write(path)
        return path

    write.__name__ = ending
    return write


WRITERS = [
    pcd("ascii"), pcd("binary"), pcd("binary_compressed"), ply_by_meshio(False, np.float32),
    ply_by_meshio(True, np.float32), ply_by_meshio(True, np.float64), ply_by_trimesh, ply_with_faces,
    las(".las"), las(".laz"),
]  # fmt: skip
BINARY = pcd("binary")


def kitti_lines(count: int) -> str:
    return "".join(" ".join(repr(float(v)) for v in pose_matrix(i)[:3].ravel()) + "\n" for i in range(count))


def tum_lines(stamps: list[float]) -> str:
    lines = ["# t x y z qx qy qz qw"]
    for i, stamp in enumerate(stamps):
        quaternion = rotations.from_matrix(pose_matrix(i)[:3, :3]).as_quat()
        lines.append(" ".join(repr(float(v)) for v in (stamp, *pose_matrix(i)[:3, 3], *quaternion)))
    return "\n".join(lines) + "\n"


def numbered(folder: Path, count: int = 3, write: Callable = BINARY) -> Path:
    """Clouds with every second number."""
    for i in range(0, 2 * count, 2):
        write(folder / f"{i:06d}", cloud(i))
    return folder


def check(log: ndtree.Log, seeds: list[int], atol: float = 1e-6) -> list[ndtree.Scan]:
    """Each scan is the cloud of a seed, moved by the pose of that seed."""
    scans = list(log)
    assert len(scans) == len(log) == len(seeds) > 0
    for scan, seed in zip(scans, seeds):
        T = pose_matrix(seed)
        expected = cloud(seed).astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        np.testing.assert_allclose(scan.endpoints, expected, atol=atol)
        np.testing.assert_allclose(scan.origin, T[:3, 3], atol=1e-9)
        assert scan.returned is None
    return scans


# --- Point clouds -----------------------------------------------------------------------------------


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_clouds_of_every_kind_get_the_poses_of_their_numbers(write: Callable, tmp_path: Path) -> None:
    numbered(tmp_path, write=write)
    (tmp_path / "my_slam.txt").write_text(kitti_lines(6))
    log = read(tmp_path)
    assert (log.format, log.dim) == ("point_clouds", 3)
    check(log, [0, 2, 4], atol=2e-6)
    assert len(list(log)) == 3, "a log can be read again"


def test_numbers_count_not_the_order_of_names(tmp_path: Path) -> None:
    for i in (10, 9, 2):
        BINARY(tmp_path / f"scan_{i}", cloud(i))
    (tmp_path / "poses.txt").write_text(kitti_lines(11))
    (tmp_path / "times.txt").write_text("".join(f"{0.5 * i}\n" for i in range(11)))
    scans = check(read(tmp_path), [2, 9, 10])
    assert [scan.stamp for scan in scans] == [1.0, 4.5, 5.0]


@pytest.mark.parametrize("poses", [3, 4, 5])
def test_poses_before_or_behind_the_numbers_of_files_are_told_of(poses: int, tmp_path: Path) -> None:
    for i in (1, 3):
        BINARY(tmp_path / f"{i}", cloud(i))
    (tmp_path / "poses.txt").write_text(kitti_lines(poses + 1))
    log = read(tmp_path)
    check(log, [1, 3])
    more = {3: "1 more pose, such as number 0", 4: "2 more poses, such as", 5: "3 more poses, such as"}
    assert any(more[poses] in note and "numbers 1 to 3" in note for note in log.notes)


def test_names_without_numbers_are_taken_in_their_order(tmp_path: Path) -> None:
    for i, name in enumerate(("hall", "kitchen", "stairs")):
        BINARY(tmp_path / name, cloud(i))
    (tmp_path / "poses.txt").write_text(kitti_lines(3))
    check(read(tmp_path), [0, 1, 2])
    (tmp_path / "poses.txt").write_text(kitti_lines(4))
    with pytest.raises(ValueError, match=r"poses.txt: 4 poses for 3 files without a number, expected"):
        list(read(tmp_path))


@pytest.mark.parametrize("names", ["{:.6f}", "{:.0f}000000", "{:.0f}000000000"])
def test_stamps_as_names_get_the_pose_of_their_time(tmp_path: Path, names: str) -> None:
    stamps = [1305031229.0, 1305031231.0, 1305031232.0]
    for i, stamp in enumerate(stamps):
        BINARY(tmp_path / names.format(stamp), cloud(i))
    (tmp_path / "groundtruth.txt").write_text(tum_lines(stamps))
    scans = check(read(tmp_path), [0, 1, 2])
    assert [scan.stamp for scan in scans] == stamps
    between = next(iter(read(tmp_path, time_offset=0.5)))
    np.testing.assert_allclose(between.origin, (3 * pose_matrix(0) + pose_matrix(1))[:3, 3] / 4, atol=1e-9)
    with pytest.raises(ValueError, match=r"groundtruth.txt: no pose at 1305031226.000000 s"):
        list(read(tmp_path, time_offset=-3.0, strict=True))
    late = read(tmp_path, time_offset=-3.0)
    assert len(list(late)) == 1 and late.skipped["scans without a pose"].summary == (
        "2 of 3 scans had no pose: the poses begin 3.00 s later"
    )


def test_numbers_get_the_pose_of_the_time_on_their_line(tmp_path: Path) -> None:
    numbered(tmp_path)
    (tmp_path / "slam.tum").write_text(tum_lines([7.0, 8.0, 9.0, 10.0, 11.0]))
    with pytest.raises(ValueError, match=r"3 of 3 scans had no pose: the poses begin 7.00 s later"):
        list(read(tmp_path))
    (tmp_path / "times.txt").write_text("7\n8\n9\n10\n11\n")
    assert [scan.stamp for scan in check(read(tmp_path), [0, 2, 4])] == [7, 9, 11]
    (tmp_path / "times.txt").write_text("7\n8\n9\n")
    with pytest.raises(ValueError, match=r"000004.pcd: number 4, but .*times.txt has times 0 to 2"):
        list(read(tmp_path))


@pytest.mark.parametrize("ending, rows", [(".pose.txt", 4), (".txt", 3)])
def test_each_file_can_have_its_pose_beside_it(tmp_path: Path, ending: str, rows: int) -> None:
    numbered(tmp_path)
    for i in (0, 2, 4):
        np.savetxt(tmp_path / f"{i:06d}{ending}", pose_matrix(i)[:rows])
    check(read(tmp_path), [0, 2, 4])
    (tmp_path / f"000002{ending}").unlink()
    with pytest.raises(
        ValueError, match=r"000002.pcd: no pose beside it as others have, expected 000002.pose"
    ):
        list(read(tmp_path))
    kept = read(tmp_path, keep_going=True)
    assert len(list(kept)) == 2 and kept.skipped["scans without a pose"].count == 1
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "poses.txt").write_text(kitti_lines(5))
    check(read(tmp_path, trajectory=str(tmp_path / "elsewhere" / "poses.txt")), [0, 2, 4])


def ply_with_camera(path: Path, points: np.ndarray, order: str, pose: np.ndarray) -> Path:
    axes = [f"view_p{axis}" for axis in "xyz"] + [f"{row}_axis{axis}" for row in "xyz" for axis in "xyz"]
    lines = ["ply", f"format {order} 1.0", f"element vertex {len(points)}"]
    lines += [f"property float {axis}" for axis in "xyz"] + ["element camera 1"]
    lines += [f"property float {name}" for name in (*axes, "focal")] + [
        "property int viewportx",
        "end_header",
        "",
    ]
    camera = [*pose[:3, 3], *pose[:3, :3].ravel(), 0.0]
    if order == "ascii":
        rows = [" ".join(f"{float(value):.9g}" for value in row) for row in points]
        body = "\n".join([*rows, " ".join(f"{value:.9g}" for value in camera) + " 3\n"]).encode()
    else:
        end = "<" if "little" in order else ">"
        body = np.asarray(points, f"{end}f4").tobytes() + np.asarray(camera, f"{end}f4").tobytes()
        body += np.asarray([3], f"{end}i4").tobytes()
    path.write_bytes("\n".join(lines).encode() + body)
    return path


def test_the_pose_can_stand_in_the_pcd(tmp_path: Path) -> None:
    numbered(tmp_path)
    for i in (0, 2, 4):
        with_viewpoint(tmp_path / f"{i:06d}.pcd", pose_matrix(i))
    check(read(tmp_path), [0, 2, 4])
    check(read(tmp_path / "000002.pcd"), [2])


def test_points_in_the_map_take_only_origins(tmp_path: Path) -> None:
    numbered(tmp_path)
    for i in (0, 2, 4):
        with_viewpoint(tmp_path / f"{i:06d}.pcd", pose_matrix(i))
    for i, scan in zip((0, 2, 4), read(tmp_path, points_in="map")):
        np.testing.assert_array_equal(scan.endpoints, cloud(i))
        np.testing.assert_allclose(scan.origin, pose_matrix(i)[:3, 3])
    with pytest.raises(ValueError, match="points_in = 'world': must be one of sensor, map"):
        read(tmp_path, points_in="world")


def test_a_cloud_alone_that_does_not_say_from_where_is_refused(tmp_path: Path) -> None:
    """What a program writes that was told no VIEWPOINT is none: the points may be those of a map."""
    ways = r"; try\n  ndtree map .* --points-only (.|\n)*--origin-of-scan (.|\n)*--trajectory FILE"
    path = BINARY(tmp_path / "table", cloud(0))
    with pytest.raises(ValueError, match=rf"table.pcd: a PCD .* \(VIEWPOINT is the identity\){ways}"):
        read(path)
    for close in (1e-9, -3e-8):
        with_viewpoint(path, np.eye(4) + np.outer([close, 0, 0, 0], [0, 0, 0, 1]))
        with pytest.raises(ValueError, match="VIEWPOINT is the identity"):
            read(path)
    header = path.read_bytes().split(b"VIEWPOINT", 1)  # Its quaternion with w last, as many programs have it.
    path.write_bytes(header[0] + b"VIEWPOINT 0 0 0 0 0 0 1" + header[1][header[1].index(b"\n") :])
    with pytest.raises(ValueError, match="VIEWPOINT is the identity"):
        read(path)
    (scan,) = read(path, origin_of_scan="0,0,0")
    np.testing.assert_array_equal(scan.endpoints, cloud(0))
    with pytest.raises(ValueError, match=rf"table.ply: a PLY of points without a pose{ways}"):
        read(ply_by_trimesh(tmp_path / "table", cloud(0)))


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_the_pose_can_stand_in_the_element_camera_of_a_ply(order: str, tmp_path: Path) -> None:
    """As PCL writes it behind the points; its identity says as little as that of VIEWPOINT."""
    pose = pose_matrix(2)
    path = ply_with_camera(tmp_path / "a.ply", cloud(2), order, pose)
    check(read(path), [2])
    path = ply_with_camera(path, cloud(2), order, np.eye(4))
    with pytest.raises(ValueError, match="a PLY of points without a pose"):
        read(path)
    path = ply_with_camera(path, cloud(2), order, pose * 2)
    with pytest.raises(ValueError, match=r"a\.ply: element camera: expected a position and a rotation"):
        list(read(path))


def test_far_away_las_points_keep_their_last_digit(tmp_path: Path) -> None:
    """A metre is 100 integers; neither float32 nor the scale may cost a millimetre at 5000 km."""
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.offsets, header.scales = np.array([500000.0, 5400000.0, 100.0]), np.full(3, 0.01)
    counts = np.random.default_rng(1).integers(-(2**31), 2**31, (50, 3))
    made = laspy.LasData(header)
    made.X, made.Y, made.Z = counts.T
    made.write(tmp_path / "000000.las")
    (tmp_path / "000000.pose.txt").write_text("1 0 0 500001 0 1 0 5400002 0 0 1 103")
    (scan,) = read(tmp_path, points_in="map")
    assert scan.endpoints.dtype == np.float64
    np.testing.assert_array_equal(scan.endpoints, counts * header.scales + header.offsets)
    np.testing.assert_array_equal(scan.origin, [500001, 5400002, 103])


TABLE = np.column_stack([cloud(7, 40), np.arange(40), np.arange(40) % 16])
PCD_HEADERS = {
    "version .5, COLUMNS": ("COLUMNS x y z\nPOINTS {n}\nDATA {encoding}\n", "xyz", "fff"),
    "version .6": (
        "# .PCD v.6\nVERSION .6\nFIELDS x y z i\nSIZE 4 4 4 4\nTYPE F F F F\n"
        "WIDTH {n}\nHEIGHT 1\nPOINTS {n}\n"
        "DATA {encoding}\n",
        "xyzi",
        "ffff",
    ),
    "no VERSION, no COUNT, no POINTS": (
        "# .PCD\nFIELDS i x y z\nSIZE 2 8 8 8\nTYPE U F F F\nWIDTH {n}\nHEIGHT 1\nDATA {encoding}\n",
        "ixyz",
        "Hddd",
    ),
    "padding": (
        "# .PCD v.7\nVERSION .7\nFIELDS x _ y z _ r _\nSIZE 4 1 4 4 1 2 1\nTYPE F U F F U U U\n"
        "COUNT 1 4 1 1 8 1 0\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {encoding}\n",
        "x____yz________r",
        "fBBBBffBBBBBBBBH",
    ),
    "COUNT 0 that stands for one": (
        "# .PCD v.7\nVERSION .7\nFIELDS x i y z\nSIZE 4 1 4 4\nTYPE F U F F\nCOUNT 1 0 1 1\nWIDTH {n}\n"
        "HEIGHT 1\nPOINTS {n}\nDATA {encoding}\n",
        "xiyz",
        "fBff",
    ),
}


def by_struct(order: str, names: str, kinds: str, row: np.ndarray) -> bytes:
    values = {"x": row[0], "y": row[1], "z": row[2], "i": int(row[3]), "r": int(row[4]), "_": 0}
    return struct.pack(
        order + kinds,
        *(values[name] if kind in "fd" else int(values[name]) for name, kind in zip(names, kinds)),
    )


def by_text(names: str, row: np.ndarray, separator: str = " ") -> str:
    values = {"x": row[0], "y": row[1], "z": row[2], "i": int(row[3]), "r": int(row[4]), "_": 0}
    return separator.join(f"{values[name]:.9g}" for name in names)


@pytest.mark.parametrize(
    "start",
    ["# .PCD v0.7\n", "#.PCD v.7\n", "# made by hand\n# .PCD v0.7\n\n", "\n", "# by hand\n", "", "\ufeff"],
)
@pytest.mark.parametrize("end, by", [("\n", " "), ("\r\n", "\t")])
def test_pcd_is_recognised_however_its_header_begins(start: str, end: str, by: str, tmp_path: Path) -> None:
    lines = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n1 2 3\n4 5 6\n"
    path = tmp_path / "cloud.pcd"
    path.write_bytes((start + lines.replace(" ", by)).replace("\n", end).encode())
    (scan,) = read(path, origin_of_scan="0,0,0")
    np.testing.assert_array_equal(scan.endpoints, [[1, 2, 3], [4, 5, 6]])


def test_compressed_pcd_may_hold_what_lzf_cannot_shorten(tmp_path: Path) -> None:
    points = cloud(0)
    path = BINARY(tmp_path / "000000", points)
    pypcd4.PointCloud.from_xyz_points(points).save(path, encoding=pypcd4.Encoding.BINARY)
    head, _, data = path.read_bytes().partition(b"DATA binary\n")
    plain = np.frombuffer(data, "<f4").reshape(-1, 3).T.tobytes()
    sizes = struct.pack("<II", len(plain), len(plain))
    path.write_bytes(head + b"DATA binary_compressed\n" + sizes + plain)
    (scan,) = read(path, origin_of_scan="0,0,0")
    np.testing.assert_array_equal(scan.endpoints.astype(np.float32), points)
    path.write_bytes(head + b"DATA binary_compressed\n" + struct.pack("<II", 10, 1 << 30) + plain)
    with pytest.raises(ValueError, match="found 360 compressed bytes, expected 10 for 1073741824"):
        list(read(path, origin_of_scan="0,0,0"))


@pytest.mark.parametrize("encoding", ["ascii", "ascii with tabs and CRLF", "binary", "binary_compressed"])
@pytest.mark.parametrize("case", PCD_HEADERS)
def test_headers_of_every_version_of_pcd(case: str, encoding: str, tmp_path: Path) -> None:
    """What struct packs by hand is what is read; a point fewer, or a value, is an error."""
    header, names, kinds = PCD_HEADERS[case]
    head = header.format(n=40, encoding=encoding.split()[0])
    end, separator = ("\r\n", "\t") if "CRLF" in encoding else ("\n", " ")
    rows = [by_struct("<", names, kinds, row) for row in TABLE]
    if encoding.startswith("ascii"):
        content = (
            (head + "".join(by_text(names, row, separator) + "\n" for row in TABLE))
            .replace("\n", end)
            .encode()
        )
    elif encoding == "binary":
        content = head.encode() + b"".join(rows)
    else:
        fields = header.split("FIELDS" if "FIELDS" in header else "COLUMNS")[1].split("\n")[0].split()
        counts = {"padding": [1, 4, 1, 1, 8, 1, 0]}.get(case, [1] * len(fields))
        table = np.frombuffer(b"".join(rows), np.uint8).reshape(40, -1)
        sizes = [struct.calcsize("<" + kind) for kind in kinds]
        starts = np.cumsum([0, *sizes])
        columns = np.cumsum([0, *counts])
        plain = b"".join(
            table[:, starts[first] : starts[last]].tobytes() for first, last in zip(columns, columns[1:])
        )
        pieces = [plain[i : i + 32] for i in range(0, len(plain), 32)]
        packed = b"".join(bytes([len(piece) - 1]) + piece for piece in pieces)  # LZF of what does not repeat.
        content = head.encode() + struct.pack("<II", len(packed), len(plain)) + packed
    path = tmp_path / "000000.pcd"
    path.write_bytes(content)
    (scan,) = read(path, origin_of_scan="0,0,0")
    np.testing.assert_array_equal(scan.endpoints.astype(np.float32), TABLE[:, :3].astype(np.float32))
    for cut in (len(content) - 3 * len(rows[0]), len(content) - 30, len(head) + 5):
        path.write_bytes(content[:cut])
        with pytest.raises(
            ValueError, match=r"000000.pcd: (found \d+ points, expected 40|cannot be read as PCD)"
        ):
            list(read(path, origin_of_scan="0,0,0"))


PLY_VERTEX = "property float x\nproperty float y\nproperty float z\nproperty uchar r\n"
#: Properties of a vertex, how struct packs it, and of a face with three or four corners.
PLY_KINDS = {
    "points": (PLY_VERTEX, "fffB", None),
    "doubles behind an integer": (
        "property ushort r\nproperty double x\nproperty double y\nproperty double z\n", "Hddd", None
    ),
    "lists of vertices": ("property list uchar int seen\n" + PLY_VERTEX, "LfffB", None),
    "mixed faces": (PLY_VERTEX, "fffB", "property list uchar int vertex_indices\n"),
    "texture coordinates": (
        PLY_VERTEX, "fffB", "property list uchar int vertex_indices\nproperty list uchar float texcoord\n"
    ),
}  # fmt: skip


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("end, faces_first", [("\n", True), ("\r\n", False)])
@pytest.mark.parametrize("case", PLY_KINDS)
def test_ply_with_all_that_a_vertex_and_a_face_may_have(
    case: str, faces_first: bool, end: str, order: str, tmp_path: Path
) -> None:
    properties, kinds, face = PLY_KINDS[case]
    lists = [("B", "i"), ("B", "f")][: (face or "").count("list")]
    sign = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[order]

    def stored(values: list[tuple[str, float]]) -> bytes:
        if not sign:
            return (" ".join(f"{value:.9g}" for _, value in values) + end).encode()
        return b"".join(struct.pack(sign + kind, value) for kind, value in values)

    vertices = []
    for i, row in enumerate(TABLE):
        x, y, z, r = row[0], row[1], row[2], int(row[4])
        seen = [("B", i % 4), *(("i", k) for k in range(i % 4))]
        one = {
            "f": [("f", x), ("f", y), ("f", z), ("B", r)],
            "L": [*seen, ("f", x), ("f", y), ("f", z), ("B", r)],
        }
        one["H"] = [("H", r), ("d", x), ("d", y), ("d", z)]
        vertices.append(stored(one[kinds[0]]))
    faces = []
    for i in range(25 if face else 0):
        values: list[tuple[str, float]] = []
        for count, kind in lists:
            corners = 3 + (i % 7 == 5) if kind == "i" else 2 * (3 + (i % 7 == 5))
            values += [(count, corners), *((kind, k % 4) for k in range(corners))]
        faces.append(stored(values))
    parts = [(f"element vertex 40\n{properties}", vertices)]
    if face:
        parts.insert(0 if faces_first else 1, (f"element face 25\n{face}", faces))
    head = f"ply\nformat {order} 1.0\ncomment by hand\n" + "".join(said for said, _ in parts) + "end_header\n"
    body = b"".join(b"".join(rows) for _, rows in parts)
    path = tmp_path / "000000.ply"
    np.savetxt(tmp_path / "000000.pose.txt", np.eye(4))
    path.write_bytes(head.replace("\n", end).encode() + body)
    (scan,) = read(tmp_path)
    assert len(scan) == 40
    np.testing.assert_allclose(scan.endpoints, TABLE[:, :3], rtol=1e-7)
    for kept in (len(body) // 3, len(body) // 2 + 1):
        path.write_bytes(head.replace("\n", end).encode() + body[:kept])
        with pytest.raises(
            ValueError, match=r"000000.ply: (found \d+ points, expected 40|cannot be read as PLY)"
        ):
            list(read(tmp_path))


def test_nan_points_of_an_ordered_cloud_are_invalid_beams(tmp_path: Path) -> None:
    points = cloud(0)
    points[3:7] = np.nan
    points[8, 1] = np.inf
    BINARY(tmp_path / "000000", points)
    np.savetxt(tmp_path / "000000.pose.txt", pose_matrix(0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (scan,) = read(tmp_path)
    report = scan.insert_into(ndtree.AdaptiveMap(dim=3))
    assert (report.beams, report.invalid, report.returned) == (30, 5, 25)


def test_far_away_pcd_points_keep_their_digits(tmp_path: Path) -> None:
    points = cloud(0).astype(np.float64) + np.array([500000, 5400000, 100])
    made = pypcd4.PointCloud.from_points(points, ("x", "y", "z"), (np.float64,) * 3)
    made.save(tmp_path / "utm.pcd")
    (scan,) = read(tmp_path / "utm.pcd", points_only=True)
    np.testing.assert_array_equal(scan.endpoints, points)


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_clouds_of_one_point_or_none(tmp_path: Path, encoding: str) -> None:
    for n in (1, 0):
        path = pcd(encoding)(tmp_path / f"cloud{n}", cloud(0, n))
        (scan,) = read(path, origin_of_scan="0,0,0")
        np.testing.assert_allclose(scan.endpoints, cloud(0, n), rtol=1e-6)


def test_names_say_numbers_and_times() -> None:
    assert [number_in(stem) for stem in ("000012", "a-7", "a", "7a")] == [12, 7, None, None]
    stamps = ("1.5", "1305031229528784000", "1305031229528784", "000012", "1.5.2", "a1.5")
    assert [stamp_in(stem) for stem in stamps] == [1.5, 1305031229.528784, 1305031229.528784, *3 * [None]]


NAMED = {
    "seconds and nanoseconds": (["a_1583836592_182590976", "a_1583836591_9825909"], [592.182591, 591.009826]),
    "without zeros in front": (["1583836591_82590976", "1583836591_182590976"], [591.0825909, 591.1825909]),
    "a simulator's clock": (["c-12-500000000", "c-3-000000000"], [12.5 - 1583836000, 3 - 1583836000]),
    "microseconds": (["a_1583836591_500000", "a_1583836591_000000"], [591.5, 591]),
    "milliseconds": (["1583836591500"], [591.5]),
    "behind a word": (["scan_1583836591.25", "scan_1583836590.75"], [591.25, 590.75]),
    "nanoseconds behind a word": (["scan_1583836591250000000"], [591.25]),
    "numbers": (["run_12_345", "run_13_000000001"], None),
    "numbers with zeros": (["seq_00_000000001", "seq_00_000000123"], None),
}  # fmt: skip


@pytest.mark.parametrize("case", NAMED)
def test_names_of_a_folder_tell_times(case: str) -> None:
    names, expected = NAMED[case]
    found = stamps_in(names)
    if expected is None:
        assert found == [None] * len(names)
    else:
        np.testing.assert_allclose(np.array(found) - 1583836000, expected, atol=1e-6)


def test_seconds_and_a_number_of_unknown_unit_are_refused() -> None:
    with pytest.raises(
        ValueError, match=r"a_1583836591_12: a name of seconds and a number of 3 digits or fewer"
    ):
        stamps_in(["a_1583836591_12", "a_1583836591_123"])


def test_clouds_named_by_seconds_and_nanoseconds_come_in_their_order(tmp_path: Path) -> None:
    """The nanoseconds of the later scans are the smaller ones."""
    names = ["cloud_1583836591_182590976", "cloud_1583836591_982590976", "cloud_1583836592_082590976"]
    stamps = [1583836591.182590976, 1583836591.982590976, 1583836592.082590976]
    for i, name in enumerate(names):
        BINARY(tmp_path / name, cloud(i))
        with_viewpoint(tmp_path / f"{name}.pcd", pose_matrix(i))
    scans = check(read(tmp_path), [0, 1, 2])
    assert [scan.stamp for scan in scans] == stamps
    (tmp_path / "poses.tum").write_text(tum_lines(stamps))
    check(read(tmp_path), [0, 1, 2])
    (tmp_path / "poses.tum").unlink()
    rows = [line.split() for line in tum_lines(stamps).splitlines()[1:]]
    lines = [",".join([*name.split("_")[1:], *row[1:]]) for name, row in zip(names, rows)]
    (tmp_path / "poses.csv").write_text("#sec,nsec,x,y,z,qx,qy,qz,qw\n" + "\n".join(lines) + "\n")
    check(read(tmp_path), [0, 1, 2])


# --- KITTI ------------------------------------------------------------------------------------------


TR = np.array([[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, -0.3], [0, 0, 0, 1.0]])


def kitti(folder: Path, count: int = 3, poses: str | None = "poses.txt") -> Path:
    (folder / "velodyne").mkdir(parents=True)
    for i in range(count):
        np.column_stack([cloud(i), np.ones(30)]).astype("<f4").tofile(folder / "velodyne" / f"{i:06d}.bin")
    matrix = " ".join(f"{value:.9e}" for value in TR[:3].ravel())
    (folder / "calib.txt").write_text(f"P0: {' '.join(['1'] * 12)}\nTr: {matrix}\n")
    (folder / "times.txt").write_text("".join(f"{0.1 * i:.6e}\n" for i in range(count)))
    if poses:
        (folder / poses).parent.mkdir(exist_ok=True)
        (folder / poses).write_text(kitti_lines(count))
    return folder


@pytest.mark.parametrize("poses", ["poses.txt", "../../poses/07.txt"])
def test_kitti_poses_are_those_of_the_camera(tmp_path: Path, poses: str) -> None:
    log = read(kitti(tmp_path / "sequences" / "07", poses=poses))
    assert (log.format, len(log)) == ("kitti", 3)
    for i, scan in enumerate(log):
        T = np.linalg.inv(TR) @ pose_matrix(i) @ TR
        np.testing.assert_allclose(scan.endpoints, cloud(i) @ T[:3, :3].T + T[:3, 3], atol=1e-5)
        np.testing.assert_allclose(scan.origin, T[:3, 3], atol=1e-8)
        assert scan.stamp == pytest.approx(0.1 * i)


def street(seed: int, n: int) -> np.ndarray:
    """Points of a sensor with 16 rings between a floor and two walls, with their intensity, ring and time."""
    random = np.random.default_rng(seed)
    azimuth = np.repeat(np.linspace(-np.pi, np.pi, -(-n // 16)), 16)[:n]
    ring = np.tile(np.arange(16), -(-n // 16))[:n]
    elevation = np.radians(-15 + 2 * ring)
    range_ = np.minimum(
        8 / np.maximum(np.abs(np.sin(azimuth)), 0.2), 1.7 / np.maximum(-np.tan(elevation), 0.02)
    )
    xyz = range_[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)])
    return np.column_stack([xyz, random.integers(0, 256, n), ring, np.arange(n) * 1e-5])


@pytest.mark.parametrize("width", [3, 4, 5, 6])
@pytest.mark.parametrize("n, brightest", [(48, 1), (1080, 255), (12_000, 1)])
def test_the_numbers_of_a_point_are_told_from_the_content(
    width: int, n: int, brightest: int, tmp_path: Path
) -> None:
    """The number of bytes fits 3, 4, 5 and 6."""
    kitti(tmp_path / "00")
    clouds = [street(i, n) for i in range(3)]
    for i, points in enumerate(clouds):
        points[:, 3] *= brightest / 255
        points[:, :width].astype("<f4").tofile(tmp_path / "00" / "velodyne" / f"{i:06d}.bin")
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    log = read(tmp_path / "00", trajectory=str(tmp_path / "poses.txt"))
    scans = list(log)
    assert len(scans) == 3
    for scan, points in zip(scans, clouds):
        np.testing.assert_array_equal(scan.endpoints, points[:, :3].astype(np.float32))
    assert len(log.notes) == (width != 4)
    file = tmp_path / "00" / "velodyne" / "000001.bin"
    file.write_bytes(file.read_bytes()[:-2])
    with pytest.raises(
        ValueError, match=rf"000001.bin: \d+ bytes, expected a multiple of {4 * width} \(x y z"
    ):
        list(read(tmp_path / "00", trajectory=str(tmp_path / "poses.txt")))


@pytest.mark.parametrize("lines", [kitti_lines(3), tum_lines([0.0, 0.1, 0.2])], ids=["kitti", "tum"])
def test_kitti_takes_poses_of_the_velodyne(tmp_path: Path, lines: str) -> None:
    kitti(tmp_path / "00", poses=None)
    (tmp_path / "00" / "calib.txt").unlink()
    (tmp_path / "slam.txt").write_text(lines)
    check(read(tmp_path / "00", trajectory=str(tmp_path / "slam.txt")), [0, 1, 2])


def surroundings(seed: int, order: str, n: int = 720) -> np.ndarray:
    """Points on the walls of a room of 10 x 8 m, as a lidar of 4 rings sees them, or in a random order."""
    azimuth = np.linspace(0, 2 * np.pi, n // 4, endpoint=False)
    x, y = np.cos(azimuth), np.sin(azimuth)
    distance = np.minimum(5 / np.maximum(np.abs(x), 1e-9), 4 / np.maximum(np.abs(y), 1e-9))
    rings = [np.column_stack([distance * x, distance * y, distance * tilt]) for tilt in (-0.2, -0.1, 0, 0.1)]
    points = np.stack(rings, axis=1 if order == "columns" else 0).reshape(-1, 3)
    random = np.random.default_rng(seed)
    return points[random.permutation(n)] if order == "shuffled" else points


MORE = {
    4: lambda n: [np.arange(n) % 7 / 7],
    5: lambda n: [np.arange(n) % 255, np.arange(n) % 4],
    6: lambda n: [np.arange(n) % 7 / 7, np.arange(n) % 4, np.arange(n) / n],
    7: lambda n: [np.arange(n) % 7 / 7, *[np.arange(n) % 255] * 3],
    8: lambda n: [np.arange(n) % 7 / 7, np.arange(n) % 4, np.arange(n) / n, *[np.arange(n) % 255] * 2],
}


@pytest.mark.parametrize("order", ["rings", "columns", "shuffled"])
@pytest.mark.parametrize("floats", MORE)
def test_kitti_points_of_any_length_are_told_from_the_numbers(
    floats: int, order: str, tmp_path: Path
) -> None:
    kitti(tmp_path)
    for i in range(3):  # 720 points of 4 to 8 floats: a multiple of 16 bytes whatever they are.
        points = surroundings(i, order)
        np.column_stack([points, *MORE[floats](len(points))]).astype("<f4").tofile(
            tmp_path / "velodyne" / f"{i:06d}.bin"
        )
    for i, scan in enumerate(read(tmp_path)):
        T = np.linalg.inv(TR) @ pose_matrix(i) @ TR
        np.testing.assert_allclose(scan.endpoints, surroundings(i, order) @ T[:3, :3].T + T[:3, 3], atol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_kitti_points_of_which_nothing_tells_the_length_are_of_four_floats(seed: int, tmp_path: Path) -> None:
    kitti(tmp_path)
    random = np.random.default_rng(seed)
    for i in range(3):  # All columns alike, and as many bytes as 160 or 100 points would have.
        random.normal(0, 5, (200, 4)).astype("<f4").tofile(tmp_path / "velodyne" / f"{i:06d}.bin")
    assert [len(scan) for scan in read(tmp_path)] == [200] * 3


@pytest.mark.parametrize("count", [15, 201, 3001])
def test_kitti_points_that_come_in_pairs_are_not_half_as_many(count: int, tmp_path: Path) -> None:
    kitti(tmp_path)
    random = np.random.default_rng(count)
    counts = [count, count + 2, count + 4]  # Odd: in 8 floats a point, each file would end amid one.
    for i, n in enumerate(counts):
        points = random.uniform((-20, -20, 0, 0), (20, 20, 0.1, 1), (n, 4))
        points[::2, 2:] += 10.0  # Two lasers in turns.
        points.astype("<f4").tofile(tmp_path / "velodyne" / f"{i:06d}.bin")
    log = read(tmp_path)
    assert [len(scan) for scan in log] == counts and not log.notes


def test_kitti_scan_that_is_cut_off_is_named_whatever_the_length(tmp_path: Path) -> None:
    kitti(tmp_path)
    for i in range(3):
        points = np.column_stack([surroundings(i, "rings"), *MORE[5](720)]).astype("<f4").tobytes()
        (tmp_path / "velodyne" / f"{i:06d}.bin").write_bytes(points[:1616] if i == 1 else points)
    with pytest.raises(ValueError, match=r"000001\.bin: 1616 bytes, expected a multiple of 20"):
        list(read(tmp_path))


# --- What is refused --------------------------------------------------------------------------------


def broken_cloud(write: Callable, keep: float) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        numbered(folder, write=write)
        (folder / "poses.txt").write_text(kitti_lines(5))
        (path,) = folder.glob("000002.*")
        content = path.read_bytes()
        path.write_bytes(content[: int(keep * len(content))])
        return folder

    return make


def changed(name: str, content: bytes | None, make: Callable[[Path], Path] = numbered) -> Callable:
    """With a trajectory of 5 poses, and another content of one file."""

    def write(folder: Path) -> Path:
        if make is numbered:
            (folder / "poses.txt").write_text(kitti_lines(5))
        make(folder)
        (folder / name).unlink(missing_ok=content is not None)
        if content is not None:
            (folder / name).write_bytes(content)
        return folder

    return write


def two_kinds(folder: Path) -> Path:
    ply_by_trimesh(numbered(folder) / "000006", cloud(6))
    return folder


def without_x(folder: Path) -> Path:
    made = pypcd4.PointCloud.from_points(cloud(0), ("x", "b", "c"), (np.float32,) * 3)
    made.save(folder / "000000.pcd")
    np.savetxt(folder / "000000.pose.txt", np.eye(4))
    return folder


def wrong_viewpoint(folder: Path) -> Path:
    path = BINARY(folder / "000000", cloud(0))
    path.write_bytes(path.read_bytes().replace(b"0.0 0.0 0.0 1.0", b"0.0 0.0 0.0 9.0"))
    return folder


def las_header(at: int, values: bytes) -> Make:
    def write(folder: Path) -> Path:
        path = las(".las")(folder / "000000", cloud(0))
        content = bytearray(path.read_bytes())
        content[at : at + len(values)] = values
        path.write_bytes(content)
        (folder / "poses.txt").write_text(kitti_lines(1))
        return folder

    return write


BROKEN: dict[str, tuple[Make, str]] = {
    **{f"{write.__name__} cut off": (broken_cloud(write, 0.8),
        r"000002\.\w+: (cannot be read as|found \d+ poi)") for write in WRITERS},
    "nothing in a file": (changed("000002.pcd", b""), r"000002\.pcd: expected a PCD, PLY, LAS or LAZ"),
    "other content": (changed("000002.pcd", b"\x89PNG"), r"000002\.pcd: expected a PCD, PLY, LAS or LAZ"),
    "header of garbage": (
        changed("000002.pcd", b"# .PCD v0.7\nFIELDS\nrubbish"),
        r"000002\.pcd: cannot be read as PCD",
    ),
    "header of a PLY": (changed("000002.pcd", b"ply\nrubbish"), r"000002\.pcd: cannot be read as PLY"),
    "no fields": (without_x, r"000000\.pcd: no field y or z, found x, b, c"),
    "two kinds": (two_kinds, "PCD and PLY files, expected point clouds of one kind"),
    "no poses": (numbered,
        r"3 PCD files without poses \(VIEWPOINT is the identity in all\); try\n  ndtree map "),
    "no poses of PLY": (lambda folder: numbered(folder, write=ply_by_trimesh),
        r"3 PLY files without poses; try\n  ndtree map (.|\n)* --points-only (.|\n)*\n  --trajectory FILE"),
    "two trajectories": (changed("other.txt", kitti_lines(5).encode()),
        r"2 trajectories, expected one of them:\n  trajectory .*other\.txt\n  trajectory .*poses\.txt"),
    "trajectory too short": (changed("poses.txt", kitti_lines(4).encode()),
        r"000004\.pcd: number 4, but .*poses\.txt has poses 0 to 3"),
    "trajectory cut off": (changed("poses.txt", kitti_lines(5)[:-60].encode()), r"poses\.txt: line 5: found"),
    "LAS cut in its header": (changed("000002.pcd", b"LASF" + bytes(90)), r"the LAS header is cut off, exp"),
    "LAS of endless records": (las_header(100, b"\xff" * 4),
        r"000000\.las: the LAS header .* 4294967295 records"),
    "LAS points behind the end": (las_header(96, b"\xff" * 4),
        r"points from byte 4294967295 of \d+, expected"),
    "viewpoint": (wrong_viewpoint, r"000000\.pcd: VIEWPOINT: found .* expected x y z qw qx qy qz"),
    "kitti scan": (changed("velodyne/000001.bin", b"12345", kitti),
        r"000001\.bin: 5 bytes, expected a multiple"),
    "kitti no Tr": (changed("calib.txt", b"P0: 1 2 3\n", kitti), r"calib\.txt: no line Tr, expected where"),
    "kitti short Tr": (changed("calib.txt", b"P0: 1\nTr: 1 2 3\n", kitti),
        r"calib\.txt: Tr: expected a 3x4 matrix"),
    "kitti no poses": (changed("poses.txt", None, kitti),
        r"a KITTI sequence without poses: neither poses\.txt in it nor "),
    "kitti no calib": (changed("calib.txt", None, kitti),
        r"a KITTI sequence without calib\.txt, .*; try\n  ndtree map .* --trajectory .*poses\.txt \(if"),
    "kitti few poses": (changed("poses.txt", kitti_lines(2).encode(), kitti), r"000002\.bin: number 2, but"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_broken_folders_are_named_with_file_and_expectation(case: str, tmp_path: Path) -> None:
    make, message = BROKEN[case]
    folder = make(tmp_path)
    with pytest.raises(ValueError, match=message) as caught:
        list(read(folder))
    assert str(caught.value).startswith(str(folder))
    assert all(line.startswith("  ") for line in str(caught.value).splitlines()[1:])


def test_the_other_scans_can_be_kept(tmp_path: Path) -> None:
    log = read(broken_cloud(BINARY, 0.5)(tmp_path), keep_going=True)
    assert len(list(log)) == 2 and log.skipped["damaged scans"].count == 1


@pytest.mark.parametrize(
    "write, library, module",
    [(pcd("binary_compressed"), "pypcd4", "lzf"), (las(".las"), "laspy", "laspy")],
)
def test_without_its_library_the_extra_is_named(
    write: Callable, library: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbered(tmp_path, write=write)
    (tmp_path / "poses.txt").write_text(kitti_lines(5))
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=rf"need {library} .*:\n  {re.escape(install_of('clouds'))}$"):
        list(read(tmp_path, keep_going=True))


def test_an_ascii_ply_that_ends_behind_a_line_is_noticed(tmp_path: Path) -> None:
    path = ply_by_meshio(False, np.float32)(tmp_path / "000000", cloud(0))
    np.savetxt(tmp_path / "000000.pose.txt", np.eye(4))
    path.write_bytes(b"\n".join(path.read_bytes().split(b"\n")[:-11]) + b"\n")
    with pytest.raises(ValueError, match=r"000000.ply: found 20 points, expected 30 as its header says"):
        list(read(tmp_path))


def test_a_pcd_cut_off_behind_a_point_is_noticed(tmp_path: Path) -> None:
    path = BINARY(tmp_path / "table", cloud(0))
    path.write_bytes(path.read_bytes()[:-160])
    with pytest.raises(ValueError, match=r"table\.pcd: found 20 points, expected 30 as its header says"):
        list(read(path, origin_of_scan="0,0,0"))
