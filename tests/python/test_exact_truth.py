# SPDX-License-Identifier: BSD-3-Clause
"""What the exact truth of simulated worlds counts, on worlds that are worked out here."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import ndtree
from ndtree.evaluation.exact_truth import ExactTruth, _is_grazed_floor, area_under_roc

POLE = 0.02  # Radius [m].


class Yard:
    """A wall behind y = 3, a pole at (0.5, 1.5), and in 3-D the ground below z = 0."""

    def __init__(self, dim: int) -> None:
        self.dim = dim

    def contains(self, points: Any) -> np.ndarray:
        inside = (points[:, 1] >= 3.0) | (np.hypot(points[:, 0] - 0.5, points[:, 1] - 1.5) <= POLE)
        return inside | (points[:, 2] <= 0.0) if self.dim == 3 else inside

    def distance(self, starts: Any, ways: Any, max_range: float) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            walls = [(3.0 - starts[:, 1]) / ways[:, 1]]
            if self.dim == 3:
                walls.append(-starts[:, 2] / ways[:, 2])
        flat = np.hypot(ways[:, 0], ways[:, 1])
        to = np.array([0.5, 1.5]) - starts[:, :2]
        along = (to * ways[:, :2]).sum(axis=1) / flat
        chord = along**2 - (to**2).sum(axis=1) + POLE**2
        walls.append(
            np.where((chord > 0) & (along > 0), along - np.sqrt(np.maximum(chord, 0)), np.inf) / flat
        )
        found = np.min([np.where(wall > 0, wall, np.inf) for wall in walls], axis=0)
        return np.where(found <= max_range, found, np.nan)

    def scan(self, height: float = 0.3) -> ndtree.Scan:
        """Level all around; in 3-D some beams go down, by up to 30 degrees."""
        yaw, down = np.meshgrid(np.linspace(0.1, math.pi - 0.1, 400), np.radians(np.linspace(0, 30, 7)))
        ways = np.stack([np.cos(yaw), np.sin(yaw), -np.tan(down)], axis=-1).reshape(-1, 3)[:, : self.dim]
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        start = np.array([0.0, 0.0, height])[: self.dim]
        reach = self.distance(np.broadcast_to(start, ways.shape), ways, 20.0)
        use = np.isfinite(reach)
        return ndtree.Scan(start + reach[use, None] * ways[use], start)


class Judge:
    """Not a map, but something to ask: occupied where `solid` says."""

    def __init__(self, solid: Any) -> None:
        self.solid = solid

    def state(self, points: Any) -> np.ndarray:
        return self.solid(points).astype(np.int8)

    def probability(self, points: Any) -> np.ndarray:
        return self.solid(points).astype(np.float32)

    def occupied_within(self, points: Any, radius: float) -> np.ndarray:
        return self.solid(points + 1e-4)


@pytest.mark.parametrize("dim", [2, 3])
def test_thin_things_and_the_floor_are_told_apart(dim: int) -> None:
    yard = Yard(dim)
    exact = ExactTruth(yard, [yard.scan()], math.inf)  # type: ignore[arg-type]
    near_pole = Judge(lambda p: np.hypot(p[:, 0] - 0.5, p[:, 1] - 1.5) < 2 * POLE)
    found = exact.of(near_pole)  # type: ignore[arg-type]
    assert found["thin"]["samples"] > 200
    assert found["thin"]["found"] == 1.0, "all that is thin is the pole"
    everything_else = Judge(lambda p: np.hypot(p[:, 0] - 0.5, p[:, 1] - 1.5) >= 2 * POLE)
    assert exact.of(everything_else)["thin"]["found"] == 0.0  # type: ignore[arg-type]
    assert ("floor" in found) == (dim == 3)
    if dim == 3:
        low = exact.of(Judge(lambda p: p[:, 2] < 0.01))["floor"]  # type: ignore[arg-type]
        assert low["samples"] > 1000
        assert low["found"] == 1.0


@pytest.mark.parametrize("dim", [2, 3])
def test_who_knows_the_world_is_right_everywhere(dim: int) -> None:
    yard = Yard(dim)
    exact = ExactTruth(yard, [yard.scan()], math.inf).of(Judge(yard.contains))  # type: ignore[arg-type]
    assert exact["auc"] == 1.0
    assert exact["inside"]["occupied"] == 1.0
    assert exact["free"]["free"] == exact["near"]["free"] == 1.0
    start = yard.scan().origin

    def is_deep(points: np.ndarray) -> np.ndarray:
        away = points - start
        return yard.contains(points - 0.025 * away / np.linalg.norm(away, axis=1, keepdims=True))

    deep = ExactTruth(yard, [yard.scan()], math.inf).of(Judge(is_deep))  # type: ignore[arg-type]
    assert deep["inside"]["occupied"] == pytest.approx(0.5, abs=0.05), "half of the 0.05 m behind"
    wrong = ExactTruth(yard, [yard.scan()], math.inf).of(  # type: ignore[arg-type]
        Judge(lambda p: ~yard.contains(p))  # type: ignore[arg-type]
    )
    assert wrong["auc"] == 0.0


def test_area_under_the_roc_curve_is_that_of_all_pairs() -> None:
    generator = np.random.default_rng(5)
    for _ in range(20):
        positive = generator.integers(0, 8, generator.integers(1, 60)) / 7
        negative = generator.integers(0, 8, generator.integers(1, 60)) / 7
        pairs = np.sign(positive[:, None] - negative[None, :])
        assert area_under_roc(positive, negative) == pytest.approx((pairs.mean() + 1) / 2)
    assert area_under_roc(np.array([]), np.array([1.0])) is None


def test_returned_beams_are_those_that_met_something() -> None:
    ends = np.array([[3.0, 4.0], [np.nan, 1.0], [0.0, 0.0], [6.0, 8.0], [0.0, 2.0]])
    scan = ndtree.Scan(ends, np.zeros(2), returned=np.array([True, True, True, True, False]))
    start, way, far = scan.returned_beams(7.0)
    np.testing.assert_allclose(far, [5.0])
    np.testing.assert_allclose(way, [[0.6, 0.8]])
    np.testing.assert_allclose(start, [[0.0, 0.0]])
    assert len(scan.returned_beams()[2]) == 2


def test_a_floor_is_level_all_around() -> None:
    """A table of 1 m by 1 m: within 0.1 m of an edge there is none below, or a step above."""

    class Table:
        def __init__(self, sign: int) -> None:
            self.sign = sign

        def contains(self, points: Any) -> np.ndarray:
            on = (np.abs(points[:, :2]) < 0.5).all(axis=1)
            return points[:, 2] <= np.where(on, 0.0, 0.5 * self.sign)

    middle, edge = [[0.0, 0.0, 0.0]], [[x, y, 0.0] for x, y in ((0.45, 0), (-0.45, 0), (0, 0.45), (0, -0.45))]
    way = np.array([[math.cos(0.1), 0.0, -math.sin(0.1)]])
    for sign in (-1, 1):
        world: Any = Table(sign)
        assert _is_grazed_floor(world, np.array(middle), way).all()
        assert not _is_grazed_floor(world, np.array(edge), np.repeat(way, 4, axis=0)).any()


def test_without_one_of_both_kinds_there_is_no_area() -> None:
    some, none = np.ones(3), np.empty(0)
    assert area_under_roc(some, none) is None and area_under_roc(none, some) is None
