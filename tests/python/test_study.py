# SPDX-License-Identifier: BSD-3-Clause
"""A study's rows are what `compare` says of each job, no job is done twice, and none stops another."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from snippets import ROOT, blocks

pytest.importorskip("matplotlib")
if sys.version_info < (3, 11):
    pytest.importorskip("tomli")

from calling import cli

import ndtree
from ndtree.base.engines import ProcessEngine
from ndtree.study import StudyTable, load, run
from ndtree.study.run import _outcome, jobs_of

SMALL = """
[logs.office]
simulate = "office"
scans = 4
[maps.fixed]
min_cell_size = [0.2, 0.4]
"""


def written(folder: Path, text: str) -> Path:
    file = folder / "study.toml"
    file.write_text(text)
    return file


@pytest.mark.long
def test_the_page_s_study_is_what_compare_says(tmp_path: Path) -> None:
    text = blocks((ROOT / "docs" / "commands.md").read_text(), "toml")
    assert len(text) == 1
    study = load(written(tmp_path, text[0]))
    table = run(study, processes=2)
    assert not table.failed
    assert len(table.rows) == 6
    expected = ndtree.compare(
        ndtree.simulate("apartment", scans=10),
        {"rough": lambda: ndtree.FixedMap(dim=3, min_cell_size=0.2, range_sigma=0.05)},
        max_range=5.0,
    ).row("rough")
    row = next(row for row in table.rows if (row["log"], row["map"]) == ("rooms", "rough"))
    keys = ("cells", "updates", "splits", "merges", "truth", "claims", "exact", "memory_bytes")
    assert {key: row[key] for key in keys} == json.loads(json.dumps({key: expected[key] for key in keys}))
    sizes = {row["map"]: row["cells"] for row in table.rows if row["log"] == "office"}
    assert sizes["adaptive, min_cell_size 0.2"] < sizes["rough"] < 2.5 * sizes["adaptive, min_cell_size 0.1"]
    folder = tmp_path / "sizes"
    names = ["results", "table.csv", "table.json", "table.md", "truth.pdf", "truth.png"]
    assert sorted(path.name for path in folder.iterdir()) == names
    rows = list(csv.DictReader((folder / "table.csv").open()))
    assert [int(one["cells"]) for one in rows] == [one["cells"] for one in table.rows]
    assert json.loads((folder / "table.json").read_text())["rows"] == table.rows
    lines = (folder / "table.md").read_text().splitlines()
    assert len(lines) == 8 and len({line.count("|") for line in lines}) == 1


def test_nothing_is_done_twice(tmp_path: Path) -> None:
    study = load(written(tmp_path, SMALL))
    first = run(study)
    files = sorted((study.output / "results").iterdir())
    assert len(files) == 2
    files[0].write_text("{")  # As no run leaves it: it is done again.
    old = [file.stat().st_mtime_ns for file in files]
    again = run(study)
    times = [file.stat().st_mtime_ns > before for file, before in zip(files, old)]
    assert times == [True, False]
    for one, two in zip(first.rows, again.rows):
        assert {**one, "seconds": 0, "beams_per_second": 0, "resident_bytes": 0} == {
            **two, "seconds": 0, "beams_per_second": 0, "resident_bytes": 0,
        }  # fmt: skip


@pytest.mark.long
def test_a_killed_run_goes_on(tmp_path: Path) -> None:
    sizes = "min_cell_size = [0.2, 0.3, 0.1, 0.15, 0.12]"
    text = f'[logs.a]\nsimulate = "office"\nscans = 150\n[maps.fixed]\n{sizes}\n'
    file = written(tmp_path, text)
    results = tmp_path / "study-results" / "results"
    command = [sys.executable, "-m", "ndtree", "study", str(file), "--processes", "1"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        end = time.monotonic() + 60
        while not (results.is_dir() and list(results.glob("[!.]*.json"))) and time.monotonic() < end:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        process.wait(30)
    finally:
        process.kill()
        process.wait()
    left = {path: path.stat().st_mtime_ns for path in results.glob("[!.]*.json")}
    assert 1 <= len(left) < 5 and not (tmp_path / "study-results" / "table.csv").exists()
    table = run(load(file))
    assert len(table.done) == 5 and len(list(results.glob("*.json"))) == 5
    assert {path: path.stat().st_mtime_ns for path in left} == left


def test_a_job_is_known_by_what_it_depends_on(tmp_path: Path) -> None:
    def keys(text: str) -> list[str]:
        return [job.key() for job in jobs_of(load(written(tmp_path, text)))]

    log = tmp_path / "log.npz"

    def record(value: float) -> None:
        points = np.full((4, 2), value)
        np.savez(log, points=points, origins=np.zeros((1, 2)), offsets=np.array([0, 4]))

    record(1.0)
    text = '[logs.one]\npath = "log.npz"\n[maps.fixed]\n'
    (first,) = keys(text)
    assert keys(text.replace("logs.one", "logs.two")) == [first]  # What it is called does not matter.
    assert keys(text.replace("maps.fixed", "maps.x") + 'kind = "fixed"') == [first]
    others = [
        keys(text + "min_cell_size = 0.1"),
        keys(text.replace("fixed", "adaptive")),
        keys("held_out = 5\n" + text),
        keys(text.replace('npz"\n', 'npz"\nevery = 2\n')),
    ]
    record(2.0)
    others.append(keys(text))
    assert len({first, *(one for (one,) in others)}) == 6
    log.rename(tmp_path / "moved.npz")
    assert keys(text.replace("log.npz", "moved.npz")) == others[-1]


def test_a_job_that_fails_stops_no_other(tmp_path: Path) -> None:
    (tmp_path / "bad.log").write_text("FLASER 2 1 1 0 0\n")
    text = (
        SMALL
        + '[logs.missing]\npath = "missing.log"\n[logs.bad]\npath = "bad.log"\n[maps.x]\nrange_sigma = -1.0\n'
    )
    file = written(tmp_path, text)
    done = cli("study", file, "--processes", "2")
    assert done.exit_code == 1
    lines = " ".join(done.stderr.split()).split("ndtree: ")[1:]
    assert len(lines) == 7 and len(list((tmp_path / "study-results" / "results").glob("*.json"))) == 2
    assert sum("missing.log: No such file" in line for line in lines) == 3
    assert sum("bad.log: line 1" in line for line in lines) == 3
    assert sum("office: x: range_sigma = -1" in line for line in lines) == 1
    table = (tmp_path / "study-results" / "table.md").read_text()
    assert table.count("| failed |") == 7


def test_a_process_that_is_killed_is_a_job_that_failed(tmp_path: Path) -> None:
    engine = ProcessEngine(2, method="spawn", most_deaths=1)
    try:
        killed = engine.submit(signal.raise_signal, signal.SIGKILL)
        ended = engine.submit(os._exit, 3)
        left = {killed, ended}
        while left:
            left -= engine.done_of(left)
        assert _outcome(engine, killed, tmp_path)["error"] == "a task's process ended by SIGKILL"
        assert _outcome(engine, ended, tmp_path)["error"] == "a task's process ended with exit status 3"
    finally:
        engine.close()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[logs.a", "expected TOML"),
        ("", "logs: expected at least one table [logs.NAME]"),
        ('[logs.a]\nsimulate = "office"', "maps: expected at least one table [maps.NAME]"),
        ('logs = 3\n[maps.fixed]', "logs: expected at least one table"),
        (SMALL.replace("= 4", "= 0"), "logs.office.scans = 0: expected a whole number >= 1"),
        (SMALL.replace("= 4", "= true"), "logs.office.scans = True: expected a whole number >= 1"),
        (SMALL.replace('"office"', '"castle"'), "logs.office.simulate = 'castle': expected one of office,"),
        (SMALL.replace("scans", "scanz"), "logs.office.scanz = 4: expected no such key, but scans, seed"),
        (SMALL.replace("simulate", "path = 'x'\nsimulate"), "logs.office: expected either path or simulate"),
        (SMALL.replace("0.4]", "0.2]"), "maps.fixed.min_cell_size = [0.2, 0.2]: expected a number, or"),
        (SMALL.replace("[0.2, 0.4]", '"fine"'), "maps.fixed.min_cell_size = 'fine': expected a number"),
        (SMALL + "colour = 1", "maps.fixed.colour = 1: expected no such key, but kind, branching"),
        ("held_out = 1\n" + SMALL, "held_out = 1: expected 0, or at least 2"),
        ("held_out = 2.5\n" + SMALL, "held_out = 2.5: expected a whole number >= 0"),
        ('pictures = ["bmp"]\n' + SMALL, "pictures = ['bmp']: expected a list, each one of png, pdf, svg"),
        ("speed = 1\n" + SMALL, "speed = 1: expected no such key"),
        (SMALL.replace("scans", "max_range = 0\nscans"), "logs.office.max_range = 0: expected a number > 0"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_named_with_key_value_and_what_was_expected(
    tmp_path: Path, text: str, said: str
) -> None:
    file = written(tmp_path, text)
    done = cli("study", file)
    assert done.exit_code == 1
    printed = " ".join(done.stderr.split())
    assert printed.startswith(f"ndtree: {file}: ") and said in printed
    assert os.listdir(tmp_path) == ["study.toml"]


def test_tables_escape_and_align(tmp_path: Path) -> None:
    table = StudyTable(
        tmp_path, [{"log": "a|b", "map": "m", "error": "no"}, {"log": "c", "map": "n", "cells": 5}]
    )
    assert "a\\|b" in table.to_markdown() and "a|b" in str(table)
    assert len(table.failed) == len(table.done) == 1
