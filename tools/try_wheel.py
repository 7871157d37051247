#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Tries the installed ndtree: maps, queries, files, threads, and the command; tools/wheels calls it.

usage: try_wheel.py numpy | cli

numpy: NumPy and ndtree alone are installed; the command says in one sentence what it needs.
cli: the extra "cli" is installed, too; the command maps a log.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

import ndtree

COMMAND = [str(Path(sys.executable).with_name("ndtree"))]


def mapped(dim: int) -> tuple[ndtree.AdaptiveMap, np.ndarray]:
    """A map of a ring around the origin (a sphere in 3-D) of radius 4 m, and directions to it."""
    random = np.random.default_rng(7)
    m = ndtree.AdaptiveMap(dim=dim, min_cell_size=0.05, max_cell_size=1.6, range_sigma=0.01)
    for _ in range(20):
        directions = random.normal(size=(3000, dim))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        m.insert(4 * directions, np.zeros(dim))
    return m, directions


def check_maps() -> None:
    for dim in (2, 3):
        m, directions = mapped(dim)
        assert m.stats().observed_leaves > 1000, m.stats()
        assert (m.state(2 * directions) == 0).mean() > 0.99
        assert (m.probability(5 * directions) == 0.5).all()
        distances = m.cast_rays(np.zeros((len(directions), dim)), directions, max_range=10)
        assert np.median(np.abs(distances - 4)) < 0.1, distances
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "ring.ndt"
            m.save(file)
            assert ndtree.load(file) == m
            try:
                ndtree.load(Path(folder) / "none.ndt")
            except (OSError, RuntimeError) as error:  # Exceptions of C++ are caught, and become Python's.
                assert "none.ndt" in str(error), error
            else:
                raise AssertionError("a file that is not there was loaded")


def check_threads() -> None:
    """Readers and a writer at once: locks that wait until a time come from the module, not from glibc."""
    m, directions = mapped(2)
    failures = []

    def ask() -> None:
        for _ in range(50):
            if not (m.state(2 * directions) == 0).mean() > 0.99:
                failures.append("a reader saw an unfinished map")

    readers = [threading.Thread(target=ask) for _ in range(3)]
    for reader in readers:
        reader.start()
    for _ in range(20):
        m.insert(4 * directions, np.zeros(2))
    for reader in readers:
        reader.join()
    assert not failures, failures


def called(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, check=False)


def check_command_without_cli() -> None:
    done = called("--help")
    assert done.returncode == 0 and "ndtree map LOG" in done.stdout, done
    done = called("map", "room.log")
    assert done.returncode == 2 and not done.stdout, done
    assert re.fullmatch(r"ndtree: .*\n +pip install 'ndtree-mapping\[cli\]'\n", done.stderr), done


def check_command() -> None:
    with tempfile.TemporaryDirectory() as folder:
        log, file = Path(folder) / "room.log", Path(folder) / "room.ndt"
        ranges = " ".join(
            f"{2 / max(abs(np.cos(a)), abs(np.sin(a))):.3f}" for a in np.arange(180) * np.pi / 180
        )
        log.write_text(
            "".join(f"FLASER 180 {ranges} 0 0 0 0 0 0 {t}.0 host {t}.0\n" for t in range(10)),
            encoding="ascii",
        )
        done = called("map", str(log), "-o", str(file))
        assert done.returncode == 0 and file.exists(), done
        done = called("info", str(file))
        assert done.returncode == 0 and "0.05" in done.stdout, done


def main() -> None:
    if sys.argv[1:] not in (["numpy"], ["cli"]):
        sys.exit("try_wheel.py: expected numpy or cli")
    check_maps()
    check_threads()
    if sys.argv[1] == "numpy":
        check_command_without_cli()
    else:
        check_command()
    print(f"ndtree {ndtree.__version__}, NumPy {np.__version__}")


if __name__ == "__main__":
    main()
