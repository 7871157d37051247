# SPDX-License-Identifier: BSD-3-Clause
"""The include check passes on this repository and fails on each kind of violation."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

ALLOWED = [
    ("include/ndtree/core/a.hpp", "#include <vector>"),
    ("include/ndtree/core/a.hpp", "#include <Eigen/Core>"),
    ("include/ndtree/core/a.hpp", '#include "ndtree/core/types.hpp"'),
    ("include/ndtree/core/a.hpp", '#include "types.hpp"'),
    ("include/ndtree/tree/a.hpp", '#include "ndtree/core/types.hpp"'),
    ("include/ndtree/io/a.hpp", '#include "ndtree/version.hpp"'),
    ("include/ndtree/mapping/a.hpp", '#include "ndtree/cell/cell.hpp"'),
    ("include/ndtree/evaluation/a.hpp", '#include "ndtree/query/point.hpp"'),
    ("include/ndtree/ndtree.hpp", '#include "ndtree/mapping/map.hpp"'),
    ("include/ndtree/io/replaced_file.hpp", "#include <unistd.h>"),
    ("include/ndtree/core/a.hpp", '// #include "ndtree/tree/tree.hpp"'),
    ("src/python/bindings/a.cpp", '#include "ndtree/ndtree.hpp"'),
    ("tools/compare/octomap_baseline.cpp", "#include <octomap/octomap.h>"),
    ("tools/bench/collisions/main.cpp", "#include <octomap/octomap.h>"),
]

FORBIDDEN = [
    ("include/ndtree/core/a.hpp", '#include "ndtree/tree/tree.hpp"'),
    ("include/ndtree/core/a.hpp", "  #  include <ndtree/tree/tree.hpp>"),
    ("include/ndtree/core/a.hpp", '#include "../tree/tree.hpp"'),
    ("include/ndtree/core/a.hpp", '#include "ndtree/core/../tree/tree.hpp"'),
    ("include/ndtree/core/a.hpp", '#include "ndtree/ndtree.hpp"'),
    ("include/ndtree/core/a.hpp", "#include <zlib.h>"),
    ("include/ndtree/io/a.hpp", "#include <unistd.h>"),
    ("include/ndtree/io/replaced_file.hpp", "#include <immintrin.h>"),
    ("include/ndtree/core/a.hpp", "#include <octomap/octomap.h>"),
    ("include/ndtree/tree/a.hpp", '#include "ndtree/cell/cell.hpp"'),
    ("include/ndtree/cell/a.hpp", '#include "ndtree/tree/tree.hpp"'),
    ("include/ndtree/mapping/a.hpp", '#include "ndtree/query/point.hpp"'),
    ("include/ndtree/query/a.hpp", '#include "ndtree/mapping/map.hpp"'),
    ("include/ndtree/io/a.hpp", '#include "ndtree/mapping/map.hpp"'),
    ("include/ndtree/io/a.hpp", '#include "ndtree/query/point.hpp"'),
    ("include/ndtree/logs/a.hpp", '#include "ndtree/cell/cell.hpp"'),
    ("include/ndtree/evaluation/a.hpp", '#include "ndtree/mapping/map.hpp"'),
    ("include/ndtree/stray/a.hpp", '#include "ndtree/core/types.hpp"'),
    ("include/ndtree/version.hpp", '#include "ndtree/core/types.hpp"'),
    ("tests/cpp/test_a.cpp", "#include <octomap/octomap.h>"),
]


def check(root):
    command = [sys.executable, str(ROOT / "tools" / "check_includes.py"), str(root)]
    return subprocess.run(command, capture_output=True, text=True)


def write(root, file, line):
    types = root / "include" / "ndtree" / "core" / "types.hpp"
    for path, text in ((types, "#pragma once\n"), (root / file, f"// first line\n{line}\n")):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def test_this_repository_keeps_the_direction():
    result = check(ROOT)
    assert (result.returncode, result.stdout) == (0, "")


@pytest.mark.parametrize(("file", "line"), ALLOWED)
def test_allowed_include_passes(tmp_path, file, line):
    write(tmp_path, file, line)
    result = check(tmp_path)
    assert (result.returncode, result.stdout) == (0, "")


@pytest.mark.parametrize(("file", "line"), FORBIDDEN)
def test_forbidden_include_is_named_with_its_line(tmp_path, file, line):
    write(tmp_path, file, line)
    result = check(tmp_path)
    assert result.returncode == 1
    assert len(result.stdout.splitlines()) == 1
    assert result.stdout.startswith(f"{file}:2: ")


def test_an_empty_folder_is_not_a_pass(tmp_path):
    assert check(tmp_path).returncode == 2
