# SPDX-License-Identifier: BSD-3-Clause
"""`ndtree.load`: one of our maps or OctoMap's; of anything else, its kind and what makes a map of it."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from ndtree._native import _core

if TYPE_CHECKING:
    from ndtree._native._core import AdaptiveMap, FixedMap


def load(path: str | os.PathLike[str]) -> AdaptiveMap | FixedMap:
    try:
        return _core.load(path)
    except (IsADirectoryError, ValueError):
        better = _better(os.fsdecode(path))
        if better is None:
            raise
        raise better from None


def _better(name: str) -> ValueError | None:
    """What a file or folder is instead of one of these maps; None if it is damaged or not known."""
    from ndtree.logs import MAP_MAGIC, OCTOMAP_MAGIC, kind_of  # All formats: not for those who load maps.
    from ndtree.logs.core.plain_file import open_regular
    from ndtree.maps.open import is_map, no_map, tiles_url

    if tiles_url(name) is not None:
        return ValueError(f"{name}: a map in tiles, expected one in a file:\n  ndtree.open_tiles({name!r})")
    if not os.path.isdir(name):
        with open_regular(name) as file:
            if file.read(len(OCTOMAP_MAGIC)).startswith((MAP_MAGIC, OCTOMAP_MAGIC)):
                return None
        if is_map(name):
            target = f"{os.path.splitext(os.path.basename(name))[0]}.ndt"
            return ValueError(
                f"{name}: a map of map_server's, expected one of ndtree's or OctoMap's:\n"
                f"  ndtree.convert({name!r}, {target!r})"
            )
    if kind_of(name) is None:
        return None
    in_python = f"for scan in ndtree.read({name!r}): scan.insert_into(m)"
    return no_map(name, "a map of ndtree's or OctoMap's (.bt, .ot)", in_python)


load.__doc__, load.__module__ = _core.load.__doc__, "ndtree"
