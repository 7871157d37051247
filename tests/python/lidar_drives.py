# SPDX-License-Identifier: BSD-3-Clause
"""What a lidar of 24 rings measures on its way through a world, with noise of a centimetre."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def beams() -> NDArray[np.float64]:
    """Directions (n, 3) in the sensor's frame."""
    up, around = np.meshgrid(np.radians(np.linspace(-24, 12, 24)), np.radians(np.arange(0, 360, 3)))
    directions = [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)]
    return np.stack([one.ravel() for one in directions], axis=1)


def measured(scene: Any, poses: NDArray[np.float64], rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Points (n, 3) in the sensor's frame, from each pose (4, 4)."""
    clouds = []
    for T in poses:
        ranges = scene.cast(T[:3, 3], beams() @ T[:3, :3].T) + rng.normal(0, 0.01, len(beams()))
        clouds.append(beams() * ranges[:, None])
    return clouds
