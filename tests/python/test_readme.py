# SPDX-License-Identifier: BSD-3-Clause
"""What README.md shows is run: the Python lines, the C++ lines, and the files that it names."""

import os
import re
import subprocess
import sys

import pytest
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


def test_commands_exist():
    typer = pytest.importorskip("typer.main", reason="typer is not installed: no command line")
    from ndtree.commands import app

    ours = typer.get_command(app).commands
    lines = "".join(blocks(README, "sh")).splitlines()
    assert len(lines) >= 2
    for line in lines:
        name, *arguments = line.split()
        assert arguments[0] in ours if name == "ndtree" else os.access(ROOT / name, os.X_OK), line


def test_links_exist():
    assert len(links(README)) > 4
    for link in links(README):
        assert (ROOT / link).exists(), link


def test_figures_were_measured():
    for name in re.findall(r"<!-- figures: (\w+) -->", README):
        content = re.search(rf"<!-- figures: {name} -->\n(.*?)<!-- end -->", README, re.DOTALL)[1]
        assert len(content.strip()) > 40, name
