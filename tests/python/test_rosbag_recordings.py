# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of other formats, written as bags, are read as what they were."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from bags import Messages, write_bag
from drives import START

import ndtree
from ndtree.logs import read
from ndtree.logs.poses.trajectory_files import read_trajectory


def test_recorded_depth_images_lie_where_the_folder_has_them(recordings: Path, tmp_path: Path) -> None:
    """The same images from a folder and from a bag whose poses are in /tf."""
    image = pytest.importorskip("PIL.Image")
    folder = recordings / "kinect_tum_fr1_rpy" / "tum_format"
    in_folder = list(islice(read(folder), 3))
    make = Messages("ros1")
    trajectory = read_trajectory(folder / "groundtruth.txt")
    content = [
        ("/tf", stamp, make.tf(make.transform(stamp, "world", "camera", position, quaternion)))
        for stamp, position, quaternion in zip(
            trajectory.stamps, trajectory.positions, trajectory.quaternions
        )
        if abs(stamp - in_folder[1].stamp) < 2
    ]
    info = make.camera_info(0, "camera", (480, 640), (525, 525, 319.5, 239.5))
    content.append(("/depth/camera_info", START, info))
    rows = [line.split() for line in (folder / "depth.txt").read_text().splitlines() if line[0] != "#"]
    for stamp, name in rows[:3]:
        values = np.asarray(image.open(folder / name)).astype(np.float32) / 5000
        message = make.image(float(stamp), "camera", values, "32FC1")
        content.append(("/depth/image", float(stamp), message))
    log = read(write_bag(tmp_path / "bag", make, content))
    scans = list(log)
    assert len(scans) == len(in_folder) == 3
    for one, other in zip(scans, in_folder):
        assert one.stamp == pytest.approx(other.stamp, abs=1e-6)
        np.testing.assert_allclose(one.endpoints, other.endpoints, atol=1e-4)
        np.testing.assert_allclose(one.origin, other.origin, atol=1e-5)


def test_recorded_laser_scans_make_the_map_of_their_log(recordings: Path, tmp_path: Path) -> None:
    """The same scans from a CARMEN log and from a bag."""
    log = list(read(recordings / "laser2d_intel" / "intel-corrected.log.gz").select(every=10))
    make, content = Messages("mcap"), []
    for i, scan in enumerate(log):
        way = scan.endpoints - scan.origin
        ahead = np.arctan2(*way[len(way) // 2][::-1])
        ranges = np.where(scan.returned, np.linalg.norm(way, axis=1), np.inf)
        angles = np.unwrap(np.arctan2(way[:, 1], way[:, 0])) - ahead
        step = (angles[-1] - angles[0]) / (len(angles) - 1)
        turn = [0, 0, np.sin(ahead / 2), np.cos(ahead / 2)]
        content.append(("/tf", i, make.tf(make.transform(i, "map", "laser", [*scan.origin, 0], turn))))
        laser = make.laser(i, "laser", ranges, angle_min=angles[0], angle_increment=step, range_max=81.83)
        content.append(("/scan", i, laser))
    maps = []
    for scans in (log, read(write_bag(tmp_path / "bag", make, content))):
        # Without samples, which depend on the last bits of the ranges.
        maps.append(ndtree.AdaptiveMap(dim=2, sample_beams=1e9))
        for scan in scans:
            scan.insert_into(maps[-1], max_range=20)
    points = np.concatenate([scan.endpoints[scan.returned] for scan in log])
    same = maps[0].state(points) == maps[1].state(points)
    assert len(points) > 10_000 and same.mean() > 0.999
