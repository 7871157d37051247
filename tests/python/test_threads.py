# SPDX-License-Identifier: BSD-3-Clause
"""Several threads of Python: on one map, each on its own, and all writing one file."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from conftest import room_scan

import ndtree

SCANS = [room_scan(2, seed) for seed in range(40)]


def mapped(scans: list) -> ndtree.OccupancyMap:
    m = ndtree.AdaptiveMap(dim=2)
    for points, origin in scans:
        m.insert(points, origin)
    return m


def together(*work: Callable[[], None]) -> None:
    """Run at the same time; the first error is raised here."""
    start = threading.Barrier(len(work))

    def run(one: Callable[[], None]) -> None:
        start.wait(20)
        one()

    with ThreadPoolExecutor(len(work)) as pool:
        for done in [pool.submit(run, one) for one in work]:
            done.result(120)


def test_questions_and_files_see_whole_scans(tmp_path: Path) -> None:
    steps = {mapped(SCANS[:n]).to_bytes() for n in range(len(SCANS) + 1)}
    m = ndtree.AdaptiveMap(dim=2)
    finished = threading.Event()
    points = np.random.default_rng(1).uniform(-3, 3, (500, 2))
    seen = {"bytes": 0, "files": 0, "questions": 0}

    def insert() -> None:
        try:
            for scan, origin in SCANS:
                m.insert(scan, origin)
        finally:
            finished.set()

    def ask() -> None:
        while not finished.is_set() or not seen["questions"]:
            states, leaves = m.state(points), m.leaves()
            assert set(np.unique(states)) <= {-1, 0, 1} and np.isfinite(leaves.lower).all()
            m.cast_rays(np.zeros(2), points, max_range=5)
            seen["questions"] += 1

    def take() -> None:
        while not finished.is_set() or not seen["bytes"]:
            assert m.to_bytes() in steps
            seen["bytes"] += 1

    def save() -> None:
        while not finished.is_set() or not seen["files"]:
            m.save(tmp_path / "a.ndt")
            assert (tmp_path / "a.ndt").read_bytes() in steps
            seen["files"] += 1

    together(insert, ask, ask, take, save)
    assert min(seen.values()) > 0
    assert m.to_bytes() == mapped(SCANS).to_bytes()


def test_logs_are_read_by_each_thread(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with open(path, "w") as file:
        for points, origin in SCANS[:10]:
            file.writelines(f"{origin[0]} {origin[1]} {x} {y}\n" for x, y in points)
    counts: list[int] = []
    together(*[lambda: counts.append(sum(len(scan) for scan in ndtree.read(path)))] * 4)
    assert counts == [sum(len(points) for points, _ in SCANS[:10])] * 4


def test_a_distance_field_is_asked_while_it_is_updated() -> None:
    """Every answer is of before or after, and never of both."""
    m = ndtree.AdaptiveMap(dim=2)
    for scan, origin in SCANS[:1]:
        m.insert(scan, origin)
    box = [[-4.0, -4.0], [4.0, 4.0]]
    field = m.distance_field(box, 0.02)
    seen = m.snapshot()
    for scan, origin in SCANS[1:]:
        m.insert(scan, origin)
    after = m.distance_field(box, 0.02)
    points = np.random.default_rng(3).uniform(-4, 4, (20_000, 2))
    known = [
        {"values": one.values.tobytes(), "distance": one.distance(points).tobytes()} for one in (field, after)
    ]
    assert known[0]["values"] != known[1]["values"] and known[0]["distance"] != known[1]["distance"]
    finished = threading.Event()
    asked = {"values": 0, "distance": 0, "pickle": 0}

    def update() -> None:
        try:
            for since, now in [(seen, m), (m, seen)] * 5 + [(seen, m)]:
                field.update(now, since=since)
        finally:
            finished.set()

    def ask(name: str, answer: Callable[[], bytes]) -> None:
        while not finished.is_set() or not asked[name]:
            assert answer() in [one["values" if name == "pickle" else name] for one in known]
            asked[name] += 1

    together(
        update,
        lambda: ask("values", lambda: field.values.tobytes()),
        lambda: ask("distance", lambda: field.distance(points).tobytes()),
        lambda: ask("pickle", lambda: pickle.loads(pickle.dumps(field)).values.tobytes()),
    )
    assert min(asked.values()) > 0
    assert field.values.tobytes() == known[1]["values"]


def test_two_writers_of_one_map_insert_all() -> None:
    """In some order, scan by scan: evidence far from its limits adds up whatever that is."""
    m, alone = (ndtree.FixedMap(dim=2, min_cell_size=0.1, log_odds_max=100, log_odds_min=-100) for _ in "ab")

    def insert(target: ndtree.OccupancyMap, scans: list) -> None:
        for points, origin in scans:
            target.insert(points, origin)

    insert(alone, SCANS)
    together(lambda: insert(m, SCANS[::2]), lambda: insert(m, SCANS[1::2]))
    assert m.stats().updates == alone.stats().updates
    points = np.random.default_rng(2).uniform(-2, 2, (300, 2))
    assert np.allclose(m.probability(points), alone.probability(points), atol=1e-5)
