# SPDX-License-Identifier: BSD-3-Clause
"""A room in the files of others: each gives the scans that were written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import rooms
from rooms import Placed, folder_of

import ndtree
from ndtree.logs import NotALog, read

CELL = 0.1
SCANS = rooms.scanned()
#: What six decimals in a file leave open [m].
MICROMETRE = 2e-6


def map_of(scans: Sequence[ndtree.Scan]) -> ndtree.AdaptiveMap:
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=CELL, range_sigma=0.02)
    for scan in scans:
        scan.insert_into(m)
    return m


def assert_same(found: list[ndtree.Scan], expected: Sequence[Placed], tolerance: float) -> None:
    """The scans are those that were written, and each beam returned."""
    assert len(found) == len(expected) > 0
    for scan, one in zip(found, expected):
        np.testing.assert_allclose(scan.endpoints, one.in_map, atol=tolerance)
        np.testing.assert_allclose(scan.origin, one.pose[:3, 3], atol=tolerance)
        assert scan.returned is None or np.all(scan.returned)


# --- A file each scan, and poses --------------------------------------------------------------------

TEXT = rooms.as_text
FOLDERS: dict[str, Callable[[Path, Sequence[Placed]], Path]] = {
    "xyz and TUM": folder_of(TEXT, ".xyz", rooms.tum, "poses.txt", names=lambda i, one: f"{one.stamp:.6f}"),
    "pts and KITTI": folder_of(rooms.pts, ".pts", rooms.kitti, "poses.txt"),
    "asc and 4x4 a line": folder_of(rooms.asc, ".asc", rooms.rows_of_16, "poses.txt"),
    "csv and blocks of 4x4": folder_of(rooms.csv_with_time_first, ".csv", rooms.blocks_of_4, "poses.txt"),
    "csv with decimal commas and a mark": folder_of(rooms.decimal_comma, ".csv", rooms.kitti, "poses.txt"),
    "txt and g2o": folder_of(TEXT, ".txt", rooms.g2o, "graph.g2o"),
    "Hokuyo csv and named matrices": folder_of(
        rooms.csv_with_time_first, ".csv", rooms.named_matrices, "pose_scanner_leica.csv",
        names=lambda i, one: f"Hokuyo_{one.stamp:.6f}",
    ),
    "bin and KITTI": folder_of(rooms.as_floats, ".bin", rooms.kitti, "poses.txt"),
    "nuScenes' bin and a time and a matrix": folder_of(
        lambda path, points: rooms.as_floats(path, points, 5), ".pcd.bin", rooms.timed_matrices, "poses.txt",
        names=lambda i, one: f"n008__LIDAR_TOP__{round(one.stamp * 1e6)}",
    ),
    "a folder Scans beside the poses": folder_of(
        TEXT, ".xyz", rooms.euroc, "poses.csv", scans_in="Scans",
        names=lambda i, one: f"{round(one.stamp * 1e9)}",
    ),
    "Newer College": folder_of(
        TEXT, ".xyz", rooms.newer_college, "ground_truth/registered_poses.csv",
        scans_in="raw_format/ouster_scan", names=rooms.seconds_and_nanoseconds,
    ),
    "a folder of poses": folder_of(TEXT, ".xyz", rooms.pose_each, "poses", scans_in="lidar"),
    "Ouster's csv": folder_of(
        rooms.ouster_csv, ".csv", rooms.kitti, "poses.txt", names=lambda i, one: f"scans_{i:06d}"
    ),
    "numbers from 1": folder_of(TEXT, ".xyz", rooms.kitti, "poses.txt", names=lambda i, one: f"scan_{i + 1}"),
}  # fmt: skip


@pytest.mark.parametrize("kind", FOLDERS)
def test_folders_of_clouds_give_its_scans(kind: str, tmp_path: Path) -> None:
    log = read(FOLDERS[kind](tmp_path, SCANS))
    assert log.format == "point_clouds"
    assert_same(list(log), SCANS, 1e-5 if "bin" in kind else MICROMETRE)


def test_the_folder_of_scans_alone_finds_the_poses_above_it(tmp_path: Path) -> None:
    FOLDERS["a folder Scans beside the poses"](tmp_path, SCANS)
    log = read(tmp_path / "Scans")
    assert_same(list(log), SCANS, MICROMETRE)
    assert any("poses.csv" in note for note in log.notes), "poses from elsewhere are said"


def test_poses_above_that_need_not_be_of_the_scans_are_only_named(tmp_path: Path) -> None:
    """More poses than scans, fewer, at other times, or a file that is damaged: the way on is in the error."""
    for i in range(3):
        (tmp_path / "clouds").mkdir(exist_ok=True)
        rooms.as_text(tmp_path / "clouds" / f"{i:06d}.xyz", SCANS[i].points)
    for count in (2, len(SCANS)):
        rooms.kitti(tmp_path / "poses.txt", SCANS[:count])
        with pytest.raises(
            NotALog, match=rf"3 .* without poses(.|\n)*--trajectory .*poses\.txt \(has {count} poses\)"
        ):
            read(tmp_path / "clouds")
    rooms.kitti(tmp_path / "poses.txt", SCANS[:3])
    assert_same(list(read(tmp_path / "clouds")), SCANS[:3], MICROMETRE)
    for i in range(3):
        (tmp_path / "clouds" / f"{i:06d}.xyz").rename(tmp_path / "clouds" / f"{1700000000 + i}.000.xyz")
    rows = [f"{1600000000 + i}.0 {i} 0 0 0 0 0 1" for i in range(9)]
    (tmp_path / "poses.txt").write_text("\n".join(rows))
    with pytest.raises(NotALog, match=r"--trajectory .*poses\.txt \(has 9 poses\)"):
        read(tmp_path / "clouds")
    (tmp_path / "poses.txt").write_text("\n".join([*rows, *rows]))
    with pytest.raises(NotALog, match=r"--trajectory .*poses\.txt \(cannot be read\)"):
        read(tmp_path / "clouds")


def test_as_many_poses_above_as_clouds_whose_names_say_nothing_are_only_named(tmp_path: Path) -> None:
    (tmp_path / "clouds").mkdir()
    for name in ("corners", "surfaces"):
        rooms.as_text(tmp_path / "clouds" / f"{name}.xyz", SCANS[0].points)
    rooms.kitti(tmp_path / "poses.txt", SCANS[:2])
    with pytest.raises(NotALog, match=r"2 .* without poses(.|\n)*--trajectory .*poses\.txt \(has 2 poses\)"):
        read(tmp_path / "clouds")


def test_points_of_the_same_name_are_no_pose(tmp_path: Path) -> None:
    for ending in ("pts", "txt"):
        rooms.as_text(tmp_path / f"hall.{ending}", SCANS[0].points)
    with pytest.raises(NotALog, match=r"hall\.pts: points in text without a pose"):
        read(tmp_path / "hall.pts")


def test_the_map_beside_a_graph_is_no_scan_of_it(tmp_path: Path) -> None:
    rooms.as_text(tmp_path / "map.xyz", SCANS[0].points)
    (tmp_path / "pose_graph.g2o").write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n")
    with pytest.raises(
        NotALog, match=r"without a pose(.|\n)*--points-only(.|\n)*pose_graph.g2o \(has 2 poses\)"
    ):
        read(tmp_path)


def test_poses_in_the_clouds_come_before_those_above(tmp_path: Path) -> None:
    """Stray trajectories in the folder above are not taken where the clouds have poses of their own."""
    (tmp_path / "clouds").mkdir()
    rooms.kitti(tmp_path / "of_another.txt", SCANS[:2])
    for i in range(2):
        header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
        header += f"VIEWPOINT {i} 5 0 1 0 0 0\n"
        (tmp_path / "clouds" / f"{i}.pcd").write_text(header + "POINTS 1\nDATA ascii\n1 0 0\n")
    origins = [scan.origin.tolist() for scan in read(tmp_path / "clouds")]
    assert origins == [[0, 5, 0], [1, 5, 0]]
    rooms.kitti(tmp_path / "and_one_more.txt", SCANS[:2])
    rooms.as_text(tmp_path / "clouds" / "0.xyz", SCANS[0].points)
    for name in ("0.pcd", "1.pcd"):
        (tmp_path / "clouds" / name).unlink()
    with pytest.raises(NotALog, match="points in text without a pose"):
        read(tmp_path / "clouds")


def test_several_folders_of_scans_are_named(tmp_path: Path) -> None:
    for name in ("left", "right"):
        (tmp_path / name).mkdir()
        rooms.as_text(tmp_path / name / "0.xyz", SCANS[0].points)
    with pytest.raises(
        ValueError, match=r"2 folders with point clouds, expected one of them: .*left, .*right"
    ):
        read(tmp_path)


def test_vertices_of_a_graph_belong_to_files_by_their_ids(tmp_path: Path) -> None:
    """Of ten scans, a graph keeps some: the others have no pose, and are named."""
    folder = folder_of(rooms.as_text, ".xyz", lambda path, scans: None, "none")(tmp_path, SCANS)
    lines = ["VERTEX_SE2 2 1.5 -0.5 0.25", "VERTEX_SE2 0 0 0 0", "EDGE_SE2 0 2 1 0 0 1 0 0 1 0 1"]
    (tmp_path / "graph.g2o").write_text("\n".join(lines))
    with pytest.raises(ValueError, match=r"000001\.xyz: number 1, but .*graph\.g2o has poses 0 to 2"):
        list(read(folder))
    scans = list(read(folder, keep_going=True))
    assert len(scans) == 2
    np.testing.assert_allclose(scans[1].origin, [1.5, -0.5, 0])
    expected = SCANS[2].points @ rooms.turned(0.25).T + (1.5, -0.5, 0)
    np.testing.assert_allclose(scans[1].endpoints, expected, atol=MICROMETRE)


# --- Files of several scans -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["poses", "registered", "colours"])
def test_a_ptx_gives_its_scans(kind: str, tmp_path: Path) -> None:
    path = rooms.ptx(tmp_path, SCANS, registered=kind == "registered", width=7 if kind == "colours" else 4)
    log = read(path)
    assert log.format == "ptx"
    assert_same(list(log), SCANS, MICROMETRE)


def test_points_that_a_ptx_has_at_0_were_not_measured(tmp_path: Path) -> None:
    """The grid of a scan has a place for each beam: here one more than was measured."""
    odd = [Placed(one.points[:-1], one.pose, one.stamp) for one in SCANS]
    path = rooms.ptx(tmp_path, odd)
    assert path.read_text().count("\n0 0 0 0.5") == len(odd)
    assert_same(list(read(path)), odd, MICROMETRE)


@pytest.mark.parametrize("write", [rooms.e57, rooms.e57_in_angles])
def test_an_e57_gives_its_scans(write: Callable[..., Path], tmp_path: Path) -> None:
    log = read(write(tmp_path, SCANS))
    assert (log.format, len(log)) == ("e57", len(SCANS))
    assert_same(list(log), SCANS, 1e-6)


def test_points_that_an_e57_calls_invalid_are_not_measured(tmp_path: Path) -> None:
    kept = [Placed(one.points[np.arange(len(one.points)) % 3 != 0], one.pose, one.stamp) for one in SCANS]
    assert_same(list(read(rooms.e57(tmp_path, SCANS, invalid=True))), kept, 1e-6)


def test_an_e57_without_poses_needs_an_origin(tmp_path: Path) -> None:
    path = rooms.e57(tmp_path, SCANS[:1], with_pose=False)
    with pytest.raises(
        NotALog, match=r"a\.e57: an E57 of points without a pose; try\n  ndtree map .*--points-only"
    ):
        read(path)
    (scan,) = read(path, origin_of_scan=(1, 2, 0.5))
    np.testing.assert_allclose(scan.origin, [1, 2, 0.5])
    np.testing.assert_allclose(scan.endpoints, SCANS[0].points, atol=1e-6)


@pytest.mark.parametrize("frames", [False, True])
def test_a_folder_of_3dtk_gives_its_scans(frames: bool, tmp_path: Path) -> None:
    log = read(rooms.three_dtk(tmp_path, SCANS, frames=frames))
    assert log.format == "3dtk"
    assert_same(list(log), SCANS, MICROMETRE)


def test_a_drive_of_kitti_gives_its_scans(tmp_path: Path) -> None:
    log = read(rooms.kitti_raw(tmp_path, SCANS))
    assert log.format == "kitti_raw"
    start = (SCANS[0].pose @ np.linalg.inv(rooms.MOUNT))[:3, 3]
    moved = [Placed(one.points, one.pose.copy(), one.stamp) for one in SCANS]
    for one in moved:
        one.pose[:3, 3] -= start
    found = list(log)
    for scan, one in zip(found, moved):
        np.testing.assert_allclose(scan.origin, one.pose[:3, 3], atol=1e-4)
        np.testing.assert_allclose(scan.endpoints, one.in_map, atol=1e-4)
        assert scan.stamp == one.stamp
    assert len(found) == len(moved)


POSES_OF_IMAGES = {
    "trajectory.log": rooms.open3d_log,
    "poses.txt": rooms.kitti,
    "livingroom1.gt.freiburg": lambda path, scans: np.savetxt(
        path, [[i, *one.pose[:3, 3], *one.quaternion] for i, one in enumerate(scans)], fmt="%.12f"
    ),
}


def test_depth_images_may_be_pgm_of_16_bits(tmp_path: Path) -> None:
    """Their values are as they are, whatever the header says is the largest."""
    image_module = pytest.importorskip("PIL.Image")
    measured = rooms.depth_images(tmp_path, SCANS)
    POSES_OF_IMAGES["poses.txt"](tmp_path / "poses.txt", SCANS)
    rooms.camera_json(tmp_path / "camera.json")
    for image in sorted((tmp_path / "depth").glob("*.png")):
        values = np.asarray(image_module.open(image)).astype(">u2")
        header = f"P5\n# of a camera\n{values.shape[1]} {values.shape[0]}\n65535\n".encode()
        image.with_suffix(".pgm").write_bytes(header + values.tobytes())
        image.unlink()
    assert_same(list(read(tmp_path)), measured, 1e-9)
    first = tmp_path / "depth" / "00000.pgm"
    first.write_bytes(first.read_bytes().replace(b"65535", b"12000"))
    assert_same(list(read(tmp_path)), measured, 1e-9)
    for content, message in (
        (b"P5 4 4 255\n" + bytes(16), "values up to 255, expected one of 16 bits"),
        (b"P5 4 4 65535\n" + bytes(31), "is cut off, expected 4 x 4 pixels"),
        (b"P2 4 4 65535\n" + bytes(32), "not a binary PGM"),
        (b"P5 13000 13000 65535\n", "13000 x 13000 pixels, expected at most"),
    ):
        first.write_bytes(content)
        with pytest.raises(ValueError, match=rf"00000\.pgm: .*{message}"):
            list(read(tmp_path))


def test_images_of_more_pixels_than_a_camera_has_are_refused(tmp_path: Path) -> None:
    image_module = pytest.importorskip("PIL.Image")
    rooms.depth_images(tmp_path, SCANS)
    POSES_OF_IMAGES["poses.txt"](tmp_path / "poses.txt", SCANS)
    image_module.fromarray(np.zeros((1 << 12, (1 << 13) + 1), np.uint16)).save(
        tmp_path / "depth" / "00000.png"
    )
    with pytest.raises(ValueError, match=r"00000\.png: 8193 x 4096 pixels, expected at most"):
        list(read(tmp_path))


def test_a_calibration_of_infinity_is_refused(tmp_path: Path) -> None:
    path = rooms.kitti_raw(tmp_path, SCANS)
    (calibration,) = tmp_path.rglob("calib_imu_to_velo.txt")
    lines = calibration.read_text().splitlines()
    calibration.write_text("\n".join("T: 1 inf 0" if line.startswith("T") else line for line in lines))
    with pytest.raises(ValueError, match=r"calib_imu_to_velo.txt: expected .* must be finite"):
        list(read(path))


@pytest.mark.parametrize("name", ["trajectory.log", "poses.txt"])
def test_depth_images_of_open3d_give_its_scans(name: str, tmp_path: Path) -> None:
    measured = rooms.depth_images(tmp_path, SCANS)
    POSES_OF_IMAGES[name](tmp_path / name, SCANS)
    rooms.camera_json(tmp_path / "camera.json")
    log = read(tmp_path)
    assert (log.format, log.is_depth_camera) == ("depth_folder", True)
    assert_same(list(log), measured, 1e-9)
    (tmp_path / "camera.json").unlink()
    other = read(tmp_path)
    assert any("PrimeSense" in note for note in other.notes), "the camera that is assumed is said"
    said = read(tmp_path, camera=",".join(map(str, rooms.CAMERA)))
    assert_same(list(said), measured, 1e-9)
    (tmp_path / name).unlink()
    with pytest.raises(
        NotALog, match=r"4 depth images without poses; try\n  ndtree map .* --trajectory FILE"
    ):
        read(tmp_path)


# --- Points without a sensor ------------------------------------------------------------------------


def test_points_only_make_their_cells_occupied_and_nothing_free(tmp_path: Path) -> None:
    points = np.concatenate([one.in_map for one in SCANS])
    rooms.as_text(tmp_path / "room.xyz", points)
    (scan,) = read(tmp_path / "room.xyz", points_only=True)
    m = map_of([scan])
    assert (m.state(np.round(points, 6)) == 1).all()
    assert not (m.leaves().state == 0).any(), "no free space is made up"
    inside = np.random.default_rng(5).uniform(rooms.ROOM[0] + 0.3, rooms.ROOM[1] - 0.3, (2000, 3))
    assert (m.state(inside) == -1).all()
    again = map_of([ndtree.Scan(points[::-1], points[::-1], points_only=True)])
    grid = np.random.default_rng(6).uniform(*rooms.ROOM, (5000, 3))
    assert (again.state(grid) == m.state(grid)).mean() > 0.999, "the order of the points does not matter"


@pytest.mark.parametrize("spread", [0.5, 200.0, 5e6])
def test_voxels_are_the_rounded_points(spread: float) -> None:
    points = np.random.default_rng(7).normal(0, spread, (300, 3)) - spread
    points[5] = np.nan
    m = ndtree.FixedMap(dim=3, min_cell_size=0.25)
    report = ndtree.Scan(points, points, points_only=True).insert_into(m)
    assert (report.beams, report.returned, report.invalid) == (300, 299, 1)
    leaves = m.leaves()
    found = {tuple(row) for row in np.rint(leaves.lower[leaves.state == 1] / 0.25).astype(int).tolist()}
    kept = points[np.isfinite(points).all(axis=1)]
    assert found == {tuple(row) for row in np.floor(kept / 0.25).astype(int).tolist()}
    assert report.updates == len(found) > 10


def test_points_on_borders_are_in_the_cells_that_the_map_finds_there() -> None:
    numbers = np.arange(-60, 60)
    on = numbers * 0.1  # To the last bit where cells begin.
    below = np.nextafter(on, -np.inf)
    decimal = np.round(on, 1)  # What files have: some lie below the border.
    for values, expected in ((on, numbers), (below, numbers - 1), (decimal, None)):
        points = np.column_stack([values, np.full(len(values), 0.05), np.full(len(values), 0.05)])
        m = ndtree.FixedMap(dim=3, min_cell_size=0.1)
        ndtree.Scan(points, points, points_only=True).insert_into(m)
        assert (m.state(points) == 1).all()
        leaves = m.leaves()
        found = np.rint(leaves.lower[leaves.state == 1, 0] / 0.1).astype(int)
        if expected is not None:
            assert sorted(found) == sorted(expected)


def test_an_origin_for_all_points_is_a_scan_from_there(tmp_path: Path) -> None:
    one = SCANS[1]
    rooms.as_text(tmp_path / "room.csv", one.in_map, delimiter=",", header="X,Y,Z", comments="")
    origin = ",".join(f"{value:.12f}" for value in one.pose[:3, 3])
    assert_same(list(read(tmp_path / "room.csv", origin_of_scan=origin)), [one], MICROMETRE)
    for wrong in ("1,2", "a,b,c", "1,2,nan"):
        with pytest.raises(ValueError, match=r"origin_of_scan = .*: expected three numbers"):
            read(tmp_path / "room.csv", origin_of_scan=wrong)
    with pytest.raises(TypeError, match="origin_of_scan and points_only: expected one of them"):
        read(tmp_path / "room.csv", origin_of_scan=origin, points_only=True)


# --- Packets ----------------------------------------------------------------------------------------


def still(_: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = (0.2, -0.3, 0.1)
    return pose


def moving(stamp: float) -> np.ndarray:
    """Turns and drives through the room while it scans."""
    pose = np.eye(4)
    since = stamp - rooms.START
    pose[:3, :3], pose[:3, 3] = rooms.turned(0.5 * since), (2 * since - 0.6, 0.3, 0.5 * since)
    return pose


def off_the_walls(scan: ndtree.Scan) -> np.ndarray:
    """How far end points are from the nearest wall [m]."""
    ends = scan.endpoints[np.isfinite(scan.endpoints).all(axis=1)]
    return np.abs(ends[:, None, :] - rooms.ROOM).min(axis=(1, 2))


def frames_of(pose: Callable[[float], np.ndarray], turns: int = 3) -> list[tuple[float, bytes]]:
    return [(stamp, rooms.udp(data, 2368)) for stamp, data in rooms.velodyne_packets(pose, turns)]


WRITTEN_AS: dict[str, Callable[[Path, list[tuple[float, bytes]]], Path]] = {
    "pcap": rooms.pcap,
    "pcap of nanoseconds": lambda path, frames: rooms.pcap(path, frames, nanoseconds=True),
    "pcap of another machine": lambda path, frames: rooms.pcap(path, frames, order=">"),
    "pcapng": rooms.pcapng,
}


@pytest.mark.parametrize("kind", WRITTEN_AS)
def test_packets_of_a_velodyne_that_stands_end_on_the_walls(kind: str, tmp_path: Path) -> None:
    pytest.importorskip("velodyne_decoder", reason="no velodyne-decoder: no packets can be decoded")
    path = WRITTEN_AS[kind](tmp_path / "a.pcap", frames_of(still))
    log = read(path, still=True)
    scans = list(log)
    assert log.format == "velodyne" and sum(map(len, scans)) > 25_000
    shifted = [
        ndtree.Scan(scan.endpoints + still(0)[:3, 3], scan.origin + still(0)[:3, 3], stamp=scan.stamp)
        for scan in scans
    ]
    off = np.concatenate([off_the_walls(scan) for scan in shifted])
    assert np.mean(off < 0.004) > 0.99 and off.max() < 0.05, "ranges are in steps of 2 mm"
    stamps = [scan.stamp - rooms.START for scan in scans]
    assert all(0 <= stamp < 0.4 for stamp in stamps) and np.ptp(stamps) > 0.15, stamps


def test_packets_of_a_velodyne_that_moves_give_its_scans(tmp_path: Path) -> None:
    pytest.importorskip("velodyne_decoder", reason="no velodyne-decoder: no packets can be decoded")
    path = rooms.pcap(tmp_path / "a.pcap", frames_of(moving))
    stamps = rooms.START + np.linspace(-0.2, 0.8, 200)
    track = [Placed(np.zeros((0, 3)), moving(stamp), stamp) for stamp in stamps]
    rooms.tum(tmp_path / "track.txt", track)
    scans = list(read(path, trajectory=str(tmp_path / "track.txt")))
    off = np.concatenate([off_the_walls(scan) for scan in scans])
    assert len(off) > 25_000
    assert np.mean(off < 0.01) > 0.99, "each beam is placed by the pose of its own time"
    as_one = ndtree.Scan(scans[1].endpoints, scans[1].origin[0])
    assert np.ptp(scans[1].origin, axis=0).max() > 0.05, "the sensor moves within a turn"
    assert len(as_one) == len(scans[1])


def test_packets_without_poses_and_of_others_are_named(tmp_path: Path) -> None:
    path = rooms.pcap(tmp_path / "a.pcap", frames_of(still, 1))
    with pytest.raises(NotALog, match=r"packets of a Velodyne, and no poses with them; try\n(.|\n)*--still"):
        read(path)
    cases = {
        "Ouster": (bytes(12608), 7502, "try ouster-cli source .*a.pcap save scans.csv"),
        "Hesai": (b"\xee\xff" + bytes(1078), 2368, "Hesai's ROS driver"),
        "RoboSense": (b"\x55\xaa\x05\x0a\x5a\xa5\x50\xa0" + bytes(1240), 6699, "rslidar_sdk"),
        "Livox": (bytes(1362), 56301, "livox_ros_driver2"),
    }
    for sender, (data, port, help) in cases.items():
        rooms.pcap(tmp_path / "a.pcap", [(rooms.START, rooms.udp(data, port, port))] * 3)
        with pytest.raises(NotALog, match=rf"packets of a lidar by {sender}; try\n(.|\n)*{help[4:]}"):
            read(path, still=True)
    rooms.pcap(tmp_path / "a.pcap", [(rooms.START, rooms.udp(b"GET / HTTP/1.1", 80, 80))])
    with pytest.raises(NotALog, match="recorded network traffic without packets of a lidar"):
        read(path, still=True)


def test_a_cut_off_pcap_is_read_up_to_there_and_said(tmp_path: Path) -> None:
    pytest.importorskip("velodyne_decoder", reason="no velodyne-decoder: no packets can be decoded")
    path = rooms.pcap(tmp_path / "a.pcap", frames_of(still))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - 700])
    with pytest.raises(ValueError, match=r"a\.pcap: cut off at byte \d+, expected a whole packet"):
        list(read(path, still=True))
    log = read(path, still=True, keep_going=True)
    assert sum(map(len, log)) > 20_000 and "ends that cannot be read" in log.skipped


# --- Bags -------------------------------------------------------------------------------------------


def test_clouds_of_foxglove_packed_by_protobuf_give_its_scans(tmp_path: Path) -> None:
    path = rooms.foxglove_mcap(tmp_path / "a.mcap", SCANS)
    log = read(path)
    assert_same(list(log), SCANS, 1e-5)
    np.testing.assert_allclose([scan.stamp for scan in log], [one.stamp for one in SCANS], rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_clouds_before_pointcloud2_give_its_scans(kind: str, tmp_path: Path) -> None:
    path = rooms.bag_of_old_clouds(tmp_path / "bag", SCANS, kind)
    log = read(path)
    assert "PointCloud in" in log.uses
    assert_same(list(log), SCANS, 1e-5)
    np.testing.assert_allclose([scan.stamp for scan in log], [one.stamp for one in SCANS], rtol=0, atol=1e-6)
