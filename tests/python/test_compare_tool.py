# SPDX-License-Identifier: BSD-3-Clause
"""ndtree-compare: its report agrees with the log and with itself; mistakes get one line and a status."""

import csv
import gzip
import io
import json
import math
import os
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
PLACES = ["build*/tools/compare", "build*", "build*/tools", "build/*/tools/compare", "build/*/tools"]

PARAMETERS = {
    "min_cell_size", "max_cell_size", "range_sigma", "range_sigma_quadratic", "probability_min",
    "probability_max", "log_odds_min", "log_odds_max", "miss_given_occupied", "hit_given_free",
    "significance", "merge_free_below", "merge_occupied_above", "max_range", "held_out", "repeat",
    "sample_spacing", "sample_margin", "endpoint_radius", "cast_tolerance", "cast_overshoot", "no_return",
    "split_probability", "merge_loss", "inherited_beams", "noise_sigmas", "evidence_memory", "evidence_prior",
    "free_memory", "scan_beams", "known_evidence", "sample_beams",
    "probability_clip", "change_probability", "evidence_half_life", "covered_share", "coverage_cells",
    "partial_probability", "beam_divergence", "max_memory",
    "claims_samples", "claims_spacings", "claims_tolerance", "claims_margin", "claims_middle", "claims_seed",
}  # fmt: skip
TRUTH = {
    "free", "occupied", "unknown", "samples", "endpoints_near", "endpoints", "casts_within", "casts",
    "median_error", "surfaces_within", "surface_error", "balanced_accuracy", "log_score",
}  # fmt: skip
CLAIMS = {
    "points", "seen", "free", "free_and_unseen", "unknown_and_seen", "free_unseen", "seen_unknown",
    "wrong_volume",
}  # fmt: skip
MAP = {
    "map", "refinement", "cells", "leaves", "nodes", "updates", "splits", "merges", "seconds",
    "beams_per_second", "memory_bytes", "bytes_per_node", "resident_bytes", "truth", "claims", "cell_sizes",
}  # fmt: skip


def find_executable():
    """The program that NDTREE_COMPARE names, else the last one that was built."""
    if named := os.environ.get("NDTREE_COMPARE"):
        return named
    built = [file for place in PLACES for file in ROOT.glob(f"{place}/ndtree-compare") if file.is_file()]
    return str(max(built, key=lambda file: file.stat().st_mtime)) if built else None


EXECUTABLE = find_executable()
pytestmark = pytest.mark.skipif(
    EXECUTABLE is None, reason="ndtree-compare is not built: no NDTREE_COMPARE, and nothing in build*/"
)


def call(*arguments):
    return subprocess.run(
        [EXECUTABLE, *map(str, arguments)], capture_output=True, text=True, errors="replace", timeout=600
    )


def expect_complaint(result, status, *parts):
    """Nothing but one line on stderr, which holds the parts."""
    assert result.returncode == status, result.stderr
    assert result.stdout == ""
    assert result.stderr.startswith("ndtree-compare: ")
    assert result.stderr.count("\n") == 1 and result.stderr.endswith("\n")
    for part in parts:
        assert str(part) in result.stderr


# A log of 23 scans of 40 beams in a square room. In each scan a beam is invalid, and one did not return.
SCANS, BEAMS = 23, 40


def room(dim, num_beams=BEAMS):
    """Origins (S, dim), end points (S, B, dim) and returned (S, B) of the log."""
    random = np.random.default_rng(4)
    print("seed 4")
    origins = np.zeros((SCANS, dim))
    origins[:, :2] = random.uniform(-1.0, 1.0, (SCANS, 2))
    directions = random.normal(size=(SCANS, num_beams, dim))
    if dim == 3:
        directions[..., 2] *= 0.2
    directions /= np.abs(directions[..., :2]).max(axis=-1, keepdims=True)
    directions[..., :2][directions[..., :2] == 0.0] = 1e-9
    gap = (3.013 * np.sign(directions[..., :2]) - origins[:, None, :2]) / directions[..., :2]
    points = origins[:, None] + gap.min(axis=-1, keepdims=True) * directions
    returned = np.ones((SCANS, num_beams), bool)
    returned[:, 7] = False
    points[:, 3] = np.nan
    return origins, points, returned


def text_log(dim=2, num_beams=BEAMS):
    origins, points, returned = room(dim, num_beams)
    lines = ["# a room"]
    for origin, beams, flags in zip(origins, points, returned):
        for point, flag in zip(beams, flags):
            lines.append(" ".join(repr(float(x)) for x in (*origin, *point)) + f" {int(flag)}")
    return "\n".join(lines) + "\n"


def npz_arrays(dim=3):
    origins, points, returned = room(dim)
    return {
        "origins": origins,
        "points": points.reshape(-1, dim),
        "offsets": np.arange(SCANS + 1) * BEAMS,
        "no_return": ~returned.reshape(-1),
        "stamps": np.array(["not", "numbers"]),
    }


def write_npz(path, arrays, compressed=True):
    with open(path, "wb") as file:
        (np.savez_compressed if compressed else np.savez)(file, **arrays)
    return path


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "room.txt"
    path.write_text(text_log())
    return path


def report_of(log, *arguments):
    target = log.parent / "report.json"
    result = call(log, "--repeat", "1", "--json", target, *arguments)
    assert (result.returncode, result.stderr) == (0, "")
    return json.loads(target.read_text()), result.stdout


def has_octomap():
    """Whether the program knows OctoMap: if not, the call is wrong before the log is looked for."""
    return call("no such log", "--maps", "octomap").returncode == 1


@pytest.mark.parametrize("dim, branching", [(2, 2), (2, 4), (3, 3)])
def test_the_report_agrees_with_the_log_and_with_itself(tmp_path, dim, branching):
    beams = 120  # Enough that in 3-D cells of four smallest ones are seen.
    log = tmp_path / "room.txt"
    log.write_text(text_log(dim, beams))
    report, table = report_of(log, "--branching", branching, "--max-range", 30, "--no-return", "free")

    assert report["log"] == str(log)
    assert (report["dim"], report["branching"]) == (dim, branching)
    assert (report["scans"], report["scans_mapped"]) == (SCANS, SCANS - 2)  # scans 9 and 19 are held out
    mapped = SCANS - 2
    assert report["beams"] == {
        "returned": mapped * (beams - 2), "not_returned": mapped, "beyond_max_range": 0, "invalid": mapped,
    }  # fmt: skip
    assert set(report["parameters"]) == PARAMETERS
    assert report["parameters"]["max_range"] == 30
    names = [entry["map"] for entry in report["maps"]]
    assert names[:2] == ["adaptive", "fixed"]
    assert (names[2:] == ["octomap"]) == has_octomap()

    for entry in report["maps"]:
        octomap = entry["map"] == "octomap"
        assert set(entry) == MAP | ({"cells_pruned"} if octomap else set())
        truth = entry["truth"]
        assert set(truth) == TRUTH
        assert truth["samples"] == truth["free"] + truth["occupied"] + truth["unknown"] > 1000
        assert truth["endpoints"] == truth["casts"] == 2 * (beams - 2)
        assert truth["endpoints_near"] <= truth["endpoints"]
        assert truth["casts_within"] <= truth["casts"]
        assert truth["surfaces_within"] <= truth["casts"]
        assert truth["free"] > 0.1 * truth["samples"]
        claims = entry["claims"]
        assert set(claims) == CLAIMS
        wrong = claims["free_and_unseen"], claims["unknown_and_seen"]
        assert claims["points"] == report["parameters"]["claims_samples"] == 40_000
        assert claims["seen"] > 1000 and claims["free"] > 300
        assert math.isclose(claims["free_unseen"], wrong[0] / claims["free"])
        assert math.isclose(claims["seen_unknown"], wrong[1] / claims["seen"])
        assert math.isclose(claims["wrong_volume"], sum(wrong) / claims["seen"])
        for share in ("free_unseen", "seen_unknown", "wrong_volume"):
            assert f"{100 * claims[share]:.1f} %" in table
        assert sum(size["leaves"] for size in entry["cell_sizes"]) == entry["leaves"]
        if not octomap:
            assert sum(size["observed"] for size in entry["cell_sizes"]) == entry["cells"]
            assert entry["nodes"] == 1 + (entry["leaves"] - 1) * branching**dim // (branching**dim - 1)
        sizes = [size["size"] for size in entry["cell_sizes"]]
        assert sizes == sorted(sizes, reverse=True)
        seconds = entry["seconds"]
        assert seconds["runs"] == 1
        assert 0 < seconds["min"] <= seconds["median"] <= seconds["max"]
        assert math.isclose(entry["beams_per_second"] * seconds["median"], mapped * (beams - 1))
        assert math.isclose(entry["bytes_per_node"] * entry["nodes"], entry["memory_bytes"])
        assert f"{entry['cells']:,}" in table and f"{entry['updates']:,}" in table

    adaptive, fixed = report["maps"][:2]
    observed = [size["size"] for size in fixed["cell_sizes"] if size["observed"]]
    assert observed == [pytest.approx(0.05)]
    assert adaptive["splits"] > 0 and fixed["splits"] == fixed["merges"] == 0
    for key in ("cells", "nodes", "updates", "memory_bytes"):
        assert math.isclose(report["ratios"][key], adaptive[key] / fixed[key])
    assert report["ratios"]["cells"] < 0.5 and report["ratios"]["updates"] < 0.5


@pytest.mark.parametrize("dim", [2, 3])
def test_claims_are_those_of_the_python_module(tmp_path, dim):
    ndtree = pytest.importorskip("ndtree")
    log = tmp_path / "room.txt"
    log.write_text(text_log(dim))
    maps = ["adaptive", "paper", "fixed"] + ["octomap"] * (has_octomap() and ndtree.has_octomap)
    report, table = report_of(log, "--maps", ",".join(maps), "--max-range", 3.1)
    theirs = ndtree.compare(ndtree.read(log), maps, max_range=3.1)
    for entry, row in zip(report["maps"], theirs["maps"]):
        assert entry["map"] == row["map"]
        assert entry["claims"] == row["claims"]
        assert [*entry["truth"], "hit_log_score"] == list(row["truth"])
        for key, value in entry["truth"].items():
            assert value == row["truth"][key] or math.isclose(value, row["truth"][key], rel_tol=1e-12), key
        assert set(entry) == set(row)
    for label in ("free but unseen", "seen but unknown", "wrong volume"):
        assert label in table


def test_octomap_counts_as_the_fixed_map_does(log):
    if not has_octomap():
        pytest.skip("ndtree-compare was built without OctoMap")
    # With next to no noise nothing behind an end point is updated, which OctoMap never does.
    report, table = report_of(
        log,
        "--maps",
        "adaptive,fixed,octomap,octomap-scan,octomap-scan-lazy,octomap-scan-discretized",
        "--range-sigma",
        1e-6,
    )
    adaptive, fixed, octomap, scan, lazy, discretized = report["maps"]
    assert octomap["cells"] == pytest.approx(fixed["cells"], rel=0.01)
    assert octomap["updates"] == pytest.approx(fixed["updates"], rel=0.01)
    assert octomap["cells_pruned"] <= octomap["leaves"] <= octomap["cells"]
    assert scan["updates"] == lazy["updates"] < octomap["updates"]
    assert scan["cells"] == lazy["cells"] == lazy["leaves"] == octomap["cells"]
    assert discretized["updates"] <= lazy["updates"]
    for entry in (octomap, scan, lazy, discretized):
        assert entry["splits"] is None and entry["merges"] is None
        ratios = report["ratios"][entry["map"]]
        assert math.isclose(ratios["cells"], adaptive["cells"] / entry["cells"])
        assert math.isclose(ratios["cells_pruned"], adaptive["cells"] / entry["cells_pruned"])
    assert "once per scan" in table


def as_both_read_it(path):
    """What the program and the package say of an .npz: scans, dimension, beams, truth; None if refused."""
    ndtree = pytest.importorskip("ndtree")
    target = path.parent / "both.json"
    arguments = ("--maps", "fixed", "--held-out", 3, "--no-return", "free", "--repeat", 1)
    result = call(path, *arguments, "--json", target)
    try:
        reports = [None, ndtree.compare(ndtree.read(path), ["fixed"], held_out=3, no_return="free")]
    except ValueError as error:
        assert str(path) in str(error) or "scan" in str(error)
        reports = [None, None]
    if result.returncode == 0:
        reports[0] = json.loads(target.read_text())
    else:
        expect_complaint(result, 1, path)
    keys = ("dim", "scans", "scans_mapped", "beams", "maps")
    figures = [report and {key: report[key] for key in keys} for report in reports]
    for of in filter(None, figures):
        (row,) = of["maps"]
        of["maps"] = [row[key] for key in ("cells", "nodes", "updates", "claims", "cell_sizes")]
        sums = ("log_score", "hit_log_score")  # Added up in another order.
        of["truth"] = {key: value for key, value in row["truth"].items() if key not in sums}
    return figures


def layouts():
    """Archives of one room that differ in types, orders and dimensions; and others that are refused."""
    plane, space = npz_arrays(2), npz_arrays(3)
    for arrays in (plane, space):
        del arrays["stamps"]
    lifted = {
        **plane,
        "origins": np.pad(plane["origins"], ((0, 0), (0, 1)), constant_values=0.25),
        "points": np.pad(plane["points"], ((0, 0), (0, 1)), constant_values=0.5),
    }
    endless = lifted["points"].copy()
    endless[5, 2] = np.inf
    return {
        "plane": plane,
        "space": space,
        "float32": {**space, "points": space["points"].astype(np.float32)},
        "origins of float32": {**space, "origins": space["origins"].astype(np.float32)},
        "columns": {**space, "points": np.asfortranarray(space["points"])},
        "unsigned": {**space, "offsets": space["offsets"].astype(np.uint16)},
        "every beam returned": {key: value for key, value in space.items() if key != "no_return"},
        "two heights": lifted,
        "an infinite height": {**lifted, "points": endless},
        "scans without beams": {**plane, "offsets": np.r_[np.zeros(5, int), plane["offsets"][5:]]},
        "points of whole numbers": {**space, "points": np.nan_to_num(space["points"]).astype(int)},
        "origins of whole numbers": {**space, "origins": space["origins"].astype(int)},
        "flags of whole numbers": {**space, "no_return": space["no_return"].astype(np.uint8)},
        "offsets that are true": {**space, "offsets": space["offsets"] > 0},
        "offsets of floats": {**space, "offsets": space["offsets"].astype(float)},
        "points with other columns": {**space, "points": plane["points"]},
    }


@pytest.mark.parametrize("layout", layouts())
def test_both_readers_of_npz_read_the_same(tmp_path, layout):
    ours, theirs = as_both_read_it(write_npz(tmp_path / "log.npz", layouts()[layout]))
    assert (ours is None) == (layout in list(layouts())[-6:])
    assert ours == theirs


def test_carmen_logs_are_read(tmp_path):
    records = "".join(
        f"FLASER 5 2.0 2.0 2.0 2.0 90.0 {x} 0 0 {x} 0 0 {x} host {x}\n" for x in np.linspace(0.0, 0.2, 20)
    )
    for name, content in (
        ("log.clf", records.encode()),
        ("log.log", b"# comment\nPARAM robot_width 0.5 host 0\n" + records.encode()),
        ("packed", gzip.compress(records.encode())),
    ):
        (tmp_path / name).write_bytes(content)
        report, _ = report_of(tmp_path / name, "--no-return", "free")
        assert (report["dim"], report["scans"], report["scans_mapped"]) == (2, 20, 18)
        assert (report["beams"]["returned"], report["beams"]["not_returned"]) == (72, 18)


def test_dimension_can_be_forced(log, tmp_path):
    report, _ = report_of(log, "--dim", 3, "--maps", "adaptive")
    assert report["dim"] == 3
    solid = write_npz(tmp_path / "solid.npz", npz_arrays(3))
    assert report_of(solid, "--maps", "adaptive")[0]["dim"] == 3
    expect_complaint(call(solid, "--dim", 2), 1, solid, "z = ", "--dim 2")


def test_limit_and_held_out_choose_the_scans(log):
    for limit, held_out, scans, mapped in ((10, 10, 10, 9), (9, 10, 9, 9), (23, 0, 23, 23), (99, 2, 23, 12)):
        report, _ = report_of(log, "--limit", limit, "--held-out", held_out, "--maps", "adaptive")
        assert (report["scans"], report["scans_mapped"]) == (scans, mapped)
        assert (report["maps"][0]["truth"]["casts"] == 0) == (scans == mapped)
        assert (report["maps"][0]["truth"]["median_error"] is None) == (scans == mapped)


def test_max_range_cuts_beams(log):
    report, _ = report_of(log, "--max-range", 3, "--maps", "fixed", "--no-return", "free")
    assert report["beams"]["beyond_max_range"] > 0
    assert sum(report["beams"].values()) == report["scans_mapped"] * BEAMS


def test_csv_has_the_figures_of_the_json(log, tmp_path):
    target = tmp_path / 'a,"b".csv'
    report, _ = report_of(log, "--csv", target)
    rows = list(csv.DictReader(io.StringIO(target.read_text())))
    assert [row["map"] for row in rows] == [entry["map"] for entry in report["maps"]]
    for row, entry in zip(rows, report["maps"]):
        assert None not in row and None not in row.values()
        assert row["log"] == str(log)
        assert int(row["cells"]) == entry["cells"]
        assert float(row["seconds_median"]) == entry["seconds"]["median"]
        assert int(row["truth_free"]) == entry["truth"]["free"]
        assert float(row["parameter_range_sigma"]) == 0.03
    assert not list(tmp_path.glob("*.tmp"))


def test_options_reach_the_map_and_the_report(log):
    arguments = {
        "min_cell_size": 0.1, "max_cell_size": 0.8, "range_sigma": 0.02, "range_sigma_quadratic": 0.001,
        "probability_min": 0.35, "probability_max": 0.8, "log_odds_min": -3.0, "log_odds_max": 4.0,
        "miss_given_occupied": 0.1, "hit_given_free": 0.02, "significance": 0.9, "merge_free_below": 0.1,
        "merge_occupied_above": 0.9, "split_probability": 0.6, "merge_loss": 3.0, "inherited_beams": 1.5,
        "noise_sigmas": 0.5, "evidence_memory": 100.0, "evidence_prior": 0.25,
        "free_memory": 30.0, "scan_beams": 20.0,
        "change_probability": 0.001, "evidence_half_life": 500.0, "covered_share": 0.5, "coverage_cells": 4.0,
        "partial_probability": 0.6, "beam_divergence": 0.05, "max_memory": 1e9,
    }  # fmt: skip
    flags = [part for name, value in arguments.items() for part in ("--" + name.replace("_", "-"), value)]
    report, _ = report_of(log, *flags)
    assert {name: report["parameters"][name] for name in arguments} == arguments
    observed = [size["size"] for size in report["maps"][0]["cell_sizes"] if size["observed"]]
    assert min(observed) >= 0.1 and max(observed) <= 0.8


WRONG_CALLS = [
    ([], "LOG"), (["--world", "office", "LOG"], "LOG"), (["--world", "castle"], "castle"),
    (["LOG", "--no-such-option"], "no-such-option"), (["LOG", "SECOND"], "SECOND"),
    (["LOG", "--min-cell-size", "small"], "min-cell-size"),
    (["LOG", "--min-cell-size", "-1"], "min_cell_size = -1.0: must be in [1e-09, 1000000] m"),
    (["LOG", "--max-cell-size", "0.01"], "max_cell_size"), (["LOG", "--range-sigma", "nan"], "range_sigma"),
    (["LOG", "--max-range", "0"], "max_range = 0.0: must be > 0 m"),
    (["LOG", "--branching", "5"], "branching"), (["LOG", "--branching", "2.5"], "branching"),
    (["LOG", "--dim", "4"], "dim"), (["LOG", "--held-out", "1"], "held_out = 1.0: must be 0"),
    (["LOG", "--held-out", "-3"], "held-out"), (["LOG", "--repeat", "0"], "repeat"),
    (["LOG", "--limit", "0"], "limit"),
    (["LOG", "--maps", "adaptive,best"], "'best' must be one of adaptive, paper, fixed, octomap"),
    (["LOG", "--maps", "fixed,fixed"], "'fixed' must not be named twice"), (["LOG", "--maps", ","], "maps"),
    (["LOG", "--json", "LOG"], "overwrite"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "part"), WRONG_CALLS)
def test_a_wrong_call_is_status_2_and_one_line(log, arguments, part):
    before = log.read_bytes()
    expect_complaint(call(*(str(log) if argument == "LOG" else argument for argument in arguments)), 2, part)
    assert log.read_bytes() == before


def npz_with(**changes):
    arrays = npz_arrays()
    for name, value in changes.items():
        if value is None:
            del arrays[name]
        else:
            arrays[name] = value
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def zip_with(method, content=b"no array"):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as file:
        file.writestr("origins.npy", content)
    return buffer.getvalue()


def flipped(data, at):
    return data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :]


TEXT = text_log().encode()
PACKED = gzip.compress(TEXT)
NPZ = npz_with()
BAD_LOGS = {
    "empty": (b"", ["empty", "expected a CARMEN log"]),
    "blank": (b"\n\n# nothing\n", ["no line with numbers"]),
    "words": (b"Lorem ipsum\ndolor\n", ["no FLASER or ROBOTLASER1 record in 2 lines"]),
    "binary": (bytes(range(256)), ["neither text nor a zip"]),
    "three numbers": (b"1 2 3\n", ["line 1", "found 3"]),
    "a word in line 4": (b"0 0 1 1\n0 0 1 2\n\n0 0 x 2\n", ["line 4", "column 3", "'x'"]),
    "a control character": (b"0 0 1 1\n0 0 \x1b[31m 2\n", ["neither text nor a zip"]),
    "another dimension": (b"0 0 1 1\n0 0 0 1 1 1\n", ["line 2", "found 6"]),
    "carmen cut off": (b"FLASER 3 1.0 1.0", ["line 1", "FLASER", "expected 3 ranges"]),
    "far away": (b"0 0 1 1\n1e300 0 1e300 1\n", ["scan 1", "beam 0"]),
    "gzip cut off": (PACKED[: len(PACKED) // 2], ["damaged gzip", "cut off"]),
    "gzip damaged": (flipped(PACKED, len(PACKED) // 2), ["damaged gzip"]),
    "gzip checksum": (flipped(PACKED, len(PACKED) - 6), ["damaged gzip"]),
    "gzip of nothing": (gzip.compress(b""), ["empty"]),
    "npz cut off": (NPZ[: len(NPZ) // 2], ["zip is cut off or damaged"]),
    "npz cut at the end": (NPZ[:-5], ["zip is"]),
    "npz damaged": (flipped(NPZ, len(NPZ) // 3), ["points.npy", "damaged"]),
    "npz without points": (npz_with(points=None), ["no array 'points'"]),
    "npz of words": (npz_with(points=np.array(["a", "b"])), ["points.npy", "type '<U1'"]),
    "npz of big endians": (npz_with(origins=np.zeros((SCANS, 3), ">f8")), ["origins.npy", "'>f8'"]),
    "npz of objects": (npz_with(origins=np.array([{}], object)), ["origins.npy", "type '|O'"]),
    "npz of 4-D points": (npz_with(points=np.zeros((9, 4))), ["points: float64 (9, 4)", "(beams, 3)"]),
    "npz of 3 dimensions": (npz_with(points=np.zeros((9, 3, 2))), ["points.npy", "at most two dimensions"]),
    "npz with few flags": (npz_with(no_return=np.zeros(5, bool)), ["no_return: bool (5,)", "(920,)"]),
    "npz with few offsets": (npz_with(offsets=np.arange(9)), ["offsets: int64 (9,)", "24 whole numbers"]),
    "npz with falling offsets": (npz_with(offsets=np.r_[0, 80, 40 * np.arange(2, 24)[::-1]]), ["offsets[3]"]),
    "npz with long offsets": (npz_with(offsets=np.arange(SCANS + 1) * 41), ["offsets[23] = 943", "920"]),
    "npz of no scans": (npz_with(origins=np.zeros((0, 3)), points=np.zeros((0, 3)), offsets=np.zeros(1, int),
                                 no_return=np.zeros(0, bool)), ["no scans"]),
    "zip of bzip2": (zip_with(zipfile.ZIP_BZIP2), ["origins.npy", "compression method 12"]),
    "zip of text": (zip_with(zipfile.ZIP_STORED), ["origins.npy", "expected a .npy file"]),
    "zip of a stub": (zip_with(zipfile.ZIP_STORED, b"\x93NUMPY\x01\x00\xff\xff{'descr'"), ["origins.npy"]),
    "zip of nothing": (b"PK\x05\x06" + bytes(18), ["no array 'origins'"]),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_LOGS)
def test_a_bad_log_is_status_1_and_one_line(tmp_path, name):
    content, parts = BAD_LOGS[name]
    log = tmp_path / "bad.log"
    log.write_bytes(content)
    expect_complaint(call(log, "--repeat", 1), 1, log, *parts)


def test_missing_files_and_folders_are_status_1(log, tmp_path):
    expect_complaint(call(tmp_path / "none.log"), 1, "none.log: no such file")
    expect_complaint(call(tmp_path), 1, f"{tmp_path}: is a folder")
    expect_complaint(call(log, "--json", tmp_path / "none" / "a.json"), 1, "a.json: cannot be written")
    expect_complaint(call(log, "--csv", tmp_path), 1, "cannot be written: is a folder")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["room.txt"]


def test_odd_bytes_in_a_complaint_are_replaced(tmp_path):
    log = tmp_path / "bad.log"
    log.write_bytes(b"0 0 1 1\n" * 1000 + b"0 0 \x1b[31m 2\n")
    result = call(log)
    expect_complaint(result, 1, "line 1001")
    assert "\x1b" not in result.stderr


@pytest.mark.parametrize("make", [lambda room: room(0.2, scans=341), lambda room: room(0.01, gate=True)])
def test_the_log_decides_what_beams_without_return_say(make, tmp_path):
    ndtree = pytest.importorskip("ndtree")
    from test_no_returns import room, written

    from ndtree.tuning.first_look import first_look

    path = written(make(room), tmp_path / "log.npz")
    expected = first_look(ndtree.read(path)).no_returns
    report = tmp_path / "report.json"
    done = call(path, "--maps", "fixed", "--held-out", "0", "--repeat", "1", "--json", report)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == expected.text
    assert json.loads(report.read_text())["parameters"]["no_return"] == expected.choice
    assert expected.beams > 0
