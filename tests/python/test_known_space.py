# SPDX-License-Identifier: BSD-3-Clause
"""What was seen to be free stays known when something comes up in it."""

import numpy as np
import pytest

import ndtree


@pytest.mark.parametrize("branching", [2, 3])
def test_what_was_known_in_small_cells_is_known_when_a_large_one_splits(branching: int) -> None:
    log = list(ndtree.simulate("office", scans=400, people=4, seed=5))
    m = ndtree.AdaptiveMap(dim=2, branching=branching, min_cell_size=0.1, range_sigma=0.02)
    ends = np.concatenate([scan.endpoints[scan.returned] for scan in log])
    points = np.random.default_rng(3).uniform(*np.quantile(ends, [0.01, 0.99], axis=0), (20_000, 2))
    known_size = np.full(len(points), np.inf)  # The smallest cell around each point that was free.
    kept = lost = 0
    for scan in log:
        size_before, state_before = m.cell_size(points), m.state(points)
        scan.insert_into(m, max_range=20)
        size, state = m.cell_size(points), m.state(points)
        was_split = (state_before == 0) & (size < size_before) & (size >= known_size)
        kept += int(np.sum(was_split & (state != -1)))
        lost += int(np.sum(was_split & (state == -1)))
        known_size = np.minimum(known_size, np.where(state == 0, size, np.inf))
    assert kept > 1000
    assert lost < 0.01 * kept
