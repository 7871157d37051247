# SPDX-License-Identifier: BSD-3-Clause
"""Points in text: whatever the separators, headers and marks around them, they are those written."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ndtree.logs import NotALog, read
from ndtree.logs.folders import text_clouds
from ndtree.logs.folders.text_clouds import columns_of, text_points

hypothesis = pytest.importorskip("hypothesis")
st = hypothesis.strategies

numbers = st.floats(-1e6, 1e6, allow_nan=False).map(lambda value: round(value, 4))
points = st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=30)
#: Separator, and whether commas are decimal points.
separators = st.sampled_from(
    [(" ", False), ("\t", False), (",", False), (", ", False), (";", False), (";", True), ("\t", True)]
)
#: Lines before the points, for commas or not.
headers = st.sampled_from(
    ["", "# made by a program", "// x y z", "x{0}y{0}z", "X{0}Y{0}Z{0}Intensity", "scan of a hall", "12"]
)
extras = st.sampled_from([(), ("7",), ("12", "250", "3"), ("0.5", "12", "250", "3")])


@hypothesis.settings(max_examples=200, deadline=None, suppress_health_check=list(hypothesis.HealthCheck))
@hypothesis.given(
    rows=points, how=separators, header=headers, extra=extras, mark=st.booleans(), blank=st.booleans(),
    end=st.sampled_from(["\n", "\r\n"]),
)  # fmt: skip
def test_points_are_read_as_they_were_written(
    rows: list[tuple[float, float, float]], how: tuple[str, bool], header: str, extra: tuple[str, ...],
    mark: bool, end: str, blank: bool, tmp_path_factory: pytest.TempPathFactory,
) -> None:  # fmt: skip
    separator, decimal_comma = how
    lines = [header.format(separator)] if header else []
    if "Intensity" in header and not extra:
        extra = ("7",)
    for row in rows:
        fields = [f"{value:.4f}" for value in row]
        if decimal_comma:
            fields = [field.replace(".", ",") for field in fields]
        lines.append(
            separator.join([*fields, *(one.replace(".", ",") if decimal_comma else one for one in extra)])
        )
        lines += [""] * blank
    path = tmp_path_factory.mktemp("text") / "a.xyz"
    path.write_bytes((b"\xef\xbb\xbf" if mark else b"") + end.join([*lines, ""]).encode())
    np.testing.assert_array_equal(text_points(str(path)), np.round(rows, 4))


def test_columns_are_those_that_a_header_names() -> None:
    cases = {
        b"timestamp,x,y,z,intensity\n1,2,3,4,5\n": (1, 2, 3),
        b"z;y;x\n1;2;3\n": (2, 1, 0),
        b'"Points:0","Points:1","x","y","z"\n9,9,1,2,3\n': (2, 3, 4),
        b"//X,Y,Z,R,G,B\n1,2,3,4,5,6\n": (0, 1, 2),
        b"id easting northing elevation\n1 2 3 4\n": (1, 2, 3),
        b"name,pos_x,pos_y,pos_z\nwall,2,3,4\n": (1, 2, 3),
        b"x [m], y [m], z [m]\n1, 2, 3\n": (0, 1, 2),
        b"x [m] y [m] z [m]\n1 2 3\n": (0, 1, 2),
        b"time (s) x (m) y (m) z (m)\n1 2 3 4\n": (1, 2, 3),
        b"# points x y z of the hall\n1 2 3\n": (0, 1, 2),
        b"# RANGE (mm), X1 (m), Y1 (m), Z1 (m), X2 (m)\n9, 1, 2, 3, 0\n": (1, 2, 3),
        b"Points_m_XYZ:0,Points_m_XYZ:1,Points_m_XYZ:2,intensity\n1,2,3,4\n": (0, 1, 2),
        b"scan of hall\n1 2 3\n": (0, 1, 2),
    }
    for text, expected in cases.items():
        columns = columns_of(text.splitlines())
        assert columns is not None and columns.xyz == expected, text
    for text in (
        b"azimuth,elevation,range\n1,2,3\n",
        b"a;b;c\n1;2;3\n",
        b"id x y z\n1 2 3\n",
        b"",
        b"hello\n",
        b"1 2\n3 4\n",
        b"a b c\nd e f\n",
        b"x y z\n",
    ):
        assert columns_of(text.splitlines()) is None, text


def test_units_that_a_header_names_count(tmp_path: Path) -> None:
    for unit, metres in (("mm", 0.001), ("cm", 0.01), ("m", 1.0), ("furlong", 1.0)):
        (tmp_path / "a.csv").write_text(f"x [{unit}], y [{unit}], z [{unit}]\n1, 2, 3\n")
        np.testing.assert_allclose(text_points(str(tmp_path / "a.csv")), [[metres, 2 * metres, 3 * metres]])


@pytest.mark.parametrize(
    "header, size",
    [
        ("x_mm,y_mm,z_mm", 1e-3),
        ("X(ft),Y(ft),Z(ft)", 0.3048),
        ("x [feet],y [feet],z [feet]", 0.3048),
        ("east_km,north_km,up_km", 1e3),
        ("x_m,y_m,z_m", 1.0),
        ("x,y,z", 1.0),
    ],
)
def test_a_unit_behind_a_name_or_in_brackets_counts(header: str, size: float, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"{header}\n1,2,3\n4,5,6\n")
    (scan,) = read(tmp_path / "a.csv", points_only=True)
    np.testing.assert_allclose(scan.endpoints, size * np.array([[1, 2, 3], [4, 5, 6]]), rtol=1e-12)


def test_what_was_not_measured_is_nan(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z\n1,2,3\n,,\nnan,nan,nan\n4,5,inf\n")
    found = text_points(str(tmp_path / "a.csv"))
    np.testing.assert_array_equal(found, [[1, 2, 3], [math.nan] * 3, [math.nan] * 3, [4, 5, math.inf]])
    (scan,) = read(tmp_path / "a.csv", points_only=True)
    assert len(scan) == 4
    (tmp_path / "b.csv").write_text("x,y,z,intensity\n1,2,3,\n4,5,6,7\n8,9,10,\n")
    np.testing.assert_array_equal(text_points(str(tmp_path / "b.csv")), [[1, 2, 3], [4, 5, 6], [8, 9, 10]])


def test_counts_of_several_clouds_in_a_pts_are_no_points(tmp_path: Path) -> None:
    (tmp_path / "a.pts").write_text("2\n1 2 3 0\n4 5 6 0\n1\n7 8 9 0\n")
    np.testing.assert_array_equal(text_points(str(tmp_path / "a.pts")), [[1, 2, 3], [4, 5, 6], [7, 8, 9]])


@pytest.mark.parametrize("number", [3, 60, 70_000])
def test_a_line_at_fault_is_named(number: int, tmp_path: Path) -> None:
    """In the first lines, in the first block and behind it; fields of other lines do not make up for it."""
    lines = ["1 2 3"] * (number + 2)
    lines[number - 1] = "1 2"
    lines[number] = "1 2 3 4"
    (tmp_path / "a.xyz").write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError, match=rf"a\.xyz: line {number}: found '1 2', expected x y z of a point"):
        text_points(str(tmp_path / "a.xyz"))


def test_beams_and_poses_are_not_taken_for_points(tmp_path: Path) -> None:
    (tmp_path / "beams.txt").write_text("".join(f"0 0 1 {i} 5 1\n" for i in range(20)))
    assert read(tmp_path / "beams.txt").format == "text"
    (tmp_path / "track.txt").write_text("1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n")
    with pytest.raises(
        NotALog, match=r"track\.txt: a trajectory, poses with times; try\n  ndtree map LOG --traj"
    ):
        read(tmp_path / "track.txt")
    (tmp_path / "heights.asc").write_text("ncols 3\nnrows 1\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n")
    with pytest.raises(NotALog, match="a grid of heights"):
        read(tmp_path / "heights.asc")


def test_quotes_around_fields_are_no_part_of_them(tmp_path: Path) -> None:
    """In the first lines and in blocks; also beside decimal commas."""
    rows = np.random.default_rng(5).normal(size=(400, 3)).round(4)
    lines = [";".join(f'"{value:.4f}"'.replace(".", ",") for value in row) for row in rows]
    (tmp_path / "a.csv").write_text("\n".join(['"x";"y";"z"', *lines, ""]))
    np.testing.assert_array_equal(text_points(str(tmp_path / "a.csv")), rows)
    plain = ["1.5,2.5,3.5"] * 100
    for number, damaged in (
        (9, '1.5,2"5,3.5'),
        (80, '1.5,2"5,3.5'),
        (81, '"1.5,2.5,3.5'),
        (82, '1.5,"2.5,"3.5'),
    ):
        (tmp_path / "b.csv").write_text("\n".join([*plain[: number - 1], damaged, *plain]))
        with pytest.raises(ValueError, match=rf"b\.csv: line {number}: found "):
            text_points(str(tmp_path / "b.csv"))


def test_latitudes_are_no_metres() -> None:
    for header in (b"lat,lon,alt", b"# Longitude Latitude Height", b"time;lat;lng;x;y;z"):
        assert columns_of([header, b"48.1,11.5,520,1,2,3".replace(b",", header[4:5])]) is None, header
    assert columns_of([b"plate,longer,x,y,z", b"1,2,3,4,5"]) is not None


def test_decimal_commas_do_not_make_beams_of_points(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("1,5;2,5;3,5\n" * 20)
    with pytest.raises(NotALog) as caught:
        read(tmp_path / "a.csv")
    assert caught.value.kind == "points in text without a pose"
    assert not any("--format text" in way for way in caught.value.help)


def test_points_of_any_block_are_those_of_its_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks that are parsed at once, and such that have blank lines, words or long numbers in them."""
    monkeypatch.setattr(text_clouds, "_BLOCK", 50)
    rng = np.random.default_rng(4)
    rows = rng.normal(scale=30, size=(4000, 3))
    forms = [
        "{:.4f} {:.2f} {:.3f}",
        "{!r} {!r} {!r}",
        "{:.3e} {:g} {:.1f} wall",
        "\n{:.4f}\t{:.2f} {:.3f} 5 6",
    ]
    lines, expected = [], []
    for i, row in enumerate(rows.tolist()):
        line = forms[i // 300 % 4].format(*row)
        lines.append(line)
        expected += [float(field) for field in line.split()[:3]]
    (tmp_path / "a.xyz").write_text("\n".join(lines))
    np.testing.assert_array_equal(text_points(str(tmp_path / "a.xyz")).ravel(), expected)
