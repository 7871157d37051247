# SPDX-License-Identifier: BSD-3-Clause
"""Structure from motion: COLMAP, Bundler and BAL say the same of one world, and how sure each range is."""

from __future__ import annotations

import bz2
import gzip
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import ndtree
from ndtree.logs import read
from ndtree.logs.sfm.triangulation import Triangulation

rotations = pytest.importorskip("scipy.spatial.transform", reason="no SciPy: no rotations").Rotation


@dataclass
class World:
    """Cameras that look at points, and which sees which; rotations are from the world to the camera."""

    points: np.ndarray
    turns: list
    translations: np.ndarray
    focal_lengths: np.ndarray
    sees: np.ndarray  # (cameras, points)

    @property
    def centers(self) -> np.ndarray:
        return np.array([-r.inv().apply(t) for r, t in zip(self.turns, self.translations)])


def world(cameras: int = 5, points: int = 40, seed: int = 1) -> World:
    random = np.random.default_rng(seed)
    sees = random.random((cameras, points)) < 0.7
    sees[:, 0] = False
    sees[0, 0] = True  # One image alone sees point 0, and none point 1.
    sees[:, 1] = False
    return World(
        random.uniform(-3, 3, (points, 3)) + np.array([0, 0, 10]),
        list(rotations.random(cameras, random)),
        random.normal(size=(cameras, 3)),
        random.uniform(300, 900, cameras),
        sees,
    )


# --- Writers, by the formats' descriptions ----------------------------------------------------------


def point_name(k: int) -> int:
    """Names in COLMAP's files are neither in order nor without gaps."""
    return 1000 - 7 * k


def observed(w: World, i: int) -> list[tuple[float, float, int]]:
    """Features of an image: some without a point, and one point found twice."""
    seen = [(1.5 * k, 2.5 * k, point_name(k)) for k in np.flatnonzero(w.sees[i])]
    return [(0.5, 0.5, -1), *seen, seen[-1]] if seen else []


def track(w: World, k: int) -> list[tuple[int, int]]:
    """Images that see a point, and the features that are it."""
    return [
        (i + 3, feature)
        for i in range(len(w.turns))
        for feature, (_, _, name) in enumerate(observed(w, i))
        if name == point_name(k)
    ]


def colmap_text(folder: Path, w: World) -> Path:
    cameras = [
        "# cameras",
        *(f"{9 - i} SIMPLE_RADIAL 640 480 {f!r} 320 240 0.1" for i, f in enumerate(lengths(w))),
    ]
    (folder / "cameras.txt").write_text("\n".join(cameras) + "\n")
    lines = ["# images"]
    for i, (turn, t) in enumerate(zip(w.turns, w.translations)):
        x, y, z, qw = turn.as_quat().tolist()
        a, b, c = t.tolist()
        lines.append(f"{i + 3} {qw!r} {x!r} {y!r} {z!r} {a!r} {b!r} {c!r} {9 - i} name of {i}.jpg")
        lines.append(" ".join(f"{u} {v} {k}" for u, v, k in observed(w, i)))
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    lines = []
    for k, (x, y, z) in enumerate(w.points.tolist()):
        pairs = " ".join(f"{image} {feature}" for image, feature in track(w, k))
        lines.append(f"{point_name(k)} {x!r} {y!r} {z!r} 1 2 3 0.5 {pairs}")
    (folder / "points3D.txt").write_text("# points\n" + "\n".join(lines) + "\n")
    return folder


def colmap_binary(folder: Path, w: World) -> Path:
    cameras = struct.pack("<Q", len(w.turns))
    images = struct.pack("<Q", len(w.turns))
    for i, (turn, t, f) in enumerate(zip(w.turns, w.translations, lengths(w))):
        cameras += struct.pack("<IiQQ4d", 9 - i, 1, 640, 480, f - 10, f + 10, 320, 240)
        x, y, z, qw = turn.as_quat()
        images += struct.pack("<I7dI", i + 3, qw, x, y, z, *t, 9 - i) + f"image {i}.jpg".encode() + b"\0"
        features = observed(w, i)
        images += struct.pack("<Q", len(features)) + b"".join(struct.pack("<ddq", *one) for one in features)
    points = struct.pack("<Q", len(w.points))
    for k, point in enumerate(w.points):
        pairs = track(w, k)
        points += struct.pack("<Q3d3BdQ", point_name(k), *point, 1, 2, 3, 0.5, len(pairs))
        points += b"".join(struct.pack("<II", *one) for one in pairs)
    for name, content in (("cameras", cameras), ("images", images), ("points3D", points)):
        (folder / f"{name}.bin").write_bytes(content)
    return folder


def bundler(folder: Path, w: World) -> Path:
    """With a camera that was not registered in the first place."""
    lines = ["# Bundle file v0.3", f"{len(w.turns) + 1} {len(w.points)}", *["0 0 0"] * 5]
    for turn, t, f in zip(w.turns, w.translations, lengths(w)):
        lines += [f"{f!r} 0.01 0.02", *(row(values) for values in turn.as_matrix()), row(t)]
    for k, point in enumerate(w.points):
        views = np.flatnonzero(w.sees[:, k])
        lines += [
            row(point),
            "255 0 128",
            " ".join([str(len(views)), *(f"{i + 1} 7 1.5 -2.5" for i in views)]),
        ]
    path = folder / "bundle.out"
    path.write_text("\n".join(lines) + "\n")
    return path


def bal(folder: Path, w: World) -> Path:
    seen = np.argwhere(w.sees.T)
    lines = [f"{len(w.turns)} {len(w.points)} {len(seen)}", *(f"{i} {k}     1.5e+00 -2.5" for k, i in seen)]
    for turn, t, f in zip(w.turns, w.translations, lengths(w)):
        lines += [repr(float(value)) for value in (*turn.as_rotvec(), *t, f, 0.01, 0.02)]
    lines += [repr(float(value)) for value in w.points.ravel()]
    path = folder / "problem.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


def bal_bz2(folder: Path, w: World) -> Path:
    path = bal(folder, w)
    path.write_bytes(bz2.compress(path.read_bytes()))
    return path


def bal_gzip(folder: Path, w: World) -> Path:
    path = bal(folder, w)
    path.write_bytes(gzip.compress(path.read_bytes()))
    return path


def row(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


def lengths(w: World) -> list[float]:
    return w.focal_lengths.tolist()


WRITERS: dict[Callable[[Path, World], Path], str] = {
    colmap_text: "colmap", colmap_binary: "colmap", bundler: "bundler", bal: "bal", bal_gzip: "bal",
    bal_bz2: "bal",
}  # fmt: skip


# --- What is read -----------------------------------------------------------------------------------


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_each_observation_is_a_beam_from_its_camera(
    write: Callable[[Path, World], Path], tmp_path: Path
) -> None:
    w = world()
    w.sees[3] = False  # An image without features.
    log = read(write(tmp_path, w), pixel_sigma=0.01)
    assert (log.format, log.dim, len(log)) == (WRITERS[write], 3, 5)
    assert "the model's own unit" in log.notes[0]
    useful = w.sees.sum(axis=0) >= 2
    beams = 0
    for scan, center, sees in zip(log, w.centers, w.sees):
        np.testing.assert_allclose(scan.origin, center, atol=1e-12)
        expected = w.points[sees & useful]
        assert scan.returned is None and scan.range_sigma.shape == (len(scan),)
        order, other = np.lexsort(scan.endpoints.T), np.lexsort(expected.T)
        np.testing.assert_allclose(scan.endpoints[order], expected[other], atol=1e-12)
        beams += len(scan)
    assert beams > 80
    assert [len(scan) for scan in log] == [len(scan) for scan in log], "a log can be read again"


def test_all_formats_say_the_same_sigmas(tmp_path: Path) -> None:
    w = world()
    sigmas = []
    for write in WRITERS:
        folder = tmp_path / write.__name__
        folder.mkdir()
        scans = read(write(folder, w), pixel_sigma=0.5)
        sigmas.append([scan.range_sigma[np.lexsort(np.round(scan.endpoints, 6).T)] for scan in scans])
    for other in sigmas[1:]:
        assert len(other) == 5
        for a, b in zip(sigmas[0], other):
            np.testing.assert_allclose(a, b, rtol=1e-6)


def test_the_binary_model_comes_first(tmp_path: Path) -> None:
    colmap_text(colmap_binary(tmp_path, world(3)), world(4))
    assert len(read(tmp_path)) == 3


def test_beams_reach_the_map_with_their_sigmas(tmp_path: Path) -> None:
    seen = []

    class Target:
        def insert(self, endpoints, origin, *, range_sigma, **options):
            seen.append(range_sigma)

    for scan in read(bal(tmp_path, world())):
        scan.insert_into(Target())
    assert len(seen) == 5 and all((sigma > 0).all() for sigma in seen)


# --- How sure a range is ----------------------------------------------------------------------------


def sigma_of(points: np.ndarray, centers: np.ndarray, focal: float = 500.0, pixel: float = 1.0) -> np.ndarray:
    """(cameras, points) with all cameras seeing all points."""
    rows = np.arange(len(points))
    triangulation = Triangulation(np.asarray(points, dtype=float), pixel)
    for center in centers:
        triangulation.observe(rows, np.asarray(center, dtype=float), focal)
    return np.array([triangulation.range_sigma(rows, np.asarray(c, dtype=float), focal) for c in centers])


@pytest.mark.parametrize("parallax", [0.001, 0.01, 0.1, 0.5, 1.2])
@pytest.mark.parametrize("second", [0.5, 1.0, 3.0])
def test_two_images_give_the_triangle_s_error(parallax: float, second: float) -> None:
    r, f = 4.0, 500.0
    centers = [(-r, 0, 0), (-second * r * np.cos(parallax), second * r * np.sin(parallax), 0)]
    turned = rotations.from_rotvec([0.5, -1.1, 0.7]).apply(centers)  # Nothing stays along an axis.
    sigma = sigma_of([(0, 0, 0)], turned, f)[:, 0]
    one = (r / f) * np.hypot(second / np.sin(parallax), 1 / np.tan(parallax))
    assert sigma[0] == pytest.approx(max(one, r / f), rel=1e-5)


def test_sigma_is_the_spread_of_triangulations() -> None:
    """The oracle: least squares on features with noise, many times."""
    random = np.random.default_rng(4)
    f, point = 400.0, np.array([0.3, -0.2, 5.0])
    centers = np.array([[0, 0, 0], [0.5, 0, 0.1], [-0.3, 0.4, 0.3], [0.2, -0.6, -0.5]])
    way = point - centers
    ranges = np.linalg.norm(way, axis=1)
    rays = way / ranges[:, None]
    found = []
    for _ in range(4000):
        noisy = rays + random.normal(size=rays.shape) / f  # Across the ray; along it, normalising undoes it.
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        across = (np.eye(3) - noisy[:, :, None] * noisy[:, None, :]) / ranges[:, None, None] ** 2
        found.append(np.linalg.solve(across.sum(axis=0), (across @ centers[:, :, None]).sum(axis=0))[:, 0])
    sigma = sigma_of([point], centers, f)[:, 0]
    for ray, predicted in zip(rays, sigma):
        assert np.std((found - point) @ ray) == pytest.approx(predicted, rel=0.05)


@pytest.mark.parametrize(
    "centers",
    [[(0, 0, 0)], [(0, 0, 0), (0, 0, 1)], [(0, 0, 0), (0, 0, 0)], [(0, 0, 5), (0, 0, 0)]],
    ids=["one image", "one direction", "one place", "at the point"],
)
def test_a_range_without_parallax_is_not_known(centers: list) -> None:
    assert np.isinf(sigma_of([(0, 0, 5)], centers)).all()


def test_ranges_that_are_hardly_known_are_left_out_and_counted(tmp_path: Path) -> None:
    """Point 0 is seen by one image alone, point 3 is too far away for the baseline."""
    w = world()
    w.points[3] *= 300
    log = read(bundler(tmp_path, w))
    ends = [scan.endpoints for scan in log]
    assert not any((points == w.points[k]).all(axis=1).any() for points in ends for k in (0, 3))
    (noted,) = log.skipped.values()
    assert 1 + w.sees[:, 3].sum() <= noted.count == w.sees.sum() - sum(map(len, ends))
    assert "image 1: " in noted.first
    list(log)
    assert next(iter(log.skipped.values())).count == noted.count, "not added up over loops"


# --- Libraries of others ----------------------------------------------------------------------------


def same_scans(log: ndtree.Log, other: ndtree.Log) -> int:
    """In any order of the images and points; the number of beams."""
    pairs = [sorted(one, key=lambda scan: tuple(scan.origin)) for one in (log, other)]
    assert len(pairs[0]) == len(pairs[1])
    beams = 0
    for a, b in zip(*pairs):
        np.testing.assert_allclose(a.origin, b.origin, atol=1e-5)
        order, there = (np.lexsort(np.round(scan.endpoints, 4).T) for scan in (a, b))
        np.testing.assert_allclose(a.endpoints[order], b.endpoints[there], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(a.range_sigma[order], b.range_sigma[there], rtol=1e-3)
        beams += len(a)
    return beams


def test_colmap_s_own_files_are_read(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="no pycolmap: COLMAP cannot write files itself")
    (tmp_path / "ours").mkdir()
    w = world()
    ours = read(colmap_text(tmp_path / "ours", w))
    model = pycolmap.Reconstruction(str(tmp_path / "ours"))
    for kind in ("binary", "text"):
        (tmp_path / kind).mkdir()
        getattr(model, f"write_{kind}")(str(tmp_path / kind))
        assert same_scans(read(tmp_path / kind), ours) > 80


# --- What is refused --------------------------------------------------------------------------------


def changed(write: Callable[[Path, World], Path], name: str, change: Callable[[bytes], bytes]) -> Callable:
    def make(folder: Path) -> Path:
        path = write(folder, world())
        file = path / name if path.is_dir() else path
        file.write_bytes(change(file.read_bytes()))
        return path

    return make


def replaced(old: str, new: str) -> Callable[[bytes], bytes]:
    def change(content: bytes) -> bytes:
        assert old.encode() in content
        return content.replace(old.encode(), new.encode(), 1)

    return change


def cut(share: float) -> Callable[[bytes], bytes]:
    return lambda content: content[: int(share * len(content))]


def line(number: int, new: str) -> Callable[[bytes], bytes]:
    def change(content: bytes) -> bytes:
        lines = content.split(b"\n")
        lines[number - 1] = new.encode()
        return b"\n".join(lines)

    return change


def camera_of_model(number: int) -> Callable[[bytes], bytes]:
    return lambda content: content[:12] + struct.pack("<i", number) + content[16:]


def first(count: int) -> Callable[[bytes], bytes]:
    """The first lines alone."""
    return lambda content: b"\n".join(content.split(b"\n")[:count])


Change = Callable[[bytes], bytes]
#: By the writer and the file that is changed: what errors say of the file after its name.
CHANGED: dict[tuple[Callable[[Path, World], Path], str], dict[str, tuple[Change, str]]] = {
    (colmap_text, "cameras.txt"): {
        "unknown model": (
            replaced("SIMPLE_RADIAL", "MAGIC"),
            "line 2: found model 'MAGIC', expected SIMPLE_PINHOLE, PINHOLE",
        ),
        "too few parameters": (
            replaced("SIMPLE_RADIAL", "OPENCV"),
            "line 2: found 4 parameters, OPENCV has 8",
        ),
        "camera of words": (line(3, "a b c"), "line 3: expected CAMERA_ID"),
        "no focal length": (
            line(2, "9 PINHOLE 640 480 0 100 320 240"),
            "line 2: found a focal length of 0 px, expected one > 0",
        ),
    },
    (colmap_text, "images.txt"): {
        "pose of words": (line(2, "1 a b c d 0 0 0 9 n.jpg"), "line 2: expected IMAGE_ID QW QX"),
        "no rotation": (line(2, "1 0 0 0 0.5 0 0 0 9 n.jpg"), "line 2: quaternion .* has length 0.5"),
        "pose not finite": (line(2, "1 1 0 0 0 nan 0 0 9 n.jpg"), "line 2: found a pose that is not finite"),
        "features of words": (line(3, "1 2 x"), "line 3: 3 fields"),
        "images cut off": (first(4), "after line 4: cut off, expected a line of X Y POINT3D_ID"),
    },
    (colmap_text, "points3D.txt"): {
        "point of words": (line(4, "1 2 x 3"), "line 4: expected POINT3D"),
        "point not finite": (line(4, "986 2 inf 3"), ".*is not finite"),
        "point twice": (line(4, "993 2 3 3"), "point 993 is there twice"),
    },
    (colmap_binary, "cameras.bin"): {
        "model 77": (camera_of_model(77), "camera 1 of 5: found model 77"),
        "more cameras": (lambda c: c + b"\0", "after camera 5 of 5: more by"),
    },
    (colmap_binary, "images.bin"): {
        "images.bin cut off": (cut(0.5), "image 3 of 5: the file is cut off"),
        "huge number of images": (
            lambda c: struct.pack("<Q", 1 << 60) + c[8:],
            r"\d+ bytes for 1152921504606846976 images, expected at least",
        ),
        "huge number of features": (
            lambda c: c[:84] + struct.pack("<Q", 1 << 50) + c[92:],
            "image 1 of 5: the file is cut off",
        ),
    },
    (bundler, ""): {
        "other version": (replaced("v0.3", "v0.4"), "line 1: found '# Bundle file v0.4', expec"),
        "bundle cut off": (first(50), "after line 50: cut off, expected point 7 of 40: its position"),
        "camera short": (line(8, "1 2"), "line 8: expected camera 2 of 6: f k1 k2"),
        "camera negative": (line(8, "-1 0 0"), ".*camera 2 of 6: a focal length of -1 px"),
        "camera no rotation": (line(9, "5 5 5"), "cameras: pose 0: .* is not a rotation"),
        "sizes of words": (line(2, "a b"), "line 2: expected the numbers of cameras and"),
        "views short": (line(35, "2 1 2 3 4"), "line 35: expected point 1 of 40: a number of v"),
        "view of no camera": (line(35, "1 6 2 3 4"), "line 35: expected point 1 of 40: cameras of 0 to"),
        "view of the blind": (line(35, "1 0 2 3 4"), "line 35: point 1 of 40: camera 0 has no f"),
    },
    (bal, ""): {
        "bal cut in observations": (first(20), "after line 20: cut off, expected more observ"),
        "bal with more": (lambda text: text + b"1\n", ".*found more numbers of cameras and points"),
        "bal of words": (line(9, "0 3 x 1"), "line 9: expected camera, point, x, y"),
        "bal camera": (line(9, "5 3 1 1"), "line 9: expected a camera of 0 to 4 and a point of 0 to 39"),
        "bal parameter": (lambda text: text[:-4] + b"x\n", ".*expected only numbers"),
        "bal not finite": (
            lambda text: b"\n".join([*text.split(b"\n")[:-2], b"nan"]),
            "number 164 of the cameras and points is not finite",
        ),
    },
    (bal_bz2, ""): {"bz2 cut off": (cut(0.8), "the bzip2 stream is cut off")},
}
BROKEN: dict[str, tuple[Callable[[Path], Path], str]] = {
    "camera missing": (
        changed(colmap_text, "cameras.txt", line(2, "")),
        r"images\.txt: line 2: camera 9 is not in .*cameras\.txt",
    ),
    "point missing": (
        changed(colmap_text, "points3D.txt", line(5, "")),
        r"images\.txt: line \d: point \d+ is not in .*points3D\.txt",
    ),
    **{
        case: (changed(write, name, change), f"{re.escape(name)}: {message}")
        for (write, name), cases in CHANGED.items()
        for case, (change, message) in cases.items()
    },
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_models_are_named_with_place_and_expectation(case: str, tmp_path: Path) -> None:
    make, message = BROKEN[case]
    path = make(tmp_path)
    with pytest.raises(ValueError, match=message) as caught:
        list(read(path))
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_images_before_the_damage_can_be_kept(tmp_path: Path) -> None:
    """What the lost images saw counts no longer."""
    log = read(BROKEN["images.bin cut off"][0](tmp_path), keep_going=True)
    assert len(list(log)) == 2 and log.skipped["damaged files"].count == 1


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("write", [colmap_text, bundler, bal], ids=lambda write: write.__name__)
def test_a_wrong_pixel_sigma_is_refused(write: Callable, value: float, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"pixel_sigma = .* px: must be > 0"):
        read(write(tmp_path, world()), pixel_sigma=value)


def test_a_log_packed_by_bzip2_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(bz2.compress(b"0 0 1 1\n0 0 2 2\n"))
    (scan,) = read(path)
    assert scan.endpoints.tolist() == [[1, 1], [2, 2]]
