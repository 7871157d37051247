# SPDX-License-Identifier: BSD-3-Clause
"""Bags in which /tf alone does not say where the sensor is: clouds in fixed frames, Odometry, late maps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import LEVEL, START, Messages, write_bag

from ndtree.logs import read

MAKE = Messages("mcap")
STAMPS = np.arange(0, 2, 0.1)
MOUNT = np.array([0.1, 0, 0])
POINTS = np.array([[4.0, 1.0, 0.5], [3.0, -2.0, 1.0], [-5.0, 0.5, 0.2]])


def place(t: float) -> np.ndarray:
    return np.array([0.8 * t, 0.2 * t * t, 0.3])


def moved(parent: str, child: str, begin: float = 0.0) -> list[tuple[str, float, Any]]:
    return [MAKE.moved(START + t, parent, child, place(t)) for t in STAMPS if t >= begin]


def fixed(parent: str, child: str) -> tuple[str, float, Any]:
    return "/tf_static", START, MAKE.tf(MAKE.transform(START, parent, child, MOUNT, LEVEL))


def odometry(parent: str, child: str, name: str = "/odom") -> list[tuple[str, float, Any]]:
    return [(name, START + t, MAKE.odometry(START + t, parent, child, place(t), LEVEL)) for t in STAMPS]


def clouds(frame: str, name: str = "/points", every: int = 1) -> list[tuple[str, float, Any]]:
    return [(name, START + t, MAKE.cloud(START + t, frame, POINTS)) for t in STAMPS[::every]]


def scans(frame: str) -> list[tuple[str, float, Any]]:
    return [("/scan", START + t, MAKE.laser(START + t, frame, [2.0, 3.0, 4.0])) for t in STAMPS]


def log_of(path: Path, *parts: Any, **options: Any) -> Any:
    content = [one for part in parts for one in (part if isinstance(part, list) else [part])]
    content.sort(key=lambda one: one[1])
    return read(write_bag(path / "bag", MAKE, content), **options)


REGISTERED: dict[str, tuple[list[Any], dict[str, Any], str]] = {
    "in odom": ([moved("odom", "base_link"), clouds("odom")], {}, "base_link"),
    "in the frame of SLAM": ([moved("camera_init", "body"), clouds("camera_init")], {}, "body"),
    "with its Odometry": ([odometry("camera_init", "body"), clouds("camera_init")], {}, "body"),
    "as asked": (
        [odometry("camera_init", "body"), clouds("camera_init")], {"odometry": "/odom"}, "body",
    ),
    "of a robot among others": (
        [moved("r1/odom", "r1/base_link"), fixed("r1/base_link", "r1/wheel"), clouds("r1/odom")], {},
        "r1/base_link",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REGISTERED)
def test_beams_of_clouds_in_a_fixed_frame_come_from_the_robot(name: str, tmp_path: Path) -> None:
    parts, options, observer = REGISTERED[name]
    log = log_of(tmp_path, *parts, **options)
    found = list(log)
    assert len(found) == len(STAMPS) and any(f"come from {observer}, " in note for note in log.notes)
    for scan, t in zip(found, STAMPS):
        np.testing.assert_allclose(scan.endpoints, POINTS, atol=1e-6)
        np.testing.assert_allclose(scan.origin, place(t), atol=1e-6)
    assert log.spans["poses"] == pytest.approx((START, START + STAMPS[-1]))


def test_the_frame_that_a_registered_cloud_was_seen_from_may_be_said(tmp_path: Path) -> None:
    parts = [moved("odom", "base_link"), fixed("base_link", "lidar"), clouds("odom")]
    for scan, t in zip(log_of(tmp_path, *parts, base_frame="lidar"), STAMPS):
        np.testing.assert_allclose(scan.origin, place(t) + MOUNT, atol=1e-6)
        np.testing.assert_allclose(scan.endpoints, POINTS, atol=1e-6)


@pytest.mark.parametrize("child", ["base_link", "camera_link"])
def test_no_beams_come_from_where_a_map_begins(child: str, tmp_path: Path) -> None:
    """The robot stands: no transform moves, and yet the frame of a map is no sensor's."""
    parts = [fixed("map", child), clouds("map")]
    if child != "base_link":
        (tmp_path / "unsaid").mkdir()
        with pytest.raises(
            ValueError, match=r"(?s)are in map, which is no sensor's frame,.* of camera_link\n"
        ):
            log_of(tmp_path / "unsaid", *parts)
    for scan in log_of(tmp_path, *parts, **({} if child == "base_link" else {"base_frame": child})):
        np.testing.assert_allclose(scan.origin, MOUNT, atol=1e-6)
        np.testing.assert_allclose(scan.endpoints, POINTS, atol=1e-6)


def test_points_in_a_fixed_frame_were_moved_there_before(tmp_path: Path) -> None:
    """Whatever times of their own they have, all of a cloud go into the map by the pose of its stamp."""
    timed = clouds("odom")[:-2]
    for _, _, cloud in timed:
        MAKE.with_times(cloud, POINTS, np.array([0, 0.05, 0.1], np.float32))
    drift = [MAKE.moved(START + t, "map", "odom", [t, 0, 0]) for t in STAMPS]
    log = log_of(tmp_path, moved("odom", "base_link"), drift, timed)
    assert "poses in map" in log.uses
    for scan, t in zip(log, STAMPS):
        np.testing.assert_allclose(scan.endpoints, POINTS + np.array([t, 0, 0]), atol=1e-5)
        np.testing.assert_allclose(scan.origin, place(t) + np.array([t, 0, 0]), atol=1e-5)


def test_a_sensor_comes_before_clouds_that_were_made_of_it(tmp_path: Path) -> None:
    parts = [moved("odom", "base_link"), fixed("base_link", "lidar")]
    registered = [clouds("odom", "/a_registered"), clouds("odom", "/a_map", every=5)]
    (tmp_path / "raw").mkdir()
    assert log_of(tmp_path / "raw", *parts, *registered, clouds("lidar", "/z_raw")).uses.startswith("/z_raw ")
    assert log_of(tmp_path, *parts, *registered).uses.startswith("/a_registered ")  # And not the rare map.


@pytest.mark.parametrize("turned", [False, True], ids=["wheels", "upside down"])
def test_a_sensor_above_what_moves_is_still_a_sensor(turned: bool, tmp_path: Path) -> None:
    """A root that is the robot's base, and a tree in which the fixed frame hangs below the sensor."""
    parts = [moved("lidar", "odom")] if turned else [moved("base_link", "arm")]
    if not turned:
        with pytest.raises(ValueError, match="base_link is connected to none of map, odom, world"):
            log_of(tmp_path, *parts, clouds("base_link"))
        return
    for scan, t in zip(log_of(tmp_path, *parts, clouds("lidar")), STAMPS):
        np.testing.assert_allclose(scan.origin, -place(t), atol=1e-6)


def test_without_tf_the_odometry_that_knows_the_sensors_base_counts(tmp_path: Path) -> None:
    parts = [fixed("base_link", "laser"), scans("laser")]
    log = log_of(tmp_path, *parts, odometry("odom", "base_link"), odometry("odom", "other", "/a"))
    assert log.uses == "/scan (LaserScan in laser), poses in odom from /odom"
    assert any("odometry /odom; others are /a (Odometry)" in note for note in log.notes)
    for scan, t in zip(log, STAMPS):
        np.testing.assert_allclose(scan.origin, (place(t) + MOUNT)[: log.dim], atol=1e-6)
    for name, wrong in (("nameless", ""), ("another", "wheel")):
        (tmp_path / name).mkdir()
        with pytest.raises(ValueError, match=r"expected one of:\n  odometry /odom\n"):
            log_of(tmp_path / name, *parts, odometry("odom", wrong))


def test_a_map_that_is_known_too_late_is_told_of(tmp_path: Path) -> None:
    late = [MAKE.moved(one[1], "map", "odom", [i, 0, 0])
            for i, one in enumerate(moved("", "", 1.5))]  # fmt: skip
    parts = [moved("odom", "base_link"), fixed("base_link", "laser"), scans("laser"), late]
    log = log_of(tmp_path, *parts)
    assert "poses in odom" in log.uses
    assert any("map is known for 25 % of the scans: fixed_frame map" in note for note in log.notes)
    assert len(list(read(tmp_path / "bag", fixed_frame="map"))) == 5


def test_messages_that_name_no_frame_are_told_of(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError,
        match=r"(?s)/scan names no frame of its own, expected .*the frames of /tf are base_link, odom",
    ):
        log_of(tmp_path, moved("odom", "base_link"), scans(""))
    log = read(tmp_path / "bag", sensor_frame="base_link")
    assert len(list(log)) == len(STAMPS) and "(LaserScan in no frame)" in log.uses


@pytest.mark.parametrize("way", ["still", "tf", "sensor_frame"])
def test_of_two_sensors_in_one_topic_the_one_that_hangs_nowhere_is_left_out(way: str, tmp_path: Path) -> None:
    """As where a simulator and a robot publish the same, by clocks of their own."""
    other = [("/scan", START + t + 0.01, MAKE.laser(50 + t, "ghost", [9.0, 9.0])) for t in STAMPS[::2]]
    transforms = [moved("odom", "base_link"), fixed("base_link", "laser")] if way != "still" else []
    options = {"still": {"still": True}, "tf": {}, "sensor_frame": {"sensor_frame": "laser"}}[way]
    log = log_of(tmp_path, *transforms, scans("laser"), other, **options)
    if way == "sensor_frame":  # Whatever the messages say.
        assert sum(len(scan) == 2 for scan in log) == 0 and len(log.skipped) == 1
        return
    found = list(log)
    assert len(found) == len(STAMPS) and all(len(scan) == 3 for scan in found)
    (left_out,) = log.skipped.values()
    assert left_out.count == 10
    assert left_out.summary == (
        "10 of 30 messages of /scan are left out: they are in ghost, and nothing says where that is"
    )
    assert log.spans["scans"] == pytest.approx((START, START + STAMPS[-1]))
    log = log.ruled(strict=True)
    with pytest.raises(ValueError, match="is in ghost, expected laser"):
        list(log)


def test_a_base_that_nothing_is_said_of_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="base_frame = base_link: nothing is said of it, expected a mount"):
        log_of(
            tmp_path,
            moved("odom", "base_link"),
            fixed("base_link", "laser"),
            scans("laser"),
            base_frame="base_link",
        )
    (tmp_path / "cloud").mkdir()
    with pytest.raises(ValueError, match=r"base_frame = x: .*, or it as one of base_link$"):
        log_of(tmp_path / "cloud", moved("odom", "base_link"), clouds("odom"), base_frame="x")


LEAPS = {
    "smooth": ("", lambda i, t: place(t), None),
    "once": ("jump by up to 0.5", lambda i, t: place(t) + np.array([0.5 * (t > 1), 0, 0]), None),
    "two nodes": ("jump back and forth by up to", lambda i, t: place(t + 0.3 * (i % 2)), None),
    "fixed, too": ("are fixed in /tf_static", lambda i, t: place(t), (0, 0, 0)),
}


@pytest.mark.parametrize("name", LEAPS)
def test_transforms_that_leap_or_disagree_are_told_of(name: str, tmp_path: Path) -> None:
    """Also a robot that brakes and turns back, which is no leap: the way there and back takes a second."""
    said, where, other = LEAPS[name]
    times = np.arange(0, 2, 0.02)
    rows = [MAKE.moved(START + t, "map", "odom", where(i, t), LEVEL) for i, t in enumerate(times)]
    rows += [MAKE.moved(START + t, "odom", "base_link", [0.3 * np.sin(6 * t), 0, 0], LEVEL) for t in times]
    rows += [MAKE.fixed(START, "map", "odom", other, LEVEL)] if other else []
    log = log_of(tmp_path, rows, fixed("base_link", "laser"), scans("laser"))
    told = [note for note in log.notes if note.startswith("transforms from")]
    assert len(told) == bool(said) and all(said in note and "map to odom" in note for note in told)
