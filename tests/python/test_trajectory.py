# SPDX-License-Identifier: BSD-3-Clause
"""Poses between poses are SciPy's, files of TUM and KITTI say the same, and wrong ones are named."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from ndtree.logs.poses.pose import matrices_of, quaternions_of
from ndtree.logs.poses.trajectory import STAMP_TOLERANCE, Trajectory
from ndtree.logs.poses.trajectory_files import read_times, read_trajectory, trajectory_kind

spatial = pytest.importorskip("scipy.spatial.transform")


def drive(n: int = 40, seed: int = 4) -> Trajectory:
    generator = np.random.default_rng(seed)
    stamps = 1.7e9 + np.cumsum(generator.uniform(0.01, 0.3, n))
    positions = 4e5 + np.cumsum(generator.normal(size=(n, 3)), axis=0)
    return Trajectory(stamps, positions, spatial.Rotation.random(n, random_state=seed).as_quat())


def test_between_poses_is_what_scipy_says() -> None:
    one = drive()
    wanted = np.random.default_rng(5).uniform(one.stamps[0], one.stamps[-1], 500)
    wanted = np.concatenate([wanted, one.stamps])
    positions, quaternions = one.poses_at(wanted)
    oracle = spatial.Slerp(one.stamps - one.stamps[0], spatial.Rotation.from_quat(one.quaternions))
    expected = oracle(wanted - one.stamps[0])
    np.testing.assert_allclose(matrices_of(quaternions), expected.as_matrix(), atol=1e-6)
    for axis in range(3):
        np.testing.assert_allclose(
            positions[:, axis], np.interp(wanted, one.stamps, one.positions[:, axis]), atol=1e-8
        )
    np.testing.assert_array_equal(positions[500:], one.positions)
    for i in (0, 250, 520):
        pose = one.pose_at(wanted[i])
        np.testing.assert_array_equal(pose.position, positions[i])
        np.testing.assert_allclose(pose.rotation, expected[i].as_matrix(), atol=1e-6)


def test_matrices_and_quaternions_are_scipys_and_inverse() -> None:
    rotations = spatial.Rotation.random(300, random_state=6)
    halves = spatial.Rotation.from_rotvec(np.pi * np.vstack([np.eye(3), -np.eye(3), np.zeros((1, 3))]))
    every = spatial.Rotation.concatenate([rotations, halves])
    np.testing.assert_allclose(matrices_of(every.as_quat()), every.as_matrix(), atol=1e-15)
    again = quaternions_of(every.as_matrix())
    np.testing.assert_allclose(np.abs(np.sum(again * every.as_quat(), axis=1)), 1.0, atol=1e-14)


def test_outside_is_refused_but_for_rounding() -> None:
    one = drive()
    for stamp, end in ((one.stamps[0], -1), (one.stamps[-1], 1)):
        near = one.pose_at(stamp + end * 0.9 * STAMP_TOLERANCE)
        np.testing.assert_array_equal(near.position, one.positions[0 if end < 0 else -1])
        with pytest.raises(ValueError, match=r"trajectory: no pose at \d+\.\d{6} s, expected a time from"):
            one.pose_at(stamp + end * 1.5 * STAMP_TOLERANCE)
    with pytest.raises(ValueError, match="no pose at nan"):
        one.pose_at(np.nan)
    single = Trajectory([5.0], np.ones((1, 3)), np.eye(3)[None])
    np.testing.assert_array_equal(single.pose_at(5.0).position, np.ones(3))


def test_files_of_tum_and_kitti_say_the_same(tmp_path: Path) -> None:
    one = drive()
    tum, kitti = tmp_path / "a.txt", tmp_path / "b.txt.gz"
    np.savetxt(tum, np.hstack([one.stamps[:, None], one.positions, one.quaternions]), header="t x y z q")
    matrices = np.concatenate([matrices_of(one.quaternions), one.positions[:, :, None]], axis=2)
    np.savetxt(kitti, matrices.reshape(-1, 12))
    for read, stamps in ((read_trajectory(tum), one.stamps), (read_trajectory(kitti), np.arange(40))):
        np.testing.assert_allclose(read.stamps, stamps, rtol=0)
        np.testing.assert_allclose(read.positions, one.positions, atol=1e-9)
        np.testing.assert_allclose(matrices_of(read.quaternions), matrices_of(one.quaternions), atol=1e-12)


POSE = {"t": 1.6e9, "x": 1.5, "y": -2.5, "z": 3.5, "qx": 0.1, "qy": -0.3, "qz": 0.3, "qw": 0.9, "-": 77.0}
#: A header, what its columns are, and how many of its unit are a second.
HEADERS = {
    "w first": ("# t,x,y,z,qw,qx,qy,qz", "t x y z qw qx qy qz", 1),
    "EuRoC": (
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
        "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_a_RS_S_x [m s^-2]",
        "t x y z qw qx qy qz - - - - -",
        10**9,
    ),
    "TUM VI": (
        "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x, q_RS_y, q_RS_z",
        "t x y z qw qx qy qz",
        10**9,
    ),
    "no comment": ("timestamp tx ty tz qx qy qz qw", "t x y z qx qy qz qw", 1),
    "time last": ("qw;qx;qy;qz;px;py;pz;time_us", "qw qx qy qz x y z t", 10**6),
    "a number first": ("# num timestamp(ms) tx ty tz qw qx qy qz", "- t x y z qw qx qy qz", 10**3),
    "units behind blanks": ("# Time (s)  X (m)  Y (m)  Z (m)  QW  QX  QY  QZ", "t x y z qw qx qy qz", 1),
    "bare names": ("time,tx,ty,tz,w,x,y,z", "t x y z qw qx qy qz", 1),
    "behind a colon": ("# columns: t z y x qw qz qy qx", "t z y x qw qz qy qx", 1),
    "letters of quaternions": ("# t x y z w i j k", "t x y z qw qx qy qz", 1),
    "parts of quaternions": ("utime,x,y,z,qr,qi,qj,qk", "t x y z qw qx qy qz", 10**6),
    "units as words": ("timestamp_ns,x_m,y_m,z_m,qw,qx,qy,qz", "t x y z qw qx qy qz", 10**9),
    "words": ("stamp,position.x,position.y,position.z,quat.x,quat.y,quat.z,quat.w", "t x y z qx qy qz qw", 1),
}  # fmt: skip


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("case", HEADERS)
def test_a_header_says_the_order_of_columns_and_the_unit(
    case: str, mark: bytes, end: str, tmp_path: Path
) -> None:
    header, columns, per_second = HEADERS[case]
    by = "," if "," in header else ";" if ";" in header else " "
    lines = [header, "# another comment"]
    for i in range(5):
        values = {
            **POSE,
            "t": round((POSE["t"] + i / 8) * per_second) if per_second > 1 else POSE["t"] + i / 8,
        }
        lines.append(by.join(repr(values[name]) for name in columns.split()))
    path = tmp_path / "poses.csv"
    path.write_bytes(mark + (end.join(lines) + end).encode())
    found = read_trajectory(path)
    assert trajectory_kind(path) == "tum"
    np.testing.assert_allclose(found.stamps, 1.6e9 + np.arange(5) / 8, atol=1e-6, rtol=0)
    np.testing.assert_array_equal(found.positions, np.tile([1.5, -2.5, 3.5], (5, 1)))
    wanted = np.array([0.1, -0.3, 0.3, 0.9])
    np.testing.assert_allclose(found.quaternions[0], wanted, atol=1e-12)


def test_words_in_other_columns_are_passed_over(tmp_path: Path) -> None:
    """As `rostopic echo -p` writes poses."""
    path = tmp_path / "poses.csv"
    at, turn = "field.pose.position", "field.pose.orientation"
    path.write_text(
        f"%time,field.header.seq,field.header.stamp,field.header.frame_id,{at}.x,{at}.y,{at}.z,"
        f"{turn}.x,{turn}.y,{turn}.z,{turn}.w\n1600000009000000000,7,1600000000500000000,map,1,2,3,0,0,0,1\n"
    )
    found = read_trajectory(path)
    assert found.stamps.tolist() == [1600000000.5] and found.positions.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    "names", ["sec,nsec", "stamp_sec,stamp_nanosec", "header.stamp.sec,header.stamp.nanosec"]
)
def test_seconds_and_nanoseconds_are_one_time(names: str, tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(
        f"{names},x,y,z,qx,qy,qz,qw\n1600000000,500000000,1,2,3,0,0,0,1\n1600000001,5,1,2,3,0,0,0,1\n"
    )
    np.testing.assert_allclose(read_trajectory(path).stamps, [1600000000.5, 1600000001], atol=1e-6, rtol=0)


@pytest.mark.parametrize("per_second", [1, 10**3, 10**6, 10**9])
def test_stamps_since_1970_need_no_unit(per_second: int, tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("".join(f"{1600000000 * per_second + i * per_second} 0 0 0 0 0 0 1\n" for i in range(4)))
    assert read_trajectory(path).stamps.tolist() == [1.6e9, 1.6e9 + 1, 1.6e9 + 2, 1.6e9 + 3]
    path.write_text("".join(f"{1600000000 * per_second + i * per_second}\n" for i in range(4)))
    assert read_times(path).tolist() == [1.6e9, 1.6e9 + 1, 1.6e9 + 2, 1.6e9 + 3]


BROKEN = {
    "nanoseconds of no known time": (
        "0 0 0 0 0 0 0 1\n100000000 0 0 0 0 0 0 1\n200000000 0 0 0 0 0 0 1\n",
        r"poses are 1e\+08 apart at times around 1e\+08, expected seconds, or a first line",
    ),
    "a header with more columns": (
        "# t,x,y,z,qw,qx,qy,qz\n1,0,0,0,1,0,0\n",
        "line 2: found 7 numbers, expected 8 as the header names columns",
    ),
    "a header half understood": (
        "# when,x,y,z,qw,qx,qy,qz\n1,0,0,0,1,0,0,0\n",
        "line 1: the header names qw before qx, expected one time, x y z and",
    ),
    "numbers of quaternions": (
        "# t x y z q0 q1 q2 q3\n1 0 0 0 1 0 0 0\n",
        "line 1: the header names q0 q1 q2 q3, expected one time, x y z and",
    ),
    "angles": (
        "# t, x, y, z, roll, pitch, yaw, quality\n1,0,0,0,1,0,0,0\n",
        "line 1: the header names roll pitch yaw, expected one time, x y z and",
    ),
    "empty": ("# nothing\n\n", "no poses, expected 8 numbers a line"),
    "seven columns": ("0 0 0 0 0 0 1\n", "line 1: found 7 numbers, expected 8 numbers a line"),
    "a shorter line": (
        "0 0 0 0 0 0 0 1\n# and\n1 0 0 0 0 0 1\n",
        "line 3: found 7 numbers, expected 8 as in",
    ),
    "a word": ("0 0 0 0 0 0 0 one\n", "line 1: found '0 0 0 0 0 0 0 one', expected only numbers"),
    "time turned back": ("1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", "pose 1: stamp 0.000000 s follows 1.000000 s"),
    "no length": ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 0\n", r"pose 1: quaternion .* has length 0, expected 1"),
    "a mirror": ("1 0 0 0 0 1 0 0 0 0 -1 0\n", "is not a rotation, expected rows of .*, and no mirror"),
    "nan": ("nan 0 0 0 0 0 0 1\n", "stamps: pose 0 is not finite"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_files_are_named_with_place_and_expectation(case: str, tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(BROKEN[case][0])
    with pytest.raises(ValueError, match=BROKEN[case][1]) as caught:
        read_trajectory(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_odd_files_are_read_or_named(tmp_path: Path) -> None:
    poses, times, tum = tmp_path / "poses.txt", tmp_path / "times.txt", tmp_path / "tum.txt"
    tum.write_text("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n")
    assert len(read_trajectory(tum)) == 1, "a pose said twice is one"
    times.write_text("1 2\n")
    with pytest.raises(ValueError, match="line 1: found 2 numbers, expected one"):
        read_times(times)
    poses.write_bytes(gzip.compress(b"1 0 0 0 0 1 0 0 0 0 1 0\n" * 100)[:-20])
    with pytest.raises(ValueError, match="gzip stream is cut off or damaged"):
        read_trajectory(poses)
    with pytest.raises(FileNotFoundError):
        read_trajectory(tmp_path / "none.txt")


def test_shapes_are_named() -> None:
    with pytest.raises(ValueError, match=r"shapes \(2,\), \(3, 3\) and \(2, 4\)"):
        Trajectory([0, 1], np.zeros((3, 3)), np.zeros((2, 4)))


def test_decimal_commas_are_points(tmp_path: Path) -> None:
    rows = [f"{i}.25 {i}.5 -0.125 3 0 0 0 1" for i in range(3)]
    expected = written(tmp_path / "points.txt", rows)
    for name, separator in (("semicolons.csv", ";"), ("blanks.txt", " "), ("tabs.txt", "\t")):
        found = written(tmp_path / name, [row.replace(".", ",").replace(" ", separator) for row in rows])
        assert found.stamps.tolist() == expected.stamps.tolist() == [0.25, 1.25, 2.25]
        assert found.positions.tolist() == expected.positions.tolist()
    named = ["time;qw;qx;qy;qz;x;y;z", "0,5;1;0;0;0;1,5;2,5;3,5"]
    assert written(tmp_path / "named.csv", named).positions.tolist() == [[1.5, 2.5, 3.5]]
    commas = written(tmp_path / "commas.csv", [row.replace(" ", ",") for row in rows])
    assert commas.positions.tolist() == expected.positions.tolist()


def test_text_in_utf16_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes("0 0 0 0 0 0 0 1\n".encode("utf-16"))
    with pytest.raises(ValueError, match=r"a\.txt: text in UTF-16:\n  iconv -f UTF-16 -t UTF-8 .*a\.txt > "):
        read_trajectory(tmp_path / "a.txt")
    (tmp_path / "b.txt").write_bytes(b"0 0 0 0 0 0 0 1\r1 0 0 0 0 0 0 1\r")
    with pytest.raises(ValueError, match=r"b\.txt: text whose lines end as on old Macs:\n  tr .*b\.txt > "):
        read_trajectory(tmp_path / "b.txt")


def written(path: Path, lines: list[str]) -> Trajectory:
    path.write_text("\n".join([*lines, ""]))
    return read_trajectory(path)
