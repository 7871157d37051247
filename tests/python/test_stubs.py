# SPDX-License-Identifier: BSD-3-Clause
"""The type stub says what the compiled module has: names, members, keywords."""

import ast
import inspect
import re
from pathlib import Path

import pytest

import ndtree
from ndtree import _core

PACKAGE = Path(inspect.getfile(ndtree)).parent
STUB = ast.parse((PACKAGE / "_core.pyi").read_text())
CLASSES = {node.name: node for node in STUB.body if isinstance(node, ast.ClassDef)}
FUNCTIONS = {node.name: node for node in STUB.body if isinstance(node, ast.FunctionDef)}
OPTIONAL = set() if _core.has_octomap else {"OctoMap"}


def public(names):
    return {name for name in names if not name.startswith("_")}


def keywords(node: ast.FunctionDef) -> list[str]:
    return [a.arg for a in node.args.args + node.args.kwonlyargs if a.arg != "self"]


def documented_keywords(function) -> list[str]:
    """Argument names from the signature that pybind11 writes in the first line of a docstring."""
    signature = function.__doc__.splitlines()[0]
    inside = signature[signature.index("(") + 1 : signature.rindex(") ->")]
    names = re.findall(r"(?:^|, )\*{0,2}(\w+)(?=:)", inside)
    return [n for n in names if n not in ("self", "kwargs")]


def test_the_package_is_marked_as_typed():
    assert (PACKAGE / "py.typed").exists()


def test_names_are_those_of_the_module():
    assert public(CLASSES) | set(FUNCTIONS) | {"has_octomap"} == public(dir(_core)) | OPTIONAL


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
            assert keywords(node) == documented_keywords(getattr(getattr(_core, name), node.name)), node.name
            checked += 1
    without = (
        "Claims CompressReport Frontier HeldOutTruth InsertReport Leaves MapStats NearestOccupied RayEnds "
        "SeenSpace Shape"
    ).split()
    assert checked or name in without or "Map" in name


def test_options_of_the_maps_are_those_of_the_library():
    def options(name: str) -> set[str]:
        init = next(n for n in CLASSES[name].body if getattr(n, "name", "") == "__init__")
        return set(keywords(init)) - {"dim", "branching", "refinement", "insertion"}

    everything = set(ndtree.default_options())
    assert options("AdaptiveMap") == everything
    for name in ("FixedMap", "OctoMap"):
        assert options(name) - {"cell_size"} < everything
    for kind in {"AdaptiveMap", "FixedMap", "OctoMap"} - OPTIONAL:
        accepted = set()
        for name in everything | {"cell_size"}:
            for choice in ({"refinement": "paper"}, {}) if kind == "AdaptiveMap" else ({},):
                try:
                    getattr(ndtree, kind)(**choice, **{name: ndtree.default_options().get(name, 0.05)})
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
        assert len(documentation.splitlines()) > 1 or not documentation.startswith(member + "("), (
            f"{name}.{member}"
        )
