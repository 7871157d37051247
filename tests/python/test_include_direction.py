# SPDX-License-Identifier: BSD-3-Clause
"""The check of includes and imports passes on this repository and fails on each kind of violation."""

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
    ("include/ndtree/mapping/a.hpp", '#include "ndtree/fwd.hpp"'),
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
    ("include/ndtree/fwd.hpp", '#include "ndtree/core/types.hpp"'),
    ("tests/cpp/test_a.cpp", "#include <octomap/octomap.h>"),
]

#: Of Python: a module, a line in it, and what is said of it (nothing where it may stand).
IMPORTS = [
    ("readers/log.py", "from ndtree.scan import Scan", None),
    ("readers/log.py", "from ..scan import Scan", None),
    ("readers/log.py", "import numpy", None),
    ("plot/flat.py", "from ndtree.lattice.cells import Cells", None),
    ("commands/app.py", "import ndtree", None),
    ("scan.py", "from ndtree import _core", None),
    ("scan.py", "from ndtree.readers.log import Log", "core may import no other room"),
    ("scan.py", "def f():\n    from ndtree.readers import log", "core may import no other room"),
    ("scan.py", "from .readers.log import Log", "core may import no other room"),
    ("scan.py", "import ndtree.readers.log", "core may import no other room"),
    ("scan.py", "import ndtree", "core may import no other room"),
    ("plot/flat.py", "from ndtree.commands import app", "pictures may import cells, core, writers"),
    ("lattice/cells.py", "from ndtree.plot.flat import cells", "cells may import core"),
    ("lattice/cells.py", "from ..plot import flat", "cells may import core"),
    ("readers/__init__.py", "from ndtree.readers import log\nfrom ndtree.readers.log import A", None),
    ("stray.py", "", "is in no room"),
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


def package(root, **more):
    """A package with a file or two in each room that the imports name."""
    write(root, "include/ndtree/core/a.hpp", "")
    files = {
        "__init__.py": "",
        "scan.py": "",
        "_core.pyi": "",
        "readers/__init__.py": "",
        "readers/log.py": "",
    }
    files |= {"lattice/__init__.py": "from ndtree.lattice.cells import Cells", "lattice/cells.py": ""}
    files |= {"plot/__init__.py": "", "plot/flat.py": "", "commands/__init__.py": "", "commands/app.py": ""}
    for name, text in {**files, **more}.items():
        path = root / "src" / "python" / "ndtree" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", encoding="utf-8")


@pytest.mark.parametrize(("file", "text", "said"), IMPORTS)
def test_imports_run_one_way(tmp_path, file, text, said):
    package(tmp_path, **{file: text})
    result = check(tmp_path)
    if said is None:
        assert (result.returncode, result.stdout) == (0, "")
    else:
        assert result.returncode == 1
        assert len(result.stdout.splitlines()) == 1
        assert result.stdout.startswith(f"src/python/ndtree/{file}:") and said in result.stdout


def test_modules_that_import_each_other_are_named(tmp_path):
    there, back = "def f():\n    from ndtree.readers import text", "from ndtree.readers.log import Log"
    package(tmp_path, **{"readers/log.py": there, "readers/text.py": back})
    result = check(tmp_path)
    assert result.returncode == 1
    assert "imports itself: readers.log -> readers.text -> readers.log" in result.stdout


def test_an_empty_folder_is_not_a_pass(tmp_path):
    assert check(tmp_path).returncode == 2
