# SPDX-License-Identifier: BSD-3-Clause
"""What the stub and ``ndtree.typing`` say of the maps' options, from the library's table.

usage: tools/option_stubs.py    (writes both; tests/python/test_stubs.py compares)

The table is `kOptionTable` in include/ndtree/mapping/map_options.hpp; `_core.option_table()` has its rows.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1] / "src" / "python" / "ndtree"
STUB = PACKAGE / "_native" / "_core.pyi"
TYPING = PACKAGE / "base" / "typing.py"
#: Classes of the stub, and the refinements of their maps.
CLASSES = {
    "AdaptiveMap": ("evidence", "paper"),
    "FixedMap": ("fixed",),
    "OctoMap": ("octomap",),
}
TYPED = {"MapOptions": CLASSES["AdaptiveMap"], "FixedMapOptions": ("fixed",), "OctoMapOptions": ("octomap",)}
WIDTH = 118

Row = Sequence[Any]


def _read_by(rows: Sequence[Row], refinements: Sequence[str]) -> list[Row]:
    """Options, without constants, that maps of these refinements read."""
    return [row for row in rows if row[6] is not None and set(refinements) & set(row[5])]


def _described(row: Row) -> str:
    """An option as a paragraph of a NumPy docstring."""
    name, _, _, _, unit, readers, _, what, _ = row
    first, more, rest = what.rstrip(".").partition(";")
    text = first + (f" [{unit.strip()}]" if unit else "") + more + rest
    own = set(readers) & {"evidence", "paper"}
    text += f' ("{own.pop()}").' if len(own) == 1 else "."
    indent = " " * 8
    return f"    {name} : float\n" + textwrap.fill(
        text, WIDTH, initial_indent=indent, subsequent_indent=indent
    )


def _replaced(text: str, pattern: str, new: Callable[[], str]) -> str:
    found, times = re.subn(pattern, lambda match: match[1] + new() + match[2], text, count=1, flags=re.DOTALL)
    assert times == 1, pattern
    return found


def stub(text: str, rows: Sequence[Row]) -> str:
    """The stub with its classes' docstrings and keywords."""
    for name, refinements in CLASSES.items():
        at = text.index(f"\nclass {name}(")
        head, part = text[:at], text[at:]
        options = _read_by(rows, refinements)
        if name == "AdaptiveMap":
            part = _replaced(
                part,
                r"([Ss]ee `insert`, `layer`\.\n).*?(\n\n    \w+\n    -{3})",
                lambda options=options: "\n".join(map(_described, options)),
            )
        else:
            names = ", ".join(row[0] for row in options)
            part = _replaced(part, r"(\n    )(?:\w+, )+\w+( : float\n)", lambda names=names: names)
        part = _replaced(
            part,
            r"(def __init__\(\n.*?)        min_cell_size: float = \.\.\.,\n.*?(    \) -> None)",
            lambda options=options: "".join(f"        {row[0]}: float = ...,\n" for row in options),
        )
        text = head + part
    return text


def typing(text: str, rows: Sequence[Row]) -> str:
    """The module of types with its dictionaries of options."""
    for name, refinements in TYPED.items():
        fields = "".join(f"    {row[0]}: float\n" for row in _read_by(rows, refinements))
        text = _replaced(
            text,
            rf"(class {name}\(TypedDict, total=False\):\n    \"\"\"[^\n]*\"\"\"\n\n).*?(\n\n\n?class |\Z)",
            lambda fields=fields: fields.rstrip("\n"),
        )
    return text


def main() -> None:
    from ndtree._native import _core

    rows = _core.option_table()
    STUB.write_text(stub(STUB.read_text(), rows))
    TYPING.write_text(typing(TYPING.read_text(), rows))


if __name__ == "__main__":
    main()
