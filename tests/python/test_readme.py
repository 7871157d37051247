# SPDX-License-Identifier: BSD-3-Clause
"""What README.md shows is run: the Python lines, the C++ lines, and the files that it names."""

import gzip
import os
import re
import subprocess
import sys

import numpy as np
from snippets import ROOT, blocks, links, run_cpp

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


def test_cpp_compiles_and_runs(tmp_path):
    (code,) = blocks(README, "cpp")
    assert run_cpp([code], tmp_path, end="return hit ? 0 : 1;") == 0


def test_programs_run(tmp_path):
    """On a log of a square room; all but the page, which has tests of its own."""
    angles = np.deg2rad(np.arange(180) - 90.0)
    ranges = 3.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    readings = " ".join(f"{r:.3f}" for r in ranges)
    with gzip.open(tmp_path / "intel.log.gz", "wt") as log:
        for k in range(12):
            log.write(f"FLASER 180 {readings} 0 0 {0.5 * k} 0 0 0 {k} host {k}\n")
    commands = [line.split("#")[0].split() for line in blocks(README, "sh")[1].splitlines()]
    assert [command[:2] for command in commands] == [
        ["ndtree", name] for name in ("map", "view", "convert", "compare")
    ]
    for command in commands:
        if command[1] == "view":
            continue
        call = [sys.executable, "-m", "ndtree.cli", *command[1:]]
        done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, (command, done.stderr)
        if command[1] == "convert":  # What is compared next is another's map.
            for made, other in (("intel.yaml", "other.yaml"), ("intel.pgm", "other.pgm")):
                (tmp_path / other).write_bytes((tmp_path / made).read_bytes())
    assert "100" in done.stdout


def test_commands_and_links_exist():
    for line in blocks(README, "sh")[0].splitlines():
        command = ROOT / line.split()[0]
        assert os.access(command, os.X_OK), command
    assert len(links(README)) > 4
    for link in links(README):
        assert (ROOT / link).exists(), link


def test_figures_were_measured():
    for name in re.findall(r"<!-- figures: (\w+) -->", README):
        content = re.search(rf"<!-- figures: {name} -->\n(.*?)<!-- end -->", README, re.DOTALL)[1]
        assert len(content.strip()) > 40, name
