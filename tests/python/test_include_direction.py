# SPDX-License-Identifier: BSD-3-Clause
"""The check of includes and imports passes on this repository and fails on each kind of violation."""

import contextlib
import io
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
import check_includes  # noqa: E402

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
    ("tools/bench/peers/octomap.cpp", "#include <octomap/octomap.h>"),
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
    ("logs/core/log.py", "from ndtree.base.scan import Scan", None),
    ("logs/core/log.py", "from ...base.scan import Scan", None),
    ("logs/core/log.py", "import numpy", None),
    ("logs/formats/npz.py", "from ndtree.logs.core.log import Log", None),
    ("plot/flat.py", "from ndtree.cells.regions import Region", None),
    ("cli/app.py", "from ndtree._native import _core\nfrom ndtree.plot import flat", None),
    ("_native/_calls.py", "from ndtree import _lazy", None),
    ("base/scan.py", "from ndtree._native import _core", None),
    ("_native/_core.pyi", "from ndtree.base.scan import Scan", None),
    ("base/scan.py", "from ndtree.logs.core.log import Log", "base may import _errors, _lazy"),
    ("base/scan.py", "def f():\n    from ndtree.logs.core import log", "base may import _errors, _lazy"),
    ("base/scan.py", "from ..logs.core.log import Log", "base may import _errors, _lazy"),
    ("base/scan.py", "import ndtree.logs.core.log", "base may import _errors, _lazy"),
    ("base/scan.py", "import ndtree", "imports __init__: base may import"),
    ("base/scan.py", "from ndtree import read", "imports __init__: base may import"),
    ("cli/app.py", "import ndtree", "imports __init__: cli may import"),
    ("_native/_calls.py", "from ndtree.base import scan", "_native may import _errors, _lazy"),
    ("_lazy.py", "from ndtree.base import scan", "_lazy may import _errors"),
    ("plot/flat.py", "from ndtree.cli import app", "imports cli.app: plot may import _errors, _lazy"),
    ("cells/regions.py", "from ndtree.plot.flat import cells", "cells may import _errors, _lazy, _native"),
    ("cells/regions.py", "from ..plot import flat", "cells may import _errors, _lazy, _native"),
    ("logs/core/log.py", "from ndtree.logs.formats import npz", "logs.core may import no folder beside it"),
    ("logs/formats/npz.py", "from ndtree.logs.sfm import bal", "logs.formats may import core, poses"),
    ("logs/__init__.py", "from ndtree.logs.core import log\nfrom ndtree.logs.core.log import A", None),
    ("stray.py", "", "is in no folder"),
    ("stray/a.py", "", "is in no folder"),
]


def check(root):
    """What tools/check_includes.py returns and prints."""
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()):
        status = check_includes.main([str(root)])
    return SimpleNamespace(returncode=status, stdout=out.getvalue())


def write(root, file, line):
    types = root / "include" / "ndtree" / "core" / "types.hpp"
    for path, text in ((types, "#pragma once\n"), (root / file, f"// first line\n{line}\n")):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


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
    """A package with the modules that the imports name."""
    write(root, "include/ndtree/core/a.hpp", "")
    names = ("__init__", "_lazy", "base/scan", "cells/regions", "plot/flat", "cli/app")
    names += ("_native/_calls", "logs/core/log", "logs/formats/npz", "logs/sfm/bal")
    files = {f"{name}.py": "" for name in names} | {"_native/_core.pyi": ""}
    files |= {f"{Path(name).parent}/__init__.py": "" for name in names if "/" in name}
    files |= {"plot/__init__.py": "from ndtree.plot.flat import draw", "logs/__init__.py": ""}
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
    there, back = "def f():\n    from ndtree.logs.core import text", "from ndtree.logs.core.log import Log"
    package(tmp_path, **{"logs/core/log.py": there, "logs/core/text.py": back})
    result = check(tmp_path)
    assert result.returncode == 1
    assert "imports itself: logs.core.log -> logs.core.text -> logs.core.log" in result.stdout


def test_every_folder_of_the_package_is_in_the_order(tmp_path):
    drawn = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "check_includes.py"), "--draw"], capture_output=True, text=True
    )
    folders = {line.partition(":")[0] for line in drawn.stdout.splitlines()}
    package = ROOT / "src" / "python" / "ndtree"
    found = {
        path.stem for path in package.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    assert folders == found


def test_an_empty_folder_is_not_a_pass(tmp_path):
    assert check(tmp_path).returncode == 2
