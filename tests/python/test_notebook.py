# SPDX-License-Identifier: BSD-3-Clause
"""What notebooks show of maps: a table, and a small PNG that is made without any library."""

from __future__ import annotations

import base64
import io
import re
import subprocess
import sys

import numpy as np
import pytest

import ndtree
from ndtree.maps.notebook import LONGER_SIDE, encoded

RNG = np.random.default_rng(3)


def pixels(data: bytes) -> np.ndarray:
    """As Pillow reads them."""
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed").open(io.BytesIO(data))
    return np.asarray(image)


def test_png_is_what_pillow_reads() -> None:
    for shape in ((1, 1), (7, 300), (5, 4, 3)):
        image = RNG.integers(0, 256, shape, dtype=np.uint8)
        np.testing.assert_array_equal(pixels(encoded(image)), image)


def test_a_flat_map_is_drawn_as_its_states_are() -> None:
    states = RNG.choice(np.array([-1, 0, 1], dtype=np.int8), (40, 23))
    states[0, 0] = states[-1, -1] = 1
    m = ndtree.from_grid(states, [-2.0, 1.0], 0.1, refinement="fixed")
    drawn = pixels(m._repr_png_())
    factor = drawn.shape[1] // 40
    assert drawn.shape == (23 * factor, 40 * factor) and 0.5 * LONGER_SIDE < drawn.shape[1] <= LONGER_SIDE
    grey = np.array([205, 254, 0], dtype=np.uint8)[states + 1]  # First axis x, second y upwards.
    np.testing.assert_array_equal(drawn[factor // 2 :: factor, factor // 2 :: factor], grey.T[::-1])


def test_thin_walls_of_a_large_map_are_seen() -> None:
    states = np.zeros((2000, 1600), dtype=np.int8)
    walls = {"column": 1003, "row": 377}
    states[walls["column"]] = 1
    states[:, walls["row"]] = 1
    states[[0, -1]] = states[:, [0, -1]] = 1
    m = ndtree.from_grid(states, [0.0, 0.0], 0.05)
    dark = pixels(m._repr_png_()) == 0
    assert max(dark.shape) <= LONGER_SIDE
    assert dark.all(axis=0)[round(walls["column"] / 2000 * dark.shape[1])]
    assert dark.all(axis=1)[::-1][round(walls["row"] / 1600 * dark.shape[0])]
    assert dark.mean() < 0.05


def test_a_solid_map_is_seen_from_above_in_the_colors_of_its_height() -> None:
    states = np.full((30, 20, 10), -1, dtype=np.int8)
    states[:15, :, 0] = 1
    states[5, 5, :] = 1
    m = ndtree.from_grid(states, [0.0, 0.0, 0.0], 0.1)
    drawn = pixels(m._repr_png_()).astype(int)
    factor = drawn.shape[1] // 15  # What is seen is half of the box.
    small = drawn[::-1][factor // 2 :: factor, factor // 2 :: factor].transpose(1, 0, 2)
    assert small.shape[:2] == (15, 20)
    high = np.abs(small - small[5, 5]).sum(axis=2) == 0
    assert high.sum() == 1 and high[5, 5]
    assert len(np.unique(small[~high], axis=0)) == 1 and not (small[0, 0] == 255).all()


def test_what_has_no_picture_has_its_numbers() -> None:
    empty = ndtree.AdaptiveMap(dim=3)
    deep = ndtree.AdaptiveMap(dim=4)
    deep.insert(np.ones((3, 4)), np.zeros(4))
    for m in (empty, deep):
        assert m._repr_png_() is None
        shown = m._repr_html_()
        assert "<img" not in shown and f"AdaptiveMap, {m.dim}-D" in shown


@pytest.mark.parametrize("kind", ["AdaptiveMap", "FixedMap", "OctoMap"])
def test_the_table_has_the_picture_in_it(kind: str) -> None:
    if kind == "OctoMap" and not ndtree.has_octomap:
        pytest.skip("built without OctoMap")
    m = getattr(ndtree, kind)(dim=2)
    for scan in ndtree.simulate("office", scans=5):
        scan.insert_into(m, max_range=10)
    shown = m._repr_html_()
    found = re.search(r'src="data:image/png;base64,([^"]+)"', shown)
    assert found and base64.b64decode(found[1]) == m._repr_png_()
    assert f"{m.stats().observed_leaves:,} observed" in shown and f"{kind}, 2-D" in shown
    assert len(shown) < 60_000


def test_pictures_need_numpy_alone() -> None:
    code = """
import sys
for name in ("matplotlib", "PIL", "IPython", "scipy"):
    sys.modules[name] = None
import ndtree
m = ndtree.AdaptiveMap(dim=2)
m.insert([[1.0, 0.5]], [0.0, 0.0])
assert m._repr_png_().startswith(b"\\x89PNG") and "<img" in m._repr_html_()
"""
    subprocess.run([sys.executable, "-c", code], check=True)
