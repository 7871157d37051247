# SPDX-License-Identifier: BSD-3-Clause
"""Folders of depth images: each pixel with a depth is the point that projects to it, and no other is said."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ndtree.logs import read
from ndtree.logs.folders.depth_image import Camera, camera_of, points_of
from ndtree.tuning.inspection import inspect

Image = pytest.importorskip("PIL.Image", reason="no Pillow: no PNG can be written")
rotations = pytest.importorskip("scipy.spatial.transform", reason="no SciPy: no rotations").Rotation

SHAPE = (12, 16)  # rows, columns


def depth_image(seed: int, high: int = 60000) -> np.ndarray:
    random = np.random.default_rng(seed)
    image = random.integers(1, high, SHAPE).astype(np.uint16)
    image[random.random(SHAPE) < 0.2] = 0
    return image


def pose_matrix(seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = rotations.random(None, random).as_matrix()
    matrix[:3, 3] = random.normal(size=3)
    return matrix


def save_png(path: Path, image: np.ndarray) -> None:
    Image.fromarray(image).save(path)


def seven_scenes(folder: Path, frames: int = 3) -> Path:
    for i in range(frames):
        image = depth_image(i)
        image[0, 0] = 65535
        save_png(folder / f"frame-{i:06d}.depth.png", image)
        np.savetxt(folder / f"frame-{i:06d}.pose.txt", pose_matrix(i))
    return folder


STAMPS = (100.0, 100.5, 101.0)


def tum(folder: Path) -> Path:
    (folder / "depth").mkdir()
    lines = ["# depth maps", "# timestamp filename"]
    for i, stamp in enumerate(STAMPS):
        save_png(folder / "depth" / f"{stamp:.6f}.png", depth_image(i))
        lines.append(f"{stamp:.6f} depth/{stamp:.6f}.png")
    (folder / "depth.txt").write_text("\n".join(lines) + "\n")
    # A straight way along x, turning about z with constant speed.
    truth = ["# timestamp tx ty tz qx qy qz qw"]
    for t in np.arange(99.0, 103.0, 1.0):
        x, y, z, w = rotations.from_rotvec([0, 0, 0.3 * (t - 100)]).as_quat()
        truth.append(f"{t} {2 * (t - 100)} 0.5 0.25 {x} {y} {z} {w}")
    (folder / "groundtruth.txt").write_text("\n".join(truth) + "\n")
    return folder


def measured_pixels(
    endpoints: np.ndarray, T_map_camera: np.ndarray, camera: Camera
) -> dict[tuple[int, int], float]:
    """The oracle: projects end points into the camera's image; row and column, and image value there."""
    in_camera = (endpoints - T_map_camera[:3, 3]) @ T_map_camera[:3, :3]
    u = camera.fx * in_camera[:, 0] / in_camera[:, 2] + camera.cx
    v = camera.fy * in_camera[:, 1] / in_camera[:, 2] + camera.cy
    assert np.abs(u - u.round()).max() < 1e-6 and np.abs(v - v.round()).max() < 1e-6
    return dict(zip(zip(v.round().astype(int), u.round().astype(int)), in_camera[:, 2] * camera.scale))


# --- What is read -----------------------------------------------------------------------------------


@pytest.mark.parametrize("stride", [1, 2, 3, 5])
def test_end_points_of_7_scenes_project_to_their_pixels(tmp_path: Path, stride: int) -> None:
    log = read(seven_scenes(tmp_path), pixel_stride=stride)
    assert (log.format, log.dim, len(log)) == ("seven_scenes", 3, 3)
    for i, scan in enumerate(log):
        image = depth_image(i)
        image[0, 0] = 0
        first = stride // 2
        kept = np.zeros(SHAPE, dtype=bool)
        kept[first::stride, first::stride] = True
        expected = {(v, u): float(image[v, u]) for v, u in zip(*np.nonzero((image > 0) & kept))}
        found = measured_pixels(scan.endpoints, pose_matrix(i), Camera(585, 585, 320, 240, 1000))
        assert found.keys() == expected.keys() and len(expected) > 2
        np.testing.assert_allclose([found[key] for key in expected], list(expected.values()), rtol=1e-9)
        np.testing.assert_allclose(scan.origin, pose_matrix(i)[:3, 3], atol=1e-12)
        assert scan.returned is None


def test_the_camera_of_7_scenes_is_the_one_said_then_the_one_in_the_folder(tmp_path: Path) -> None:
    seven_scenes(tmp_path, 1)
    np.savetxt(tmp_path / "camera-intrinsics.txt", [[500, 0, 7], [0, 400, 5], [0, 0, 1]])
    said_and_used = [(None, Camera(500, 400, 7, 5, 1000)), ("50,40,8,6,2000", Camera(50, 40, 8, 6, 2000))]
    for said, camera in said_and_used:
        (scan,) = read(tmp_path, camera=said)
        measured = measured_pixels(scan.endpoints, pose_matrix(0), camera)
        assert measured[(5, 5)] == pytest.approx(depth_image(0)[5, 5])
    (tmp_path / "camera-intrinsics.txt").write_text("500 0 7")
    with pytest.raises(ValueError, match=r"camera-intrinsics.txt: expected a camera's 3x3 matrix"):
        read(tmp_path)


@pytest.mark.parametrize("offset", [0.0, -0.25])
def test_tum_images_get_the_pose_of_their_time(tmp_path: Path, offset: float) -> None:
    log = read(tum(tmp_path), time_offset=offset)
    assert (log.format, len(log)) == ("tum_rgbd", 3)
    for i, scan in enumerate(log):
        since = STAMPS[i] + offset - 100
        T = np.eye(4)
        T[:3, :3] = rotations.from_rotvec([0, 0, 0.3 * since]).as_matrix()
        T[:3, 3] = (2 * since, 0.5, 0.25)
        image = depth_image(i)
        found = measured_pixels(scan.endpoints, T, Camera(525, 525, 319.5, 239.5, 5000))
        assert found.keys() == set(zip(*np.nonzero(image)))
        np.testing.assert_allclose([found[key] for key in found], [image[key] for key in found], rtol=1e-6)
        np.testing.assert_allclose(scan.origin, T[:3, 3], atol=1e-9)
        assert scan.stamp == STAMPS[i]


@pytest.mark.parametrize("make, scale", [(seven_scenes, 1000), (tum, 5000)])
def test_what_is_assumed_of_a_camera_is_said(make: Make, scale: int, tmp_path: Path) -> None:
    folder = make(tmp_path)
    (note,) = read(folder).notes
    assert note.startswith("the camera is taken as") and f",{scale}; " in note
    (note,) = read(folder, camera="500,500,3,2").notes
    assert note.startswith(f"depths are taken as {scale} a metre")
    assert not read(folder, camera="500,500,3,2,1000").notes


def test_tum_takes_another_trajectory(tmp_path: Path) -> None:
    tum(tmp_path)
    other = tmp_path / "slam.txt"
    other.write_text("99 1 2 3 0 0 0 1\n102 1 2 3 0 0 0 1\n")
    for scan in read(tmp_path, trajectory=str(other)):
        np.testing.assert_allclose(scan.origin, [1, 2, 3])
    (tmp_path / "groundtruth.txt").unlink()
    with pytest.raises(FileNotFoundError, match=r"groundtruth\.txt"):
        list(read(tmp_path))


def counted(folder: Path, listed: str) -> Path:
    """As ICL-NUIM: poses with times 1, 2, 3, images with numbers from 0."""
    (folder / "depth").mkdir()
    for i in range(4):
        save_png(folder / "depth" / f"{i}.png", depth_image(i))
    poses = [f"{i} {i} 0 0 0 0 0 1\n" for i in range(1, 4)]
    (folder / "room.gt.freiburg").write_text("".join(poses))
    if listed:
        lines = [listed.format(i) for i in range(4)]
        (folder / "associations.txt").write_text("\n".join(lines))
    return folder


@pytest.mark.parametrize(
    "listed", ["", "{0} depth/{0}.png {0} rgb/{0}.png", "{0}.0 ./rgb/{0}.png {0} depth/{0}.png"]
)
def test_times_that_are_numbers_of_images_find_their_poses(listed: str, tmp_path: Path) -> None:
    log = read(counted(tmp_path, listed))
    assert [scan.origin[0] for scan in log] == [1, 2, 3]
    assert "that of ICL-NUIM: 481.2,-480,319.5,239.5,5000" in log.notes[0]
    said = read(tmp_path, camera="481.2,-480,319.5,239.5,5000")
    assert all(np.array_equal(one.endpoints, other.endpoints) for one, other in zip(log, said))
    assert log.skipped["scans without a pose"].count == 1


def test_a_list_says_other_times_than_the_names(tmp_path: Path) -> None:
    folder = counted(tmp_path, "{0} depth/{0}.png")
    (folder / "associations.txt").write_text("".join(f"{3 - i}.25 depth/{i}.png\n" for i in range(4)))
    assert [scan.origin[0] for scan in read(folder)] == [2.25, 1.25]


def test_a_negative_focal_length_turns_the_image_over() -> None:
    image = depth_image(1).astype(np.float64)
    upright = points_of(image, Camera(10, 10, 8, 5.5))
    over = points_of(image, Camera(10, -10, 8, 5.5))
    np.testing.assert_array_equal(over, upright * [1, -1, 1])


@pytest.mark.parametrize("make", [seven_scenes, tum])
def test_the_noise_of_a_depth_camera_is_chosen_as_for_bags(
    make: Callable[[Path], Path], tmp_path: Path
) -> None:
    """Where images do not show it, that of such cameras: it grows with the squared range."""
    config = inspect(read(make(tmp_path)))
    assert config.options["range_sigma"] == 0.005 and config.options["range_sigma_quadratic"] == 0.0015
    assert any(line.startswith("chosen: ") and "range_sigma_quadratic" in line for line in config.notes)


def test_floats_are_metres_and_what_is_not_finite_is_no_depth() -> None:
    image = np.array([[1.5, np.nan, np.inf], [0.0, -1.0, 2.0]], dtype=np.float32)
    points = points_of(image, Camera(2, 4, 1, 1))
    np.testing.assert_allclose(points, [[-0.75, -0.375, 1.5], [1.0, 0.0, 2.0]])


# --- What is refused --------------------------------------------------------------------------------


Make = Callable[[Path], Path]


def without_pose(folder: Path) -> Path:
    (seven_scenes(folder) / "frame-000001.pose.txt").unlink()
    return folder


def rewritten(name: str, content: bytes, make: Make = seven_scenes) -> Make:
    def write(folder: Path) -> Path:
        (make(folder) / name).write_bytes(content)
        return folder

    return write


def other_image(mode: str) -> Make:
    def write(folder: Path) -> Path:
        Image.new(mode, (4, 4)).save(seven_scenes(folder) / "frame-000001.depth.png")
        return folder

    return write


def cut(folder: Path) -> Path:
    path = seven_scenes(folder) / "frame-000001.depth.png"
    path.write_bytes(path.read_bytes()[:120])
    return folder


def bad_checksum(folder: Path) -> Path:
    header = struct.pack(">II5B", 4, 4, 16, 0, 0, 0, 0)
    chunk = struct.pack(">I", len(header)) + b"IHDR" + header + struct.pack(">I", zlib.crc32(header))
    return rewritten("frame-000001.depth.png", b"\x89PNG\r\n\x1a\n" + chunk)(folder)


POSE = "frame-000001.pose.txt"
DEPTH = "frame-000001.depth.png"
BROKEN: dict[str, tuple[Make, str]] = {
    "no pose": (without_pose, f"{POSE}"),
    "pose of 3 numbers": (rewritten(POSE, b"1 2 3"), f"{POSE}: found 3 numbers, expected a matrix of 3x4 or"),
    "pose of words": (rewritten(POSE, b"1 2 x"), f"{POSE}: line 1: found '1 2 x', expected only numbers"),
    "no rotation": (rewritten(POSE, b"2 " * 12), f"{POSE}: .* is not a rotation"),
    "not finite": (rewritten(POSE, b"-inf " * 16), f"{POSE}: the pose is not finite"),
    "last row": (rewritten(POSE, b"1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1"), f"{POSE}: the last row is"),
    "cut off": (cut, f"{DEPTH}: the PNG is damaged"),
    "bad checksum": (bad_checksum, f"{DEPTH}: (not a PNG|the PNG is damaged)"),
    "garbage": (rewritten(DEPTH, b"\0rubbish" * 40), f"{DEPTH}: not a PNG, expected a PNG of one channel"),
    "empty": (rewritten(DEPTH, b""), f"{DEPTH}: not a PNG"),
    "8 bits": (other_image("L"), f"{DEPTH}: found an image of mode L, expected a PNG of one chan"),
    "colours": (other_image("RGB"), f"{DEPTH}: found an image of mode RGB"),
    "list of words": (rewritten("depth.txt", b"now a.png\n", tum), "depth.txt: line 1: found 'now a"),
    "list of times": (rewritten("depth.txt", b"# t\n1.0\n", tum), "depth.txt: line 2: found '1.0', exp"),
    "empty list": (rewritten("depth.txt", b"# t\n", tum), "depth.txt: no images, expected a line each"),
    "missing image": (rewritten("depth.txt", b"100 depth/no.png\n", tum), "depth/no.png"),
    "image too early": (rewritten("depth.txt", b"9 a.png\n", tum), "groundtruth.txt: no pose at 9.000000 s"),
    "cut trajectory": (rewritten("groundtruth.txt", b"99 0 0", tum), "groundtruth.txt: line 1: found 3"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_folders_are_named_with_file_and_expectation(case: str, tmp_path: Path) -> None:
    make, message = BROKEN[case]
    folder = make(tmp_path)
    with pytest.raises((ValueError, FileNotFoundError), match=message) as caught:
        list(read(folder))
    assert str(folder) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("case, kind", [("no pose", "scans without a pose"), ("cut off", "damaged scans")])
def test_damaged_frames_can_be_passed_over(case: str, kind: str, tmp_path: Path) -> None:
    log = read(BROKEN[case][0](tmp_path), keep_going=True)
    assert len(list(log)) == 2
    assert log.skipped.keys() == {kind} and log.skipped[kind].count == 1


@pytest.mark.parametrize(
    "options, message",
    [
        ({"camera": "1,2,3"}, "camera = '1,2,3': expected fx,fy,cx,cy or fx,fy,cx,cy,scale"),
        ({"camera": "a,b,c,d"}, "camera = 'a,b,c,d': expected"),
        ({"camera": "0,1,2,3"}, "fx = 0 of the camera: must be > 0"),
        ({"camera": "1,0,2,3"}, "fy = 0 of the camera: must be not 0 and finite"),
        ({"camera": "-1,1,2,3"}, "fx = -1 of the camera: must be > 0"),
        ({"camera": "1,1,nan,3"}, "cx = nan of the camera: must be finite"),
        ({"camera": "1,1,2,3,-5"}, "scale = -5 of the camera: must be > 0"),
        ({"pixel_stride": 0}, "pixel_stride = 0: must be a whole number >= 1"),
        ({"dim": 2}, "a 7-Scenes folder is 3-D, expected dim=3"),
    ],
)
def test_wrong_options_are_refused(options: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        read(seven_scenes(tmp_path), **options)


def test_options_of_other_formats_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="time_offset: a 7-Scenes folder takes no such option"):
        read(seven_scenes(tmp_path), time_offset=1.0)


def test_a_camera_can_have_a_scale_of_its_own() -> None:
    assert camera_of("1,2,3,4", scale=7) == Camera(1, 2, 3, 4, 7)
    assert camera_of("1,2,3,4,5", scale=7) == Camera(1, 2, 3, 4, 5)
