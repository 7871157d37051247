# SPDX-License-Identifier: BSD-3-Clause
"""The package's names load when they are asked for: all of them, and nothing before."""

import ast
import inspect
import pickle
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import ndtree
from ndtree import _lazy
from ndtree._native import _core
from ndtree._native._compiled import INTERNAL


def output_of(code: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_every_public_name_is_there_and_is_what_type_checkers_see() -> None:
    """The imports for type checkers name each of `__all__`, of the module that has it."""
    seen = {}
    for node in ast.walk(ast.parse(inspect.getsource(ndtree))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ndtree"):
            seen.update({alias.asname or alias.name: (node.module, alias.name) for alias in node.names})
    del seen["_lazy"]
    assert set(ndtree.__all__) | set(ndtree._FOLDERS) == set(seen)
    for name, (module, own) in seen.items():
        held = getattr(ndtree, name)
        assert held is getattr(import_module(str(module)), own), name
    assert set(seen) <= set(dir(ndtree))


def test_importing_the_package_loads_nothing_else() -> None:
    code = "import sys; before = set(sys.modules); import ndtree; print(*set(sys.modules) - before)"
    loaded = {name for name in output_of(code) if "ndtree" in name}
    assert loaded == {"ndtree", "ndtree._lazy"}
    assert output_of("import sys, ndtree; print('numpy' in sys.modules)") == ["False"]


def test_the_first_map_loads_no_readers() -> None:
    code = "import sys, ndtree; ndtree.AdaptiveMap(dim=2); print(*sys.modules)"
    loaded = output_of(code)
    folders = {name.split(".")[1] for name in loaded if name.startswith("ndtree.")}
    assert folders == {"_errors", "_lazy", "_native"}
    if int(np.__version__.split(".")[0]) >= 2:  # NumPy 1 loads it itself.
        assert "numpy.ma" not in loaded


@pytest.mark.parametrize("name", _lazy.METHODS)
def test_functions_that_methods_load_are_there(name: str) -> None:
    assert callable(_lazy.method(name))


def test_names_that_are_not_there_are_refused_as_of_any_module() -> None:
    with pytest.raises(AttributeError, match="module 'ndtree' has no attribute 'nothing'"):
        _ = ndtree.nothing
    with pytest.raises(ImportError, match="cannot import name 'nothing' from 'ndtree'"):
        exec("from ndtree import nothing")
    scope: dict[str, object] = {}
    exec("from ndtree import *", scope)
    assert set(ndtree.__all__) <= set(scope)


def test_pickles_name_the_package_alone() -> None:
    """What a program stores does not depend on the module that has a class."""
    m = ndtree.AdaptiveMap(dim=2)
    m.insert([[1.0, 0.5]], [0.0, 0.0])
    fixed = ndtree.FixedMap(dim=3, min_cell_size=0.1)
    made = (m, fixed, ndtree.Sphere(0.2), ndtree.HeldOutTruth(), m.leaves(), m.stats())
    for held in (*made, ndtree.Leaves, ndtree.load):
        for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
            stored = pickle.dumps(held, protocol)
            assert b"_native" not in stored
            assert type(pickle.loads(stored)) is type(held)
    assert pickle.loads(pickle.dumps(m, 0)) == m


def test_what_cannot_be_pickled_is_refused_by_each_protocol() -> None:
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        with pytest.raises(TypeError, match="FrontierSearch"):
            pickle.dumps(ndtree.FrontierSearch(ndtree.AdaptiveMap(dim=2)), protocol)


def test_names_of_the_compiled_module_are_the_package_s_or_its_own() -> None:
    names = {name for name in vars(_core) if not name.startswith("_")}
    assert names - INTERNAL <= set(ndtree.__all__)
    assert INTERNAL <= names
    assert INTERNAL & set(ndtree.__all__) == {"simulate"}  # A reader makes a log of it.


def test_the_help_of_the_command_line_loads_no_command() -> None:
    """And so neither NumPy nor the compiled module. Its line of a command is how that one's help begins."""
    pytest.importorskip("typer")
    from ndtree.cli.commands import COMMANDS, app, every

    code = "import sys; from ndtree.cli.commands import app\ntry: app(['--help'])\nexcept SystemExit: pass\n"
    said = output_of(code + "print(*sys.modules)")
    assert {name for name in said if name.startswith("ndtree.")} == {
        "ndtree._errors",
        "ndtree._lazy",
        "ndtree.base",
        "ndtree.base.exit_status",
        "ndtree.cli",
        "ndtree.cli.commands",
        "ndtree.cli.commands.app",
        "ndtree.cli.help",
        "ndtree.cli.interrupt",
        "ndtree.cli.streams",
    }
    assert "numpy" not in said and set(COMMANDS) <= set(said)
    commands = every()
    assert list(commands) == list(COMMANDS)
    announced = {one.name: one.help for one in app.registered_commands}
    for name, command in commands.items():
        assert command.name == name
        assert " ".join(command.help.split("\n\n")[0].split()) == " ".join(announced[name].split())
    files = {path.stem for path in Path(inspect.getfile(every)).parent.glob("*.py")}
    assert set(COMMANDS.values()) < files
