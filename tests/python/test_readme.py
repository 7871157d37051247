# SPDX-License-Identifier: BSD-3-Clause
"""What README.md shows is run: the Python lines, the C++ lines, and the files that it names."""

import json
import os
import re
import subprocess
import sys

import pytest
from snippets import ROOT, blocks

pytest.importorskip("typer")

from calling import cli

README = (ROOT / "README.md").read_text()


def test_is_short():
    assert len(README.splitlines()) < 130


def test_python_runs(tmp_path):
    (code,) = blocks(README, "python")
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    cells, states, median = done.stdout.splitlines()
    assert int(cells.split()[0]) > 1000
    assert states.strip("[]").split() == ["0", "-1"]
    assert 0.5 < float(median) < 26
    assert (tmp_path / "office.ndt").stat().st_size > 1000


def test_programs_run(tmp_path, monkeypatch):
    """All but the page, which has tests of its own."""
    monkeypatch.chdir(tmp_path)
    commands = [line.split("#")[0].split() for line in blocks(README, "sh")[1].splitlines()]
    assert [command[:2] for command in commands] == [
        ["ndtree", name] for name in "simulate map view plan convert clean live compare".split()
    ]
    for command in commands:
        if command[1] == "view":
            continue
        more = ["--scans", "40"] if command[1] == "simulate" else []
        done = cli(*command[1:], *more)
        assert done.exit_code == 0, (command, done.stderr)
    agreement = re.search(r"of the cells observed in both, alike in both: ([0-9.]+) %", done.stdout)
    assert agreement and 98 < float(agreement[1]) < 100, "all but single thin things"


def test_commands_exist():
    for line in blocks(README, "sh")[0].splitlines():
        command = ROOT / line.split()[0]
        assert os.access(command, os.X_OK), command


def test_figures_were_measured():
    pages = {
        "README.md": ["claim", "summary", "machine", "losses"],
        "docs/benchmarks.md": ["comparison", "machine", "truth", "losses", "branching", "parts"],
        "docs/peers.md": ["octomap"],
    }
    for page, expected in pages.items():
        text = (ROOT / page).read_text()
        names = re.findall(r"<!-- figures: (\w+) -->", text)
        assert names == expected
        for name in names:
            content = re.search(rf"<!-- figures: {name} -->\n(.*?)<!-- end -->", text, re.DOTALL)[1]
            assert len(content.strip()) > 40, (page, name)


def test_the_summary_s_figures_are_those_of_the_whole_table():
    """Each number of a row of the small table stands in the row of the same log and map of the large one."""

    def rows(page):
        log, found = "", {}
        for line in (ROOT / page).read_text().splitlines():
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            if len(cells) >= 8 and cells[1] in ("adaptive", "fixed", "OctoMap"):
                log = cells[0].partition(": ")[2] or cells[0] or log
                found[log, cells[1]] = cells[2:]
        return found

    small, large = rows("README.md"), rows("docs/benchmarks.md")
    assert len(small) == 6 and len(large) == 24
    for key, cells in small.items():
        assert all(cell in large[key] for cell in cells), key
    losses = re.findall(r"^\| [\w ]+ \| \d of 8 \| (.*?) \| (.*?) \| (.*?) \|$", README, re.MULTILINE)
    assert losses
    for log, adaptive, fixed in losses:
        assert adaptive in large[log, "adaptive"] and fixed in large[log, "fixed"], log


def test_losses_are_the_largest_of_all_logs():
    """Of the committed table's logs, worst first, on both pages alike; memory is of the README's own logs."""
    truth = json.loads((ROOT / "tools/truth_table.json").read_text())
    keys = {
        "seen but unknown": ("seen_unknown", -1),
        "free but unseen": ("free_unseen", -1),
        "ray casts": ("surfaces_within", 1),
        "accuracy": ("accuracy", 1),
    }
    row = re.compile(r"^\| ([\w ]+) \| (\d+) of 18 \| (.*?) \| ([\d.]+) % \| ([\d.]+) % \|$", re.MULTILINE)
    rows = row.findall(README)
    assert rows == row.findall((ROOT / "docs/benchmarks.md").read_text()) and len(rows) >= 3
    sizes = []
    for measure, count, log, adaptive, fixed in rows:
        key, sign = keys.pop(measure)
        lost = {
            name: round(sign * (round(maps["fixed"][key], 1) - round(maps["adaptive"][key], 1)), 1)
            for name, maps in truth.items()
        }
        sizes.append(lost[log])
        assert lost[log] == max(lost.values()) == round(sign * (float(fixed) - float(adaptive)), 1)
        assert int(count) == sum(loss > 0 for loss in lost.values())
    assert sizes == sorted(sizes, reverse=True) and len(truth) == 18
    for key, sign in keys.values():  # What is not in the table is lost nowhere.
        assert all(sign * (maps["fixed"][key] - maps["adaptive"][key]) < 0.1 for maps in truth.values())


def test_speeds_beside_others_are_those_of_the_page_of_peers():
    """Each number of the README's table stands in the row of the same work of the page's."""
    pages = [(ROOT / page).read_text() for page in ("README.md", "docs/peers.md")]
    small, large = (
        re.findall(r"^\| ((?:7-Scenes|Intel|Livox Avia),.*?) \|(.*)\|$", page, re.M) for page in pages
    )
    assert len(small) == 3
    for work, cells in small:
        (row,) = [found for name, found in large if name.partition(",")[0] == work.partition(",")[0]]
        for number in re.findall(r"[\d.,]*\d", cells):
            assert re.search(rf"(?<![\d.]){re.escape(number)}(?![\d.])", row), (work, number)


def test_the_answer_that_is_most_often_wrong_without_a_warning_is_told():
    trials = json.loads((ROOT / "tools/trials_table.json").read_text())
    worst = max(trials.values(), key=lambda one: one["counts"][3] / one["trials"])
    assert f"({worst['counts'][3]} of {worst['trials']})" in README
