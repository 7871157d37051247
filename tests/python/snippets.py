# SPDX-License-Identifier: BSD-3-Clause
"""Code in Markdown: found, compiled and run."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def fenced(text: str) -> list[tuple[str, str]]:
    """Language and lines of each fenced block, in their order."""
    return re.findall(r"^```(\w+)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def blocks(text: str, language: str) -> list[str]:
    """The fenced blocks of one language."""
    return [code for one, code in fenced(text) if one == language]


def links(text: str) -> list[str]:
    """Files that Markdown links and pictures lead to, without their anchors."""
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.findall(r"\]\((?!http)([^)#]+)(?:#[^)]*)?\)", prose)


def anchors(text: str) -> set[str]:
    """What links to headings end with, on code hosts and on the site alike."""
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ (.*)$", prose, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def run_cpp(codes: Iterable[str], folder: Path, end: str) -> int:
    """Compile blocks, each as statements in a scope of its own, run them there, and return the exit status.

    Lines that begin with #include come first. `end` closes main() in the scope of the last block.
    """
    compiler = shutil.which(os.environ.get("CXX", "c++"))
    eigen = next((p for p in ("/usr/include/eigen3", "/usr/local/include/eigen3") if Path(p).is_dir()), None)
    if compiler is None or eigen is None:
        pytest.skip("no C++ compiler or no Eigen on this machine")
    includes: dict[str, None] = {}
    scopes = []
    for code in codes:
        lines = code.splitlines()
        includes.update(dict.fromkeys(line for line in lines if line.startswith("#include")))
        scopes.append("\n".join(line for line in lines if not line.startswith("#include")))
    body = "".join(f"{{\n{scope}\n}}\n" for scope in scopes[:-1]) + f"{scopes[-1]}\n{end}\n"
    (folder / "main.cpp").write_text("\n".join(includes) + f"\nint main() {{\n{body}}}\n")
    cache = os.environ.get("CMAKE_CXX_COMPILER_LAUNCHER", "").split()
    more = os.environ.get("CXXFLAGS", "").split()
    options = [*more, "-std=c++17", f"-I{ROOT / 'include'}", "-isystem", eigen]
    for call in ([*cache, compiler, *options, "-c", "main.cpp"], [compiler, "main.o", "-o", "main"]):
        built = subprocess.run(call, cwd=folder, capture_output=True, text=True)
        assert built.returncode == 0, built.stderr
    return subprocess.run([folder / "main"], cwd=folder).returncode
