# SPDX-License-Identifier: BSD-3-Clause
"""Ways in random worlds, against dense samples of poses and against floods over lattices."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

import ndtree

ndimage = pytest.importorskip("scipy.ndimage")

CELL = 0.1
REACH = {2: 3.2, 3: 1.6}


def world(random: np.random.Generator, dim: int) -> Any:
    """Free space with boxes, balls and holes of unknown space in it, anywhere between borders of cells."""
    m = ndtree.AdaptiveMap(dim=dim, min_cell_size=CELL, max_cell_size=1.6)
    reach = REACH[dim]
    m.mark([[-reach] * dim, [reach] * dim], "free")
    for k in range(22 if dim == 2 else 16):
        center = random.uniform(-reach, reach, dim)
        if k % 3 == 0:
            shape = ndtree.Sphere(random.uniform(0.05, 0.5), center)
        else:
            shape = ndtree.Box(random.uniform(0.05, 1.4, dim) ** 1.5, center=center)
        if k % 4 == 3:
            m.clear(shape)
        else:
            m.mark(shape, "occupied")
    return m


def body_of(random: np.random.Generator, dim: int, larger: float = 0.0) -> Any:
    """All points within `larger` of a body, or more; less than 0: of a body all of whose points within that
    belong to the first."""
    kind, size = random.integers(4), random.uniform(0.05, 0.25)
    ends = random.uniform(-0.2, 0.2, (2, dim))
    edges, center = random.uniform(0.24, 0.5, dim), random.uniform(-0.1, 0.1, dim)
    ball, capsule = (ndtree.Sphere(max(0.0, size + larger)), ndtree.Capsule(*ends, max(0.0, size + larger)))
    box = ndtree.Box(np.maximum(0.0, edges + 2.0 * larger), center=center)
    return (ball, capsule, box, ball | box)[kind]


def flooded(m: Any, body: Any, step: float, unknown: str, all_neighbours: bool) -> Any:
    """Numbers of the parts of a lattice whose points are free, > 0, and of cells around points."""
    dim = m.dim
    n = round(2 * (REACH[dim] + 0.8) / step)
    centers = (np.indices((n,) * dim).reshape(dim, -1).T + 0.5) * step - (REACH[dim] + 0.8)
    free = ~m.collides(body, centers, unknown=unknown).reshape((n,) * dim)
    parts = ndimage.label(free, np.ones((3,) * dim) if all_neighbours else None)[0]

    def part_at(point: Any) -> int:
        return int(parts[tuple(((point + REACH[dim] + 0.8) / step).astype(int))])

    return part_at


def check_way(m: Any, body: Any, points: Any, unknown: str) -> None:
    """Neither samples at each half centimetre nor the exact sweep meet anything."""
    steps = [np.linspace(a, b, 2 + int(200 * np.linalg.norm(b - a))) for a, b in zip(points, points[1:])]
    assert not m.collides(body, np.concatenate(steps), unknown=unknown).any()
    poses = np.tile(np.eye(m.dim + 1), (len(points), 1, 1))
    poses[:, :-1, -1] = points
    assert m.path_collides(body, poses, unknown=unknown) == -1


def check_pairs(seed: int, dim: int, unknown: Any, pairs: int) -> Counter[str]:
    """All of one world's; how they ended."""
    random = np.random.default_rng(seed)
    m = world(random, dim)
    form = random.integers(2**32)
    body, larger, smaller = (body_of(np.random.default_rng(form), dim, by) for by in (0.0, CELL, -CELL))
    state = "occupied" if unknown == "blocked" else "free"
    surely = flooded(m, larger, CELL, state, all_neighbours=False)
    perhaps = flooded(m, smaller, CELL, state, all_neighbours=True)
    slightly = body_of(np.random.default_rng(form), dim, CELL / 8)
    finely = flooded(m, slightly, CELL / 8, state, all_neighbours=False) if dim == 2 else surely
    places = random.uniform(-REACH[dim], REACH[dim], (40 * pairs, dim))
    margin = body_of(np.random.default_rng(form), dim, 1e-5)
    places = places[~m.collides(margin, places, unknown=state)][: 2 * pairs]
    planner, ended = ndtree.Planner(m, body, unknown=unknown), Counter()
    for start, goal in zip(places[::2], places[1::2]):
        path = planner.plan(start, goal)
        ended[path.status] += 1
        if path:
            assert (path.points[[0, -1]] == [start, goal]).all()
            check_way(m, body, path.points, state)
            assert perhaps(start) == perhaps(goal) != 0, "found where a smaller body has no way"
        else:
            assert path.status == "none" and path.reason
            is_proved = "proved" in path.reason
            ended["proved"] += is_proved
            for joined in (surely, finely)[: 1 + is_proved]:
                assert not joined(start) or joined(start) != joined(goal), "a larger body has a way"
    return ended


@pytest.mark.parametrize("unknown", ["blocked", "free", 2.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_ways_are_free_and_none_is_missed(dim: int, unknown: Any) -> None:
    ended: Counter[str] = Counter()
    for seed in range(3):
        ended += check_pairs(seed, dim, unknown, 30)
    assert ended["found"] > 30
    assert dim == 3 or unknown != "blocked" or ended["proved"] > 0
