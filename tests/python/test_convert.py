# SPDX-License-Identifier: BSD-3-Clause
"""Every format that maps are written in, read by somebody else's program, and maps from other programs."""

from __future__ import annotations

import importlib.util
import re
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import room_scan, with_room

import ndtree
from ndtree._lazy import install_of
from ndtree.maps import images
from ndtree.maps.open import open_map

BOX = 2.4  # The rooms are within [-BOX, BOX).


def room(dim: int, branching: int = 2, scans: int = 3) -> ndtree.AdaptiveMap:
    m = ndtree.AdaptiveMap(dim=dim, branching=branching, min_cell_size=0.1, max_cell_size=1.6)
    return with_room(m, scans, 500)


@pytest.fixture(scope="module")
def space() -> ndtree.AdaptiveMap:
    return room(3)


@pytest.fixture(scope="module")
def plane() -> ndtree.AdaptiveMap:
    return room(2)


def states(m: Any, cell_size: float = 0.1) -> np.ndarray:
    return m.to_grid([[-BOX] * m.dim, [BOX] * m.dim], cell_size)


def cells_of(m: Any, state: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres, sizes and probabilities."""
    leaves = m.leaves()
    chosen = leaves.state == state
    lower, size = leaves.lower[chosen], leaves.size[chosen]
    return lower + size[:, None] / 2, size, leaves.probability[chosen]


# --- OctoMap --------------------------------------------------------------------------------------


def test_octomap_files_become_maps_of_ours(tmp_path: Path, space: ndtree.AdaptiveMap) -> None:
    ndtree.convert(space, tmp_path / "room.bt", cell_size=0.3)
    ndtree.convert(tmp_path / "room.bt", tmp_path / "room.ndt")
    m = ndtree.load(tmp_path / "room.ndt")
    assert m.options["min_cell_size"] == 0.3
    np.testing.assert_array_equal(states(m, 0.3), states(space, 0.3))
    assert m.insert(*room_scan(3, 9)).returned == 300


# --- map_server -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["hall.yaml", "hall.pgm", "hall.png", "it's a #1.png"])
def test_images_are_read_by_others_and_back_cell_by_cell(
    tmp_path: Path, plane: ndtree.AdaptiveMap, name: str
) -> None:
    pil, yaml = pytest.importorskip("PIL.Image"), pytest.importorskip("yaml")
    ndtree.convert(plane, tmp_path / name, wall_depth=np.inf)
    target = (tmp_path / name).with_suffix(".yaml")
    image_suffix = ".png" if name.endswith(".png") else ".pgm"
    assert {file.suffix for file in tmp_path.iterdir()} == {".yaml", image_suffix}
    about = yaml.safe_load(target.read_text())
    assert about["image"] == Path(name).with_suffix(image_suffix).name
    assert (about["resolution"], about["free_thresh"], about["occupied_thresh"]) == (0.1, 0.196, 0.65)
    with pil.open(tmp_path / about["image"]) as image:
        assert image.mode == "L"
        grey = np.asarray(image)
    # Where map_server looks for a cell: row from the top, the origin at the lower left.
    x, y, _ = about["origin"]
    row, column = np.indices(grey.shape)
    points = np.stack([x + (column + 0.5) * 0.1, y + (len(grey) - 1 - row + 0.5) * 0.1], axis=-1)
    expected = np.array([205, 254, 0])[plane.state(points.reshape(-1, 2)) + 1]
    np.testing.assert_array_equal(grey.ravel(), expected)
    assert set(expected) == {0, 205, 254}
    again = open_map(target)
    assert not again.offset.any()
    np.testing.assert_array_equal(states(again.map), states(plane))


def write_image(folder: Path, pixels: np.ndarray, **entries: Any) -> Path:
    pil, _ = pytest.importorskip("PIL.Image"), pytest.importorskip("yaml")
    pil.fromarray(pixels).save(folder / "map.png")
    about = {"image": "map.png", "resolution": 0.5, "origin": [0, 0, 0], "negate": 0, **entries}
    lines = [f"{key}: {value}" for key, value in about.items() if value is not None]
    (folder / "map.yaml").write_text("\n".join(lines) + "\n")
    return folder / "map.yaml"


@pytest.mark.parametrize(
    "entries, expected",
    [
        ({}, [1, 1, -1, -1, 0, 0]),
        ({"mode": "scale"}, [1, 1, -1, -1, 0, 0]),
        ({"mode": "TRINARY"}, [1, 1, -1, -1, 0, 0]),  # In any case, as nav2 does.
        ({"negate": 1}, [0, 0, -1, 1, 1, 1]),
        ({"mode": "raw"}, [0, 0, 1, -1, -1, -1]),
        ({"occupied_thresh": 0.95, "free_thresh": 0.01}, [1, -1, -1, -1, -1, 0]),
        ({"occupied_thresh": 1.0, "free_thresh": 0.0}, [1, -1, -1, -1, -1, 0]),  # Reached, as in nav2.
        ({"origin": "[0, 0, 1.0e-17]"}, [1, 1, -1, -1, 0, 0]),  # It turns nothing.
    ],
)
def test_foreign_images_are_read_by_their_own_rules(
    tmp_path: Path, entries: dict[str, Any], expected: list[int]
) -> None:
    pixels = np.array([[0, 19, 100, 205, 206, 255]], dtype=np.uint8)
    opened = open_map(write_image(tmp_path, pixels, **entries))
    centres = np.array([[0.25 + 0.5 * i, 0.25] for i in range(6)])
    np.testing.assert_array_equal(opened.state(centres), expected)
    assert opened.cell_size == 0.5


def nav2_state(pixel: list[int], mode: str, has_alpha: bool) -> int:
    """The state of one pixel by nav2's map_io.cpp with the usual thresholds, line by line."""
    channels = pixel[:3]
    if mode == "trinary" and has_alpha:
        channels = pixel
    shade = sum(channels) / len(channels) / 255
    occupied = round(shade * 255) / 100 if mode == "raw" else 1 - shade
    if mode == "scale" and has_alpha and pixel[3] != 255:
        return -1
    if mode == "raw" and occupied > 1:
        return -1
    return 1 if occupied >= 0.65 else 0 if occupied <= 0.196 else -1


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
@pytest.mark.parametrize("kind", ["RGBA", "LA", "L with a transparent grey", "RGB", "P"])
def test_pixels_with_an_alpha_channel_are_read_as_nav2_does(tmp_path: Path, mode: str, kind: str) -> None:
    image_module = pytest.importorskip("PIL.Image")
    random = np.random.default_rng(4)
    pixels = random.choice([0, 1, 60, 64, 100, 128, 205, 254, 255], (40, 30, 4)).astype(np.uint8)
    pixels[:10, :, 3] = 255
    path = write_image(tmp_path, pixels, mode=mode)
    (picture,) = path.parent.glob("*.png")
    if kind == "LA":
        pixels[..., 1:3] = pixels[..., :1]
        image_module.fromarray(pixels[..., [0, 3]], "LA").save(picture)
    elif kind == "RGB":
        pixels[..., 3] = 255
        image_module.fromarray(pixels[..., :3], "RGB").save(picture)
    elif kind == "P":
        pixels[..., 1:3], pixels[..., 3] = pixels[..., :1], 255
        image_module.fromarray(pixels[..., 0], "L").convert("P").save(picture)
    elif kind != "RGBA":
        pixels[..., 1:3] = pixels[..., :1]
        pixels[..., 3] = np.where(pixels[..., 0] == 205, 0, 255)
        image_module.fromarray(pixels[..., 0], "L").save(picture, transparency=205)
    row, column = np.indices(pixels.shape[:2])
    points = np.stack([(column + 0.5) * 0.5, (len(pixels) - 1 - row + 0.5) * 0.5], axis=-1)
    expected = [nav2_state(one.tolist(), mode, kind not in ("RGB", "P")) for one in pixels.reshape(-1, 4)]
    assert len(set(expected)) == 3
    np.testing.assert_array_equal(open_map(path).state(points.reshape(-1, 2)), expected)


@pytest.mark.parametrize("size, origin", [(0.05, -0.025), (0.03, -15.1), (0.1, 1234.55), (0.05, -10.0249999)])
def test_moving_to_whole_pixels_loses_and_doubles_none(tmp_path: Path, size: float, origin: float) -> None:
    """Half a pixel away, too, where rounding of single cells would go to either side."""
    pixels = np.where(np.indices((37, 41)).sum(axis=0) % 2, 0, 254).astype(np.uint8)
    path = write_image(tmp_path, pixels, origin=f"[{origin}, {-origin}, 0]", resolution=size)
    leaves = open_map(path).resampled().leaves()
    states = leaves.state[leaves.observed]
    assert np.bincount(states).tolist() == [(37 * 41 + 1) // 2, 37 * 41 // 2]


def test_the_grey_of_unknown_that_is_free_is_counted(tmp_path: Path) -> None:
    pixels = np.array([[0, 205, 205, 254]], dtype=np.uint8)
    opened = open_map(write_image(tmp_path, pixels, free_thresh=0.25))
    assert opened.state(np.array([[0.75, 0.25]])).tolist() == [0]
    (note,) = opened.notes
    assert note.startswith("2 pixels of grey 205") and "0.196" in note
    assert not open_map(write_image(tmp_path, pixels, free_thresh=0.196)).notes
    assert not open_map(write_image(tmp_path, np.array([[0, 254]], dtype=np.uint8), free_thresh=0.25)).notes


def test_an_image_of_unknown_pixels_is_an_empty_map(tmp_path: Path) -> None:
    grey = np.full((3, 3), 205, dtype=np.uint8)
    ndtree.convert(write_image(tmp_path, grey, origin="[0.013, 0, 0]"), tmp_path / "map.ndt")
    assert ndtree.load(tmp_path / "map.ndt").stats().observed_leaves == 0
    assert open_map(tmp_path / "map.yaml").notes == ("no pixel is free or occupied: the map is empty",)


@pytest.mark.parametrize("mode, count", [("trinary", 0), ("scale", 3), ("raw", 2)])
def test_costs_between_the_thresholds_are_counted(mode: str, count: int, tmp_path: Path) -> None:
    """Of raw pixels those above 100 are unknown to nav2, too; those below 255 are of another mode's image."""
    pixels = np.array([[0, 30, 50, 100, 101, 200, 254, 255]], dtype=np.uint8)
    path = write_image(tmp_path, pixels, mode=mode, occupied_thresh=0.65, free_thresh=0.1)
    notes = open_map(path).notes
    assert [int(note.split()[0]) for note in notes if "in nav2 free" in note] == [count] * bool(count)
    assert [int(note.split()[0]) for note in notes if "its mode is" in note] == [3] * (mode == "raw")


def test_origins_between_pixels_are_kept_until_they_are_sampled(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    pixels = random.choice(np.array([0, 205, 254], dtype=np.uint8), (20, 30))
    path = write_image(tmp_path, pixels, origin="[-3.21, 4.56, 0.0]", resolution=0.2)
    opened = open_map(path)
    np.testing.assert_array_equal(opened.offset, [-3.21, 4.56])
    row, column = np.indices(pixels.shape)
    points = np.stack([-3.21 + (column + 0.5) * 0.2, 4.56 + (19 - row + 0.5) * 0.2], axis=-1)
    expected = np.array([1, -1, 0])[np.searchsorted([0, 205, 254], pixels)]
    np.testing.assert_array_equal(opened.state(points.reshape(-1, 2)), expected.ravel())
    ndtree.convert(path, tmp_path / "map.ndt")
    moved = points.reshape(-1, 2) + np.array([0.01, 0.04])  # To -3.2 and 4.6 m.
    np.testing.assert_array_equal(ndtree.load(tmp_path / "map.ndt").state(moved), expected.ravel())
    assert "(-3.21, 4.56) m is not a whole number of pixels of 0.2 m" in opened.moved_note
    assert "moved by (0.01, 0.04) m" in opened.moved_note
    sampled = opened.resampled(0.05)
    centres = np.random.default_rng(2).integers(-100, 200, (3000, 2)) * 0.05 + 0.025
    np.testing.assert_array_equal(sampled.state(centres), opened.state(centres))
    ndtree.convert(path, tmp_path / "map.npy", cell_size=0.05)
    assert np.load(tmp_path / "map.npy").shape == (120, 80)


@pytest.mark.parametrize(
    "entries, message",
    [
        ({"image": None}, "map.yaml: no 'image', expected the YAML"),
        ({"resolution": "wide"}, "map.yaml: resolution: found 'wide', expected a number"),
        ({"resolution": -0.1}, "map.yaml: resolution: found -0.1, expected metres a pixel"),
        ({"resolution": 1e-300}, "map.yaml: resolution: found 1e-300, expected metres a pixel"),
        ({"resolution": None}, "map.yaml: resolution: found nothing"),
        ({"occupied_thresh": 65}, "map.yaml: occupied_thresh: found 65, expected a probability, 0 to 1"),
        ({"free_thresh": -0.1}, "map.yaml: free_thresh: found -0.1, expected a probability, 0 to 1"),
        ({"free_thresh": 0.7}, "map.yaml: free_thresh: found 0.7, expected at most occupied_thresh = 0.65"),
        ({"origin": "[0, 0]"}, r"map.yaml: origin: found \[0, 0\], expected \[x, y, yaw\]"),
        ({"origin": None}, "map.yaml: origin: found None"),
        ({"origin": "[0, 0, 0.5]"}, "map.yaml: origin: found a yaw of 0.5"),
        ({"mode": "fuzzy"}, "map.yaml: mode: found 'fuzzy'"),
        ({"negate": "perhaps"}, "map.yaml: negate: found 'perhaps'"),
        ({"image": "map.yaml"}, "map.yaml: not an image"),
        ({"image": "none.png"}, "map.yaml: image: found 'none.png', expected a file"),
        (
            {"image": "/robot/map.png"},
            "map.yaml: image: found '/robot/map.png', expected map.png, which is b",
        ),
        ({"image": "maps\\\\map.png"}, "image: found .*, expected map.png, which is beside it"),
        ({"image": "'"}, "map.yaml: not YAML"),
    ],
)
def test_damaged_yaml_is_refused(tmp_path: Path, entries: dict[str, Any], message: str) -> None:
    path = write_image(tmp_path, np.zeros((2, 2), dtype=np.uint8), **entries)
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        open_map(path)


def test_large_images_are_read_without_a_warning_or_a_change_of_its_filters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pil, _ = pytest.importorskip("PIL.Image"), pytest.importorskip("yaml")
    path = write_image(tmp_path, np.full((30, 40), 254, dtype=np.uint8))
    monkeypatch.setattr(pil, "MAX_IMAGE_PIXELS", 700)  # Twice that is refused, less is warned of.
    with monkeypatch.context() as patched:
        patched.setattr(warnings, "catch_warnings", None)
        patched.setattr(warnings, "warn", None)
        assert open_map(path) is not None
    monkeypatch.setattr(images, "_MOST_PIXELS", 1199)
    with pytest.raises(ValueError, match=r"map\.png: an image of more than 1,199 pixels, expected fewer"):
        open_map(path)


def test_images_that_are_cut_off_or_too_deep_are_refused(tmp_path: Path) -> None:
    pil, _ = pytest.importorskip("PIL.Image"), pytest.importorskip("yaml")
    path = write_image(tmp_path, np.random.default_rng(0).integers(0, 255, (99, 99)).astype(np.uint8))
    png = (tmp_path / "map.png").read_bytes()
    (tmp_path / "map.png").write_bytes(png[: len(png) // 2])
    with pytest.raises(ValueError, match=r"map\.png: a damaged image"):
        open_map(path)
    pil.fromarray(np.full((4, 4), 9000, dtype=np.uint16)).save(tmp_path / "map.png")
    with pytest.raises(ValueError, match=r"map\.png: pixels of more than 8 bits"):
        open_map(path)


# --- Points and meshes ----------------------------------------------------------------------------


def test_ply_points_are_read_by_meshio(tmp_path: Path, space: ndtree.AdaptiveMap) -> None:
    meshio = pytest.importorskip("meshio")
    ndtree.convert(space, tmp_path / "room.ply", states=["occupied", "free"])
    read = meshio.read(tmp_path / "room.ply")
    found = {tuple(p): i for i, p in enumerate(read.points.tolist())}
    total = 0
    for state in (0, 1):
        for centre, size, probability in zip(*cells_of(space, state)):
            i = found[tuple(centre)]
            assert read.point_data["state"][i] == state
            assert read.point_data["size"][i] == np.float32(size)
            assert read.point_data["probability"][i] == probability
            total += 1
    assert total == len(read.points) > 1000


def test_pcd_is_read_by_another_library(tmp_path: Path, space: ndtree.AdaptiveMap) -> None:
    pypcd4 = pytest.importorskip("pypcd4")
    ndtree.convert(space, tmp_path / "room.pcd")
    cloud = pypcd4.PointCloud.from_path(tmp_path / "room.pcd").pc_data
    centre, size, probability = cells_of(space, 1)
    np.testing.assert_array_equal(np.column_stack([cloud[a] for a in "xyz"]), centre.astype(np.float32))
    np.testing.assert_array_equal(cloud["size"], size.astype(np.float32))
    np.testing.assert_array_equal(cloud["probability"], probability)
    assert (cloud["state"] == 1).all() and len(cloud) > 500
    assert b"SIZE 4 4 4 4 4 1\nTYPE F F F F F I\n" in (tmp_path / "room.pcd").read_bytes()[:400]


def fixed_room() -> ndtree.FixedMap:
    """Not about 0, so that no two axes look alike."""
    m = ndtree.FixedMap(dim=3, min_cell_size=0.2)
    points, origin = room_scan(3, 1, 400)
    shift = np.array([0.2, 0.6, -0.4])
    m.insert(points + shift, origin + shift)
    return m


def test_meshes_enclose_the_cells(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    m = fixed_room()
    occupied = m.to_grid([[-3.2] * 3, [3.2] * 3]) == 1
    expected = 0
    for axis in range(3):  # Faces between a cell of the set and one that is not.
        padded = np.pad(occupied, [(1, 1) if a == axis else (0, 0) for a in range(3)])
        expected += np.count_nonzero(np.diff(padded.astype(np.int8), axis=axis))
    volume = np.count_nonzero(occupied) * 0.2**3
    for name in ("mesh.ply", "mesh.glb", "mesh.gltf"):
        ndtree.convert(m, tmp_path / name, **({"faces": True} if name == "mesh.ply" else {}))
        mesh = trimesh.load(tmp_path / name, force="mesh")
        assert len(mesh.faces) == 2 * expected > 500
        assert mesh.volume == pytest.approx(volume, rel=1e-5)  # So all faces look outwards.
        centre, size, _ = cells_of(m, 1)
        low, high = (centre - size[:, None] / 2).min(axis=0), (centre + size[:, None] / 2).max(axis=0)
        if name != "mesh.ply":  # y upwards
            low, high = low[[0, 2, 1]] * [1, 1, -1], high[[0, 2, 1]] * [1, 1, -1]
            low, high = np.minimum(low, high), np.maximum(low, high)
        np.testing.assert_allclose(mesh.bounds, [low, high], atol=1e-6)
        assert len(np.unique(mesh.visual.vertex_colors, axis=0)) > 5


def test_meshes_of_cells_of_several_sizes_hide_what_is_covered(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    grid = np.full((4, 2, 2), -1)
    grid[:2] = 1  # One cell of 1 m, ...
    grid[2, 0, 0] = 1  # ... and one of 0.5 m at its side.
    m = ndtree.from_grid(grid, [0, 0, 0], 0.5)
    assert sorted(m.leaves().size[m.leaves().state == 1]) == [0.5, 1.0]
    ndtree.convert(m, tmp_path / "two.ply", faces=True)
    mesh = trimesh.load(tmp_path / "two.ply")
    # Six faces of the large one, which none covers as a whole; of the small one all but that on it.
    assert len(mesh.faces) == 2 * (6 + 5)
    at_border = np.isclose(mesh.triangles[:, :, 0], 1).all(axis=1)
    assert mesh.area_faces[at_border].sum() == pytest.approx(1)


def test_the_plane_becomes_quads_at_zero(tmp_path: Path, plane: ndtree.AdaptiveMap) -> None:
    trimesh = pytest.importorskip("trimesh")
    ndtree.convert(plane, tmp_path / "room.ply", faces=True, states=("occupied", "free"))
    mesh = trimesh.load(tmp_path / "room.ply")
    sizes = np.concatenate([cells_of(plane, 0)[1], cells_of(plane, 1)[1]])
    assert len(mesh.faces) == 2 * len(sizes)
    assert mesh.area == pytest.approx(np.sum(sizes**2))
    assert (mesh.vertices[:, 2] == 0).all() and (mesh.face_normals[:, 2] > 0).all()


# --- Arrays ---------------------------------------------------------------------------------------


def test_leaves_are_records_and_grids_dense(tmp_path: Path, space: ndtree.AdaptiveMap) -> None:
    ndtree.convert(space, tmp_path / "leaves.npz")
    with np.load(tmp_path / "leaves.npz") as file:
        records = file["leaves"]
        assert (file["branching"], file["min_cell_size"]) == (2, 0.1)
    leaves = space.leaves()
    known = leaves.state >= 0
    for name in ("lower", "size", "state", "hits", "misses", "probability"):
        np.testing.assert_allclose(records[name], getattr(leaves, name)[known], rtol=1e-6, atol=1e-12)
    ndtree.convert(space, tmp_path / "grid.npz", format="grid", cell_size=0.3)
    ndtree.convert(space, tmp_path / "grid.npy", cell_size=0.3)
    with np.load(tmp_path / "grid.npz") as file:
        grid, lower, size = file["states"], file["lower"], float(file["cell_size"])
    np.testing.assert_array_equal(np.load(tmp_path / "grid.npy"), grid)
    assert size == 0.3 and grid.dtype == np.int8
    np.testing.assert_array_equal(states(ndtree.from_grid(grid, lower, size), 0.3), states(space, 0.3))
    ndtree.convert(space, tmp_path / "own.npy")
    grid = np.load(tmp_path / "own.npy")
    for side in (grid[0], grid[-1], grid[:, 0], grid[:, -1], grid[..., 0], grid[..., -1]):
        assert (side >= 0).any()  # No larger than what is known.


@pytest.mark.parametrize(
    "box, options, message",
    [
        ([[0, 0, 0]], {}, r"box has shape \(1, 3\): must be \(2, 3\)"),
        ([[1, 0, 0], [0, 1, 1]], {}, "box: axis 0 is from 1.0"),
        ([[0, 0, 0], [1, 1, np.inf]], {}, "box: axis 2"),
        ([[0, 0, 0], [1, 1, 1]], {"cell_size": 0}, "cell_size = 0.0"),
        ([[0, 0, 0], [1, 1, 1]], {"cell_size": 1e-300}, "more cells than"),
        ([[0, 0, 0], [1, 1, 1]], {"values": "colour"}, "values = 'colour'"),
    ],
)
def test_grids_that_cannot_be_made_are_refused(
    space: ndtree.AdaptiveMap, box: Any, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        space.to_grid(box, **options)
    with pytest.raises(TypeError, match="whole numbers"):
        ndtree.from_grid(np.zeros((2, 2)), [0, 0], 0.1)


# --- ROS ------------------------------------------------------------------------------------------


def message_of(path: Path) -> tuple[str, Any]:
    """The one message in a bag, by the definitions in the bag itself."""
    highlevel = pytest.importorskip("rosbags.highlevel")
    if path.suffix == ".db3":  # Its definitions are not in the file.
        typesys = pytest.importorskip("rosbags.typesys")
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        text = "std_msgs/Header header\nbool binary\nstring id\nfloat64 resolution\nint8[] data\n"
        store.register(typesys.get_types_from_msg(text, "octomap_msgs/msg/Octomap"))
        reader = highlevel.AnyReader([path], default_typestore=store)
    else:
        reader = highlevel.AnyReader([path])
    with reader:
        ((connection, _, data),) = reader.messages()
        return connection.topic, reader.deserialize(data, connection.msgtype)


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_bags_hold_octomaps(tmp_path: Path, space: ndtree.AdaptiveMap, suffix: str) -> None:
    path = tmp_path / f"room{suffix}"
    pytest.importorskip("rosbags")
    ndtree.convert(space, path, cell_size=0.3)
    assert list(tmp_path.iterdir()) == [path]
    topic, message = message_of(path)
    assert (topic, message.id, message.binary, message.resolution) == ("/octomap_full", "OcTree", False, 0.3)
    assert message.header.frame_id == "map" and message.header.stamp.sec > 1e9
    # What octomap_msgs does: a file is a header and the message's data.
    data = message.data.tobytes()
    header = f"# Octomap OcTree file\nid OcTree\nsize {len(data) // 5}\nres {message.resolution}\ndata\n"
    (tmp_path / "again.ot").write_bytes(header.encode() + data)
    np.testing.assert_array_equal(states(ndtree.load_octomap(tmp_path / "again.ot"), 0.3), states(space, 0.3))


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_bags_hold_occupancy_grids(tmp_path: Path, space: ndtree.AdaptiveMap, suffix: str) -> None:
    pytest.importorskip("rosbags")
    ndtree.convert(space, tmp_path / f"slice{suffix}", height=(0.0, 0.5))
    topic, message = message_of(tmp_path / f"slice{suffix}")
    info = message.info
    assert topic == "/map" and info.resolution == np.float32(0.1)
    grid = message.data.reshape(info.height, info.width)
    assert set(np.unique(grid)) == {-1, 0, 100}
    found = ndtree.from_grid(
        np.where(grid == 100, 1, grid).T, [info.origin.position.x, info.origin.position.y], 0.1
    )
    np.testing.assert_array_equal(states(found), states(space)[:, :, 24:29].max(axis=2))
    assert info.origin.orientation.w == 1.0


@pytest.mark.parametrize("depth", [None, 0.15, np.inf])
def test_walls_of_grids_in_bags_are_as_thick_as_in_images(tmp_path: Path, depth: float | None) -> None:
    pytest.importorskip("rosbags")
    m = ndtree.AdaptiveMap(dim=2, range_sigma=0.01, range_sigma_quadratic=0.004)
    angles, rng = np.linspace(-0.5, 0.5, 400), np.random.default_rng(1)
    for y in np.linspace(-0.6, 0.6, 25):
        length = 8.0 / np.cos(angles)
        noisy = length + rng.normal(0, 1, 400) * (0.01 + 0.004 * length**2)
        m.insert([0.013, y] + np.c_[np.cos(angles), np.sin(angles)] * noisy[:, None], [0.013, y])
    ndtree.convert(m, tmp_path / "wall.mcap", wall_depth=depth)
    grid = message_of(tmp_path / "wall.mcap")[1].data
    pixels, *_ = m.map_server_image(wall_depth=0.02 + 0.05 if depth is None else depth)
    np.testing.assert_array_equal(
        grid, np.select([pixels[::-1] == 254, pixels[::-1] == 0], [0, 100], -1).ravel()
    )
    slab, *_ = m.map_server_image()
    is_thinner = np.count_nonzero(grid == 100) < 0.8 * np.count_nonzero(slab == 0)
    assert is_thinner == (depth != np.inf)


def test_bags_of_ros_2_are_latched(tmp_path: Path, plane: ndtree.AdaptiveMap) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    ndtree.convert(plane, tmp_path / "room.mcap")
    with rosbag2.Reader(tmp_path / "room.mcap") as bag:
        (connection,) = bag.connections
        (qos,) = connection.ext.offered_qos_profiles
    assert qos.durability.name == "TRANSIENT_LOCAL" and connection.topic == "/map"


# --- What is refused ------------------------------------------------------------------------------


def far_away() -> ndtree.FixedMap:
    return ndtree.from_grid(np.ones((2, 2, 2), dtype=int), [5e5, 4e6, 0], 0.1, refinement="fixed")


@pytest.mark.parametrize(
    "name, options, message",
    [
        ("a.txt", {}, "a.txt: no format has this ending, expected one of .ndt"),
        ("a", {}, "no format has this ending"),
        ("a.ply", {"format": "obj"}, "format = 'obj': must be one of ndtree"),
        ("a.ply", {"format": "pcd"}, "a.ply: format pcd writes .pcd"),
        ("a.ndt", {"cell_size": 0.2},
            r"cell_size: format ndtree \(.ndt\) takes no such option, it takes none"),
        ("a.ply", {"height": (0, 1)},
            r"height: format ply \(.ply\) takes no such option, it takes cell_size, states"),
        ("a.ply", {"cell_size": -1}, "cell_size = -1"),
        ("a.ndt", {"height": (0, 1)}, r"height: format ndtree \(.ndt\) takes no such option, it takes none"),
        ("a.pcd", {"faces": True}, "faces: format pcd"),
        ("a.ply", {"states": ["unknown"]}, r"states = \['unknown'\]: must be some of occupied"),
        ("a.ply", {"states": "occupied"}, "states = 'occupied': must be some of"),
        ("a.bt", {"cell_size": -1}, "cell_size = -1"),
        ("a.npy", {"cell_size": 0}, "cell_size = 0"),
        ("a.png", {"height": (1, 0)}, "from low to high"),
        ("a.mcap", {"height": (50, 60)}, "heights of observed cells"),
    ],
)  # fmt: skip
def test_wrong_calls_are_refused_and_write_nothing(
    tmp_path: Path, space: ndtree.AdaptiveMap, name: str, options: dict[str, Any], message: str
) -> None:
    for library in ("rosbags", "PIL", "pypcd4"):
        pytest.importorskip(library)
    with pytest.raises(ValueError, match=message):
        ndtree.convert(space, tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


def test_what_a_format_cannot_hold_is_refused(tmp_path: Path, plane: ndtree.AdaptiveMap) -> None:
    for library in ("pypcd4", "trimesh", "meshio", "rosbags"):
        pytest.importorskip(library)
    refused: list[tuple[Any, str, str]] = [
        (plane, "a.bt", "OctoMap has three dimensions"),
        (far_away(), "a.pcd", "coordinates up to 4000000 m: PCD has 24 bits"),
        (far_away(), "a.glb", "glTF has 24 bits"),
        (far_away(), "a.bt", "16 levels end"),
        (ndtree.AdaptiveMap(dim=3), "a.ply", "the map is empty"),
        (ndtree.AdaptiveMap(dim=3), "a.npy", "the map is empty"),
        (room(4, 2, 1), "a.ply", "dim = 4"),
        (room(4, 2, 1), "a.vtu", "dim = 4"),
        (room(4, 2, 1), "a.glb", "dim = 4"),
        (room(4, 2, 1), "a.mcap", "a 4-D map"),
    ]
    for m, name, message in refused:
        with pytest.raises(ValueError, match=message):
            ndtree.convert(m, tmp_path / name)
    ndtree.convert(far_away(), tmp_path / "far.ply")  # Doubles have room for them.
    assert [file.name for file in tmp_path.iterdir()] == ["far.ply"]
    with pytest.raises(FileNotFoundError):
        ndtree.convert(plane, tmp_path / "none" / "a.npz")


@pytest.mark.parametrize(
    "name, missing, extra",
    [
        ("a.png", "PIL", "convert"),
        ("a.glb", "trimesh", "convert"),
        ("a.pcd", "pypcd4", "convert"),
        ("a.vtu", "meshio", "convert"),
        ("a.bag", "rosbags", "ros"),
    ],
)
def test_a_missing_library_is_named_with_its_extra(
    tmp_path: Path,
    plane: ndtree.AdaptiveMap,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    missing: str,
    extra: str,
) -> None:
    for module in [module for module in sys.modules if module.split(".")[0] == missing]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ImportError, match=rf"(?s){missing}.*{re.escape(install_of(extra))}"):
        ndtree.convert(plane, tmp_path / name)
    assert not list(tmp_path.iterdir())


def of_all_cells(m: Any, cell_size: float) -> dict[tuple[int, ...], int]:
    """States of larger cells, from the map's leaves one by one: number along each axis to state."""
    found: dict[tuple[int, ...], int] = {}
    leaves = m.leaves(states=["free", "occupied"])
    for lower, size, state in zip(leaves.lower, leaves.size, leaves.state):
        first = np.floor(lower / cell_size + 1e-9).astype(int)
        last = np.ceil((lower + size) / cell_size - 1e-9).astype(int)
        for offset in np.ndindex(*(last - first)):
            at = tuple(int(i) for i in first + offset)
            found[at] = max(found.get(at, -1), int(state))
    return found


@pytest.mark.parametrize("cell_size", [0.2, 0.25, 0.32, 0.7])
@pytest.mark.parametrize("dim, branching", [(2, 2), (2, 3), (3, 2)])
def test_all_writers_make_larger_cells_by_one_rule(
    tmp_path: Path, dim: int, branching: int, cell_size: float
) -> None:
    m = room(dim, branching)
    expected = of_all_cells(m, cell_size)
    both = {"states": ["occupied", "free"], "cell_size": cell_size}

    def check(centres: np.ndarray, states: np.ndarray) -> None:
        at = np.floor(np.asarray(centres)[:, :dim] / cell_size).astype(int)
        found = {tuple(int(i) for i in one): int(state) for one, state in zip(at, states)}
        assert len(found) == len(at) and found == expected

    assert {0, 1} == set(expected.values())
    ndtree.convert(m, tmp_path / "a.npz", **both)
    with np.load(tmp_path / "a.npz") as file:
        leaves = file["leaves"]
        assert float(file["min_cell_size"]) == cell_size
    check(leaves["center"], leaves["state"])
    assert np.array_equal(leaves["probability"] > 0.5, leaves["state"] == 1)
    np.testing.assert_allclose(leaves["size"], cell_size)
    ndtree.convert(m, tmp_path / "a.ply", **both)
    record = np.dtype([("x", "<f8", 3), ("size", "<f4"), ("probability", "<f4"), ("state", "<i4")])
    data = np.frombuffer((tmp_path / "a.ply").read_bytes().partition(b"end_header\n")[2], record)
    check(data["x"], data["state"])
    ndtree.convert(m, tmp_path / "a.npy", cell_size=cell_size)
    assert int((np.load(tmp_path / "a.npy") == 1).sum()) == sum(s == 1 for s in expected.values())
    occupied = np.array([at for at, state in expected.items() if state == 1])
    for name, module in (("a.pcd", "pypcd4"), ("a.glb", "trimesh"), ("a.vtu", "meshio")):
        if importlib.util.find_spec(module) is None:
            continue
        ndtree.convert(m, tmp_path / name, states=["occupied"], cell_size=cell_size)
        if name == "a.vtu":
            import meshio

            assert len(meshio.read(tmp_path / name).cells[0].data) == len(occupied)
        elif name == "a.pcd":
            assert f"POINTS {len(occupied)}\n".encode() in (tmp_path / name).read_bytes()[:1000]
        else:
            import trimesh

            low, high = trimesh.load(tmp_path / name, force="mesh").bounds
            extent = (high - low)[[0, 2, 1]][:dim]
            spans = (occupied.max(axis=0) + 1 - occupied.min(axis=0)) * cell_size
            np.testing.assert_allclose(extent, spans, rtol=1e-5)


def test_points_carry_the_layers_of_their_cells(tmp_path: Path) -> None:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, layers={"color": "mean3"})
    ends = np.random.default_rng(2).uniform(-2, 2, (200, 2))
    m.insert(ends, [0.0, 0.0], layers={"color": np.full((200, 3), [10.0, 20.0, 30.0])})
    for states in (["occupied"], ["occupied", "free"]):
        ndtree.convert(m, tmp_path / "a.ply", states=states)
        m.save_ply(tmp_path / "b.ply", leaves=np.isin(m.leaves().state, [1, 0][: len(states)]))
        assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    assert b"uchar red" in (tmp_path / "a.ply").read_bytes()[:1000]


def test_coloured_octomaps_become_layers_and_back(tmp_path: Path) -> None:
    m = ndtree.AdaptiveMap(dim=3, min_cell_size=0.1, layers={"color": "mean3"})
    random = np.random.default_rng(3)
    colors = random.integers(0, 250, (300, 3))
    m.insert(random.uniform(-2, 2, (300, 3)), [0.0, 0.0, 0.0], layers={"color": colors})
    ndtree.convert(m, tmp_path / "a.ot")
    again = open_map(tmp_path / "a.ot").map
    centres = m.leaves(states=["occupied"]).center
    own = m.layer("color", centres)
    assert again.layers == {"color": "mean3"} and np.isfinite(own).sum() > 100
    np.testing.assert_allclose(again.layer("color", centres), own, atol=0.5)
