# SPDX-License-Identifier: BSD-3-Clause
"""Directions of the imports in the Python package: between its rooms, and no circles among its modules.

Every import counts, also those within functions and those for types alone.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

#: The rooms from the bottom up, the modules and packages in each, and what each may import besides itself.
#: What stands in the package's own folder is a room's by its name here.
ROOMS: Mapping[str, tuple[set[str], set[str]]] = {
    "core": (
        {"_core", "_arguments", "_calls", "_compiled", "_interrupt", "_signatures", "exit_status", "files"}
        | {"results", "sampling", "scan", "typing"},
        set(),
    ),
    "cells": ({"lattice", "regions"}, {"core"}),
    "readers": ({"readers"}, {"core"}),
    "tiles": ({"tiles"}, {"core", "readers"}),
    "fleet": ({"distributed"}, {"core", "readers", "tiles"}),
    "maps": ({"maps", "map_images", "_options"}, {"core", "readers", "tiles"}),
    "writers": ({"writers", "conversion"}, {"core", "cells", "maps"}),
    "pictures": ({"plot", "notebook", "record"}, {"core", "cells", "writers"}),
    "pages": ({"snapshot", "view", "page_guard"}, {"core", "cells", "pictures"}),
    "studies": (
        {
            "agreement",
            "calibration",
            "comparison",
            "exact_truth",
            "first_look",
            "map_comparison",
            "no_returns",
        }
        | {"prospect", "scale", "settings", "study"},
        {"core", "cells", "readers", "maps", "pictures"},
    ),
    "package": (
        {"__init__", "_methods"},
        {"core", "cells", "readers", "tiles", "maps", "writers", "pictures", "studies"},
    ),
    "commands": (
        {"__main__", "cli", "commands"},
        {
            "core",
            "cells",
            "readers",
            "tiles",
            "fleet",
            "maps",
            "writers",
            "pictures",
            "pages",
            "studies",
            "package",
        },
    ),
}
ROOM_OF = {module: room for room, (modules, _) in ROOMS.items() for module in modules}


class Import(NamedTuple):
    """One import: the line that it is in, and the module that it takes, both without ``ndtree.``."""

    line: int
    module: str


def modules_in(package: Path) -> dict[str, Path]:
    """Each module of a package by its dotted name without the package's; packages end in ``__init__``."""
    files = sorted([*package.rglob("*.py"), *package.glob("_core.pyi")])
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


def room_of(module: str) -> str | None:
    return ROOM_OF.get(module.split(".")[0])


def graph(package: Path) -> dict[str, list[Import]]:
    """Each module's imports of others of its package."""
    modules = modules_in(package)
    return {
        name: [one for one in imports(file, name, modules) if one.module != name]
        for name, file in modules.items()
        if file.suffix == ".py"
    }


def circles(arrows: Mapping[str, list[Import]]) -> Iterator[list[str]]:
    """One way around for each knot of modules that import each other."""
    done: set[str] = set()
    for start in arrows:
        way: list[str] = []
        iterators = [iter([start])]
        while iterators:
            here = next(iterators[-1], None)
            if here is None:
                iterators.pop()
                if way:
                    done.add(way.pop())
            elif here in way:
                yield [*way[way.index(here) :], here]
            elif here not in done:
                way.append(here)
                iterators.append(iter([one.module for one in arrows.get(here, [])]))


def violations(root: Path) -> Iterator[str]:
    """Yield one line for each import against the direction, and for each circle."""
    package = root / "src" / "python" / "ndtree"
    if not package.is_dir():
        return
    arrows = graph(package)
    modules = modules_in(package)
    for name, found in arrows.items():
        path = modules[name].relative_to(root)
        room = room_of(name)
        if room is None:
            yield f"{path}:1: is in no room: add it to {Path(__file__).name} with what it may import"
            continue
        for line, target in found:
            other = room_of(target)
            if other != room and other not in ROOMS[room][1]:
                allowed = ", ".join(sorted(ROOMS[room][1])) or "no other room"
                yield f"{path}:{line}: imports {target}, of {other}: {room} may import {allowed}"
    for way in circles(arrows):
        yield f"{modules[way[0]].relative_to(root)}:1: imports itself: {' -> '.join(way)}"


def drawing(root: Path) -> str:
    """The rooms from the top down: their modules with lines, and the rooms that they do import."""
    package = root / "src" / "python" / "ndtree"
    arrows, modules = graph(package), modules_in(package)
    lines = []
    for room in reversed(ROOMS):
        here = [name for name in arrows if room_of(name) == room]
        used = {room_of(one.module) for name in here for one in arrows[name]} - {room}
        count = sum(len(modules[name].read_text().splitlines()) for name in here)
        below = [other for other in reversed(ROOMS) if other in used]
        lines.append(f"{room}: {count:,} lines in {len(here)} files -> {', '.join(below) or 'nothing'}")
    return "\n".join(lines)
