# SPDX-License-Identifier: BSD-3-Clause
"""A comparison counts what the maps themselves count, and calls true what an independent count calls true."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ndtree

OPTIONS: dict[str, Any] = {"cell_size": 0.1, "max_cell_size": 0.8, "range_sigma": 0.03}


@pytest.fixture(scope="module")
def log() -> ndtree.Log:
    return ndtree.simulate("office", seed=7, scans=60)


@pytest.fixture(scope="module")
def comparison(log: ndtree.Log) -> ndtree.Comparison:
    return ndtree.compare(
        log, ("adaptive", "fixed", "fixed@0.2"), max_range=12.0, no_return="free", **OPTIONS
    )


def test_counts_are_those_of_maps_made_by_hand(log: ndtree.Log, comparison: ndtree.Comparison) -> None:
    by_hand: dict[str, Any] = {
        "adaptive": ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, max_cell_size=0.8, range_sigma=0.03),
        "fixed": ndtree.FixedMap(dim=2, min_cell_size=0.1, range_sigma=0.03),
        "fixed@0.2": ndtree.FixedMap(dim=2, min_cell_size=0.2, range_sigma=0.03),
    }
    assert [row["map"] for row in comparison["maps"]] == list(by_hand)
    for name, m in by_hand.items():
        beams = dict.fromkeys(("returned", "not_returned", "beyond_max_range", "invalid"), 0)
        updates = 0
        for i, scan in enumerate(log):
            if i % 10 != 9:
                report = m.insert(scan.endpoints, scan.origin, returned=scan.returned, max_range=12.0)
                beams = {key: count + getattr(report, key) for key, count in beams.items()}
                updates += report.updates
        row, stats = comparison.row(name), m.stats()
        assert comparison["beams"] == beams
        assert row["updates"] == updates
        assert row["cells"] == stats.observed_leaves == sum(size["observed"] for size in row["cell_sizes"])
        assert row["leaves"] == stats.leaves == sum(size["leaves"] for size in row["cell_sizes"])
        assert row["splits"] == stats.splits
        assert row["nodes"] == stats.nodes
        assert row["memory_bytes"] == comparison.map_objects[name].stats().memory_bytes
        assert row["resident_bytes"] is None or row["resident_bytes"] >= row["memory_bytes"]
        np.testing.assert_array_equal(comparison.map_objects[name].leaves().log_odds, m.leaves().log_odds)
    assert (comparison["scans"], comparison["scans_mapped"]) == (60, 54)
    sizes = [size["size"] for size in comparison.row("adaptive")["cell_sizes"]]
    assert sizes == sorted(sizes, reverse=True)


def test_held_out_truth_is_that_of_a_plain_count(log: ndtree.Log, comparison: ndtree.Comparison) -> None:
    for name, m in comparison.map_objects.items():
        found = dict.fromkeys(("free", "occupied", "unknown", "endpoints", "endpoints_near"), 0)
        errors: list[np.ndarray] = []
        for scan in list(log)[9::10]:
            way = scan.endpoints - scan.origin
            far = np.linalg.norm(way, axis=1)
            use = scan.returned & (far <= 12.0) & (far > 0)
            way, far = way[use] / far[use, None], far[use]
            steps = np.arange(1, 121) * 0.1
            beam, step = np.nonzero(steps[None, :] <= far[:, None] - 0.1)
            states = m.state(scan.origin + steps[step, None] * way[beam])
            for key, value in (("free", 0), ("occupied", 1), ("unknown", -1)):
                found[key] += int(np.count_nonzero(states == value))
            found["endpoints"] += len(far)
            found["endpoints_near"] += int(np.count_nonzero(m.occupied_within(scan.endpoints[use], 0.05)))
            casts = m.cast_rays(scan.origin, way, max_range=100.0, at="cell")
            errors.append(np.abs(casts - far))
        truth = comparison.row(name)["truth"]
        for key, count in found.items():
            assert truth[key] == pytest.approx(count, abs=2), (name, key)
        assert truth["samples"] == truth["free"] + truth["occupied"] + truth["unknown"]
        every = np.concatenate(errors)
        assert truth["casts"] == len(every)
        assert truth["casts_within"] == pytest.approx(np.count_nonzero(every <= 0.1), abs=2)
        median = float(np.median(np.nan_to_num(every, nan=math.inf)))
        assert truth["median_error"] == pytest.approx(median, abs=1e-9)
        assert found["free"] > 10_000


def test_exact_truth_finds_a_map_that_lies(log: ndtree.Log) -> None:
    honest = ndtree.compare(log, ("fixed",), held_out=0, **OPTIONS)
    exact = honest.row("fixed")["exact"]
    assert honest.row("fixed")["truth"] is None
    assert exact["free"]["free"] > 0.95
    assert exact["inside"]["occupied"] > 0.8
    assert exact["auc"] > 0.98
    assert exact["thin"]["samples"] > 100
    assert exact["thin"]["found"] > 0.5
    for name in ("free", "near", "inside"):
        shares = exact[name]
        assert shares["samples"] > 50_000
        assert shares["free"] + shares["occupied"] + shares["unknown"] == pytest.approx(1.0)

    class Shifted(ndtree.FixedMap):
        """A map in which everything is half a metre from where it is."""

        def insert(self, points: Any, origin: Any, **more: Any) -> Any:
            return super().insert(points + 0.5, origin + 0.5, **more)

    lying = ndtree.compare(log, {"shifted": lambda: Shifted(dim=2, cell_size=0.1)}, held_out=0)
    of_lie = lying.row("shifted")["exact"]
    assert of_lie["inside"]["occupied"] < 0.5
    assert of_lie["auc"] < 0.7
    assert of_lie["thin"]["found"] < 0.5


def test_truth_by_cell_size_adds_up(comparison: ndtree.Comparison) -> None:
    by_size = comparison["truth_by_cell_size"]
    assert by_size["of"] == "adaptive"
    sizes = by_size["sizes"]
    assert len(sizes) > 2
    for row in comparison["maps"]:
        truth, name = row["truth"], row["map"]
        assert sum(size["endpoints"] for size in sizes) == truth["endpoints"]
        assert sum(size["endpoints_near"][name] for size in sizes) == pytest.approx(
            truth["endpoints_near"], abs=2
        )
        free, samples = sum(size["free"][name] for size in sizes), sum(size["samples"] for size in sizes)
        assert free / samples == pytest.approx(truth["free"] / truth["samples"], abs=0.02)
    assert "by the size of cells (adaptive)" in str(comparison)


def test_ratios_are_of_the_fixed_map_and_of_others_by_name(comparison: ndtree.Comparison) -> None:
    adaptive, fixed, coarse = (comparison.row(name) for name in ("adaptive", "fixed", "fixed@0.2"))
    ratios = comparison["ratios"]
    assert ratios["cells"] == adaptive["cells"] / fixed["cells"]
    assert ratios["updates"] == adaptive["updates"] / fixed["updates"]
    assert ratios["seconds"] == adaptive["seconds"]["median"] / fixed["seconds"]["median"]
    assert ratios["fixed@0.2"]["cells"] == adaptive["cells"] / coarse["cells"]


def test_json_csv_and_table_hold_the_figures(comparison: ndtree.Comparison) -> None:
    assert json.loads(comparison.to_json()) == comparison
    keys = "log dim branching scans scans_mapped beams parameters maps truth_by_cell_size ratios".split()
    assert list(comparison) == keys
    assert comparison["parameters"]["max_range"] == 12.0
    assert comparison["parameters"]["min_cell_size"] == 0.1
    rows = list(csv.DictReader(io.StringIO(comparison.to_csv())))
    assert [int(row["cells"]) for row in rows] == [row["cells"] for row in comparison["maps"]]
    assert float(rows[0]["truth_samples"]) == comparison["maps"][0]["truth"]["samples"]
    table = str(comparison)
    for row in comparison["maps"]:
        assert f"{row['cells']:,}" in table
        assert f"{100 * row['truth']['free'] / row['truth']['samples']:.2f} %" in table
    assert "nan" not in table and "None" not in table


def test_repeat_times_each_map_as_often_and_changes_nothing_else(log: ndtree.Log) -> None:
    calls: list[tuple[str, int, int]] = []
    scans = list(log)[:12]
    once = ndtree.compare(scans, ("adaptive", "fixed"), **OPTIONS)
    thrice = ndtree.compare(
        scans, ("adaptive", "fixed"), repeat=3, progress=lambda *call: calls.append(call), **OPTIONS
    )
    for one, three in zip(once["maps"], thrice["maps"]):
        assert (one["seconds"]["runs"], three["seconds"]["runs"]) == (1, 3)
        assert three["seconds"]["min"] <= three["seconds"]["median"] <= three["seconds"]["max"]
        assert one["updates"] == three["updates"]
    names = list(dict.fromkeys(call[0] for call in calls))
    runs = [f"{name}, run {run}" for run in (1, 2, 3) for name in ("adaptive", "fixed")]
    assert names == ["reading", *runs, "what the scans saw", "adaptive, truth", "fixed, truth"]


def test_octomap_takes_part_where_it_is(log: ndtree.Log) -> None:
    if not ndtree.has_octomap:
        with pytest.raises(RuntimeError, match="OctoMap was not there when ndtree was built"):
            ndtree.compare(log, ("adaptive", "octomap"))
        pytest.skip("the module was built without OctoMap")
    comparison = ndtree.compare(list(log)[:20], ("adaptive", "octomap", "octomap-scan"), **OPTIONS)
    beam_by_beam, once_a_scan = comparison.row("octomap"), comparison.row("octomap-scan")
    assert beam_by_beam["cells_pruned"] <= beam_by_beam["cells"]
    assert once_a_scan["updates"] < beam_by_beam["updates"]
    assert beam_by_beam["splits"] is None
    assert "cells_pruned" in comparison["ratios"]["octomap"]


@pytest.mark.parametrize(
    "call, error, message",
    [
        (lambda log: ndtree.compare(log, ("fancy",)), ValueError, "maps = 'fancy': must be one of adaptive"),
        (lambda log: ndtree.compare(log, ("fixed@wide",)), ValueError, "expected a cell size in metres"),
        (lambda log: ndtree.compare(log, ("fixed", "fixed")), ValueError, "must be different names"),
        (lambda log: ndtree.compare(log, ()), ValueError, "maps: must name at least one"),
        (lambda log: ndtree.compare(log, held_out=1), ValueError, "held_out = 1: must be 0 or at least 2"),
        (lambda log: ndtree.compare(log, held_out=-1), ValueError, "held_out = -1: must be >= 0"),
        (lambda log: ndtree.compare(log, repeat=0), ValueError, "repeat = 0: must be >= 1"),
        (lambda log: ndtree.compare(log, ("fixed",), colour=3), TypeError, "colour: no map has such"),
        (lambda log: ndtree.compare(log, range_sigma=-1.0), ValueError, "range_sigma = -1.0: must be"),
        (lambda log: ndtree.compare([]), ValueError, "log: no scans, expected at least one"),
        (lambda log: ndtree.compare([ndtree.Scan(np.ones((1, 2)), np.zeros(2)), log_3d()]), ValueError,
            "scan 1 is 3-D: must be 2-D"),
        (lambda log: ndtree.compare([ndtree.Scan(np.full((1, 2), 1e12), np.zeros(2))], ("fixed",)),
            ValueError, "scan 0: beam 0"),
    ],
)  # fmt: skip
def test_what_cannot_be_compared_is_refused(
    log: ndtree.Log, call: Callable[[Any], Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        call(log)


def log_3d() -> ndtree.Scan:
    return ndtree.Scan(np.ones((1, 3)), np.zeros(3))
