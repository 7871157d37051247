# SPDX-License-Identifier: BSD-3-Clause
"""What README.md shows is run: the Python lines, the C++ lines, and the files that it names."""

import os
import re
import subprocess
import sys

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


def test_commands_and_links_exist():
    (commands,) = blocks(README, "sh")
    for line in commands.splitlines():
        command = ROOT / line.split()[0]
        assert os.access(command, os.X_OK), command
    assert len(links(README)) > 4
    for link in links(README):
        assert (ROOT / link).exists(), link


def test_figures_were_measured():
    for name in re.findall(r"<!-- figures: (\w+) -->", README):
        content = re.search(rf"<!-- figures: {name} -->\n(.*?)<!-- end -->", README, re.DOTALL)[1]
        assert len(content.strip()) > 40, name
