# SPDX-License-Identifier: BSD-3-Clause
"""What scans saw, and what maps claim beyond it: as SciPy's nearest neighbours and a plain count have it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import ndtree


@pytest.mark.parametrize("simulated", [True, False])
def test_a_comparison_says_what_its_maps_claim(simulated: bool) -> None:
    log = ndtree.simulate("office", seed=7, scans=40)
    mapped = [scan for i, scan in enumerate(log) if i % 10 != 9]
    maps = ["adaptive", "paper", "fixed"] + ["octomap"] * ndtree.has_octomap
    options: dict[str, Any] = {"cell_size": 0.1, "max_cell_size": 1.6, "range_sigma": 0.03}
    source = log if simulated else list(log)
    comparison = ndtree.compare(source, maps, max_range=12.0, no_return="free", **options)
    of = log.seen_space if simulated else ndtree.SeenSpace
    space = of(mapped, max_range=12.0)
    table = str(comparison)
    for name in maps:
        claims = comparison.row(name)["claims"]
        states = comparison.map_objects[name].state(space.points)
        free, unknown = states == 0, states == -1
        wrong = np.count_nonzero(free & ~space.seen), np.count_nonzero(unknown & space.seen)
        assert claims == {
            "points": 40_000,
            "seen": np.count_nonzero(space.seen),
            "free": np.count_nonzero(free),
            "free_and_unseen": wrong[0],
            "unknown_and_seen": wrong[1],
            "free_unseen": wrong[0] / np.count_nonzero(free),
            "seen_unknown": wrong[1] / np.count_nonzero(space.seen),
            "wrong_volume": sum(wrong) / np.count_nonzero(space.seen),
        }
        assert claims["free"] > 5000
        for share in ("free_unseen", "seen_unknown", "wrong_volume"):
            assert f"{100 * claims[share]:.2f} %" in table
    for label in ("free but unseen", "seen but unknown", "wrong volume"):
        assert label in table
    assert "claims_free_unseen" in comparison.to_csv()
