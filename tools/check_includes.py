#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Check that no header includes, and no Python module imports, against the architecture's arrows.

usage: check_includes.py [--draw] [ROOT]     (ROOT: the repository, by default the one that this file is in)

Prints one line for each violation; with --draw, the folders of the Python package and their arrows instead.
Exit status: 0 none, 1 some, 2 no headers at ROOT.
"""

from __future__ import annotations

import posixpath
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import check_imports

# What a header in each folder of include/ndtree may include, besides its own folder and version.hpp.
ALLOWED = {
    "core": set(),
    "tree": {"core"},
    "cell": {"core"},
    "mapping": {"core", "tree", "cell"},
    "alignment": {"core"},
    "query": {"core", "tree", "cell", "alignment"},
    "planning": {"core", "tree", "cell", "query"},
    "layers": {"core", "tree", "cell"},
    "io": {"core", "tree", "cell", "layers"},
    "logs": {"core"},
    "evaluation": {"core", "cell", "query"},
}
UMBRELLAS = {"ndtree.hpp", "map.hpp"}  # see all folders, and no header in a folder includes them
VERSION = "version.hpp"
FORWARD = "fwd.hpp"  # includes nothing of ours
OCTOMAP_INCLUDERS = {
    "tools/compare/octomap_baseline.hpp",
    "tools/compare/octomap_baseline.cpp",
    "tools/bench/files/main.cpp",
    "tools/bench/peers/octomap.cpp",
}

INCLUDE = re.compile(r'^\s*#\s*include\s*(?:"([^"]+)"|<([^>]+)>)')
STANDARD = re.compile(r"[a-z0-9_]+")
# Headers that know the processor or the system, and what they need of it.
SYSTEM = {
    "core/memory.hpp": {"unistd.h"},
    "core/simd.hpp": {"immintrin.h", "arm_neon.h", "simde/x86/avx2.h"},
    "io/replaced_file.hpp": {"fcntl.h", "sys/file.h", "sys/stat.h", "unistd.h"},
}


def includes(file: Path) -> Iterator[tuple[int, str, bool]]:
    """Yield line number, included name, and whether it stood in quotes."""
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), start=1):
        if match := INCLUDE.match(line):
            yield number, match[1] or match[2], match[1] is not None


def folder_of(name: str) -> str:
    """Folder of a header given relative to include/ndtree; the name itself for one at the top."""
    return name.split("/")[0]


def header_violation(header: str, name: str, quoted: bool) -> str | None:
    """Why `header`, given relative to include/ndtree, must not include `name`; None if it may."""
    folder = folder_of(header)
    if header in UMBRELLAS:
        return None
    if "/" in header and folder not in ALLOWED:
        return f"folder {folder}/ is unknown: add it to {Path(__file__).name} with what it may include"
    if name.startswith("ndtree/"):
        target = posixpath.normpath(name[len("ndtree/") :])
    elif quoted:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(header), name))
    elif name.startswith("Eigen/") or STANDARD.fullmatch(name) or name in SYSTEM.get(header, ()):
        return None
    else:
        return "a header needs nothing but the standard library and Eigen"
    if target in (VERSION, FORWARD) or folder_of(target) in ALLOWED.get(folder, set()) | {folder}:
        return None
    arrows = ", ".join(sorted(ALLOWED.get(folder, set()))) or "no other folder"
    return f"{folder} may include {arrows}"


def violations(root: Path) -> Iterator[str]:
    """Yield one line for each forbidden include under `root`."""
    library = root / "include" / "ndtree"
    for file in sorted(library.rglob("*.hpp")):
        header = file.relative_to(library).as_posix()
        for number, name, quoted in includes(file):
            if reason := header_violation(header, name, quoted):
                yield f"{file.relative_to(root)}:{number}: includes {name}: {reason}"
    for top in ("include", "src", "tests", "tools"):
        for file in sorted([*(root / top).rglob("*.hpp"), *(root / top).rglob("*.cpp")]):
            path = file.relative_to(root).as_posix()
            for number, name, _ in includes(file):
                if name.startswith("octomap/") and top != "include" and path not in OCTOMAP_INCLUDERS:
                    few = "the OctoMap baseline, its reader and a benchmark"
                    yield f"{path}:{number}: includes {name}: only {few} may"


def main(arguments: list[str]) -> int:
    draw = "--draw" in arguments
    roots = [argument for argument in arguments if argument != "--draw"]
    root = Path(roots[0]) if roots else Path(__file__).resolve().parents[1]
    if not any((root / "include" / "ndtree").rglob("*.hpp")):
        print(f"{root}: no headers in include/ndtree", file=sys.stderr)
        return 2
    if draw:
        print(check_imports.drawing(root))
        return 0
    found = [*violations(root), *check_imports.violations(root)]
    print("\n".join(found), end="\n" if found else "")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
