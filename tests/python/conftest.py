# SPDX-License-Identifier: BSD-3-Clause
"""What the Python tests share."""

import os
import signal
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # So it is in the background of a shell.
    signal.signal(signal.SIGINT, signal.default_int_handler)

SHAPES = [(2, 2), (3, 2), (4, 2), (2, 3), (3, 3), (4, 3), (2, 4)]  # branching, dim


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of real recordings; skips where there is none."""
    default = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    folder = Path(os.environ.get("NDTREE_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no recordings: $NDTREE_DATA is not set, and {folder} is not there")
    return folder


def there(path: Path) -> Path:
    """A recording; the test is skipped where it is not there."""
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return path


@pytest.fixture(params=SHAPES, ids=lambda shape: f"N{shape[0]}D{shape[1]}")
def shape(request: pytest.FixtureRequest) -> tuple[int, int]:
    return request.param


@pytest.fixture(params=["ros1", "sqlite3", "mcap"])
def make(request: pytest.FixtureRequest) -> Any:
    """What makes messages for bags of each kind."""
    from bags import Messages

    return Messages(request.param)


@pytest.fixture
def ros2() -> Any:
    """What makes messages for bags of ROS 2."""
    from bags import Messages

    return Messages("mcap")


def arrays_of(scans: Iterable[Any], **more: Any) -> dict[str, np.ndarray]:
    """What an .npz of scans holds."""
    scans = list(scans)
    return {
        "origins": np.array([scan.origin for scan in scans]),
        "points": np.concatenate([scan.endpoints for scan in scans]).astype(np.float32),
        "offsets": np.cumsum([0, *(len(scan) for scan in scans)]),
        "no_return": np.concatenate([~scan.returned for scan in scans]),
        **more,
    }


def room_scan(dim: int, seed: int, beams: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """End points on the walls of a box of 4 m around a sensor near its middle, with 1 cm of noise."""
    random = np.random.default_rng(seed)
    origin = random.uniform(-0.5, 0.5, dim)
    directions = random.normal(size=(beams, dim))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    with np.errstate(divide="ignore"):
        to_walls = np.where(directions > 0, (2 - origin) / directions, (-2 - origin) / directions)
    ranges = to_walls.min(axis=1) + random.normal(0, 0.01, beams)
    return origin + ranges[:, None] * directions, origin


def with_room(m: Any, scans: int, beams: int = 300, far: float = 0.0) -> Any:
    """A map after scans of that box, each with the next seed."""
    for seed in range(scans):
        points, origin = room_scan(m.dim, seed, beams)
        m.insert(points + far, origin + far)
    return m


def text_log(path: Path, scans: Iterable[Any]) -> Path:
    """A text log of scans in the plane."""
    with open(path, "w") as file:
        for scan in scans:
            for end, flag in zip(scan.endpoints, scan.returned):
                file.write(f"{scan.origin[0]} {scan.origin[1]} {end[0]} {end[1]} {int(flag)}\n")
    return path


def room_log(path: Path, scans: int) -> Path:
    """A text log of that box, in which all beams return."""
    every = (room_scan(2, seed, 60) for seed in range(scans))
    return text_log(
        path, (SimpleNamespace(endpoints=ends, origin=at, returned=[True] * 60) for ends, at in every)
    )


def turned(dim: int, yaw: float, position: Any) -> np.ndarray:
    """A pose that is turned in the plane [rad], as a matrix."""
    pose = np.eye(dim + 1)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:dim, dim] = position
    return pose
