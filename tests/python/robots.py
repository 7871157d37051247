# SPDX-License-Identifier: BSD-3-Clause
"""What a simulated robot would publish, and what came of it, for the tests of nodes."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import Messages
from drives import START

import ndtree
from ndtree.maps.writers.map_server import noise_depth

PATIENCE = 180.0
Content = list[tuple[str, float, Any]]


def office(kind: str, n: int) -> tuple[Messages, Content]:
    """The simulated office as a robot would publish it, at 10 Hz."""
    make: Messages = Messages(kind)
    content: Content = []
    fixed = make.transform(START - 1, "base", "laser", [0, 0, 0.2], [0, 0, 0, 1])
    content.append(("/tf_static", START - 1, make.tf(fixed)))
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
        moved = make.transform(stamp, "map", "camera", scan.origin, [0, 0, 0, 1])
        content.append(("/tf", stamp, make.tf(moved)))
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
    depth = noise_depth(m) if m.dim == 2 else None
    pixels, (x, y), cell_size = m.map_server_image(wall_depth=depth, **options)
    image = np.select([pixels[::-1] == 254, pixels[::-1] == 0], [0, 100], -1)
    grid, (left, low, size) = arrays["grid"], arrays["origin"]
    assert size == pytest.approx(cell_size, rel=1e-6)
    column, row = round((x - left) / cell_size), round((y - low) / cell_size)
    expected = np.full_like(grid, -1)
    expected[row : row + image.shape[0], column : column + image.shape[1]] = image
    return grid, expected


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
