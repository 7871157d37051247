# SPDX-License-Identifier: BSD-3-Clause
"""What a calibration found: numbers with their intervals."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ndtree.base.typing import MapOptions
from ndtree.base.words import in_full

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
CONFIDENCE = 0.9  # Of the intervals, from RESAMPLES bootstrap samples.
RESAMPLES = 200
LEAST_SIGMA = 1e-4  # The sigma of a sensor without noise [m].


@dataclass(frozen=True)
class Estimate:
    """A number from data.

    `low`, `high`: Its 90 % interval, by bootstrap over places (noise) or scans (rates); never apart from the
        value.
    """

    value: float
    low: float
    high: float
    count: int  # Observations behind it: residuals, or beams.


@dataclass(frozen=True)
class Calibration:
    """The parameters of a sensor, from `calibrate`.

    Parameters
    ----------
    log : str
        Its name.
    dim, scans, beams, returned : int
        What was read; beams without a finite end point are in none of them.
    no_return_share : float
        Beams that did not return, of all.
    median_range, longest_range : float
        Of the beams that returned [m], before `max_range`.
    range_sigma : Estimate or None
        Standard deviation of a range at the sensor [m]. None: no flat surface was found.
    range_sigma_quadratic : Estimate or None
        Its growth with the squared range [1/m]; 0 where the data do not tell it from none.
    miss_given_occupied, hit_given_free : Estimate or None
        Error rates within [0.001, 0.4]. None: fewer than 30 beams could tell.
    surfaces : int
        Flat pieces of surface that the noise is from.
    sigma_by_range : tuple of (float, float, int)
        Range [m], standard deviation [m] and residuals of each bin that the noise was fitted to.
    min_cell_size : float
        Of the map that the error rates are from [m].
    """

    log: str
    dim: int
    scans: int
    beams: int
    returned: int
    no_return_share: float
    median_range: float
    longest_range: float
    range_sigma: Estimate | None
    range_sigma_quadratic: Estimate | None
    miss_given_occupied: Estimate | None
    hit_given_free: Estimate | None
    surfaces: int
    sigma_by_range: tuple[tuple[float, float, int], ...]
    min_cell_size: float

    def options(self) -> MapOptions:
        """Keywords for `AdaptiveMap`: those that could be estimated, and ``min_cell_size`` is not among them.

        A map takes no sensor without noise: ``range_sigma`` is at least 0.1 mm.
        """
        estimates = {name: getattr(self, name) for name in _ESTIMATED}
        options = cast(MapOptions, {name: one.value for name, one in estimates.items() if one is not None})
        if "range_sigma" in options:
            options["range_sigma"] = max(options["range_sigma"], LEAST_SIGMA)
        return options

    def figures(self) -> dict[str, Any]:
        """All of it as plain numbers, ready for JSON."""
        figures: dict[str, Any] = {}
        for name, value in vars(self).items():
            if name == "sigma_by_range":
                value = [dict(zip(("range", "sigma", "count"), one)) for one in value]
            figures[name] = dict(vars(value)) if isinstance(value, Estimate) else value
        return {**figures, "options": self.options()}

    def to_json(self) -> str:
        """The figures as JSON, indented."""
        return json.dumps(self.figures(), indent=2, allow_nan=False) + "\n"

    def __str__(self) -> str:
        """A table with a line for each parameter."""
        lines = [
            f"{self.log}, {self.dim}-D: {self.scans:,} scans, {self.beams:,} beams, "
            + (
                f"{100 * self.no_return_share:.2f} % of them not returned"
                if self.no_return_share
                else "all returned"
            ),
            f"ranges: median {self.median_range:.2f} m, longest {self.longest_range:.2f} m",
            "",
            f"{'':27}{'estimate':>10}{'90 % interval':>22}{'observations':>14}",
        ]
        for name, unit in _ESTIMATED.items():
            one = getattr(self, name)
            named = f"{name} [{unit}]" if unit else name
            if one is None:
                lines.append(f"{named:27}{'-':>10}{'-':>22}{0:>14}")
                continue
            between = f"{in_full(one.low, 3)} to {in_full(one.high, 3)}"
            lines.append(f"{named:27}{in_full(one.value, 3):>10}{between:>22}{one.count:>14,}")
        lines.append("")
        if self.range_sigma is None:
            lines.append("no flat surfaces that several scans saw: the noise of the ranges is unknown")
        else:
            lines.append(f"noise from {self.surfaces:,} flat pieces of surface, pose errors included")
        if self.miss_given_occupied is None or self.hit_given_free is None:
            lines.append("too few beams met cells that the map is sure of: not every error rate is known")
        return "\n".join(lines)


_ESTIMATED = {
    "range_sigma": "m",
    "range_sigma_quadratic": "1/m",
    "miss_given_occupied": "",
    "hit_given_free": "",
}


def estimated(value: float, drawn: Floats, count: int) -> Estimate:
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(drawn, (tail, 1 - tail)) if len(drawn) else (value, value)
    return Estimate(float(value), min(float(low), float(value)), max(float(high), float(value)), count)
