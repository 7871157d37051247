# SPDX-License-Identifier: BSD-3-Clause
"""What calls may cost: memory has a bound, and Ctrl-C is heard."""

from __future__ import annotations

import io
import os
import signal
import struct
import sys
import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

import ndtree


def scan(beams: int, reach: float, dim: int = 3, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-reach, reach, (beams, dim)), np.zeros(dim)


def test_a_small_octomap_file_of_too_many_cells_is_refused(tmp_path: Path) -> None:
    """The root is one leaf: 2**48 cells."""
    data = b"# Octomap OcTree file\nid OcTree\nsize 1\nres 0.1\ndata\n" + struct.pack("<fB", 1.0, 0)
    path = tmp_path / "root.ot"
    path.write_bytes(data)
    started = time.monotonic()
    with pytest.raises(MemoryError, match=r"root\.ot: .*max_memory"):
        ndtree.load_octomap(path, refinement="fixed")
    assert time.monotonic() - started < 1
    assert ndtree.load_octomap(path).stats().observed_leaves == 8  # About 0, each an eighth.
    # Leaves that are each small enough, but not together.
    many = b"".join(struct.pack("<fB", 1.0, 0) for _ in range(8))
    path.write_bytes(
        b"# Octomap OcTree file\nid OcTree\nsize 9\nres 0.1\ndata\n" + struct.pack("<fB", 1.0, 255) + many
    )
    with pytest.raises(MemoryError, match="max_memory"):
        ndtree.load_octomap(path, refinement="fixed", max_memory=1e12)


def npz_bytes(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **{"origins": np.zeros((1, 2)), "offsets": np.array([0, 3]), **arrays})
    return file.getvalue()


def test_arrays_that_unpack_beyond_memory_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "log.npz"
    log.write_bytes(npz_bytes(points=np.ones((3, 2))))
    assert len(ndtree.read(log)) == 1
    monkeypatch.setattr("ndtree.logs.formats.npz.MOST_BYTES", 300)
    with pytest.raises(
        ValueError, match=r"log\.npz: its arrays unpack to [0-9,]+ bytes, expected at most 300"
    ):
        ndtree.read(log)


def test_an_array_that_says_it_is_larger_than_it_is_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "log.npz"
    with zipfile.ZipFile(log, "w") as archive:
        for name, array in (
            ("origins", np.zeros((1, 2))),
            ("points", np.ones((3, 2))),
            ("offsets", np.array([0, 3])),
        ):
            file = io.BytesIO()
            np.save(file, array)
            content = file.getvalue()
            if name == "points":
                content = content.replace(b"(3, 2), }" + b" " * 11, b"(900000000000, 2), }")
            archive.writestr(f"{name}.npy", content)
    with pytest.raises(ValueError, match=r"log\.npz: points: cannot be read as an array"):
        ndtree.read(log)


def big_map() -> ndtree.FixedMap:
    m = ndtree.FixedMap(dim=3, min_cell_size=0.05)
    for seed in range(2):
        m.insert(*scan(4000, 9.0, seed=seed))
    return m


def interrupted(call, after: float = 0.3) -> float:
    """Seconds from Ctrl-C until the call ended by it; -1 if it ended before."""
    sent = 0.0

    def interrupt() -> None:
        nonlocal sent
        sent = time.monotonic()
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(after, interrupt)
    timer.start()
    try:
        call()
    except KeyboardInterrupt:
        return time.monotonic() - sent
    finally:
        timer.cancel()
        timer.join()
    return -1


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_ends_long_questions(tmp_path: Path) -> None:
    m = big_map()
    before = m.to_bytes()
    points, origin = scan(2_000_000, 9.0)
    box = (np.full(3, -9.0), np.full(3, 9.0))
    field = m.distance_field(box, 0.5)
    poses = np.tile(np.eye(4), (300_000, 1, 1))
    poses[:, :3, 3] = points[:300_000]
    body = ndtree.Box((3.0, 3.0, 3.0))
    calls = {
        "collides": lambda: [m.collides(body, poses) for _ in range(1000)],
        "field.distance": lambda: [field.distance(points) for _ in range(1000)],
        "field.gradient": lambda: [field.gradient(points) for _ in range(1000)],
        "states_in": lambda: m.states_in(points - 0.4, points + 0.4),
        "to_grid": lambda: m.to_grid(box, 0.05),
        "many bounds": lambda: [m.bounds() for _ in range(100_000)],
        "cast_rays": lambda: m.cast_rays(origin, points),
        "details": lambda: m.cast_rays(origin, points, details=True, unknown="stop"),
        "distance_field": lambda: m.distance_field(box, 0.05, max_distance=4.0),
        "nearest_occupied": lambda: m.nearest_occupied(points),
        "occupied_within": lambda: m.occupied_within(points, 2.0),
        "evaluate": lambda: m.evaluate(points, origin),
        "many leaves": lambda: [m.leaves() for _ in range(1000)],
        "many frontiers": lambda: [m.frontiers() for _ in range(1000)],
        "many saves": lambda: [m.save(tmp_path / "big.ndt") for _ in range(1000)],
    }
    for name, call in calls.items():
        heard = interrupted(call)
        assert 0 <= heard < 1.5, name
    assert m.to_bytes() == before


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("waits", ["insert", "stats"])
def test_ctrl_c_is_heard_while_another_thread_has_the_map(waits: str) -> None:
    for beams in (50_000, 500_000):  # As many as keep the map longer than the other waits.
        m = ndtree.FixedMap(dim=3, min_cell_size=0.05)
        calls = {"insert": lambda m=m: m.insert(*scan(10, 1.0)), "stats": m.stats}
        points, origin = scan(beams, 9.0)
        holder = threading.Thread(target=m.insert, args=(points, origin))
        holder.start()
        time.sleep(0.1)
        heard = interrupted(calls[waits])
        still_held = holder.is_alive()
        holder.join()
        if still_held:
            break
    assert still_held, "no thread had to wait"
    assert 0 <= heard < 1
    calls[waits]()
