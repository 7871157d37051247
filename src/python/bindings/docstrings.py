# SPDX-License-Identifier: BSD-3-Clause
"""Write the docstrings of the stub of the compiled module as C++ constants, which the bindings use.

usage: docstrings.py _core.pyi docstrings.hpp

The stub is the one place where a docstring stands: editors read it there, `help()` shows what is made of
it. `Map.insert` becomes `doc::Map_insert`, `Map.__init__` `doc::Map_init`, the class itself `doc::Map`.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path


def docstrings(stub: ast.Module) -> Iterator[tuple[str, str]]:
    """Constants' names and texts; of overloads, the first that has one."""
    seen = set()
    for node in stub.body:
        members = node.body if isinstance(node, ast.ClassDef) else []
        for one in (node, *members):
            if not isinstance(one, (ast.ClassDef, ast.FunctionDef)):
                continue
            text = ast.get_docstring(one)
            name = one.name if one is node else f"{node.name}_{one.name.replace('__', '')}"
            if text and name not in seen:
                seen.add(name)
                yield name, text


def header(stub_file: Path) -> str:
    """The text of the header."""
    lines = [
        "// SPDX-License-Identifier: BSD-3-Clause",
        f"// Made by docstrings.py from {stub_file.name}.",
        "#pragma once",
        "namespace ndtree::python::doc {",
    ]
    for name, text in docstrings(ast.parse(stub_file.read_text(encoding="utf-8"))):
        assert ')doc"' not in text, name
        lines.append(f'inline constexpr char {name}[] = R"doc({text})doc";')
    return "\n".join([*lines, "}  // namespace ndtree::python::doc", ""])


if __name__ == "__main__":
    made = Path(sys.argv[2])
    made.parent.mkdir(parents=True, exist_ok=True)
    made.write_text(header(Path(sys.argv[1])), encoding="utf-8")
