# SPDX-License-Identifier: BSD-3-Clause
"""What README.md shows is run: the Python lines, the C++ lines, and the files that it names."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_is_short():
    assert len(README.splitlines()) < 130


def test_python_runs(tmp_path):
    (code,) = blocks("python")
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    cells, states, median = done.stdout.splitlines()
    assert int(cells.split()[0]) > 1000
    assert states.strip("[]").split() == ["0", "-1"]
    assert 0.5 < float(median) < 26
    assert (tmp_path / "office.ndt").stat().st_size > 1000


def test_cpp_compiles_and_runs(tmp_path):
    compiler = shutil.which(os.environ.get("CXX", "c++"))
    eigen = next((p for p in ("/usr/include/eigen3", "/usr/local/include/eigen3") if Path(p).is_dir()), None)
    if compiler is None or eigen is None:
        pytest.skip("no C++ compiler or no Eigen on this machine")
    (code,) = blocks("cpp")
    include, rest = code.split("\n", 1)
    (tmp_path / "main.cpp").write_text(f"{include}\nint main() {{\n{rest}\nreturn hit ? 0 : 1;\n}}\n")
    call = [compiler, "-std=c++17", f"-I{ROOT / 'include'}", "-isystem", eigen, "main.cpp", "-o", "main"]
    built = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    assert subprocess.run([tmp_path / "main"]).returncode == 0


def test_commands_and_links_exist():
    (commands,) = blocks("sh")
    for line in commands.splitlines():
        command = ROOT / line.split()[0]
        assert os.access(command, os.X_OK), command
    links = re.findall(r"\]\((?!http)([^)#]+)\)", README)
    assert len(links) > 4
    for link in links:
        assert (ROOT / link).exists(), link


def test_figures_were_measured():
    for name in re.findall(r"<!-- figures: (\w+) -->", README):
        content = re.search(rf"<!-- figures: {name} -->\n(.*?)<!-- end -->", README, re.DOTALL)[1]
        assert len(content.strip()) > 40, name
