# SPDX-License-Identifier: BSD-3-Clause
"""What the paper reports (its Fig. 6 and 7), on real recordings; skipped where there are none."""

import numpy as np
import pytest

import ndtree

LASER = {
    "max_range": 20,
    "no_return": "ignore",
    "min_cell_size": 0.05,
    "max_cell_size": 1.6,
    "range_sigma": 0.03,
}
KINECT = {"min_cell_size": 0.05, "max_cell_size": 1.6, "range_sigma": 0.005, "range_sigma_quadratic": 0.0015}


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


@pytest.mark.parametrize(
    "log, cell, largest", [("sfm_mono_7scenes", 0.1, 1.6), ("stereo_sparse_kitti00", 0.5, 4.0)]
)
def test_features_are_beams_with_an_origin_each(recordings, log, cell, largest):
    """Structure from motion, the paper's third sensor: each observation is one range measurement (Fig. 6)."""
    scans = list(ndtree.read(recordings / log / f"{log}.npz"))
    options = {
        "min_cell_size": cell,
        "max_cell_size": largest,
        "range_sigma": cell / 2,
        "refinement": "paper",
    }
    at_once, by_camera = (ndtree.AdaptiveMap(dim=3, **options) for _ in range(2))
    points = np.concatenate([scan.endpoints for scan in scans])
    origins = np.concatenate([np.broadcast_to(scan.origin, scan.endpoints.shape) for scan in scans])
    report = at_once.insert(points, origins)
    assert report.returned == len(points) > 50_000
    for scan in scans:
        by_camera.insert(scan.endpoints, scan.origin)
    seen = []
    for m in (at_once, by_camera):
        leaves = m.leaves()
        rows = np.column_stack([leaves.lower, leaves.size, leaves.log_odds])[leaves.observed]
        seen.append(rows[np.lexsort(rows.T)])
    np.testing.assert_array_equal(*seen)
    fixed = ndtree.FixedMap(dim=3, min_cell_size=cell, range_sigma=cell / 2)
    fixed.insert(points, origins)
    assert at_once.stats().observed_leaves < 0.371 * fixed.stats().observed_leaves
    assert at_once.occupied_within(points, cell).mean() > 0.5
