# SPDX-License-Identifier: BSD-3-Clause
"""The sensor's parameters, estimated from a log: noise by flat surfaces, error rates by scans held out."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ndtree import _core
from ndtree.comparison import NO_RETURN, is_held_out, no_progress
from ndtree.no_returns import AUTO, believed
from ndtree.readers.log import Log
from ndtree.scan import Scan

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Progress = Callable[[str, int, int], None]

SEED = 0
LEAST_BEAMS = 100  # Returned ones, below which nothing is estimated.
MOST_POINTS = 1_000_000  # End points kept, at random.
FARTHEST = 1e9  # Coordinates [m] that the grid of the neighbours can count.
CONFIDENCE = 0.9  # Of the intervals, from RESAMPLES bootstrap samples.
RESAMPLES = 200

RADII = (0.25, 0.5, 1.0)  # Of a piece of surface [m]; the next one where points are few, or noise is thick.
PIECES = 2400  # Tried.
CHUNK = 256  # Pieces at once.
CANDIDATES = 320  # Points around the middle of a piece, most.
LEAST_POINTS = {2: 15, 3: 25}  # By dimension: in a piece, ...
LEAST_SPREAD = {2: 0.2, 3: 0.15}  # ... and its standard deviation along each direction, in radii.
LEAST_SCANS = 3
LEAST_PIECES = 8  # Below which there is no estimate, ...
LEAST_RESIDUALS = 30  # ... and residuals, below which a bin of ranges says nothing.
CORE = 0.7  # Residuals count up to this distance along the surface, in radii: the ball cuts none off there.
THICKEST = 1 / 8  # Standard deviation of the residuals, in radii.
LEAST_COSINE = 0.5  # Of the angle between beam and normal: at least 30 degrees between beam and surface.
TINY = 1e-6  # Thickness that is none [m].
LEAST_SIGMA = 1e-4  # What a map is told of a sensor without noise [m].
RANGE_BINS = 12

HELD_OUT = 10
UPDATES = 25e6  # Of the maps that the error rates are from, about.
BLOCKS = 4  # Pieces of the log, most, where the whole is too much, ...
BLOCK_SCANS = 20  # ... of at least as many scans.
MARGIN_SIGMAS = 4.0
LEAST_TRIALS = 30  # Beams, below which there is no rate.
RATE_LIMITS = (0.001, 0.4)
CLEAR = 0.9  # Share of the largest and smallest log-odds from which a cell is clearly occupied or free.


@dataclass(frozen=True)
class Estimate:
    """A number from data.

    Parameters
    ----------
    value : float
    low, high : float
        Its 90 % interval, by bootstrap over places (noise) or scans (rates); never apart from the value.
    count : int
        Observations behind it: residuals, or beams.
    """

    value: float
    low: float
    high: float
    count: int


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

    def options(self) -> dict[str, float]:
        """Keywords for `AdaptiveMap`: those that could be estimated, and ``min_cell_size`` is not among them.

        A map takes no sensor without noise: ``range_sigma`` is at least 0.1 mm.
        """
        estimates = {name: getattr(self, name) for name in _ESTIMATED}
        options = {name: one.value for name, one in estimates.items() if one is not None}
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
            f"{100 * self.no_return_share:.2f} % of them not returned",
            f"ranges: median {self.median_range:.2f} m, longest {self.longest_range:.2f} m",
            "",
            f"{'':22}{'estimate':>10}{'90 % interval':>22}{'observations':>14}",
        ]
        for name, unit in _ESTIMATED.items():
            one = getattr(self, name)
            if one is None:
                lines.append(f"{name:22}{'-':>10}{'-':>22}{0:>14}")
                continue
            between = f"{one.low:.3g} to {one.high:.3g}"
            lines.append(f"{name:22}{one.value:>10.3g}{between:>22}{one.count:>14,} {unit}".rstrip())
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
        In 2-D or 3-D. A `Log` is read twice, and a million of its end points are kept; other iterables are
        kept as a whole.
    max_range : float
        Longer beams say only that the space up to there is free [m].
    no_return : str
        What a beam without return says: "free", that space is free up to its end point; "ignore", nothing;
        "auto", of a log from a file what `ndtree.no_returns.judge` finds, else "free".
    min_cell_size : float, optional
        Of the map that the error rates are from [m]. Left out: the adaptive map's own default.
    limit : int, optional
        Only so many scans from the beginning.
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
        way, and would cross half a cell length of clearly occupied space there, the share that come out of it
        into space not occupied and end more than the margin beyond. Beams that did not return are among them
        unless ignored.

    Raises
    ------
    ValueError
        If an option is out of its limits, the log is damaged, or fewer than 100 beams returned.
    """
    if no_return not in NO_RETURN:
        raise ValueError(f"no_return = {no_return!r}: must be one of {', '.join(NO_RETURN)}")
    if not max_range > 0:
        raise ValueError(f"max_range = {max_range:g} m: must be > 0")
    if limit is not None and limit < 1:
        raise ValueError(f"limit = {limit}: must be >= 1")
    cell = _core.default_options()["min_cell_size"] if min_cell_size is None else float(min_cell_size)
    if not (cell > 0 and math.isfinite(cell)):
        raise ValueError(f"min_cell_size = {cell:g} m: must be > 0 and finite")
    if no_return == AUTO:
        no_return = believed(log, log)
    if not isinstance(log, Log):
        log = _Scans(log)
    source = _Source(log, limit, progress or no_progress)
    generator = np.random.default_rng(SEED)

    points = _Points(generator)
    lengths: list[float] = []
    beams = returned = 0
    for i, one in source.beams("reading", math.inf):
        beams += len(one.length)
        returned += int(np.count_nonzero(one.hit))
        points.add(one, i)
        lengths.append(float(np.minimum(one.length, max_range).sum()))
    if returned < LEAST_BEAMS:
        raise ValueError(f"{log.name}: {returned} beams returned, expected at least {LEAST_BEAMS}")
    longest = points.longest
    points.finish()
    median = float(np.median(points.length))
    noise = _noise(points, max_range, generator, source.progress)
    if noise is None:
        sigma, quadratic, default = None, None, _core.default_options()
        model = (default["range_sigma"], default["range_sigma_quadratic"])
    else:
        sigma, quadratic = noise.sigma, noise.quadratic
        model = (max(sigma.value, LEAST_SIGMA), quadratic.value)
    dim = points.end.shape[1]
    del points
    miss, hit = _rates(source, lengths, dim, cell, model, max_range, no_return == "ignore", generator)
    return Calibration(
        log=log.name,
        dim=dim,
        scans=len(lengths),
        beams=beams,
        returned=returned,
        no_return_share=1 - returned / beams,
        median_range=median,
        longest_range=longest,
        range_sigma=sigma,
        range_sigma_quadratic=quadratic,
        miss_given_occupied=miss,
        hit_given_free=hit,
        surfaces=0 if noise is None else noise.pieces,
        sigma_by_range=() if noise is None else noise.bins,
        min_cell_size=cell,
    )


def range_noise(scans: Iterable[Scan], *, max_range: float = math.inf) -> tuple[Estimate, Estimate] | None:
    """Standard deviation of a range [m] and its growth with the squared range [1/m], as by `calibrate`.

    Returns
    -------
    tuple of Estimate, or None
        None where fewer than 100 beams returned, or several scans saw no flat surface.
    """
    generator = np.random.default_rng(SEED)
    points = _Points(generator)
    returned = 0
    for i, scan in enumerate(scans):
        one = _Beams(scan, math.inf)
        returned += int(np.count_nonzero(one.hit))
        points.add(one, i)
    if returned < LEAST_BEAMS:
        return None
    points.finish()
    noise = _noise(points, max_range, generator, no_progress)
    return None if noise is None else (noise.sigma, noise.quadratic)


# --- Reading ----------------------------------------------------------------------------------------


class _Scans(Log):
    """Scans that are no log, kept."""

    format = "scans"

    def __init__(self, scans: Iterable[Scan]) -> None:
        self._kept = list(scans)
        super().__init__(None, dim=self._kept[0].dim if self._kept else 2)

    def __len__(self) -> int:
        return len(self._kept)

    def _scans(self) -> Iterator[Scan]:
        return iter(self._kept)


class _Source:
    """The scans of a log up to a limit, checked, as often as needed."""

    def __init__(self, log: Log, limit: int | None, progress: Progress) -> None:
        self.log = log
        self.limit = limit
        self.progress = progress
        self._total = len(log) if hasattr(log, "__len__") else 0
        if limit is not None:
            self._total = min(self._total, limit)

    def beams(self, what: str, max_range: float) -> Iterator[tuple[int, _Beams]]:
        """The number of each scan, from 0, and its beams."""
        i = -1
        dim = self.log.dim
        for i, scan in enumerate(islice(self.log, self.limit)):
            if dim not in (2, 3):
                raise ValueError(f"{self.log.name}: scan {i} is {dim}-D: must be 2-D or 3-D")
            if scan.dim != dim:
                raise ValueError(f"{self.log.name}: scan {i} is {scan.dim}-D: must be {dim}-D as the first")
            with self.naming(i):
                beams = _Beams(scan, max_range)
            yield i, beams
            self.progress(what, i + 1, self._total)
        if i < 0:
            raise ValueError(f"{self.log.name}: no scans, expected at least one")

    @contextmanager
    def naming(self, i: int) -> Iterator[None]:
        """Errors in here say which scan they are about."""
        try:
            yield
        except ValueError as error:
            raise ValueError(f"{self.log.name}: scan {i}: {error}") from None


class _Beams:
    """The beams of a scan that say something, none longer than `max_range`."""

    def __init__(self, scan: Scan, max_range: float) -> None:
        origin = np.broadcast_to(np.asarray(scan.origin, dtype=np.float64), scan.endpoints.shape)
        way = scan.endpoints - origin
        length = np.linalg.norm(way, axis=1)
        use = np.isfinite(length) & (length > 0)
        far = use & ((np.abs(origin) > FARTHEST) | (np.abs(scan.endpoints) > FARTHEST)).any(axis=1)
        if far.any():
            beam = int(np.flatnonzero(far)[0])
            raise ValueError(
                f"beam {beam} reaches {scan.endpoints[beam].tolist()} m: "
                f"must be within {FARTHEST:g} m of the map's origin"
            )
        self.origin = origin[use]
        self.direction = way[use] / length[use, None]
        self.hit = np.ones(len(use), dtype=bool) if scan.returned is None else scan.returned
        self.hit = self.hit[use] & (length[use] <= max_range)
        self.length = np.minimum(length[use], max_range)

    def at(self, distance: Floats) -> Floats:
        return self.origin + distance[:, None] * self.direction

    def only(self, use: Bools) -> _Beams:
        part = object.__new__(_Beams)
        for name, array in vars(self).items():
            setattr(part, name, array[use])
        return part


class _Points:
    """A random sample of the end points that returned, all equally likely, of bounded size."""

    end: Floats
    direction: Floats
    length: Floats
    scan: NDArray[np.int64]

    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator
        self._share = 1.0
        self._kept: list[tuple[NDArray[Any], ...]] = []
        self._count = 0
        self.longest = 0.0

    def add(self, beams: _Beams, scan: int) -> None:
        if beams.hit.any():
            self.longest = max(self.longest, float(beams.length[beams.hit].max()))
        use = beams.hit
        if self._share < 1:
            use = use & (self._generator.random(len(use)) < self._share)
        one = beams.only(use)
        self._kept.append((one.at(one.length), one.direction, one.length, np.full(len(one.length), scan)))
        self._count += len(one.length)
        while self._count > 2 * MOST_POINTS:
            self._thin(0.5)

    def finish(self) -> None:
        if self._count > MOST_POINTS:
            self._thin(MOST_POINTS / self._count)
        self.end, self.direction, self.length, self.scan = (np.concatenate(part) for part in zip(*self._kept))
        self._kept = []

    def _thin(self, share: float) -> None:
        arrays = tuple(np.concatenate(part) for part in zip(*self._kept))
        use = self._generator.random(len(arrays[0])) < share
        self._kept = [tuple(array[use] for array in arrays)]
        self._count = len(self._kept[0][0])
        self._share *= share


# --- Noise of the ranges, from flat surfaces --------------------------------------------------------


@dataclass(frozen=True)
class _Noise:
    sigma: Estimate
    quadratic: Estimate
    pieces: int
    bins: tuple[tuple[float, float, int], ...]


@dataclass(frozen=True)
class _Residuals:
    """Distances from flat pieces of surface along the beams [m], all positive."""

    value: Floats
    length: Floats
    piece: NDArray[np.int64]
    middle: Floats  # Of each piece.


def _noise(
    points: _Points, max_range: float, generator: np.random.Generator, progress: Progress
) -> _Noise | None:
    pieces = _Pieces(points, max_range, generator, progress)
    noise = _fitted_noise(pieces.residuals(None), generator)
    if noise is None or noise.quadratic.value == 0:
        return noise
    # Near points are better than far ones in the same piece: once more, and each counts as it deserves.
    return _fitted_noise(pieces.residuals((noise.sigma.value, noise.quadratic.value)), generator) or noise


def _fitted_noise(residuals: _Residuals, generator: np.random.Generator) -> _Noise | None:
    if len(residuals.middle) < LEAST_PIECES or not len(residuals.length):
        return None
    low, high = np.quantile(residuals.length, (0.005, 0.995))
    edges = np.geomspace(low, max(high, low * 1.0001), RANGE_BINS + 1)
    inner = np.searchsorted(edges, residuals.length) - 1
    # In each bin from the smallest on, so that a weighted median is one look at the sums of the weights.
    order = np.lexsort((residuals.value, inner))
    value, length, piece, inner = (
        array[order] for array in (residuals.value, residuals.length, residuals.piece, inner)
    )
    parts, spots = [], []
    for i in range(RANGE_BINS):
        part = slice(*np.searchsorted(inner, (i, i + 1)))
        pieces = len(np.unique(piece[part]))
        if len(value[part]) >= LEAST_RESIDUALS and pieces >= 3:
            parts.append(part)
            spots.append((float(np.sqrt(np.mean(length[part] ** 2))), pieces))
    if not parts:
        return None
    where, pieces = np.array(spots).T

    def sigmas(weight: Floats) -> Floats:
        return np.array([1.4826 * _weighted_median(value[part], weight[part]) for part in parts])

    # Pieces overlap; places do not, and are what the bootstrap draws.
    place = np.unique(np.floor(residuals.middle / 2.0), axis=0, return_inverse=True)[1].ravel()
    place_of = place[piece]
    n = int(place.max()) + 1
    measured = sigmas(np.ones(len(value)))
    drawn = [
        sigmas(generator.multinomial(n, np.full(n, 1 / n))[place_of].astype(float)) for _ in range(RESAMPLES)
    ]
    both = _fitted(where, measured, pieces)
    spread = np.array([_fitted(where, one, pieces) for one in drawn])
    if len(parts) < 3 or np.nanquantile(spread[:, 1], (1 - CONFIDENCE) / 2) <= 0:
        # A constant explains the data as well.
        both = (_fitted_constant(measured, pieces), 0.0)
        spread[:, 0] = [_fitted_constant(one, pieces) for one in drawn]
    count = sum(part.stop - part.start for part in parts)
    sigma, quadratic = (
        _estimate(best, one[np.isfinite(one)], int(count)) for best, one in zip(both, spread.T)
    )
    bins = tuple(
        (float(r), float(s), int(part.stop - part.start)) for r, s, part in zip(where, measured, parts)
    )
    return _Noise(sigma, quadratic, len(residuals.middle), bins)


def _estimate(value: float, drawn: Floats, count: int) -> Estimate:
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(drawn, (tail, 1 - tail)) if len(drawn) else (value, value)
    return Estimate(float(value), min(float(low), float(value)), max(float(high), float(value)), count)


def _weighted_median(rising: Floats, weight: Floats) -> float:
    sums = np.cumsum(weight)
    if not sums[-1] > 0:
        return math.nan
    return float(rising[np.searchsorted(sums, 0.5 * sums[-1])])


def _fitted(where: Floats, sigma: Floats, pieces: Floats) -> tuple[float, float]:
    """a >= 0 and b >= 0 of sigma = a + b r², by least squares of the relative errors."""
    known = np.isfinite(sigma)
    where, sigma, pieces = where[known], sigma[known], pieces[known]
    if not known.any():
        return math.nan, math.nan
    weight = np.sqrt(pieces) / (sigma + TINY)
    columns = np.column_stack([weight, weight * where**2])
    wanted = weight * sigma
    if len(sigma) > 1:
        both = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        if (both >= 0).all():
            return float(both[0]), float(both[1])
    # Only one of them is not 0 then: the one that leaves less.
    alone = np.maximum((columns * wanted[:, None]).sum(axis=0) / (columns**2).sum(axis=0), 0.0)
    left = ((columns * alone - wanted[:, None]) ** 2).sum(axis=0)
    return (float(alone[0]), 0.0) if left[0] <= left[1] else (0.0, float(alone[1]))


def _fitted_constant(sigma: Floats, pieces: Floats) -> float:
    known = np.isfinite(sigma)
    if not known.any():
        return math.nan
    weight = pieces[known] / (sigma[known] + TINY) ** 2
    return float((weight * sigma[known]).sum() / weight.sum())


class _Pieces:
    """Flat pieces of surface: where they are is searched once, what they measure can be asked again."""

    def __init__(
        self, points: _Points, max_range: float, generator: np.random.Generator, progress: Progress
    ) -> None:
        use = generator.permutation(np.flatnonzero(points.length <= max_range))
        self._end, self._direction = points.end[use], points.direction[use]
        self._length, self._scan = points.length[use], points.scan[use]
        self._progress = progress
        self._waiting = {RADII[0]: _middles(self._length)}
        self._is_search = True

    def residuals(self, model: tuple[float, float] | None) -> _Residuals:
        """Of all flat pieces, where ranges are as noisy as a model says, or all alike."""
        dim = self._end.shape[1]
        sigma = np.ones(len(self._length))
        if model is not None:
            sigma = np.maximum(model[0] + model[1] * self._length**2, LEAST_SIGMA)
        rows: list[tuple[Floats, Floats, NDArray[np.int64]]] = []
        accepted = {radius: np.empty(0, dtype=np.int64) for radius in RADII}
        pieces = 0
        for radius, larger in zip(RADII, (*RADII[1:], None)):
            waiting = self._waiting.get(radius, accepted[radius])
            if not len(waiting):
                continue
            grid = _Grid(self._end, radius)
            for start in range(0, len(waiting), CHUNK):
                seeds = waiting[start : start + CHUNK]
                near_by, use = grid.around(self._end[seeds])
                flat = _flat_pieces(
                    self._end[near_by] - self._end[seeds][:, None],
                    self._direction[near_by],
                    self._scan[near_by],
                    sigma[near_by],
                    use,
                    radius,
                )
                row, column = np.nonzero(flat.residual_use & flat.accepted[:, None])
                number = np.cumsum(flat.accepted) - 1 + pieces
                rows.append((flat.residual[row, column], self._length[near_by[row, column]], number[row]))
                accepted[radius] = np.append(accepted[radius], seeds[flat.accepted])
                pieces += int(np.count_nonzero(flat.accepted))
                if self._is_search and larger is not None:
                    others = self._waiting.get(larger, seeds[:0])
                    self._waiting[larger] = np.append(others, seeds[flat.retry])
                self._progress(f"surfaces of {radius:g} m", start + len(seeds), len(waiting))
        self._waiting, self._is_search = accepted, False
        if not rows:
            return _Residuals(np.empty(0), np.empty(0), np.empty(0, dtype=np.int64), np.empty((0, dim)))
        value, length, piece = (np.concatenate(part) for part in zip(*rows))
        middle = self._end[np.concatenate([accepted[radius] for radius in RADII])]
        return _Residuals(value, length, piece, middle)


def _middles(length: Floats) -> NDArray[np.int64]:
    """Points to look around, as many of each range; the points themselves come in random order."""
    if not len(length):
        return np.empty(0, dtype=np.int64)
    low, high = np.quantile(length, (0.005, 0.995))
    edges = np.geomspace(low, max(high, low * 1.0001), RANGE_BINS + 1)
    inner = np.clip(np.searchsorted(edges, length) - 1, 0, RANGE_BINS - 1)
    share = PIECES // RANGE_BINS
    return np.concatenate([np.flatnonzero(inner == i)[:share] for i in range(RANGE_BINS)])


class _Grid:
    """Points by the cell of a grid that they are in; other cells may share a key, and distances tell."""

    _FACTORS = (73_856_093 * 2**20 + 1, 19_349_663 * 2**10 + 7, 1)

    def __init__(self, points: Floats, size: float) -> None:
        self._points = points
        self._size = size
        keys = self._keys(np.floor(points / size).astype(np.int64))
        self._order = np.argsort(keys, kind="stable")
        self._keys_sorted = keys[self._order]

    def _keys(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        factors = np.array(self._FACTORS[-cells.shape[1] :], dtype=np.int64)
        return (cells * factors).sum(axis=1)  # Wraps around.

    def around(self, middles: Floats) -> tuple[NDArray[np.int64], Bools]:
        """Indices (m, k) of points near each middle, at most `CANDIDATES`, and which are within the size."""
        dim = middles.shape[1]
        cells = np.floor(middles / self._size).astype(np.int64)
        first, last = [], []
        for shift in product((-1, 0, 1), repeat=dim - 1):  # Cells along the last axis have keys in a row.
            keys = self._keys(cells + np.array([*shift, 0]))
            first.append(np.searchsorted(self._keys_sorted, keys - 1, side="left"))
            last.append(np.searchsorted(self._keys_sorted, keys + 1, side="right"))
        begin = np.stack(first, axis=1)
        count = np.stack(last, axis=1) - begin
        ends = np.cumsum(count, axis=1)
        total = ends[:, -1]
        width = min(int(total.max()), CANDIDATES)
        step = np.maximum(total / CANDIDATES, 1.0)
        wanted = (np.arange(width) * step[:, None]).astype(np.int64)
        use = wanted < total[:, None]
        wanted = np.where(use, wanted, 0)
        run = (wanted[:, :, None] >= ends[:, None, :]).sum(axis=2)
        before = np.take_along_axis(ends - count, run, axis=1)
        indices = self._order[np.take_along_axis(begin, run, axis=1) + wanted - before]
        off = self._points[indices] - middles[:, None]
        return indices, use & ((off**2).sum(axis=2) <= self._size**2)


@dataclass(frozen=True)
class _Flat:
    """Pieces of surface, a row each: which are flat, which deserve a larger radius, and their residuals."""

    accepted: Bools
    retry: Bools
    residual: Floats
    residual_use: Bools


def _flat_pieces(
    off: Floats, direction: Floats, scan: NDArray[np.int64], noise: Floats, use: Bools, radius: float
) -> _Flat:
    """Fits a line or plane to each row of points, (m, k, dim) from their middle, robustly.

    `noise` (m, k) says how the points' standard deviations compare; what is tested is residuals over it.
    """
    dim = off.shape[2]
    inner = use
    few = np.zeros(len(use), dtype=bool)
    for _ in range(4):
        few |= inner.sum(axis=1) < LEAST_POINTS[dim]
        weight = inner / noise**2
        weight /= np.maximum(weight.sum(axis=1), 1e-300)[:, None]
        mean = np.matmul(weight[:, None], off)[:, 0]
        centred = off - mean[:, None]
        spread, axes = np.linalg.eigh(np.matmul((weight[:, :, None] * centred).transpose(0, 2, 1), centred))
        normal = axes[:, :, 0]
        distance = np.matmul(centred, normal[:, :, None])[:, :, 0]
        along = np.matmul(off, axes[:, :, 1:])
        core = use & ((along**2).sum(axis=2) <= (CORE * radius) ** 2)
        scaled = distance / noise
        scaled -= _row_median(scaled, core)[:, None]  # What stands before a surface is on one side of it.
        sigma = 1.4826 * _row_median(np.abs(scaled), core)
        tiny = TINY / noise
        inner = core & (np.abs(scaled) <= np.maximum(3 * sigma[:, None], tiny))
    n = inner.sum(axis=1)
    few |= n < LEAST_POINTS[dim]
    size = np.maximum(n, 1)
    thick = 1.4826 * _row_median(np.abs(distance), core) > THICKEST * radius
    whole = n >= 0.9 * core.sum(axis=1)
    centred_on = np.abs((mean * normal).sum(axis=1)) <= 0.3 * radius
    populated = np.sqrt(np.maximum(spread[:, 1], 0)) >= LEAST_SPREAD[dim] * radius
    several = _distinct(scan, inner) >= LEAST_SCANS
    rms = np.sqrt((scaled**2 * inner).sum(axis=1) / size)
    middle_share = (inner & (np.abs(scaled) <= np.maximum(0.5 * rms[:, None], tiny))).sum(axis=1) / size
    one_mode = middle_share >= 0.2  # 0.38 of a normal distribution, 0.29 of a uniform one.
    relief, tiles = _relief(scaled, along / (CORE * radius), inner)
    straight = (_bend(scaled, along / radius, inner) <= 0.1 + 6 / size) & (
        relief <= 0.08 + 1.5 * tiles / size
    )
    straight |= np.sqrt((distance**2 * inner).sum(axis=1) / size) <= TINY
    accepted = ~few & ~thick & whole & centred_on & populated & several & one_mode & straight
    cosine = np.abs(np.matmul(direction, normal[:, :, None])[:, :, 0])
    # The fit follows each point a little, the more the better the point is, and takes that from its residual.
    left = np.sqrt(np.maximum(1 - dim * weight, 0.25))
    along_beam = np.abs(scaled * noise) / (np.maximum(cosine, LEAST_COSINE) * left)
    return _Flat(accepted, few | thick, along_beam, core & (cosine >= LEAST_COSINE))


def _row_median(values: Floats, use: Bools) -> Floats:
    """The median of each row's values that count; 0 where none does."""
    rising = np.sort(np.where(use, values, np.inf), axis=1)
    n = use.sum(axis=1)
    rows = np.arange(len(values))
    low, high = (rising[rows, np.maximum(at, 0)] for at in ((n - 1) // 2, np.minimum(n // 2, n - 1)))
    return np.where(n > 0, 0.5 * (np.where(n > 0, low, 0) + np.where(n > 0, high, 0)), 0.0)


def _distinct(values: NDArray[np.int64], use: Bools) -> NDArray[np.int64]:
    """How many different values each row has."""
    rising = np.sort(np.where(use, values, -1), axis=1)
    return (np.diff(rising, axis=1, prepend=-1) != 0).sum(axis=1)


def _bend(residual: Floats, along: Floats, use: Bools) -> Floats:
    """The share of the residuals' variance that a paraboloid explains."""
    n = np.maximum(use.sum(axis=1), 1)
    columns = [np.ones_like(residual), *np.moveaxis(along, 2, 0)]
    columns += [along[:, :, i] * along[:, :, j] for i in range(along.shape[2]) for j in range(i + 1)]
    design = np.stack(columns, axis=2) * use[:, :, None]
    values = np.where(use, residual, 0.0)
    values = np.where(use, values - (values.sum(axis=1) / n)[:, None], 0.0)
    square = np.matmul(design.transpose(0, 2, 1), design) + 1e-9 * n[:, None, None] * np.eye(len(columns))
    mixed = np.matmul(values[:, None], design)[:, 0]
    explained = (mixed * np.linalg.solve(square, mixed[:, :, None])[:, :, 0]).sum(axis=1)
    return explained / np.maximum((values**2).sum(axis=1), 1e-30)


def _relief(residual: Floats, along: Floats, use: Bools) -> tuple[Floats, int]:
    """The share of the residuals' variance between tiles of the surface, and the number of tiles."""
    each = {1: 6, 2: 4}[along.shape[2]]
    tiles = each ** along.shape[2]
    tile = np.zeros(use.shape, dtype=np.int64)
    for axis in range(along.shape[2]):
        at = np.floor((along[:, :, axis] + 1) * (each / 2)).astype(np.int64)
        tile = tile * each + np.clip(at, 0, each - 1)
    where = (tile + tiles * np.arange(len(use))[:, None])[use]
    count = np.bincount(where, minlength=tiles * len(use))
    sums = np.bincount(where, residual[use], minlength=tiles * len(use))
    between = (sums**2 / np.maximum(count, 1)).reshape(len(use), tiles).sum(axis=1)
    return between / np.maximum((residual**2 * use).sum(axis=1), 1e-30), tiles


# --- Error rates, from scans held out ---------------------------------------------------------------


def _rates(
    source: _Source,
    lengths: list[float],
    dim: int,
    cell: float,
    model: tuple[float, float],
    max_range: float,
    ignore: bool,
    generator: np.random.Generator,
) -> tuple[Estimate | None, Estimate | None]:
    blocks, share = _blocks(np.array(lengths), dim, cell)
    counts: list[tuple[int, int, int, int]] = []
    at, target, unseen = 0, None, []
    for i, beams in source.beams("error rates", max_range):
        if i < blocks[at].start:
            continue
        if target is None:
            target = _core.FixedMap(
                dim=dim, cell_size=cell, range_sigma=model[0], range_sigma_quadratic=model[1]
            )
        use = beams.hit | (not ignore)
        if share < 1:
            use &= generator.random(len(use)) < share
        beams = beams.only(use)
        if is_held_out(i, HELD_OUT):
            unseen.append(beams)
        elif len(beams.length):
            with source.naming(i):
                target.insert(beams.at(beams.length), beams.origin, returned=beams.hit)
        if i == blocks[at].stop - 1:
            counts += [_counts(target, one, cell, model) for one in unseen if len(one.length)]
            at, target, unseen = at + 1, None, []
            if at == len(blocks):
                break
    rows = np.array(counts, dtype=float).reshape(-1, 4)
    return _rate(rows[:, :2], generator), _rate(rows[:, 2:], generator)


def _blocks(lengths: Floats, dim: int, cell: float) -> tuple[list[range], float]:
    """Parts of the log to be mapped, each by itself, and the share of their beams: about `UPDATES` in all."""
    n = len(lengths)
    per_length = {2: 1.3, 3: 1.5}[dim] / cell
    affordable = int(n * min(1.0, UPDATES / max(lengths.sum() * per_length, 1.0)))
    if affordable >= n:
        return [range(n)], 1.0
    number = min(max(affordable // BLOCK_SCANS, 1), BLOCKS)
    size = min(max(affordable // number, BLOCK_SCANS), n // number)
    starts = [(2 * i + 1) * n // (2 * number) - size // 2 for i in range(number)]
    blocks = [range(max(start, 0), max(start, 0) + size) for start in starts]
    wanted = sum(lengths[block.start : block.stop].sum() for block in blocks) * per_length
    return blocks, min(1.0, UPDATES / max(wanted, 1.0))


def _counts(target: Any, beams: _Beams, cell: float, model: tuple[float, float]) -> tuple[int, int, int, int]:
    """Beams that missed, and that met, something occupied; that hit, and that met, something free."""
    options = target.options
    occupied_from = 1 / (1 + math.exp(-CLEAR * options["log_odds_max"]))
    free_until = 1 / (1 + math.exp(-CLEAR * options["log_odds_min"]))
    margin = np.maximum(MARGIN_SIGMAS * (model[0] + model[1] * beams.length**2), cell)

    first = np.asarray(target.cast_rays(beams.origin, beams.direction))
    met = np.isfinite(first)
    met[met] = beams.length[met] > first[met] - margin[met]
    for depth in (0.1, 0.3, 0.5):
        part = beams.only(met)
        met[met] = target.probability(part.at(first[met] + depth * cell)) >= occupied_from
    part, enter, slack = beams.only(met), first[met], margin[met]
    missed = np.zeros(len(enter), dtype=bool)
    for step in range(2, 26):  # Half cells: where it comes out again.
        out = enter + 0.5 * step * cell
        open_ = ~missed & (part.length > out + slack)
        if not open_.any():
            break
        missed[open_] = target.state(part.only(open_).at(out[open_])) != 1

    # Which beams count must not depend on where they end.
    known = beams.hit & np.isfinite(first)
    hits, wall, slack = beams.only(known), first[known], margin[known]
    passed = target.probability(hits.at(0.5 * wall)) <= free_until
    tips = hits.at(hits.length)
    early = passed & (hits.length < wall - slack) & (target.probability(tips) <= free_until)
    around = np.ceil(slack / cell)
    for cells in np.unique(around[early]):
        those = np.flatnonzero(early & (around == cells))
        early[those] = ~target.occupied_within(tips[those], float(cells * cell))
    numbers = (missed, met, early, passed)
    return tuple(int(np.count_nonzero(one)) for one in numbers)  # type: ignore[return-value]


def _rate(counts: Floats, generator: np.random.Generator) -> Estimate | None:
    wrong, all_ = counts.sum(axis=0)
    if all_ < LEAST_TRIALS:
        return None
    n = len(counts)
    drawn = generator.multinomial(n, np.full(n, 1 / n), size=RESAMPLES) @ counts
    some = drawn[:, 1] > 0
    rates = np.clip(drawn[some, 0] / drawn[some, 1], *RATE_LIMITS)
    return _estimate(float(np.clip(wrong / all_, *RATE_LIMITS)), rates, int(all_))
