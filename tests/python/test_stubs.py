# SPDX-License-Identifier: BSD-3-Clause
"""The type stub says what the compiled module has: names, members, keywords."""

from __future__ import annotations

import ast
import inspect
import os
import re
from pathlib import Path
from typing import Any

import pytest
from snippets import ROOT, blocks

import ndtree
import ndtree.typing
from ndtree._native import _core, results
from ndtree._native._compiled import RESULTS

PACKAGE = Path(inspect.getfile(ndtree)).parent
STUB_FILE = PACKAGE / "_native" / "_core.pyi"
STUB = ast.parse(STUB_FILE.read_text())
CLASSES = {node.name: node for node in STUB.body if isinstance(node, ast.ClassDef)}
FUNCTIONS = {node.name: node for node in STUB.body if isinstance(node, ast.FunctionDef)}
TAKEN_OVER = {
    name.asname
    for node in STUB.body
    if isinstance(node, ast.ImportFrom) and node.module == "ndtree._native.results"
    for name in node.names
}
CONSTANTS = {
    node.target.id for node in STUB.body if isinstance(node, ast.AnnAssign) and node.target.id[0] != "_"
}
OPTIONAL = set() if _core.has_octomap else {"OctoMap"}
USES = Path(__file__).parent / "typed" / "uses.py"


def public(names):
    return {name for name in names if not name.startswith("_")}


def keywords(node: ast.FunctionDef) -> list[str]:
    return [a.arg for a in node.args.args + node.args.kwonlyargs if a.arg != "self"]


def test_the_package_is_marked_as_typed():
    assert (PACKAGE / "py.typed").exists()


def test_names_are_those_of_the_module():
    assert public(CLASSES) | set(FUNCTIONS) | TAKEN_OVER | CONSTANTS == public(dir(_core)) | OPTIONAL


@pytest.mark.parametrize("name", sorted(public(CLASSES) - OPTIONAL))
def test_members_are_those_of_the_class(name):
    members = {n.name for n in CLASSES[name].body if isinstance(n, ast.FunctionDef)}
    assert public(members) == public(vars(getattr(_core, name)))
    for special in members - public(members):
        assert hasattr(getattr(_core, name), special)


@pytest.mark.parametrize("name", sorted(public(CLASSES) - OPTIONAL))
def test_keywords_are_those_of_the_methods(name):
    checked = 0
    for node in CLASSES[name].body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and not node.decorator_list:
            shown = list(inspect.signature(getattr(getattr(_core, name), node.name)).parameters)
            assert [one for one in shown if one != "self"] == keywords(node), node.name
            checked += 1
    assert checked or name in ("HeldOutTruth", "Reliability", "SeenSpace", "Shape") or "Map" in name


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_keywords_are_those_of_the_functions(name):
    shown = list(inspect.signature(getattr(_core, name)).parameters)
    written = keywords(FUNCTIONS[name])
    assert [one for one in shown if one != "kwargs"] == written


def test_results_have_what_the_compiled_ones_have():
    assert {made.__name__ for made in RESULTS.values()} == TAKEN_OVER == set(results.__all__)
    for raw, made in RESULTS.items():
        assert public(vars(raw)) == set(made.__dataclass_fields__), made


def test_options_of_the_maps_are_those_of_the_library():
    def options(name: str) -> set[str]:
        init = next(n for n in CLASSES[name].body if getattr(n, "name", "") == "__init__")
        return set(keywords(init)) - {"dim", "branching", "refinement", "insertion", "layers"}

    everything = set(ndtree.default_options())
    assert options("AdaptiveMap") == everything
    for name in ("FixedMap", "OctoMap"):
        assert options(name) < everything
    for kind in {"AdaptiveMap", "FixedMap", "OctoMap"} - OPTIONAL:
        accepted = set()
        for name in everything:
            for choice in ({"refinement": "paper"}, {}) if kind == "AdaptiveMap" else ({},):
                try:
                    getattr(ndtree, kind)(dim=2, **choice, **{name: ndtree.default_options().get(name, 0.05)})
                except TypeError:
                    continue
                accepted.add(name)
        assert accepted == options(kind)


@pytest.mark.parametrize("name", sorted(public(CLASSES) - OPTIONAL))
def test_everything_public_is_documented(name):
    type_ = getattr(_core, name)
    assert type_.__doc__
    for member in public(vars(type_)):
        documentation = getattr(type_, member).__doc__ or ""
        assert documentation or name not in ndtree.__all__, f"{name}.{member}"
        assert not documentation.startswith(member + "("), f"{name}.{member}: its signature is shown apart"


def members(type_: type) -> dict[str, Any]:
    """Public functions and methods of a class, inherited ones too but those of Python's own types."""
    names = set(dir(type_)) - set(dir(dict))
    return {n: getattr(type_, n) for n in names if not n.startswith("_") and callable(getattr(type_, n))}


def test_every_public_call_has_a_signature():
    checked = 0
    for name in public(ndtree.__all__) - {"has_octomap"} - OPTIONAL:
        held = getattr(ndtree, name)
        calls = {name: held}  # But of classes without a constructor.
        if isinstance(held, type):
            calls.update({f"{name}.{member}": method for member, method in members(held).items()})
        for called, function in calls.items():
            if called in ("OccupancyMap", "Shape", "DistanceField", "Comparison", "MapComparison"):
                continue
            signature = inspect.signature(function)
            kinds = {parameter.kind for parameter in signature.parameters.values()}
            assert inspect.Parameter.VAR_POSITIONAL not in kinds, called
            assert inspect.getdoc(function), called
            checked += 1
    assert checked > 100


def test_signatures_say_what_is_taken():
    insert = inspect.signature(ndtree.AdaptiveMap.insert)
    assert str(insert.parameters["max_range"]) == "max_range: 'float' = inf"
    assert insert.parameters["threads"].kind is inspect.Parameter.KEYWORD_ONLY
    assert insert.return_annotation == "InsertReport"
    assert str(inspect.signature(ndtree.Sphere)) == "(radius: 'float', center=None) -> 'Shape'"
    for kind in (ndtree.AdaptiveMap, ndtree.FixedMap):
        shown = inspect.signature(kind).parameters
        used = kind(dim=2).options
        assert used == {name: shown[name].default for name in used}
    bound = inspect.signature(ndtree.AdaptiveMap(dim=2).state)
    assert list(bound.parameters) == ["points"]


def without_later_overloads(body: list[ast.stmt]) -> list[ast.stmt]:
    """From the bottom up, so that the lines above stay where they are; what overloads do stands once."""
    first = {getattr(node, "name", i): node for i, node in reversed(list(enumerate(body)))}
    return [node for i, node in reversed(list(enumerate(body))) if first[getattr(node, "name", i)] is node]


def stub_with_docstrings() -> str:
    """The stub, with the compiled module's docstrings in it, which editors show."""
    lines = STUB_FILE.read_text().splitlines()

    def put(node: ast.ClassDef | ast.FunctionDef, text: str) -> None:
        first = node.body[0]
        quote = 'r"""' if "\\" in text else '"""'
        written = (quote + text + ('\n"""' if "\n" in text else '"""')).splitlines()
        written = [" " * (node.col_offset + 4) + line if line else "" for line in written]
        begin, end = first.lineno - 1, first.end_lineno
        if ast.get_docstring(node) is None:
            is_empty = isinstance(first, ast.Expr)
            if not is_empty:  # Before the first member and what decorates it.
                begin = end = (
                    min([first.lineno, *(d.lineno for d in getattr(first, "decorator_list", []))]) - 1
                )
                written.append("")
            elif not lines[begin][: first.col_offset].isspace():  # def f() -> None: ...
                written.insert(0, lines[begin][: first.col_offset].rstrip())
        lines[begin:end] = written

    def documented(node: ast.ClassDef | ast.FunctionDef, held: Any) -> None:
        if isinstance(node, ast.ClassDef):
            for one in without_later_overloads(node.body):
                if isinstance(one, ast.FunctionDef) and not one.name.startswith("_"):
                    documented(one, getattr(held, one.name))
        text = inspect.cleandoc(held.__doc__ or "")
        if text:
            put(node, text)

    for node in without_later_overloads(STUB.body):
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and node.name not in OPTIONAL:
            documented(node, getattr(_core, node.name))
    return "\n".join(lines) + "\n"


def test_docstrings_of_the_stub_are_those_of_the_module():
    """With NDTREE_UPDATE_DOCS in the environment, the stub gets them."""
    expected = stub_with_docstrings()
    if "NDTREE_UPDATE_DOCS" in os.environ:
        STUB_FILE.write_text(expected)
    assert expected == STUB_FILE.read_text(), (
        "NDTREE_UPDATE_DOCS=1 pytest tests/python/test_stubs.py mends it"
    )


def test_stub_and_types_say_what_the_table_of_options_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    option_stubs = pytest.importorskip("option_stubs")
    rows = _core.option_table()
    for file, made in ((STUB_FILE, option_stubs.stub), (PACKAGE / "base" / "typing.py", option_stubs.typing)):
        assert made(file.read_text(), rows) == file.read_text(), "tools/option_stubs.py writes them"


def test_typed_options_are_those_of_the_maps():
    kinds = {"MapOptions": set(ndtree.default_options())}
    for kind in {"FixedMap", "OctoMap"} - OPTIONAL:
        shown = set(inspect.signature(getattr(ndtree, kind)).parameters)
        kinds[f"{kind}Options"] = shown - {"dim", "branching", "refinement", "insertion", "layers"}
    for name, expected in kinds.items():
        assert set(getattr(ndtree.typing, name).__annotations__) == expected, name
    for option in ndtree.typing.SimulationOptions.__annotations__:
        ndtree.simulate("office", scans=2, **{option: 0})


def test_a_strict_checker_accepts_pages_and_what_is_right_and_sees_what_is_wrong(tmp_path: Path) -> None:
    api = pytest.importorskip("mypy.api", reason="mypy is not installed")
    pytest.importorskip("typing_extensions", reason="typing_extensions is not installed")
    pages = []
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        code = "\n".join(blocks(page.read_text(), "python"))
        if code.strip():
            pages.append(tmp_path / f"{page.stem.lower()}_page.py")
            pages[-1].write_text(code)
    assert len(pages) > 5
    settings = tmp_path / "mypy.ini"  # What other libraries say of themselves is theirs.
    settings.write_text(
        "[mypy]\nstrict = True\n"
        "[mypy-trimesh.*,pyparsing.*,markdown_it.*,msgspec.*]\nfollow_imports = skip\n"
        "[mypy-yaml.*]\nignore_missing_imports = True\n"
        + "".join(f"[mypy-{page.stem}]\ndisallow_untyped_calls = False\n" for page in pages)
    )
    options = ["--config-file", str(settings), "--cache-dir", str(ROOT / "build/mypy"), "--no-error-summary"]
    said, failed, _ = api.run([*options, "--hide-error-context", str(USES), *map(str, pages)])
    assert not failed, failed
    in_pages = [line for line in said.splitlines() if "_page.py:" in line and ": error: " in line]
    assert not in_pages, "\n".join(in_pages)
    found = {
        (int(line), code)
        for line, code in re.findall(r"uses\.py:(\d+): error: .*\[([\w-]+)\]$", said, re.MULTILINE)
    }
    assert len(found) == said.count(": error: "), said
    expected = {
        (number, line.partition("# wrong: ")[2])
        for number, line in enumerate(USES.read_text().splitlines(), 1)
        if "# wrong: " in line
    }
    assert len(expected) > 5
    assert found == expected, said
