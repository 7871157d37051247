# SPDX-License-Identifier: BSD-3-Clause
"""What of a map is shown, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ndtree._native._core import OccupancyMap
from ndtree.cells.lattice import occupied_cells
from ndtree.cells.regions import ceiling
from ndtree.plot import COLORS

AXES = "xyz"
KINDS = ("occupied", "free", "unknown", "plane_occupied", "plane_free")
IN_PLANE = KINDS[3:]


@dataclass(frozen=True)
class Look:
    """What of a map is shown, and how.

    `color` ({"height", "size", "probability"}): What the colors of occupied cells say. A 2-D map has no
        heights.
    `occupied`, `free`, `unknown`, `track`, `grid`: What is drawn: occupied cells, free cells, unknown cells
        beside free ones, where the sensor was, and a grid with axes and a scale bar.
    `axis` ({0, 1, 2}): Of the slice.
    `slice_at`: Its position [m]; left out, there is none.
    `cut`: Leave out what is beyond the slice.
    `plane`: Draw the cells that the slice goes through.
    """

    color: str = "height"
    occupied: bool = True
    free: bool = False
    unknown: bool = False
    track: bool = True
    grid: bool = True
    axis: int = 2
    slice_at: float | None = None
    cut: bool = True
    plane: bool = True

    @classmethod
    def of(cls, dim: int, **more: Any) -> Look:
        """What suits maps of a dimension: flat ones show free cells, too, and no heights."""
        usual: dict[str, Any] = {"color": "probability", "free": True} if dim == 2 else {}
        return cls(**{**usual, **{name: value for name, value in more.items() if value is not None}})

    @classmethod
    def below_ceiling(cls, m: OccupancyMap, **more: Any) -> Look:
        """As `of`, but rooms are cut just below their ceiling, so that one sees into them."""
        if m.dim == 3 and more.get("slice_at") is None and m.stats().observed_leaves:
            some = occupied_cells(m)
            top = ceiling(some) if len(some) else None
            if top is not None:
                more = {**more, "axis": 2, "slice_at": top, "cut": True, "plane": False}
        return cls.of(m.dim, **more)

    def validate(self, dim: int) -> None:
        """@raises ValueError if a map of this dimension cannot be shown so."""
        known = COLORS if dim == 3 else COLORS[1:]
        if self.color not in known:
            raise ValueError(f"color = {self.color!r}: must be one of {', '.join(known)} for a {dim}-D map")
        if self.axis not in (0, 1, 2):
            raise ValueError(f"axis = {self.axis!r}: must be 0, 1 or 2")
        if self.slice_at is not None and dim == 2:
            raise ValueError("slice_at: a 2-D map has no slices")


def shown_kinds(look: Look) -> list[str]:
    """Layers that a look has."""
    wanted = {"occupied": look.occupied, "free": look.free, "unknown": look.unknown}
    kinds = [kind for kind, is_wanted in wanted.items() if is_wanted]
    return [*kinds, *IN_PLANE] if look.slice_at is not None and look.plane else kinds
