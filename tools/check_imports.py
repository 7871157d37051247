# SPDX-License-Identifier: BSD-3-Clause
"""Directions of the imports in the Python package: between its folders, and no circles among its modules.

Every import counts, also those within functions and those for types alone. Stubs do not: they describe what
compiled functions take, and nothing runs in them. What ``_lazy.py`` names is loaded when a method that needs
it is called, and is no import: its table is short, and a test loads each entry.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

#: Folders of the package; each may import the folders before it.
FOLDERS = (
    "_native",
    "base",
    "logs",
    "cells",
    "tiles",
    "maps",
    "alignment",
    "plot",
    "evaluation",
    "tuning",
    "distributed",
    "study",
    "viewer",
    "live",
    "cli",
)
#: Folders in folders, in the same way; modules beside them may import them, too.
INNER: Mapping[str, tuple[str, ...]] = {
    "logs": ("core", "poses", "formats", "folders", "sfm", "ros"),
    "logs.ros": ("messages", "files", "placement"),
}
#: Modules beside the folders: the lowest, which every folder may import, and the highest, which none may.
LOWEST, HIGHEST = ("_errors", "_lazy"), ("typing", "__init__", "__main__")
ORDER = (*LOWEST, *FOLDERS, *HIGHEST)


class Import(NamedTuple):
    """One import: the line that it is in, and the module that it takes, both without ``ndtree.``."""

    line: int
    module: str


def modules_in(package: Path) -> dict[str, Path]:
    """Each module of a package by its dotted name without the package's; packages end in ``__init__``."""
    files = sorted([*package.rglob("*.py"), *package.rglob("*.pyi")])
    return {".".join(file.relative_to(package).with_suffix("").parts): file for file in files}


def imports(file: Path, name: str, modules: Mapping[str, Path]) -> Iterator[Import]:
    """What of its own package a module imports."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                parts = alias.name.split(".")
                if parts[0] == "ndtree":
                    yield Import(node.lineno, _module(parts[1:], modules))
        elif isinstance(node, ast.ImportFrom):
            parts = (node.module or "").split(".") if node.module else []
            if node.level:
                parts = name.split(".")[: -node.level] + parts
            elif parts[:1] == ["ndtree"]:
                parts = parts[1:]
            else:
                continue
            for alias in node.names:
                yield Import(node.lineno, _module([*parts, alias.name], modules))


def _module(parts: list[str], modules: Mapping[str, Path]) -> str:
    """The module that a dotted name is, or is in."""
    while parts:
        for name in (".".join(parts), ".".join([*parts, "__init__"])):
            if name in modules:
                return name
        parts = parts[:-1]
    return "__init__"


def reason_against(name: str, target: str) -> str | None:
    """Why a module may not import another; None if it may."""
    here, there = name.split("."), target.split(".")
    if here[0] not in ORDER:
        return None  # Said once for the module.
    if there[0] not in ORDER or ORDER.index(there[0]) > ORDER.index(here[0]):
        before = ORDER[: ORDER.index(here[0])]
        return f"{here[0]} may import {', '.join(before) or 'nothing'}"
    for outer, inner in INNER.items():
        depth = outer.count(".") + 1
        mine, other = here[depth : depth + 1], there[depth : depth + 1]
        if here[:depth] == there[:depth] == outer.split(".") and mine[0] in inner and other[0] in inner:
            before = inner[: inner.index(mine[0]) + 1]
            if other[0] not in before:
                return f"{outer}.{mine[0]} may import {', '.join(before[:-1]) or 'no folder beside it'}"
    return None


def graph(package: Path) -> dict[str, list[Import]]:
    """Each module's imports of others of its package."""
    modules = modules_in(package)
    return {
        name: [one for one in imports(file, name, modules) if one.module != name]
        for name, file in modules.items()
        if file.suffix == ".py"
    }


def circle(arrows: Mapping[str, list[Import]]) -> list[str]:
    """A way around, where modules import each other; empty where none do."""
    try:
        TopologicalSorter({name: [one.module for one in found] for name, found in arrows.items()}).prepare()
    except CycleError as error:
        return list(reversed(error.args[1]))  # Each of its modules is imported by the next.
    return []


def violations(root: Path) -> Iterator[str]:
    """Yield one line for each import against the direction, and for a circle."""
    package = root / "src" / "python" / "ndtree"
    if not package.is_dir():
        return
    arrows = graph(package)
    modules = modules_in(package)
    for name, found in arrows.items():
        path = modules[name].relative_to(root)
        if name.split(".")[0] not in ORDER:
            yield f"{path}:1: is in no folder of {Path(__file__).name}: add it there"
        for line, target in found:
            if reason := reason_against(name, target):
                yield f"{path}:{line}: imports {target}: {reason}"
    if way := circle(arrows):
        yield f"{modules[way[0]].relative_to(root)}:1: imports itself: {' -> '.join(way)}"


def drawing(root: Path) -> str:
    """The folders from the top down: their lines, and the folders that they do import."""
    package = root / "src" / "python" / "ndtree"
    arrows, modules = graph(package), modules_in(package)
    lines = []
    for folder in reversed(ORDER):
        here = [name for name in arrows if name.split(".")[0] == folder]
        used = {one.module.split(".")[0] for name in here for one in arrows[name]} - {folder}
        count = sum(len(modules[name].read_text().splitlines()) for name in here)
        below = [other for other in reversed(ORDER) if other in used]
        lines.append(f"{folder}: {count:,} lines in {len(here)} files -> {', '.join(below) or 'nothing'}")
    return "\n".join(lines)
