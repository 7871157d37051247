# SPDX-License-Identifier: BSD-3-Clause
"""Methods of the compiled classes that are written in Python: files by their ending, pictures, texts."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ndtree import _lazy
from ndtree._native import _core
from ndtree._native._checked import checked
from ndtree._native._kinds import shown
from ndtree._native.results import Frontier

_save_own = _core.OccupancyMap.save


def save(self: _core.OccupancyMap, path: str | os.PathLike[str]) -> None:
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"save(): path = {shown(path)}: must be a path")
    target = Path(path)
    suffix = target.suffix.lower()
    own = ".ot" if self.refinement == "octomap" else ".ndt"
    if suffix in ("", own):
        _save_own(self, path)
        return
    _lazy.method("write")(self, target)


save.__doc__ = _save_own.__doc__


def certify(
    self: _core.OccupancyMap, scans: Iterable[Any], *, confidence: float = 0.95, max_range: float = math.inf
) -> Any:
    """Bound the share of what a map calls free that is occupied, by scans that it was not made of.

    Of the points along a scan's beams, every 0.1 m and at their ends, the map calls some free; the scan's
    share is that of end points among these. Of n scans and one more, in an order that says nothing, the last
    has a share of at most the k-th smallest of the others' with a probability of at least k / (n + 1): a
    conformal bound, without any assumption about sensor, world or map, or how beams of one scan depend on
    each other. It is for scans from where the held-out ones are from, so hold out scans from all along the
    way, as every tenth. Of less than confidence / (1 - confidence) scans, which is 19 at 95 %, it is 1.

    Parameters
    ----------
    scans : iterable of Scan
        Held out from the map.
    confidence : float
        In (0, 1).
    max_range : float
        Beams that are longer say nothing [m].

    Returns
    -------
    Certificate

    Raises
    ------
    ValueError
        If confidence or max_range is out of its limits.
    """
    return _lazy.method("certify")(self, scans, confidence=confidence, max_range=max_range)


def _html(self: _core.OccupancyMap) -> str:
    """What notebooks show: the map's numbers and a small picture."""
    text: str = _lazy.method("html")(self)
    return text


def _png(self: _core.OccupancyMap) -> bytes | None:
    """The small picture of `_repr_html_`, where nothing but pictures is shown."""
    picture: bytes | None = _lazy.method("png")(self)
    return picture


def _field_text(self: _core.DistanceField) -> str:
    values = self.values
    shape = " x ".join(map(str, values.shape))
    return (
        f"DistanceField({shape} cells of {self.cell_size:g} m, {values.min():g} to {values.max():g} m, "
        f"max_distance={self.max_distance:g})"
    )


def _field_centers(self: _core.DistanceField) -> NDArray[np.float64]:
    """(nx, ny[, nz], dim) float64: where `values` are [m]."""
    places = np.moveaxis(np.indices(self.values.shape), 0, -1)
    return self.lower + (places + 0.5) * self.cell_size


def _truth_text(self: _core.HeldOutTruth) -> str:
    return (
        f"HeldOutTruth(samples={self.samples}, free={self.free:.4g}, occupied={self.occupied:.4g}, "
        f"unknown={self.unknown:.4g}, endpoints={self.endpoints}, endpoints_near={self.endpoints_near:.4g}, "
        f"casts={self.casts}, casts_within={self.casts_within:.4g}, median_error={self.median_error:.4g}, "
        f"surfaces_within={self.surfaces_within:.4g}, surface_error={self.surface_error:.4g})"
    )


def _reliability_text(self: _core.Reliability) -> str:
    return f"Reliability({self.beams} beams in {int(self.pairs.sum())} cells, {int(self.ends.sum())} ends)"


def _space_text(self: _core.SeenSpace) -> str:
    return f"SeenSpace({len(self.points)} points in {self.dim}-D, {int(self.seen.sum())} seen)"


def _min_cell_size(self: _core.OccupancyMap) -> float:
    """float: edge of the smallest cells [m]; of all cells of a fixed map."""
    return float(self.options["min_cell_size"])


def _max_cell_size(self: _core.OccupancyMap) -> float:
    """float: edge of the largest cells that are updated [m].

    That is the smallest times a power of `branching`, the largest that the option of this name allows.
    """
    size = self.min_cell_size
    largest = float(self.options.get("max_cell_size", size)) * (1 + 1e-9)  # As the map rounds it.
    times = 1
    while size * times * self.branching <= largest:
        times *= self.branching
    return size * times


def _disputed(self: _core.OccupancyMap) -> float:
    """float: the fraction of the observed volume where the evidence contradicts itself in time.

    There at least two beams ended in a cell before at least twelve scans in a row all passed it, or the other
    way round, as where people walk, doors move or poses are wrong. ``leaves().disputed`` says where. Cells
    that have changed forget what was before: they are not disputed any more. nan where nothing was observed,
    and of maps whose cells count no such scans: fixed ones, OctoMap, and those of the paper's rules.
    """
    rows = np.array(_core.leaf_counts(self)) if self.refinement == "evidence" else ()
    if not len(rows):
        return math.nan
    volume = rows[:, 0] ** self.dim
    return float(rows[:, 4] @ volume) / float(rows[:, 1] @ volume)


#: What OctoMap and wavemap call methods, in small letters, and what does that here.
_ELSEWHERE = {
    **dict.fromkeys(("insertpointcloud", "insertray", "integratepointcloud"), "insert(points, origin)"),
    **dict.fromkeys(("search", "isnodeoccupied", "isoccupied", "getcellvalue"), "state(points)"),
    **dict.fromkeys(("updatenode", "setnodevalue", "setcellvalue"), "mark(box, 'occupied')"),
    **dict.fromkeys(("castray", "getrayintersection"), "cast_rays(origin, directions)"),
    **dict.fromkeys(("write", "writebinary", "store"), "save(path)"),
    **dict.fromkeys(("getresolution", "resolution", "voxelsize"), "min_cell_size"),
    **dict.fromkeys(("getnumleafnodes", "memoryusage", "size"), "stats()"),
    "prune": "compress(...); equal cells are merged while mapping",
}


def _absent(self: _core.OccupancyMap, name: str) -> Any:
    """AttributeError, which says what a method of other libraries is called here."""
    if meant := _ELSEWHERE.get(name.replace("_", "").lower()):
        raise AttributeError(f"{type(self).__name__} has no {name}: did you mean {meant}?")
    return object.__getattribute__(self, name)


_adaptive_text = _core.AdaptiveMap.__repr__


def _map_text(self: _core.AdaptiveMap) -> str:
    """Of the sizes those that cells have, and what was asked for where that was rounded."""
    asked = self.options["max_cell_size"]
    has = self.max_cell_size
    text = _adaptive_text(self)
    if math.isclose(has, asked, rel_tol=1e-8):
        return text
    before, name, after = text.partition("max_cell_size=")
    return f"{before}{name}{has:.6g} (rounded from {asked:g}){after[re.match(r'[^,)]*', after).end() :]}"  # type: ignore[union-attr]


def by_way(
    self: _core.Planner,
    start: ArrayLike,
    frontiers: Iterable[Frontier],
    *,
    max_seconds: float | None = None,
) -> list[tuple[Frontier, float]]:
    """Frontiers that the body can reach, in the order of the way to them.

    The way to a frontier is that to the nearest of its cells from whose centre the body meets no obstacle.
    Beside unknown space it fits nowhere where that is blocked: such a planner has no way to any frontier.

    Parameters
    ----------
    start : (dim,) array of float
        Where the origin of the body is [m].
    frontiers : iterable of Frontier
        As `OccupancyMap.frontiers` gives them.
    max_seconds : float, optional
        As for ways().

    Returns
    -------
    list of (Frontier, float)
        The nearest first, each with the length of the way to it [m]; of equally near ones, in their order.

    Raises
    ------
    ValueError
        The body collides at the start.
    KeyboardInterrupt
        Ctrl-C.
    """
    found = list(frontiers)
    if not found:
        return []
    goals = np.concatenate([frontier.cell_centers for frontier in found])
    ways = self.ways(start, goals, max_seconds=max_seconds)
    ends = np.cumsum([len(frontier) for frontier in found])[:-1]
    nearest = [float(np.fmin.reduce(part, initial=math.inf)) for part in np.split(ways, ends)]
    order = sorted(range(len(found)), key=nearest.__getitem__)
    return [(found[i], nearest[i]) for i in order if nearest[i] < math.inf]


def _given(type_: type, name: str, function: Any) -> None:
    """Add a method that is written here."""
    function = checked(function)
    function.__name__, function.__qualname__ = name, f"{type_.__name__}.{name}"
    function.__module__ = type_.__module__
    setattr(type_, name, function)


_given(_core.OccupancyMap, "save", save)
_core.OccupancyMap.__getattr__ = _absent  # type: ignore[attr-defined]
_given(_core.Planner, "by_way", by_way)
_core.OccupancyMap.min_cell_size = property(_min_cell_size)  # type: ignore[assignment, method-assign]
_core.OccupancyMap.max_cell_size = property(_max_cell_size)  # type: ignore[assignment, method-assign]
_core.OccupancyMap.disputed = property(_disputed)  # type: ignore[assignment, method-assign]
_given(_core.AdaptiveMap, "__repr__", _map_text)
_given(_core.OccupancyMap, "certify", certify)
_given(_core.OccupancyMap, "_repr_html_", _html)
_given(_core.OccupancyMap, "_repr_png_", _png)
_given(_core.DistanceField, "__repr__", _field_text)
_core.DistanceField.centers = property(_field_centers)  # type: ignore[assignment, method-assign]
_given(_core.HeldOutTruth, "__repr__", _truth_text)
_given(_core.Reliability, "__repr__", _reliability_text)
_given(_core.SeenSpace, "__repr__", _space_text)
