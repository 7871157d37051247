# SPDX-License-Identifier: BSD-3-Clause
"""Two clicks on the page ask for a way."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from browser import Browser, coloured

import ndtree
from ndtree import viewer as view
from ndtree.viewer.snapshot import Snapshot
from ndtree.viewer.visitor import Visitor
from ndtree.viewer.ways import Ways, place_on_plane


def rooms() -> Any:
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, max_cell_size=1.6)
    m.mark([[-2.0, -2.0], [2.0, 2.0]], "free")
    m.mark([[0.0, -2.0], [0.2, 1.0]], "occupied")
    return m


def test_a_ray_meets_the_plane_ahead_of_it_alone() -> None:
    down, up = np.array([0.5, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(place_on_plane(np.array([0.0, 1.0, 3.0]), down, 1.0), [1.0, 1.0, 1.0])
    assert place_on_plane(np.array([0.0, 1.0, 3.0]), up, 1.0) is None
    assert place_on_plane(np.zeros(3), np.array([1.0, 0.0, 0.0]), 1.0) is None


def test_every_second_click_ends_a_way() -> None:
    m, ways = rooms(), Ways()
    said, points = ways.clicked(m, np.array([-1.0, 0.0, 0.0]), 0.2)
    assert said == "from (-1.00, 0.00): click where to" and points.tolist() == [[-1.0, 0.0]]
    said, points = ways.clicked(m, np.array([1.0, 0.0, 0.0]), 0.2)
    assert len(points) > 2 and said.endswith("from obstacles")
    ways.clicked(m, np.array([-1.0, 0.0, 0.0]), 0.2)
    said, points = ways.clicked(m, np.array([0.1, 0.0, 0.0]), 0.2)
    assert "goal = (0.1, 0.0)" in said and len(points) == 0
    ways.clicked(m, np.array([-1.0, 0.0, 0.0]), 0.6)
    said, points = ways.clicked(m, np.array([1.0, 0.0, 0.0]), 0.6)
    assert "no path: the goal is in another part" in said and len(points) == 0
    assert "OctoMap" in ways.clicked(None, np.zeros(3), 0.2)[0]


def test_the_page_draws_the_way_that_two_clicks_ask_for() -> None:
    drawn: dict[str, Any] = {}

    def add(name: str, points: Any, *_: Any, **__: Any) -> Any:
        drawn[name] = points
        return SimpleNamespace(remove=lambda: drawn.pop(name, None))

    texts: list[str] = []
    visitor = Visitor.__new__(Visitor)
    snapshot = Snapshot(rooms())
    scene = SimpleNamespace(add_line_segments=add, add_point_cloud=add)
    visitor._client, visitor._drawn, visitor._ways = SimpleNamespace(scene=scene), {}, Ways()  # type: ignore
    visitor._viewer = SimpleNamespace(snapshot=snapshot)  # type: ignore
    visitor._controls = SimpleNamespace(way=(0.2, 0.0), say_cell=texts.append)  # type: ignore
    for x in (-1.0, 1.0):
        eye = np.array([x, 0.0, 5.0]) - snapshot.origin
        visitor._pick(SimpleNamespace(ray_origin=eye, ray_direction=(0.0, 0.0, -1.0)))
    assert "click where to" in texts[0] and "from obstacles" in texts[1]
    ends = np.array([drawn["/way"][0][0], drawn["/way"][-1][1]]) + snapshot.origin
    np.testing.assert_allclose(ends[:, :2], [[-1.0, 0.0], [1.0, 0.0]], atol=1e-5)


def test_two_clicks_on_the_page_draw_a_way() -> None:
    """On both sides of the wall, which is seen from above."""
    with view.Viewer(rooms(), port=0) as viewer, Browser(viewer.url) as browser:
        browser.until(lambda b: np.count_nonzero(coloured(b.picture())) > 300)
        browser.until(lambda b: "Click on one." in b.text())
        browser.click_label("Between two clicks")
        browser.until(lambda b: "Radius" in b.text())
        rows, columns = np.nonzero(coloured(browser.picture()))
        low, high, row = int(columns.min()), int(columns.max()), int(np.median(rows)) + 200
        before = np.count_nonzero(coloured(browser.picture()))
        browser.click(low - 150, row)
        browser.until(lambda b: "click where to" in b.text())
        browser.click(high + 150, row)
        browser.until(lambda b: "from obstacles" in b.text())
        browser.until(lambda b: np.count_nonzero(coloured(b.picture())) > before + 200)
        assert browser.errors == []
