# SPDX-License-Identifier: BSD-3-Clause
"""The panel of one page."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from ndtree.plot import COLORS, Coloring
from ndtree.viewer.look import AXES, Look
from ndtree.viewer.snapshot import Snapshot


class Controls:
    """The panel of one page."""

    def __init__(
        self,
        client: viser.ClientHandle,
        snapshot: Snapshot,
        look: Look,
        changed: Any,
        *,
        has_track: bool = False,
    ) -> None:
        gui = client.gui
        self._dim = snapshot.dim
        self._about = gui.add_markdown("working …")
        colors = COLORS if self._dim == 3 else COLORS[1:]
        self._color = gui.add_dropdown("Color", colors, initial_value=look.color)
        self._legend = gui.add_html("")
        self._checks = {
            name: gui.add_checkbox(label, getattr(look, name))
            for name, label in (
                ("occupied", "Occupied"),
                ("free", "Free"),
                ("unknown", "Unknown by free"),
                ("track", "Trajectory"),
                ("grid", "Grid and scale"),
            )
        }
        self.offer_track(has_track)
        inputs = [self._color, *self._checks.values()]
        self._axis = self._at = self._sliced = None
        if self._dim == 3:
            with gui.add_folder("Slice"):
                self._sliced = gui.add_checkbox("On", look.slice_at is not None)
                self._axis = gui.add_dropdown("Axis", tuple(AXES), initial_value=AXES[look.axis])
                low, high = (float(edge) for edge in snapshot.region[look.axis])
                at = 0.5 * (low + high) if look.slice_at is None else look.slice_at
                low, high = min(low, at), max(high, at)
                self._at = gui.add_slider("Position [m]", low, high, snapshot.unit / 4, at)
                self._cut = gui.add_checkbox("Cut away beyond", look.cut)
                self._plane = gui.add_checkbox("Draw its cells", look.plane)
            inputs += [self._sliced, self._at, self._cut, self._plane]
            self._axis.on_update(lambda _: self._turn(changed))
            self._offer_slice()
            self._sliced.on_update(lambda _: self._offer_slice())
        with gui.add_folder("Way"):
            self._plans = gui.add_checkbox("Between two clicks", False)
            self._radius = gui.add_slider("Radius [m]", 0.05, 2.0, 0.05, 0.3)
            low, high = (float(edge) for edge in snapshot.region[2]) if self._dim == 3 else (0.0, 1.0)
            self._height = gui.add_slider("Height [m]", low, high, snapshot.unit / 4, 0.5 * (low + high))
            self._plans.on_update(lambda _: self._offer_way())
            self._offer_way()
        with gui.add_folder("Cell"):
            self._cell = gui.add_markdown("Click on one.")
        self._snapshot = snapshot
        for each in inputs:
            each.on_update(lambda _: changed())

    def look(self) -> Look:
        """What the controls ask for."""
        shown = {name: check.value for name, check in self._checks.items()}
        if self._sliced is None or not self._sliced.value:
            return Look(color=self._color.value, **shown)
        return Look(
            color=self._color.value,
            axis=AXES.index(self._axis.value),
            slice_at=float(self._at.value),
            cut=self._cut.value,
            plane=self._plane.value,
            **shown,
        )

    def _turn(self, changed: Any) -> None:
        """A slice of another axis begins in the middle."""
        low, high = (float(edge) for edge in self._snapshot.region[AXES.index(self._axis.value)])
        self._at.min, self._at.max = min(low, self._at.min), max(high, self._at.max)
        self._at.value = 0.5 * (low + high)
        self._at.min, self._at.max = low, high
        changed()

    def fit(self, snapshot: Snapshot) -> None:
        """Reach over all of a map that has grown."""
        if snapshot is self._snapshot:
            return
        self._snapshot = snapshot
        if self._at is not None:
            low, high = snapshot.region[AXES.index(self._axis.value)]
            self._at.min, self._at.max = min(self._at.min, float(low)), max(self._at.max, float(high))

    def offer_track(self, has_track: bool) -> None:
        """Without a log there is no trajectory to show or hide."""
        self._checks["track"].visible = has_track

    def _offer_slice(self) -> None:
        """Where there is no slice, there is nothing to place, to cut or to draw."""
        for each in (self._axis, self._at, self._cut, self._plane):
            each.visible = self._sliced.value

    def _offer_way(self) -> None:
        self._radius.visible = self._plans.value
        self._height.visible = self._plans.value and self._dim == 3

    @property
    def way(self) -> tuple[float, float] | None:
        """Radius of the robot and height of its way [m], if clicks ask for ways."""
        if not self._plans.value:
            return None
        return float(self._radius.value), float(self._height.value) if self._dim == 3 else 0.0

    def say(self, text: str) -> None:
        self._about.content = text

    def say_cell(self, text: str) -> None:
        self._cell.content = text

    def explain(self, colors: Coloring | None) -> None:
        """What the colors mean: a strip from the lowest to the highest."""
        self._legend.content = "" if colors is None else legend_html(colors)


def legend_html(colors: Coloring) -> str:
    """A strip of the colors with their ends' values below."""
    shown = colors.legend()
    levels = shown.cmap(np.linspace(0, 1, 12))[:, :3]
    stops = ", ".join(f"rgb({', '.join(str(round(255 * c)) for c in level)})" for level in levels)
    return (
        '<div style="margin:0 1em 0.6em;font-size:0.8em">'
        f'<div style="height:0.8em;border-radius:3px;background:linear-gradient(to right, {stops})"></div>'
        '<div style="display:flex;justify-content:space-between">'
        f"<span>{shown.norm.vmin:.3g}</span><span>{colors.label}</span><span>{shown.norm.vmax:.3g}</span>"
        "</div></div>"
    )
