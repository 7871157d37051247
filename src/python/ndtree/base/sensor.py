# SPDX-License-Identifier: BSD-3-Clause
"""Where the beams of a range sensor point: what `OccupancyMap.information_gain` looks along."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ndtree._native._checked import checked


@checked
@dataclass(frozen=True, eq=False)
class RangeSensor:
    """The beams of a range sensor in its own frame; mostly made by `laser`, `lidar` or `camera`.

    Parameters
    ----------
    directions : array_like, (n, dim)
        Of any length but zero.
    spacing : array_like, (n, dim - 1)
        Angle that each beam stands for, at right angles to it, on one axis and in space on another one [rad];
        inf: it sees as much beside it as a smallest cell is wide. It never sees more.
    max_range : float
        [m]
    mean_free_path : float
        Of beams in unknown space [m]; inf: nothing unknown occludes what is behind it.

    Raises
    ------
    ValueError
        A value or a shape is wrong; it is named.
    """

    directions: NDArray[np.float64]
    spacing: NDArray[np.float64]
    max_range: float
    mean_free_path: float = math.inf

    def __post_init__(self) -> None:
        directions = np.atleast_2d(np.asarray(self.directions, np.float64))
        spacing = np.asarray(self.spacing, np.float64)
        if directions.ndim != 2 or directions.shape[1] not in (2, 3) or not len(directions):
            raise ValueError(f"directions: shape {directions.shape}, expected (n, 2) or (n, 3), n > 0")
        if spacing.shape != (len(directions), directions.shape[1] - 1):
            expected = (len(directions), directions.shape[1] - 1)
            raise ValueError(f"spacing: shape {spacing.shape}, expected {expected}")
        lengths = np.linalg.norm(directions, axis=1)
        for name, wrong, what in (
            ("directions", ~(np.isfinite(lengths) & (lengths > 0.0)), "finite, and not zero"),
            ("spacing", ~(spacing > 0.0).all(axis=1), "> 0 rad"),
        ):
            if wrong.any():
                i = int(wrong.argmax())
                raise ValueError(f"{name}[{i}] = {getattr(self, name)[i]}: must be {what}")
        if not 0.0 < self.max_range < math.inf:
            raise ValueError(f"max_range = {self.max_range} m: must be > 0 and finite")
        if not self.mean_free_path > 0.0:
            raise ValueError(f"mean_free_path = {self.mean_free_path} m: must be > 0")
        object.__setattr__(self, "directions", directions / lengths[:, None])
        object.__setattr__(self, "spacing", spacing)

    @classmethod
    def laser(
        cls,
        *,
        max_range: float,
        beams: int = 720,
        field_of_view: float = 2.0 * math.pi,
        dim: int = 2,
        mean_free_path: float = math.inf,
    ) -> RangeSensor:
        """A planar laser; x points ahead, and in space z up.

        Parameters
        ----------
        max_range, mean_free_path : float
            [m]
        beams : int
            > 0, spread evenly over the field of view, each in the middle of its part.
        field_of_view : float
            In (0, 2 pi] [rad].
        dim : int
            2, or 3 for its plane in space.
        """
        _require_angle("field_of_view", field_of_view, 2.0 * math.pi)
        angles = _middles(beams, "beams", -0.5 * field_of_view, 0.5 * field_of_view)
        if dim not in (2, 3):
            raise ValueError(f"dim = {dim}: must be 2 or 3")
        directions = np.zeros((beams, dim))
        directions[:, 0], directions[:, 1] = np.cos(angles), np.sin(angles)
        spacing = np.full((beams, dim - 1), math.inf)
        spacing[:, 0] = field_of_view / beams
        return cls(directions, spacing, max_range, mean_free_path)

    @classmethod
    def lidar(
        cls,
        *,
        max_range: float,
        rings: int = 64,
        azimuths: int = 512,
        lowest: float = math.radians(-25.0),
        highest: float = math.radians(15.0),
        mean_free_path: float = math.inf,
    ) -> RangeSensor:
        """A lidar of rings that turns about its z axis; x points ahead.

        Parameters
        ----------
        max_range, mean_free_path : float
            [m]
        rings, azimuths : int
            > 0; beams are rings times azimuths.
        lowest, highest : float
            Elevations that the rings are spread over [rad].
        """
        if not -0.5 * math.pi <= lowest < highest <= 0.5 * math.pi:
            raise ValueError(
                f"lowest = {lowest}, highest = {highest} rad: must be -pi/2 <= lowest < highest <= pi/2"
            )
        elevation = _middles(rings, "rings", lowest, highest).repeat(max(azimuths, 0))
        azimuth = np.tile(_middles(azimuths, "azimuths", -math.pi, math.pi), rings)
        flat = np.cos(elevation)
        directions = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
        between = np.full(len(flat), (highest - lowest) / rings)
        return cls(
            directions, np.column_stack([2.0 * math.pi / azimuths * flat, between]), max_range, mean_free_path
        )

    @classmethod
    def camera(
        cls,
        *,
        max_range: float,
        width: int = 80,
        height: int = 60,
        field_of_view: float = math.radians(58.0),
        mean_free_path: float = math.inf,
    ) -> RangeSensor:
        """A pinhole depth camera; x points right, y down, z ahead.

        Parameters
        ----------
        max_range, mean_free_path : float
            Along a pixel's ray [m].
        width, height : int
            Pixels a row, and rows, > 0; pixels are square.
        field_of_view : float
            From the left to the right border of the image, in (0, pi) [rad].
        """
        _require_angle("field_of_view", field_of_view, math.pi)
        pixel = 2.0 * math.tan(0.5 * field_of_view) / width if width > 0 else math.nan
        right = np.tile(_middles(width, "width", -0.5 * width * pixel, 0.5 * width * pixel), max(height, 0))
        down = _middles(height, "height", -0.5 * height * pixel, 0.5 * height * pixel).repeat(width)
        directions = np.column_stack([right, down, np.ones(len(right))])
        # A pixel's solid angle is its area times the cosine, cubed.
        angle = pixel / np.linalg.norm(directions, axis=1) ** 1.5
        return cls(directions, np.column_stack([angle, angle]), max_range, mean_free_path)

    @property
    def dim(self) -> int:
        """2 or 3."""
        return int(self.directions.shape[1])

    def __len__(self) -> int:
        """Number of beams."""
        return len(self.directions)

    def __repr__(self) -> str:
        return f"RangeSensor({len(self)} beams, {self.dim}-D, max_range={self.max_range:g})"


def _middles(count: int, name: str, low: float, high: float) -> NDArray[np.float64]:
    if count < 1:
        raise ValueError(f"{name} = {count}: must be > 0")
    middles: NDArray[np.float64] = low + (high - low) * (np.arange(count) + 0.5) / count
    return middles


def _require_angle(name: str, angle: float, most: float) -> None:
    if not 0.0 < angle <= most:
        raise ValueError(f"{name} = {angle} rad: must be > 0 and at most {most:g}")
