# SPDX-License-Identifier: BSD-3-Clause
"""Images for map_server say to others, cell by cell, what the map says."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import ndtree

SIZE = 0.1


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A map's YAML file, and the states that its cells have, (x, y) from the lower left on."""
    rng = np.random.default_rng(5)
    states = rng.choice([-1, 0, 1], size=(37, 23), p=[0.3, 0.4, 0.3]).astype(np.int8)
    states[[0, -1]] = states[:, [0, -1]] = 1  # What is unknown at the rim is not written.
    m = ndtree.from_grid(states, [-1.3, 0.7], SIZE)
    path = tmp_path_factory.mktemp("map") / "hall.yaml"
    ndtree.convert(m, path)
    return path, states


def served(path: Path) -> tuple[np.ndarray, list[float]]:
    """What map_server publishes by its documentation, (x, y): 0 to 100, -1 unknown; and the origin."""
    yaml, pil = pytest.importorskip("yaml"), pytest.importorskip("PIL.Image")
    about = yaml.safe_load(path.read_text())
    assert about["resolution"] == SIZE and about["origin"][2] == 0
    with pil.open(path.parent / about["image"]) as image:
        grey = np.asarray(image.convert("L")).astype(float)
    p = grey / 255 if about["negate"] else (255 - grey) / 255
    low, high = about["free_thresh"], about["occupied_thresh"]
    values = np.full(p.shape, -1)
    values[p > high], values[p < low] = 100, 0
    assert about["mode"] == "trinary"
    return values[::-1].T, about["origin"][:2]


def test_map_server_would_serve_what_the_map_says(written: tuple[Path, np.ndarray]) -> None:
    path, states = written
    values, origin = served(path)
    np.testing.assert_allclose(origin, [-1.3, 0.7])
    np.testing.assert_array_equal(values, np.array([-1, 0, 100])[states + 1])


@pytest.mark.parametrize("mode", ["Trinary", "TRINARY"])
def test_modes_are_read_in_any_case(mode: str, written: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    """As nav2 does."""
    path, _ = written
    text = path.read_text().replace("trinary", mode)
    assert mode in text
    shutil.copy(path.with_suffix(".pgm"), tmp_path)
    (tmp_path / "hall.yaml").write_text(text)
    for one in (path, tmp_path / "hall.yaml"):
        ndtree.convert(one, tmp_path / f"{one.parent == tmp_path}.ndt")
    assert (tmp_path / "True.ndt").read_bytes() == (tmp_path / "False.ndt").read_bytes()
