# SPDX-License-Identifier: BSD-3-Clause
"""Logs of every format say the same, and damaged ones say what is wrong, where, and what was expected."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import ndtree
from ndtree import logs
from ndtree.logs import FORMATS, READER_OPTIONS, Log, read
from ndtree.logs.core import joined

FLASER = "FLASER 3 1.0 2.0 81.9 0.5 0.25 0.0 0.5 0.25 0.0 12.5 host 12.5"


def arrays(dim: int = 3, scans: int = 4, beams: int = 5) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(3)
    return {
        "origins": generator.normal(size=(scans, dim)),
        "points": generator.normal(size=(scans * beams, dim)).astype(np.float32),
        "offsets": np.arange(scans + 1, dtype=np.int64) * beams,
        "no_return": generator.random(scans * beams) < 0.3,
        "stamps": np.arange(scans) * 0.1,
    }


def save(path: Path, **changes: np.ndarray | None) -> Path:
    content = {name: array for name, array in {**arrays(), **changes}.items() if array is not None}
    np.savez_compressed(path, **content)
    return path


# --- What is read -----------------------------------------------------------------------------------


def test_carmen_plain_and_packed_are_the_same(tmp_path: Path) -> None:
    text = f"# a comment\nPARAM laser_offset 0.0 host 0\n{FLASER}\nODOM 0 0 0 0 0 0 1 host 1\n{FLASER}\n"
    plain, packed = tmp_path / "a.log", tmp_path / "b"
    plain.write_text(text)
    packed.write_bytes(gzip.compress(text.encode()))
    for path in (plain, packed):
        log = read(path)
        assert (log.format, log.dim, log.path) == ("carmen", 2, str(path))
        scans = list(log)
        assert len(scans) == 2
        assert len(list(log)) == 2, "a log can be read again"
        np.testing.assert_allclose(scans[0].origin, [0.5, 0.25])
        np.testing.assert_allclose(scans[0].endpoints[0], [0.5, -0.75], atol=1e-12)
        np.testing.assert_array_equal(scans[0].returned, [True, True, False])
        assert scans[0].stamp == 12.5


@pytest.mark.parametrize(
    "params, beams, fov, degrees, note",
    [
        ("PARAM laser_front_laser_fov 240.0 nohost 0\n", 682, None, 240, None),
        ("PARAM laser_front_laser_fov 240.0 nohost 0\n", 682, 200.0, 200, None),
        ("", 682, None, 240, "field of view of 240 degrees is that of lasers with 682 beams"),
        ("", 1081, None, 270, "field of view of 270 degrees is that of lasers with 1081 beams"),
        ("", 1081, 190.0, 190, None),
        ("", 181, None, 180, None),
        ("", 99, None, 180,
            "field of view of 180 degrees is assumed: no PARAM says it, and no laser is known"),
    ],
)  # fmt: skip
def test_the_field_of_view_of_carmen_lasers(
    params: str, beams: int, fov: float | None, degrees: float, note: str | None, tmp_path: Path
) -> None:
    """Equal ranges are an arc of this many degrees, centred ahead."""
    path = tmp_path / "a.log"
    record = f"FLASER {beams} {'2.5 ' * beams}0 0 0 0 0 0 1 host 1\n"
    path.write_text(params + record * 2)
    log = read(path, fov=fov)
    for _ in range(2):
        first, _second = log
        angles = np.degrees(np.unwrap(np.arctan2(first.endpoints[:, 1], first.endpoints[:, 0])))
        steps = beams if beams % 2 == 0 else beams - 1
        expected = -degrees / 2 + np.arange(beams) * degrees / steps
        np.testing.assert_allclose(angles, expected, atol=1e-9)
        assert len(log.notes) == (note is not None)
        assert note is None or log.notes[0].startswith(note)


def test_lasers_of_carmen_that_are_not_read_are_told_of(tmp_path: Path) -> None:
    path, rear = tmp_path / "a.log", FLASER.replace("FLASER", "RLASER")
    path.write_text(f"{FLASER}\n{rear}\n" * 3)
    log = read(path)
    assert len(list(log)) == 3 and log.notes[-1] == "3 RLASER records of another laser are not read"
    path.write_text("ODOM 0 0 0 0 0 0 1 host 1\nRAWLASER1 0 -1.5 3.1 0.1 80 0 0 1 2.5 0 1 host 1\n")
    with pytest.raises(ValueError, match="expected one; found ODOM, RAWLASER1"):
        list(read(path))


@pytest.mark.parametrize("fov", [0.0, -1.0, 3.14, 361.0, float("nan")])
def test_a_field_of_view_out_of_its_limits_is_refused(fov: float, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"fov = .* degrees: must be in \(6.28, 360\], in degrees"):
        read(written("a.log", FLASER.encode())(tmp_path), fov=fov)


def test_scans_of_several_computers_in_a_carmen_log_are_told_of(tmp_path: Path) -> None:
    """Two robots that wrote one log; without a host behind the pose nothing tells."""
    lines = ["FLASER 2 1.0 1.0 0 0 0 0 0 0" + end for end in ("", " 0.1 a 0.1", " 0.2 a 0.2", " 0.3 b 0.3")]
    for last, said in ((3, 0), (4, 1)):
        log = read(written("a.log", "\n".join(lines[:last]).encode())(tmp_path))
        assert len(list(log)) == last
        assert len([note for note in log.notes if "from 2 computers, a and b" in note]) == said


@pytest.mark.parametrize(
    "first", ["ROBOTSTATE 1 2 3 host 4\nMESSAGE hello\n", "my log\n", "1 2 3\n", "\ufeff"]
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_carmen_is_recognised_behind_lines_of_others(first: str, end: str, tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(f"{first}{FLASER}\n{FLASER}\n".replace("\n", end).encode())
    log = read(path)
    assert (log.format, len(list(log))) == ("carmen", 2)


def test_beams_with_an_origin_each_are_read_by_their_format(tmp_path: Path) -> None:
    path = tmp_path / "beams.txt"
    path.write_text("".join(f"{i} 0 0 {i} 5 1\n" for i in range(20)))
    with pytest.raises(ValueError, match=r"--format text \(each line is a beam"):
        read(path)
    assert len(list(read(path, format="text"))) == 20
    path.write_text("".join(f"{i // 2} 0 0 {i} 5 1\n" for i in range(20)))
    assert len(list(read(path))) == 10, "two beams of an origin are a scan"
    path.write_text("".join(f"{i % 2} 0 0 {i} 5 1\n" for i in range(40)))
    assert len(list(read(path))) == 40, "two sensors in turn"
    path.write_text("".join(f"5 {i // 4} {i % 4} 37\n" for i in range(40)))
    assert len(list(read(path))) == 10, "nothing tells that these might be columns of points on a wall"
    path.write_text("".join(f"5 {i % 10} {i // 10} 37\n" for i in range(40)))
    with pytest.raises(ValueError, match="begin with another point"):
        read(path)


@pytest.mark.parametrize("dim", [2, 3])
def test_text_has_the_scans_of_npz(tmp_path: Path, dim: int) -> None:
    content = arrays(dim)
    npz = tmp_path / "log.npz"
    np.savez(npz, **content)
    lines = ["# origin, end point, returned"]
    for i, origin in enumerate(content["origins"]):
        for k in range(content["offsets"][i], content["offsets"][i + 1]):
            numbers = [*origin, *content["points"][k].astype(float), int(not content["no_return"][k])]
            lines.append(" ".join(repr(float(number)) for number in numbers))
    text = tmp_path / "log.txt"
    text.write_text("\n".join(lines) + "\n")
    one, other = read(npz), read(text)
    assert (one.format, other.format, one.dim, other.dim) == ("npz", "text", dim, dim)
    assert len(one) == 4
    pairs = list(zip(one, other))
    assert len(pairs) == 4
    for a, b in pairs:
        np.testing.assert_allclose(a.endpoints, b.endpoints)
        np.testing.assert_allclose(a.origin, b.origin)
        np.testing.assert_array_equal(a.returned, b.returned)


def test_npz_in_one_plane_is_2d_unless_told(tmp_path: Path) -> None:
    content = arrays()
    content["points"][:, 2] = 0.75
    content["origins"][:, 2] = 0.75
    content["points"][3] = np.nan
    path = save(tmp_path / "flat.npz", **content)
    assert read(path).dim == 2
    assert next(iter(read(path))).endpoints.shape == (5, 2)
    assert read(path, dim=3).dim == 3
    content["origins"][1, 2] = 0.76
    assert read(save(path, **content)).dim == 3


def test_npz_needs_neither_no_return_nor_stamps(tmp_path: Path) -> None:
    scan = next(iter(read(save(tmp_path / "a.npz", no_return=None, stamps=None))))
    assert scan.returned is None
    assert scan.stamp == 0.0


def test_format_can_be_forced(tmp_path: Path) -> None:
    path = tmp_path / "odd"
    path.write_text("UNKNOWN_RECORD 1 2\n" * 20_000 + f"{FLASER}\n")
    with pytest.raises(ValueError, match="line 1: found 'UNKNOWN_RECORD"):
        read(path)
    assert len(list(read(path, format="carmen"))) == 1
    with pytest.raises(
        ValueError, match=r"format = 'odd': must be one of (\w+, )*carmen, (\w+, )*npz, (\w+, )*text"
    ):
        read(path, format="odd")


def test_options_have_one_meaning_each_and_are_refused_where_nothing_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text(FLASER)
    with pytest.raises(TypeError, match="topic: a CARMEN log takes no such option, it takes zero_is, fov"):
        read(path, topic="/scan")
    assert read(path, topic=None).format == "carmen"
    taken = [option for format in logs._TABLE for option in format.options]
    for option in taken:
        assert [other.name for other in READER_OPTIONS if other.name == option] == [option]
    names = [format.name for format in logs._TABLE]
    assert sorted(names) == list(FORMATS) and len(set(names)) == len(names)
    assert {format.stored_as for format in logs._TABLE} <= {"file", "folder", "either"}


def test_what_is_damaged_can_be_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text(f"{FLASER}\nFLASER 3 1.0\n{FLASER}\nFLASER x\n")
    log = read(path, keep_going=True)
    for _ in range(2):
        assert len(list(log)) == 2
        assert {kind: skipped.count for kind, skipped in log.skipped.items()} == {"damaged lines": 2}
    assert log.skipped["damaged lines"].first.startswith(f"{path}: line 2: FLASER: expected")
    cut = cut_gzip(tmp_path)
    log = read(cut, keep_going=True)
    assert 500 < len(list(log)) < 2000
    assert list(log.skipped) == ["damaged gzip streams"]


@pytest.mark.parametrize("world, dim", [("office", 2), ("apartment", 3), ("street", 3)])
def test_simulated_logs_measure_their_world(world: str, dim: int) -> None:
    log = ndtree.simulate(world, seed=5, scans=3, noise_scale=0.0, outlier_rate=0.0)
    assert (log.format, log.dim, log.path, len(log)) == ("simulated", dim, None, 3)
    checked = 0
    for scan in log:
        hit = scan.returned & np.isfinite(scan.endpoints).all(axis=1)
        way = scan.endpoints[hit] - scan.origin
        measured = np.linalg.norm(way, axis=1)
        exact = log.distance(np.broadcast_to(scan.origin, way.shape), way, max_range=1000.0)
        np.testing.assert_allclose(measured, exact, atol=1e-6)
        assert not log.contains(scan.origin + 0.99 * way).any()
        checked += len(measured)
    assert checked > 500
    np.testing.assert_array_equal(log[1].endpoints, list(log)[1].endpoints)
    with pytest.raises(IndexError):
        log[3]
    with pytest.raises(ValueError, match="office"):
        ndtree.simulate("castle")


class BreakingLog(Log):
    """A log whose reader gives up behind some scans."""

    format = "breaking"

    def __init__(self, scans: int) -> None:
        super().__init__("x.log", 2)
        self.scans = scans

    def _scans(self) -> Iterator[ndtree.Scan]:
        for _ in range(self.scans):
            yield ndtree.Scan(np.ones((1, 2)), np.zeros(2))
        raise ValueError("x.log: the rest is missing")


def test_what_was_read_before_a_reader_gives_up_is_kept() -> None:
    log = BreakingLog(3)
    with pytest.raises(ValueError, match="the rest is missing"):
        list(log)
    log = log.ruled(keep_going=True)
    assert len(list(log)) == 3
    assert log.skipped["ends that cannot be read"].first == "x.log: the rest is missing"
    nothing = BreakingLog(0)
    nothing = nothing.ruled(keep_going=True)
    with pytest.raises(ValueError, match="the rest is missing"):
        list(nothing)


def lidar_points(order: str) -> np.ndarray:
    """(240, 3): points on the walls of a square room, in 4 rings."""
    azimuth = np.linspace(0.01, 2 * np.pi, 60, endpoint=False)
    flat = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    flat *= 3 / np.abs(flat).max(axis=1, keepdims=True)
    rings = np.stack([np.column_stack([flat, np.full(60, 0.3 * k - 0.25)]) for k in range(4)])
    return (rings if order == "rings" else rings.transpose(1, 0, 2)).reshape(-1, 3)


_LEVEL = np.arange(240) % 7
ATTRIBUTES = {
    "intensity": _LEVEL[:, None] * 10.0,
    "a constant intensity": np.full((240, 1), 37.0),
    "two attributes": np.stack([_LEVEL / 7, _LEVEL % 2], axis=1),
    "colours": np.stack([255 - _LEVEL, _LEVEL, 9 * _LEVEL], axis=1),
    "colours from 0 to 1": np.stack([_LEVEL / 7, _LEVEL / 9, _LEVEL / 11], axis=1),
    "normals": np.tile([0.0, 0.6, 0.8], (240, 1)),
    "intensity and colours": np.stack([_LEVEL - 900, 255 - _LEVEL, _LEVEL, 0 * _LEVEL], axis=1),
    "normals and curvature": np.tile([0.0, 0.6, 0.8, 0.0], (240, 1)),
}


@pytest.mark.parametrize(
    "layout, order", [(" ", "rings"), (",", "columns"), ("\t", "columns"), (";", "rings")]
)
@pytest.mark.parametrize("name", ATTRIBUTES)
def test_points_of_walls_are_not_taken_for_beams(name: str, order: str, layout: str, tmp_path: Path) -> None:
    points = lidar_points(order)
    if name == "two attributes":  # Walls that are plumb to the last digit would give lines of equal x and y.
        points[:, 0] += 0.001 * np.sin(np.arange(len(points)))
    table = np.hstack([points, ATTRIBUTES[name]])
    text = "# a comment\r\n" + "".join(layout.join(f"{v:.4f}" for v in row) + "\r\n" for row in table)
    path = written("a.xyz", text.encode())(tmp_path)
    with pytest.raises(
        ValueError, match=r"a\.xyz: points in text without a pose \(.*\); try\n  ndtree map "
    ) as caught:
        read(path)
    assert all(line.startswith("  ") for line in str(caught.value).splitlines()[1:])
    told = {"colours": "have whole numbers from 0 to 255", "normals": "are vectors of length 1"}
    few = written("b.xyz", "\n".join(text.split("\n")[:5]).encode())(tmp_path)
    if name in told:
        with pytest.raises(ValueError, match=f"columns 4 to 6 {told[name]}"):
            read(few)


@pytest.mark.parametrize("intensities", [(37, 37, 37), (1, 255, 0)])
def test_few_points_with_intensities_are_not_taken_for_beams(intensities: tuple, tmp_path: Path) -> None:
    lines = [
        f"{1.5 + i / 8} {0.25 - i / 16} 0.{i + 1} {intensity}" for i, intensity in enumerate(intensities)
    ]
    path = written("a.txt", "\n".join(lines).encode())(tmp_path)
    with pytest.raises(ValueError, match="of the first four columns, only the last has whole numbers"):
        read(path)
    path.write_text("\n".join(lines[:2]))
    assert len(list(read(path))) == 2, "two lines do not tell"


@pytest.mark.parametrize("dim", [2, 3])
def test_beams_are_beams_however_their_origins_change(dim: int, tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    origins = np.repeat(random.normal(size=(40, dim)), 3, axis=0)
    sensors = np.tile(random.normal(size=(4, dim)), (30, 1))
    for name, starts in {"scans of three beams": origins, "four sensors in turns": sensors}.items():
        path = tmp_path / f"{name}.txt"
        np.savetxt(path, np.hstack([starts, random.normal(size=(120, dim))]))
        assert sum(len(scan) for scan in read(path)) == 120
    alone = tmp_path / "alone.txt"
    np.savetxt(alone, random.normal(size=(120, 2 * dim)))
    with pytest.raises(ValueError, match="format text"):
        read(alone)
    assert len(list(read(alone, format="text"))) == 120


# --- What is refused --------------------------------------------------------------------------------


def truncated(path: Path, keep: float) -> Path:
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    return path


def cut_gzip(folder: Path) -> Path:
    generator = np.random.default_rng(1)
    lines = [
        f"FLASER 3 {' '.join(f'{r:.3f}' for r in generator.random(3))} 0 0 0 0 0 0 1 host 1"
        for _ in range(2000)
    ]
    path = folder / "cut.log.gz"
    path.write_bytes(gzip.compress("\n".join(lines).encode()))
    return truncated(path, 0.6)


def written(name: str, content: bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(content)
        return path

    return write


def around_a_log(folder: Path) -> Path:
    (folder / "one").mkdir()
    written("frame-000000.depth.png", b"")(folder / "one")
    return folder


def npz(said: str, **changes: np.ndarray | None) -> tuple[Callable[[Path], Path], str]:
    return lambda folder: save(folder / "a.npz", **changes), said


BROKEN: dict[str, tuple[Callable[[Path], Path], str]] = {
    "truncated gzip": (cut_gzip, r"after line \d+: the gzip stream is cut off"),
    "gzip of a few bytes": (written("a.gz", gzip.compress(FLASER.encode())[:12]),
        "the gzip stream is cut off"),
    "damaged gzip": (written("a.gz", b"\x1f\x8b" + b"no gzip at all" * 9), "gzip stream is damaged"),
    "empty file": (written("empty.log", b""), "the file is empty, expected a log"),
    "blank file": (written("blank.log", b"\n \n\t\n"), "the file is empty, expected a log"),
    "comments only": (written("c.txt", b"# nothing\n# here\n"), "only comments, expected"),
    "binary rubbish": (written("x.log", bytes(range(256)) * 20), "binary data, expected a log"),
    "prose": (written("x.txt", b"Dear reader,\n"), "line 1: found 'Dear reader,', expected"),
    "a picture": (written("x.png", b"\x89PNG\r\n\x1a\n\0\0"), "a PNG image; try\n  ndtree map FOLDER"),
    "a map": (written("x.ndt", b"\x89NDT\r\n\x1a\n\0\0"),
        r"is a map, expected a log; to look at it:\n  ndtree view "),
    "a map that is packed": (written("x.bt", gzip.compress(b"# Octomap OcTree binary file\n")),
        r"a file packed by gzip \(a map of OctoMap's\); try\n  gunzip -k "),
    "a folder around a log": (around_a_log,
        r"a folder with 1 log in it; try\n  ndtree map .*one$"),
    "three columns": (written("x.txt", b"1 2 3\n"),
        "points in text without a pose; try\n  ndtree map .* --points-only"),
    "a shorter line": (written("x.txt", b"0 0 1 1\n0 0 1\n"), "line 2: expected 4 or 5 numbers, found 3"),
    "no number": (written("x.txt", b"0 0 1 1\n0 0 one 1\n"), "line 2: expected a number in column 3"),
    "a flag of 2": (written("x.txt", b"0 0 1 1 2\n"), "line 1: expected 0 or 1 in column 5"),
    "carmen without scans": (written("x.log", b"PARAM a b host 0\n"), "no FLASER or ROBOTLASER1"),
    "carmen cut in a line": (written("x.log", (FLASER + "\n" + FLASER[:20]).encode()),
        "line 2: FLASER: expected"),
    "truncated npz": (lambda folder: truncated(save(folder / "a.npz"), 0.7), "expected a whole .npz"),
    "other zip": (lambda folder: np.savez(folder / "a.npz", other=np.zeros(3)) or folder / "a.npz",
        r"a zip archive without points.npy"),
    "missing array": npz("no array offsets, expected origins, points, offsets, found", offsets=None),
    "points of one axis": npz(r"points: has shape \(20,\) of float64, expected \(P, 2\) or \(P, 3\) floats",
        points=np.zeros(20)),
    "origins of other axes": npz(r"origins: has shape \(4, 2\) of float64, expected \(S, 3\) floats",
        origins=np.zeros((4, 2))),
    "offsets too short": npz(r"offsets: has shape \(4,\) of int64, expected \(5,\) integers",
        offsets=np.arange(4)),
    "offsets of floats": npz(r"offsets: has shape \(5,\) of float64, expected \(5,\) integers",
        offsets=np.arange(5) * 5.0),
    "offsets falling": npz("offsets: must rise from 0 to 20, the number of points",
        offsets=np.array([0, 10, 5, 15, 20])),
    "offsets beyond": npz("offsets: must rise from 0 to 20, the number of points",
        offsets=np.array([0, 5, 10, 15, 25])),
    "short no_return": npz(r"no_return: has shape \(19,\) of bool, expected \(20,\) bools",
        no_return=np.zeros(19, dtype=bool)),
    "no_return of numbers": npz(r"no_return: has shape \(20,\) of float64, expected \(20,\) bools",
        no_return=np.zeros(20)),
    "stamps too short": npz(r"stamps: has shape \(3,\) of float64, expected \(4,\) numbers",
        stamps=np.zeros(3)),
    "pickled objects": npz("points: cannot be read as an array", points=np.array([{}] * 20, dtype=object)),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_broken_files_are_named_with_place_and_expectation(case: str, tmp_path: Path) -> None:
    make, message = BROKEN[case]
    path = make(tmp_path)
    with pytest.raises(ValueError, match=message) as caught:
        list(read(path))
    assert str(caught.value).startswith(f"{path}: ")
    assert all(line.startswith("  ") for line in str(caught.value).splitlines()[1:])


def test_missing_file_and_directory(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "none.log")
    with pytest.raises(IsADirectoryError, match="is an empty directory, expected a log"):
        read(tmp_path)
    (tmp_path / "inside").mkdir()
    with pytest.raises(IsADirectoryError, match="is a directory with inside, expected a log"):
        read(tmp_path)
    with pytest.raises(IsADirectoryError, match="is a directory, expected text with one beam"):
        read(tmp_path, format="text")


def test_wrong_dim_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="dim = 4: must be 2 or 3"):
        read(tmp_path / "none.log", dim=4)
    with pytest.raises(ValueError, match="expected a 2-D log"):
        read(save(tmp_path / "a.npz"), dim=2)
    with pytest.raises(ValueError, match=r"expected \(P, 3\)"):
        read(save(tmp_path / "b.npz", **arrays(2)), dim=3)
    carmen = written("a.log", FLASER.encode())(tmp_path)
    with pytest.raises(ValueError, match="a CARMEN log is 2-D"):
        read(carmen, dim=3)
    with pytest.raises(ValueError, match="the first beam is 2-D, expected dim=2"):
        read(written("a.txt", b"0 0 1 1\n")(tmp_path), dim=3)


# --- Scan -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "endpoints, origin, returned, message",
    [
        (np.zeros(3), np.zeros(3), None, r"endpoints has shape \(3,\): must be \(n, dim\)"),
        (np.zeros((4, 2)), np.zeros(3), None, r"origin has shape \(3,\): must be \(2,\) or \(4, 2\)"),
        (np.zeros((4, 2)), np.zeros((3, 2)), None, r"origin has shape \(3, 2\): must be \(2,\) or \(4, 2\)"),
        (np.zeros((4, 2)), np.zeros(2), np.ones(3, bool), r"returned has shape \(3,\): must be \(4,\)"),
        (np.zeros((4, 2)), np.zeros(2), np.ones(4), "returned has dtype float64: must be bool"),
    ],
)
def test_scan_names_both_shapes(
    endpoints: np.ndarray, origin: np.ndarray, returned: np.ndarray | None, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        ndtree.Scan(endpoints, origin, returned)


def test_scan_inserts_as_the_map_does() -> None:
    scan = ndtree.Scan([[2.0, 0.1], [9.0, 0.2]], [0.0, 0.0], np.array([True, False]), stamp=2)
    one, other = ndtree.AdaptiveMap(dim=2), ndtree.AdaptiveMap(dim=2)
    report = scan.insert_into(one, max_range=5.0)
    other.insert(scan.endpoints, scan.origin, returned=scan.returned, max_range=5.0)
    assert (report.returned, report.not_returned, len(scan), scan.dim) == (1, 1, 2, 2)
    np.testing.assert_array_equal(one.leaves().log_odds, other.leaves().log_odds)


# --- Real recordings --------------------------------------------------------------------------------


@pytest.mark.parametrize("most, passes", [(1 << 28, 1), (100, 3)])
def test_scans_that_are_needed_again_are_read_once_if_they_are_few(
    most: int, passes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(joined, "_MOST", most)
    log = ndtree.simulate("office", scans=5)
    begun: list[int] = []
    monkeypatch.setattr(log, "_begin", lambda: begun.append(1))
    scans = joined.Again(log, limit=3)
    found = [[scan.stamp for scan in scans] for _ in range(3)]
    assert len(found[0]) == 3 and found == 3 * [found[0]]
    assert len(begun) == passes and scans.are_kept == (passes == 1)
