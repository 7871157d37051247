# SPDX-License-Identifier: BSD-3-Clause
"""Scans in millimetres or in another frame cause a warning; a given max_range silences it."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from calling import cli

import ndtree
from ndtree.base.scan import Scan
from ndtree.tuning.first_look import Scale


def scans(factor: float = 1.0, at: tuple[float, float] = (0.0, 0.0)) -> list[Scan]:
    """Three of a room, the last with ranges times a factor and at another place."""
    angle = np.linspace(0, 6, 60)
    ways = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    made = []
    for i in range(3):
        last = i == 2
        origin = np.array([0.1 * i, 0.0]) + (at if last else 0.0)
        made.append(Scan(origin + 4.0 * (factor if last else 1.0) * ways, origin))
    return made


@pytest.mark.parametrize("factor, at, cell, limit, said", [
    (1.0, (0, 0), 0.05, math.inf, None), (50.0, (0, 0), 0.05, math.inf, None),
    (1000.0, (0, 0), 0.05, math.inf, "scan 2 has a beam of 4,000 m, 80,000 cells"),
    (1000.0, (0, 0), 0.05, 30.0, None), (1000.0, (0, 0), 1.0, math.inf, None),
    (1.0, (4e5, 5e6), 0.05, math.inf, "scan 2 lies 5,000,000 m from the one before"),
])  # fmt: skip
def test_what_is_absurd_is_told_of(
    factor: float, at: tuple[float, float], cell: float, limit: float, said: str | None
) -> None:
    scale = Scale(cell, limit)
    for scan in scans(factor, at):
        scale.add(scan)
    warning = scale.warning()
    assert (warning is None) if said is None else (warning or "").startswith(said)


def test_nothing_is_said_of_beams_that_say_nothing() -> None:
    scale = Scale(0.05)
    for ends in (np.empty((0, 2)), np.full((3, 2), np.nan), np.full((3, 2), np.inf)):
        scale.add(Scan(ends, np.zeros(2)))
    assert scale.warning() is None


@pytest.mark.parametrize("cell, said", [(0.1, "points span 8,000 m, 80,000 cells"), (0.5, "")])
def test_points_alone_in_millimetres_are_told_of(cell: float, said: str) -> None:
    points = np.linspace([5e6, 5e6, 0.0], [5e6 + 8e3, 5e6 + 7e3, 10.0], 100)
    points[7] = np.nan
    scale = Scale(cell)
    scale.add(Scan(points, points, points_only=True))
    assert (scale.warning() or "").startswith(said) and bool(scale.warning()) == bool(said)


@pytest.mark.parametrize("size, cell, said", [
    (2e-4, 0.05, "900 points span 0.0002 m across, less than 10 cells"), (0.4, 0.05, "900 points span 0.4 m"),
    (0.4, 0.01, ""), (0.6, 0.05, ""),
])  # fmt: skip
def test_points_alone_in_degrees_are_told_of(size: float, cell: float, said: str) -> None:
    scale = Scale(cell)
    for part in np.split(np.linspace([8.5, 47.0, 400.0], [8.5 + size, 47.0 + size / 2, 430.0], 900), 3):
        scale.add(Scan(part, part, points_only=True))
    assert (scale.warning() or "").startswith(said) and bool(scale.warning()) == bool(said)


def test_a_cloud_of_both_sides_of_a_wall_is_no_scan(tmp_path: Path) -> None:
    def room(begin: float) -> np.ndarray:
        """4 m of floor and walls, the nearer of which closes it."""
        a, b = (part.ravel() for part in np.meshgrid(np.linspace(0, 4, 81), np.linspace(0, 2, 41)))
        floor = np.c_[begin + a, 2 * b, np.zeros(a.size)]
        return np.concatenate([floor, *(np.c_[np.full(a.size, begin + x), a, b] for x in (0, 4))])

    clouds = {"one": room(0.0), "both": np.concatenate([room(0.0), room(4.0)])}
    for name, points in clouds.items():
        np.savetxt(tmp_path / f"{name}.xyz", points, fmt="%.4f")
        call = [f"{tmp_path / name}.xyz", "--origin-of-scan", "2,2,1", "--range-sigma", "0.01"]
        for output in (f"{name}.ndt", f"{name}.tiles"):
            said = cli("map", *call, "-o", str(tmp_path / output)).output
            assert ("lie behind others of it" in said) == (name == "both"), said


@pytest.mark.parametrize("far", [20, 60], ids=["some are far", "all are"])
def test_map_and_compare_say_it_in_one_line(far: int, tmp_path: Path) -> None:
    """Most beams of a scan that are too long are refused before they fill the memory."""
    some, near = scans(1000.0), scans()[2].endpoints
    np.savez(
        tmp_path / "a.npz",
        origins=np.array([scan.origin for scan in some]),
        points=np.concatenate([*(one.endpoints for one in some[:2]), some[2].endpoints[:far], near[far:]]),
        offsets=np.arange(4) * 60,
    )
    maps = ["map", str(tmp_path / "a.npz"), "-o", str(tmp_path / "a.ndt"), "--no-return", "free"]
    compare = ["compare", str(tmp_path / "a.npz"), "--maps", "adaptive", "--held-out", "0"]
    for call in (maps, compare) if far < 60 else (maps,):
        done = cli(*call)
        assert done.exit_code == (far == 60), done.output
        assert (
            done.output.count("scan 2 has a beam of 4,000 m" if far < 60 else "most beams are that long") == 1
        )
        assert "a beam of" not in cli(*call, "--max-range", "100").output
    said = " ".join(cli("info", str(tmp_path / "a.npz"), "--look").output.split())
    assert "scan 2 has a beam of 4,000 m, 80,000 cells: expected metres" in said, said
    assert ndtree.load(tmp_path / "a.ndt").dim == 2


@pytest.mark.parametrize("adaptive", [True, False])
def test_insert_warns_of_absurd_beams_before_it_changes_anything(adaptive: bool) -> None:
    def new() -> ndtree.OccupancyMap:
        return ndtree.AdaptiveMap(dim=2) if adaptive else ndtree.FixedMap(dim=2, min_cell_size=0.05)

    near, far = scans()[0], scans(1000.0)[2]
    m = new()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        m.insert(near.endpoints, near.origin)
        m.insert(far.endpoints, far.origin, max_range=30.0)
        m.insert(np.full((1, 2), np.nan), far.origin)
        before = m.to_bytes()
        with pytest.raises(ValueError, match=r"80,000 of the smallest cells; most beams are that"):
            m.insert(far.endpoints, far.origin)
        assert m.to_bytes() == before
        some = np.concatenate([near.endpoints[:2], far.endpoints[:1]])
        with pytest.raises(UserWarning, match="80,000 of the smallest cells: expected"):
            m.insert(some, far.origin)
        assert m.to_bytes() == before
    with pytest.raises(ValueError, match="most beams are that long"):
        ndtree.ScanHistory(dim=2).insert(0, far.endpoints - far.origin, [0.0, 0.0, 0.0])
    with pytest.warns(UserWarning, match="80,000 of the smallest cells: expected") as caught:
        m.insert(some, far.origin)
    assert len(caught) == 1
    assert caught[0].filename == __file__
