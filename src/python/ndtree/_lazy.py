# SPDX-License-Identifier: BSD-3-Clause
"""What loads when it is first used: names, and the modules that have them.

This module imports nothing of the package, so every folder may use it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

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


@contextmanager
def needs(what: str, extra: str) -> Iterator[None]:
    """Around imports of what not all have installed: ImportError says what needs it, and its extra."""
    try:
        yield
    except ImportError as error:
        raise ImportError(
            f"{what} ({error}); install it with:\n  pip install 'ndtree-mapping[{extra}]'"
        ) from None
