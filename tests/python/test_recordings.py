# SPDX-License-Identifier: BSD-3-Clause
"""What the paper reports (its Fig. 6 and 7), and what poses are worth, on real recordings."""

import pytest
from conftest import there

import ndtree

CELLS = {"min_cell_size": 0.05, "max_cell_size": 1.6}
LASER = {**CELLS, "max_range": 20, "no_return": "ignore", "range_sigma": 0.03}
KINECT = {**CELLS, "range_sigma": 0.005, "range_sigma_quadratic": 0.0015}


@pytest.mark.parametrize(
    "log, options, every, cells, updates",
    [
        ("laser2d_intel/laser2d_intel.npz", LASER, 1, 0.136, 0.33),
        ("laser2d_freiburg_079/laser2d_freiburg_079.npz", LASER, 5, 0.136, 0.33),
        ("kinect_7scenes/kinect_7scenes.npz", KINECT, 4, 0.371, 0.49),
    ],
)
def test_cells_and_updates_are_at_most_the_papers(recordings, log, options, every, cells, updates):
    scans = [scan for i, scan in enumerate(ndtree.read(recordings / log)) if i % every == 0]
    maps = ["paper", "fixed"] + ["octomap"] * ndtree.has_octomap
    result = ndtree.compare(scans, maps, held_out=0, **options)
    rows = {row["map"]: row for row in result["maps"]}
    assert rows["paper"]["cells"] <= cells * rows["fixed"]["cells"]
    assert rows["paper"]["updates"] <= updates * rows["fixed"]["updates"]
    assert rows["paper"]["bytes_per_node"] <= 12
    if "octomap" in rows:
        for what in ("cells", "updates"):  # ours goes on to r + 3 sigma behind the end point
            assert rows["fixed"][what] == pytest.approx(rows["octomap"][what], rel=0.1)


GOOD = [f"laser2d_{name}/laser2d_{name}.npz" for name in ("intel", "freiburg_079", "mrpt_sena", "orebro")]
GOOD += ["laser2d_belgioioso/laser2d_belgioioso.npz", "bags/ros1_scan_tf_turtlebot_kinect/test_turtlebot.bag"]


@pytest.mark.parametrize("path", GOOD)
def test_good_poses_are_not_doubted(recordings, path):
    look = ndtree.first_look(ndtree.read(there(recordings / path)))
    assert look.doubt is None


@pytest.mark.parametrize(
    "name, doubt", [("aces", "heading_drift"), ("csail", "heading_drift"), ("fr079", "drift")]
)
def test_raw_odometry_is_doubted(recordings, name, doubt):
    look = ndtree.first_look(ndtree.read(there(recordings / f"laser2d_raw_{name}" / f"{name}.clf.bz2")))
    assert getattr(look, doubt) is not None and look.doubt and "align" in look.doubt
    assert doubt != "drift" or look.figures()["drift"] == look.drift.error > 0.5
