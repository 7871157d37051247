# SPDX-License-Identifier: BSD-3-Clause
"""Kinds of maps, and which options each takes."""

from __future__ import annotations

from typing import Any

from ndtree._errors import WrongValue, key
from ndtree._native import _core
from ndtree._native._core import OccupancyMap
from ndtree.base.options import DEFAULT_REFINEMENT, MAP_OPTIONS

REFINEMENTS = {name for option in MAP_OPTIONS for name in option.read_by}
OPTION_NAMES = tuple(option.name for option in MAP_OPTIONS)

_INSERTIONS = {
    "octomap": "ray",
    "octomap-scan": "scan",
    "octomap-scan-lazy": "scan_lazy",
    "octomap-scan-discretized": "scan_discretized",
}

#: What a comparison can have in it; "paper" is the adaptive map exactly as the paper has it, "octomap-scan"
#: inserts scans by ``insertPointCloud``, which updates each cell once a scan, "-lazy" without pruning,
#: "-discretized" also with one beam for each cell that beams end in.
KINDS = ("adaptive", "paper", "fixed", *_INSERTIONS)


def make_map(name: str, *, dim: int, **options: Any) -> OccupancyMap:
    """A map by the name of its kind; of the options it gets those that it takes.

    `name`: One of `KINDS`, with "@" and a cell size [m] if that is not the common one, as in "fixed@0.1".
    `dim`: Number of coordinates of a point.
    `**options`: As in `AdaptiveMap`.
    Raises ValueError if there is no such kind, or an option is out of its limits; RuntimeError if OctoMap was
    not there when the module was built.
    """
    kind, _, own_size = name.partition("@")
    if kind not in KINDS:
        raise WrongValue.of(
            "maps", f"{name!r}", f"one of {', '.join(KINDS)}, with @ and a cell size if wanted"
        )
    if own_size:
        try:
            options["min_cell_size"] = float(own_size)
        except ValueError:
            said = f"{key('maps')} = {name!r}: expected a cell size in metres behind the @"
            raise WrongValue(said) from None
    if "cell_size" in options:  # Of maps with one size, another name.
        options.setdefault("min_cell_size", options.pop("cell_size"))
    for option in options:
        if option not in OPTION_NAMES:
            raise TypeError(f"{option}: no map has such an option")
    if kind in _INSERTIONS and not _core.has_octomap:
        raise RuntimeError(f"map {name!r}: OctoMap was not there when ndtree was built")
    refinement = "paper" if kind == "paper" else options.get("refinement", DEFAULT_REFINEMENT)
    refinement = "fixed" if kind == "fixed" else "octomap" if kind in _INSERTIONS else refinement
    return map_of(refinement, dim, {**options, "refinement": refinement}, insertion=_INSERTIONS.get(kind))


def map_of(
    refinement: str, dim: int, options: dict[str, Any], *, insertion: str | None = None
) -> OccupancyMap:
    """A map of a refinement, "fixed" and "octomap" too, with those of the options that it reads."""
    read = {
        option.name: options[option.name]
        for option in MAP_OPTIONS
        if option.name in options and refinement in option.read_by
    }
    if refinement not in REFINEMENTS:  # It says so.
        return _core.AdaptiveMap(dim=dim, refinement=refinement)  # type: ignore[arg-type]
    if refinement == "octomap":
        return _core.OctoMap(dim=dim, insertion=insertion, **read)  # type: ignore[arg-type]
    return (_core.FixedMap if refinement == "fixed" else _core.AdaptiveMap)(dim=dim, **read)
