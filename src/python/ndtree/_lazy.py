# SPDX-License-Identifier: BSD-3-Clause
"""What loads when it is first used: names, and the modules that have them.

This module imports nothing of the package, so every folder may use it.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from typing import Any

#: A requirement with its library, and what is said of Python behind it.
_LINE = re.compile(
    r"([\w.-]+(?:\[[^]]*\])?[^;]*?) *; (?:python_version (<|>=) \"3\.(\d+)\" and )?extra == \"([\w-]+)\""
)
#: Functions of folders above ``_native`` that methods of its classes call. The classes work without those
#: folders; the methods that need them load them.
METHODS = {
    "certify": "ndtree.evaluation.certificate",
    "write": "ndtree.maps.writers",
    "require_kind": "ndtree.base.files",
    "html": "ndtree.maps.notebook",
    "png": "ndtree.maps.notebook",
}


def method(name: str) -> Any:
    """The function of `METHODS` with this name; its module is loaded."""
    return getattr(import_module(METHODS[name]), name)


def names(
    package: str, modules: Mapping[str, str], *, folders: tuple[str, ...] = ()
) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """``__all__``, ``__getattr__`` and ``__dir__`` of a package whose names load when they are asked for.

    `modules`: Of each module in the package, the names that it has, with blanks between.
    `folders`: Modules that are attributes of the package, too.
    """
    scope = vars(sys.modules[package])
    module_of = {name: module for module, held in modules.items() for name in held.split()}

    def get(name: str) -> Any:
        if name in folders:
            return import_module(f"{package}.{name}")
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        scope[name] = getattr(import_module(f"{package}.{module_of[name]}"), name)
        return scope[name]

    def names_of() -> list[str]:
        return sorted({*module_of, *folders, *(name for name in scope if name.startswith("__"))})

    return sorted(module_of), get, names_of


@contextmanager
def needs(what: str, extra: str) -> Iterator[None]:
    """Around imports of what not all have installed: ImportError says what needs it, and its extra."""
    try:
        yield
    except ImportError as error:
        raise ImportError(f"{what} ({error}); install it with:\n  {install_of(extra)}") from None


def install_of(extra: str) -> str:
    """A line to type that installs the libraries of an extra, wherever the package itself is from."""
    libraries = list(dict.fromkeys(_libraries(extra))) or [f"ndtree-mapping[{extra}]"]
    return f"pip install {' '.join(map(shlex.quote, libraries))}"


def _libraries(extra: str) -> list[str]:
    from importlib.metadata import PackageNotFoundError, requires

    try:
        lines = requires("ndtree-mapping") or []
    except PackageNotFoundError:
        return []
    found: list[str] = []
    for line in lines:
        part = _LINE.fullmatch(line)
        if part is None or part[4] != extra:
            continue
        if part[2] and (sys.version_info[1] < int(part[3])) != (part[2] == "<"):
            continue
        own = re.fullmatch(r"ndtree-mapping\[([\w,-]+)\]", part[1])
        found += [one for name in own[1].split(",") for one in _libraries(name)] if own else [part[1]]
    return found
