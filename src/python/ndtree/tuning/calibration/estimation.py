# SPDX-License-Identifier: BSD-3-Clause
"""All of a sensor's parameters from one log."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ndtree._errors import WrongValue
from ndtree._native import _core
from ndtree._native._checked import checked
from ndtree.base.progress import Progress, no_progress
from ndtree.base.scan import Scan
from ndtree.evaluation.comparison import NO_RETURN
from ndtree.evaluation.sampling import AUTO, believed
from ndtree.logs.core.log import Log, require_log
from ndtree.tuning.calibration.beams import Beams, Points, Scans, Source
from ndtree.tuning.calibration.figures import LEAST_SIGMA, Calibration, Estimate
from ndtree.tuning.calibration.noise import Noise, noise_of
from ndtree.tuning.calibration.rates import Trial, error_rates

SEED = 0
LEAST_BEAMS = 100  # Returned ones, below which nothing is estimated.


@checked
def calibrate(
    log: Log | Iterable[Scan],
    *,
    max_range: float = math.inf,
    no_return: str = AUTO,
    min_cell_size: float | None = None,
    limit: int | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Estimate the parameters of a sensor from what it measured. The same log gives the same figures.

    Parameters
    ----------
    log : Log or iterable of Scan
        In 2-D or 3-D. A `Log` is read once, or twice if its scans take more than 256 MiB, and a million
        of its end points are kept; other iterables are kept as a whole.
    max_range : float
        Longer beams are free up to there and have no end point [m].
    no_return : str
        What a beam without return says: "free", that space is free up to its end point; "ignore", nothing;
        "auto", of a log from a file what `ndtree.evaluation.sampling.judge` finds. Of others "free": a
        simulation loses as many beams as it was told to, and that is a rate to be found.
    min_cell_size : float, optional
        Of the map that the error rates are from [m]. Left out: the adaptive map's own default.
    limit : int, optional
        Only this many scans from the beginning.
    progress : callable, optional
        Called as ``progress(what, done, total)``.

    Returns
    -------
    Calibration
        The standard deviation of a range r, ``range_sigma + range_sigma_quadratic * r**2``, is from the
        thickness of flat pieces of surface: lines (2-D) or planes (3-D) through the end points of at least
        three scans in a ball of 0.25 m, or up to 1 m where points are few or noise is large; not those that
        are bent, edged or double. What counts is 1.4826 times the median distance from the surface along the
        beam, where beam and surface enclose at least 30 degrees. Scans disagree about a surface by the errors
        of their poses too, and these are in the figure: a map sees both.

        The error rates are from every tenth scan, which a `FixedMap` of the others has not seen. Where the
        log is long it is one map for each of up to four parts of the log. The margin is four standard
        deviations of the range and at least a cell. A cell is clearly occupied or free if its log-odds have
        nine tenths of the most that they can have.

        ``hit_given_free``: of the returned beams that have an occupied cell on their line, and a clearly free
        one half way to the first, the share that end before it in a clearly free cell, with no occupied
        cell within the margin. It is a rate for each beam, not for each cell that a beam passes, and so an
        upper bound for the latter.

        ``miss_given_occupied``: of the beams that reach, but for the margin, the first occupied cell on their
        way, and would cross half a cell length of clearly occupied space there, the fraction that leave it
        into space not occupied and end more than the margin beyond. Beams that did not return are among them
        unless ignored.

    Raises
    ------
    ValueError
        If an option is out of its limits, the log is damaged, or fewer than 100 beams returned.
    """
    require_log(log)
    cell = _checked(max_range, no_return, min_cell_size, limit)
    if no_return == AUTO:
        no_return = believed(log, log) if isinstance(log, Log) and log.path is not None else "free"
    source = Source(log if isinstance(log, Log) else Scans(log), limit, progress or no_progress)
    generator = np.random.default_rng(SEED)
    seen = _Seen.of(source, max_range, generator)
    figures = seen.figures()
    noise = noise_of(seen.points, max_range, generator, source.progress)
    del seen.points  # They take much memory.
    trial = Trial(figures["dim"], cell, _model(noise), max_range, no_return == "ignore")
    miss, hit = error_rates(source, seen.lengths, trial, generator)
    if noise is not None:
        figures.update(range_sigma=noise.sigma, range_sigma_quadratic=noise.quadratic)
        figures.update(surfaces=noise.pieces, sigma_by_range=noise.bins)
    rates = {"miss_given_occupied": miss, "hit_given_free": hit}
    return Calibration(log=source.log.name, **figures, **rates, min_cell_size=cell)


def _model(noise: Noise | None) -> tuple[float, float]:
    """A range's standard deviation [m] and its growth [1/m]; the usual ones where nothing was measured."""
    if noise is None:
        default = _core.default_options()
        return default["range_sigma"], default["range_sigma_quadratic"]
    return max(noise.sigma.value, LEAST_SIGMA), noise.quadratic.value


def _checked(max_range: float, no_return: str, min_cell_size: float | None, limit: int | None) -> float:
    """The cell size; ValueError for what is out of its limits."""
    if no_return not in NO_RETURN:
        raise WrongValue.of("no_return", f"{no_return!r}", f"one of {', '.join(NO_RETURN)}")
    if not max_range > 0:
        raise WrongValue.of("max_range", f"{max_range:g} m", "> 0")
    if limit is not None and limit < 1:
        raise WrongValue.of("limit", limit, ">= 1")
    cell = _core.default_options()["min_cell_size"] if min_cell_size is None else float(min_cell_size)
    if not (cell > 0 and math.isfinite(cell)):
        raise WrongValue.of("min_cell_size", f"{cell:g} m", "> 0 and finite")
    return cell


@dataclass
class _Seen:
    """What all scans have, and some of their end points."""

    points: Points
    lengths: list[float]
    beams: int
    returned: int
    longest: float

    @classmethod
    def of(cls, source: Source, max_range: float, generator: np.random.Generator) -> _Seen:
        points = Points(generator)
        lengths: list[float] = []
        beams = returned = 0
        for i, one in source.beams("reading", math.inf):
            beams += len(one.length)
            returned += int(np.count_nonzero(one.hit))
            points.add(one, i)
            lengths.append(float(np.minimum(one.length, max_range).sum()))
        if returned < LEAST_BEAMS:
            raise ValueError(f"{source.log.name}: {returned} beams returned, expected at least {LEAST_BEAMS}")
        longest = points.longest
        points.finish()
        return cls(points, lengths, beams, returned, longest)

    def figures(self) -> dict[str, Any]:
        """As of `Calibration`."""
        return {
            "dim": self.points.end.shape[1],
            "scans": len(self.lengths),
            "beams": self.beams,
            "returned": self.returned,
            "no_return_share": 1 - self.returned / self.beams,
            "median_range": float(np.median(self.points.length)),
            "longest_range": self.longest,
            "range_sigma": None,
            "range_sigma_quadratic": None,
            "surfaces": 0,
            "sigma_by_range": (),
        }


def range_noise(scans: Iterable[Scan], *, max_range: float = math.inf) -> tuple[Estimate, Estimate] | None:
    """Standard deviation of a range [m] and its growth with the squared range [1/m], as by `calibrate`.

    Returns: None where fewer than 100 beams returned, or several scans saw no flat surface.
    """
    generator = np.random.default_rng(SEED)
    points = Points(generator)
    returned = 0
    for i, scan in enumerate(scans):
        one = Beams(scan, math.inf)
        returned += int(np.count_nonzero(one.hit))
        points.add(one, i)
    if returned < LEAST_BEAMS:
        return None
    points.finish()
    noise = noise_of(points, max_range, generator, no_progress)
    return None if noise is None else (noise.sigma, noise.quadratic)
