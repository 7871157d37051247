# SPDX-License-Identifier: BSD-3-Clause
"""What a simulated robot would publish, and what came of it, for the tests of nodes."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import START, Messages

import ndtree
from ndtree.maps.writers.map_server import noise_depth

PATIENCE = 180.0
Content = list[tuple[str, float, Any]]


def office(kind: str, n: int) -> tuple[Messages, Content]:
    """The simulated office as a robot would publish it, at 10 Hz."""
    make: Messages = Messages(kind)
    content: Content = []
    content.append(make.fixed(START - 1, "base", "laser", [0, 0, 0.2]))
    for i, scan in enumerate(ndtree.simulate("office", scans=n)):
        stamp, way = START + 0.1 * i, scan.endpoints - scan.origin
        angles = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
        turn = float(angles[0])
        ranges = np.hypot(*way.T)
        if scan.returned is not None:
            ranges[~scan.returned] = np.inf
        quaternion = [0, 0, np.sin(turn / 2), np.cos(turn / 2)]
        moved = make.transform(stamp, "map", "base", [*scan.origin, 0], quaternion)
        step = float(angles[-1] - angles[0]) / (len(angles) - 1)
        laser = make.laser(stamp, "laser", ranges, angle_min=0.0, angle_increment=step, range_max=30.0)
        content += [("/scan", stamp + 0.001, laser), ("/tf", stamp + 0.01, make.tf(moved))]
    return make, content


def apartment(kind: str, n: int) -> tuple[Messages, Content]:
    """The simulated depth camera as clouds, from a body that flies through the apartment."""
    make: Messages = Messages(kind)
    content: Content = []
    for i, scan in enumerate(ndtree.simulate("apartment", scans=n)):
        stamp = START + 0.3 * i
        points = (scan.endpoints - scan.origin)[scan.returned if scan.returned is not None else slice(None)]
        content.append(make.moved(stamp, "map", "camera", scan.origin))
        content.append(("/points", stamp + 0.001, make.cloud(stamp, "camera", points[::4])))
    return make, content


def mapped(bag: Path, python: str = sys.executable, **options: Any) -> Any:
    """The map of `ndtree map`."""
    target = bag.parent / "offline.ndt"
    words = [w for k, v in options.items() for w in (f"--{k.replace('_', '-')}", str(v))]
    command = [python, "-m", "ndtree", "map", str(bag), "-o", str(target), *words]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return ndtree.load(target)


def grid_like(arrays: Any, m: Any, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """The grid that was received, and that of a map, in the same place."""
    pixels, (x, y), cell_size = m.map_server_image(wall_depth=noise_depth(m), **options)
    image = np.select([pixels[::-1] == 254, pixels[::-1] == 0], [0, 100], -1)
    grid, (left, low, size) = arrays["grid"], arrays["origin"]
    assert size == pytest.approx(cell_size, rel=1e-6)
    column, row = round((x - left) / cell_size), round((y - low) / cell_size)
    expected = np.full_like(grid, -1)
    expected[row : row + image.shape[0], column : column + image.shape[1]] = image
    return grid, expected


def check_office(received: Any, m: Any) -> None:
    """What a receiver has of the office is the map."""
    assert received.map == m.to_bytes()
    grid, expected = received.grid_like(m)
    assert np.array_equal(grid, expected) and np.count_nonzero(grid == 100) > 500
    assert received.text["counts"]["map_updates"] > 0 and received.text["counts"]["map"] > 0
    occupied = m.leaves(states=["occupied"])
    order = np.lexsort(occupied.center.T)
    points, boxes = received.arrays["points"], received.arrays["boxes"]
    assert np.allclose(points[np.lexsort(points[:, :2].T), :2], occupied.center[order], atol=1e-5)
    assert np.allclose(np.sort(points[:, 3]), np.sort(occupied.size))
    assert len(boxes) == len(occupied) and np.allclose(np.sort(boxes[:, 3]), np.sort(occupied.size))
    frontiers = np.array([one.goal for one in m.frontiers()])
    found = received.arrays["frontiers"]  # Of those of one size the order may be another one.
    assert np.allclose(*(rows[np.lexsort(np.round(rows, 6).T)] for rows in (found, frontiers)), atol=1e-6)
    assert received.text["diagnostics"]["mapped"] == "120" and received.text["frame"] == "map"


def check_services(said: Any, file: Path) -> None:
    """What a client was answered."""
    assert "no map yet" in said["early save"]
    assert said["save"] == [True, str(file)] and said["cleared"]
    assert 300 < said["known"] - said["known around"] < 500  # 1 m square of pixels of 5 cm.
    assert said["known without a box"] < said["known around"]
    assert said["plans"] == [["odom", 0.8, 2.0], ["odom"]]
    assert said["known after reset"] == 0
    assert said["load"] == [0, 1, 2]
    assert said["known after load"] == said["known"]


class Processes:
    """Processes that talk to each other; their output is in files of their names."""

    def __init__(self, folder: Path, python: str, environment: Mapping[str, str]) -> None:
        self.folder, self.python, self.environment = folder, python, {**environment, "PYTHONUNBUFFERED": "1"}

    def running(
        self, name: str, *words: object, python: str = ""
    ) -> AbstractContextManager[subprocess.Popen[bytes]]:
        command = [python or self.python, *map(str, words)]
        return in_background(command, self.environment, self.folder / f"{name}.log")

    def log(self, name: str = "node") -> str:
        return "".join(one.read_text(errors="replace") for one in self.folder.glob(f"{name}*.log"))

    def wait(self, happens: Callable[[], bool], process: subprocess.Popen[bytes], name: str = "node") -> None:
        """Until something happens, as long as a process runs."""
        deadline = time.monotonic() + PATIENCE
        while not happens():
            assert process.poll() is None and time.monotonic() < deadline, self.log(name)
            time.sleep(0.02)

    def ended(self, process: subprocess.Popen[bytes], name: str, node: subprocess.Popen[bytes]) -> None:
        """Wait for the good end of a process, as long as the node runs."""
        self.wait(lambda: process.poll() is not None, node)
        assert process.returncode == 0, self.log(name) + self.log()

    def interrupt(self, node: subprocess.Popen[bytes]) -> None:
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE) == 0, self.log()


@contextmanager
def in_background(
    command: list[str], environment: Mapping[str, str], output: Path
) -> Iterator[subprocess.Popen[bytes]]:
    """A process that is interrupted at the end, and killed if it does not end; its output is in a file."""
    with open(output, "wb") as log:
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                try:
                    process.wait(30)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
