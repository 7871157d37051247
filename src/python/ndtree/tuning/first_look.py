# SPDX-License-Identifier: BSD-3-Clause
"""A first look at a log: the options with which it should be mapped."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from ndtree._errors import Text, key
from ndtree._native import _core
from ndtree._native._checked import checked
from ndtree.alignment.surfaces import Cloud
from ndtree.base.progress import Progress, no_progress
from ndtree.base.scan import Scan
from ndtree.base.typing import MapOptions
from ndtree.base.voxels import voxelise
from ndtree.evaluation.sampling import NoReturns, judge, skipping_unmappable, some_of, spread
from ndtree.logs.core.log import Log, require_log
from ndtree.logs.core.rules import UNSEARCHED
from ndtree.logs.core.silence import CutOff, CutOffSearch
from ndtree.tuning.calibration import range_noise
from ndtree.tuning.heading import HeadingDrift, heading_drift
from ndtree.tuning.mismatch import Mismatch, mismatch
from ndtree.tuning.pairs import pairs_of
from ndtree.tuning.range_end import range_end
from ndtree.tuning.revisits import Drift, drift
from ndtree.tuning.setup import setup_error
from ndtree.tuning.setup_error import SetupError

#: Of structured light and stereo, where the log has too little to measure it: at the sensor [m], and growing
#: with the squared range [1/m].
DEPTH_CAMERA = (0.005, 0.0015)
#: A sigma is chosen between these [m]: poses are hardly better, and worse ones are not the sensor's noise.
SIGMA_LIMITS = (0.005, 0.1)
#: Growth that adds less than this share to sigma at the longest range is none.
NEGLIGIBLE = 0.1
#: At least this many scans are mapped to see what mapping costs, if there are as many.
TRIED = 80
#: Of the longest range that was measured, how far beams without return are believed.
BELIEVED = 1.2


@dataclass(frozen=True)
class FirstLook:
    """What `first_look` found.

    Parameters
    ----------
    range_sigma, range_sigma_quadratic : float
        Standard deviation of a range [m], and its growth with the squared range [1/m].
    is_measured : bool or None
        The noise is from the log; else it is what such sensors usually have. None: it was not asked for.
    has_own_noise : bool
        The log tells the noise of each range, beside which this one does not count.
    no_returns : NoReturns
        What beams without return say, and why.
    max_range : float
        How far they are believed [m]; infinite where it does not matter.
    seconds, read_seconds : float
        That the look took, and of these the reading of the log.
    sample : list of Scan
        That was looked at.
    cut_off : float or None
        The log's largest range, where readings are taken as beams without return [m].
    limit : CutOff or None
        The same with its tolerance; None of a join of several logs, as each has its own.
    unsure_end : str or None
        Which readings at the end of the ranges may be beams without return as well.
    zeros : int
        Beams with a range of 0.
    drift : Drift or None
        How far its surfaces lie apart where the robot comes back, if they do.
    heading_drift : HeadingDrift or None
        How fast headings of a 2-D log drift, if they do.
    setup : SetupError or None
        What is wrong with the mount, the clock, the scale or the poses of a log, if something is.
    mismatch : Mismatch or None
        Where poses do not fit what is seen, if they do not.
    """

    dim: int
    scans: int
    beams: int
    range_sigma: float
    range_sigma_quadratic: float
    is_measured: bool | None
    has_own_noise: bool
    no_returns: NoReturns
    max_range: float
    seconds: float
    read_seconds: float
    sample: list[Scan] = field(repr=False, compare=False)
    cut_off: float | None = None
    limit: CutOff | None = None
    unsure_end: str | None = None
    zeros: int = 0
    drift: Drift | None = None
    heading_drift: HeadingDrift | None = None
    setup: SetupError | None = None
    mismatch: Mismatch | None = None

    @property
    def doubt(self) -> str | None:
        """Why the poses cannot be right, in one line; None where nothing says so."""
        causes = (self.setup, self.drift, self.heading_drift, self.mismatch)
        found = next(filter(None, causes), None)
        return None if found is None else str(found)

    @property
    def options(self) -> MapOptions:
        """Keywords for `AdaptiveMap`."""
        options: MapOptions = {"range_sigma": self.range_sigma}
        if self.range_sigma_quadratic:
            options["range_sigma_quadratic"] = self.range_sigma_quadratic
        return options

    def figures(self) -> dict[str, Any]:
        """All of it as plain numbers, ready for JSON."""
        return {
            "dim": self.dim,
            **({} if self.is_measured is None else {**self.options, "is_measured": self.is_measured}),
            "no_return": self.no_returns.choice,
            "no_return_why": str(self.no_returns),
            "no_return_beams": self.no_returns.beams,
            "no_return_crossing": self.no_returns.crossing,
            "no_return_expected": self.no_returns.expected,
            "max_range": self.max_range if math.isfinite(self.max_range) else None,
            "drift": None if self.drift is None else self.drift.error,
            "setup": _figures(self.setup),
            "mismatch": _figures(self.mismatch),
            "doubt": self.doubt,
        }

    def cost(self) -> tuple[float, float]:
        """Time [s] and memory [bytes] that `ndtree map` will take, about: a part of the sample is mapped."""
        m = _core.AdaptiveMap(dim=self.dim, **self.options)
        part = self.sample[:: max(1, len(self.sample) // TRIED)]
        begin = time.perf_counter()
        for scan in part:
            one = scan.returned_only() if self.no_returns.choice == "ignore" else scan
            with skipping_unmappable():
                one.insert_into(m, max_range=self.max_range)
        inserted = time.perf_counter() - begin
        inserted *= self.beams / max(sum(len(scan) for scan in part), 1)
        return self.seconds + self.read_seconds + inserted, float(m.stats().memory_bytes)


@checked
def first_look(log: Log, *, with_sigma: bool = True, progress: Progress | None = None) -> FirstLook:
    """Read a log once, and find the options with which it should be mapped.

    160 to 320 scans from all over the log are looked at, in runs of four. The noise of the ranges is measured
    as by `calibrate`. What beams without return say is decided by `ndtree.evaluation.sampling.judge`; where
    they are believed, then up to 1.2 times the longest range that was measured.

    Parameters
    ----------
    with_sigma : bool
        Measure the noise; else it is what such sensors usually have.
    progress : callable, optional
        Called as ``progress(what, done, total)``.

    Raises
    ------
    ValueError
        If the log has no scans, or is damaged.
    """
    require_log(log)
    begin = time.perf_counter()
    report = progress or no_progress
    looked = _Looked(log, report)
    runs, beams = looked.runs, round(looked.times * looked.beams)
    read_seconds = looked.times * (time.perf_counter() - begin)
    sample = [scan for run in runs for scan in run]
    if not sample:
        raise log.without_scans()
    noise = range_noise(scan for scan in sample if scan.range_sigma is None) if with_sigma else None
    told = [scan.range_sigma is not None for scan in sample if len(scan)]
    if noise is not None:
        sigma, quadratic = noise[0].value, noise[1].value
    elif log.is_depth_camera:
        sigma, quadratic = DEPTH_CAMERA
    else:
        sigma, quadratic = _core.default_options()["range_sigma"], 0.0
    longest = max((float(scan.returned_beams()[2].max(initial=0.0)) for scan in sample), default=0.0)
    sigma = _rounded(min(max(sigma, SIGMA_LIMITS[0]), SIGMA_LIMITS[1]))
    if quadratic * longest**2 < NEGLIGIBLE * sigma:
        quadratic = 0.0
    quadratic = _rounded(quadratic)
    said = judge(sample)
    limit = math.inf
    if said.choice == "free" and said.share > 0 and longest > 0:
        limit = _rounded(BELIEVED * longest)
    return FirstLook(
        dim=log.dim,
        scans=looked.scans,
        beams=beams,
        range_sigma=sigma,
        range_sigma_quadratic=quadratic,
        is_measured=noise is not None if with_sigma else None,
        has_own_noise=bool(told) and all(told),
        no_returns=said,
        max_range=limit,
        seconds=time.perf_counter() - begin,
        read_seconds=read_seconds,
        sample=sample,
        cut_off=looked.cut_off,
        limit=looked.limit,
        unsure_end=looked.unsure_end,
        zeros=round(looked.times * looked.zeros),
        **_doubts(looked, log.dim == 2),
    )


def _figures(found: Any) -> dict[str, Any] | None:
    """Of what was found, as JSON has them: None for a time that is not known."""
    if found is None:
        return None
    return {name: None if value != value else value for name, value in asdict(found).items()}


def _doubts(looked: _Looked, is_planar: bool) -> dict[str, Any]:
    """What speaks against the poses, of each kind what the first sensor tells, as `FirstLook` has it."""
    found: dict[str, Any] = {}
    for sensor, runs, clouds in looked.views():
        runs = runs if is_planar else []
        setup = setup_error(clouds)
        other = None if setup else mismatch(clouds)
        told = {
            "drift": drift(runs),
            "heading_drift": heading_drift(pairs_of(runs)),
            "setup": setup and replace(setup, sensor=sensor),
            "mismatch": other and replace(other, sensor=sensor),
        }
        found = {name: found.get(name) or one for name, one in told.items()}
    return found


class _Looked:
    """A sample of a log, and what was seen on the way: where its ranges end is found in the same pass."""

    def __init__(self, log: Log, report: Progress) -> None:
        total = len(log) if hasattr(log, "__len__") else 0
        search = CutOffSearch(says_itself=log.marks_no_returns) if log.needs_search else None
        source = log.sampled() if search is None else log.ruled(cut_off=None)
        decoded = 0

        def scans() -> Iterator[Scan]:
            nonlocal decoded
            for scan in source:
                decoded += len(scan) > 0
                if search is not None:
                    search.add(scan)
                yield scan

        def keep(scan: Scan) -> tuple[Scan, Cloud | None, str]:
            return some_of(scan) if search is None else scan, Cloud.of(scan), source.sensor

        found, self.scans, self.beams = spread(
            scans(), lambda done: report("looking at the log", done, total), keep, log.sensors_read
        )
        self.runs = [[scan for scan, _, _ in run] for run in found]
        self._clouds = [[cloud for _, cloud, _ in run] for run in found]
        self._sensors = [[sensor for _, _, sensor in run] for run in found]
        self.zeros, self.limit = source.zeros, log.limit() if search is None else search.found()
        if search is not None:
            limit = self.limit
            cut = (lambda scan: scan) if limit is None else limit.applied
            self.runs = [[some_of(cut(scan)) for scan in run] for run in self.runs]
            self._clouds = [[cloud and cloud.cut(cut) for cloud in run] for run in self._clouds]
        self.cut_off = log.cut_off if search is None else None if self.limit is None else self.limit.at
        self.unsure_end: str | None = None
        is_open = self.limit is None and log.rules.cut_off is UNSEARCHED
        end = range_end([scan for run in self.runs for scan in run]) if is_open else None
        if end is not None and end.is_empty:
            self.limit, self.cut_off = end.limit, end.limit.at
            self.runs = [[end.limit.applied(scan) for scan in run] for run in self.runs]
            self._clouds = [[cloud and cloud.cut(end.limit.applied) for cloud in run] for run in self._clouds]
        elif end is not None:
            self.unsure_end = str(end)
        #: Of the scans, how many times as many there are as were decoded.
        self.times = self.scans / decoded if decoded else 1.0

    def views(self) -> Iterator[tuple[str, list[list[Scan]], list[list[Cloud]]]]:
        """Of each sensor its name, "" where there is one, and its runs of scans and of clouds."""
        names = sorted({name for run in self._sensors for name in run})
        for name in names:
            own = [[i for i, of in enumerate(run) if of == name] for run in self._sensors]
            runs = [[run[i] for i in which] for run, which in zip(self.runs, own)]
            clouds = [[run[i] for i in which] for run, which in zip(self._clouds, own)]
            seen = [[one for one in run if one is not None] for run in clouds]
            yield name if len(names) > 1 else "", runs, seen


def _rounded(value: float) -> float:
    """To two digits, as a person would type it."""
    if not value or not np.isfinite(value):
        return value
    return float(f"{value:.2g}")


#: Fewer smallest cells than any room has along x and y; of a beam, most are `_core.most_cells`.
FEWEST_CELLS = 10
#: Of points of one scan, more than this share behind others: of sensors' own scans at most 0.08 are, in
#: cells [m] that are smaller than what blocks a view. Fewer points are too far apart to block any, and of
#: more some tell as much.
_HIDDEN, _BLOCKING, _TELLING, _MOST = 0.15, 0.05, 2000, 300_000


class Scale:
    """What of some scans is absurd for cells of a size; beams are not too long for who gave a `max_range`.

    `cell_size`: Of the smallest cells [m].
    `max_range`: Longer beams are cut there: those who say so mean it [m].
    """

    def __init__(self, cell_size: float, max_range: float = math.inf) -> None:
        self._cell, self._max_range = cell_size, max_range
        self._limit = _core.most_cells * cell_size
        self._number = 0
        self._far: tuple[int, float] | None = None
        self._jump: tuple[int, float] | None = None
        self._hidden: tuple[int, float] | None = None  # Of the first scan with enough points.
        self._span, self._points = 0.0, 0
        self._bounds: np.ndarray | None = None  # Of points alone.
        self._at: np.ndarray | None = None

    @classmethod
    def of(cls, scans: Iterable[Scan], cell_size: float, max_range: float) -> Scale:
        """That of some scans."""
        scale = cls(cell_size, max_range)
        for scan in scans:
            scale.add(scan)
        return scale

    def add(self, scan: Scan) -> None:
        """Look at the next scan."""
        if len(scan):
            origin = scan.origin if scan.origin.ndim == 1 else scan.origin[0]
            if scan.points_only:
                self._add_points(scan.endpoints[np.isfinite(scan.endpoints).all(axis=1)])
            if self._far is None and math.isinf(self._max_range):
                apart = np.abs(scan.endpoints - scan.origin)
                longest = float(apart[np.isfinite(apart)].max(initial=0.0))
                if longest > self._limit:
                    self._far = (self._number, longest)
            if self._at is not None and self._jump is None:
                jump = float(np.abs(origin - self._at).max())
                if jump > self._limit:
                    self._jump = (self._number, jump)
            if np.isfinite(origin).all():
                self._at = origin
            if self._hidden is None and len(scan) >= _TELLING and not scan.points_only:
                self._hidden = (self._number, hidden(scan))
        self._number += 1

    def _add_points(self, points: np.ndarray) -> None:
        if len(points):
            ends = np.array([points.min(axis=0), points.max(axis=0)])
            self._span = max(self._span, float(np.ptp(ends, axis=0).max()))
            every = ends if self._bounds is None else np.concatenate([self._bounds, ends])
            self._bounds = np.array([every.min(axis=0), every.max(axis=0)])
            self._points += len(points)

    def warning(self) -> str | None:
        """The first that is absurd, and what it may be, in one line; None if nothing is."""
        if self._far is not None:
            number, length = self._far
            return Text(
                f"scan {number} has a beam of {length:,.0f} m, {length / self._cell:,.0f} cells: expected "
                "metres, and origins in the frame of the end points; if it is right, set "
                f"{key('max_range')}"
            )
        if self._jump is not None:
            number, length = self._jump
            return Text(
                f"scan {number} lies {length:,.0f} m from the one before: expected all scans in one frame, "
                f"such as UTM or a local one, and {key('origin')} for coordinates far away"
            )
        if self._hidden is not None and self._hidden[1] > _HIDDEN:
            number, share = self._hidden
            return Text(
                f"{100 * share:.0f} % of the points of scan {number} lie behind others of it, as no sensor "
                "sees them: is it a cloud of several places? Where its beams pass, what it has is free"
            )
        if self._span > self._limit:
            return Text(
                f"points span {self._span:,.0f} m, {self._span / self._cell:,.0f} cells: expected metres; "
                f"if it is right, a larger {key('min_cell_size')} is enough"
            )
        if self._bounds is not None and self._points > FEWEST_CELLS**2:
            across = float(np.ptp(self._bounds, axis=0)[:2].max())
            if across < FEWEST_CELLS * self._cell:
                return Text(
                    f"{self._points:,} points span {across:.2g} m across, less than {FEWEST_CELLS} cells: "
                    f"expected metres, not degrees; if it is right, set a smaller {key('min_cell_size')}"
                )
        return None


def hidden(scan: Scan) -> float:
    """The share of a scan's end points with others of it at less than 4/5 of their way from the sensor."""
    start, way, length = (part[:: 1 + len(scan) // _MOST] for part in scan.returned_beams())
    m = _core.FixedMap(dim=scan.dim, cell_size=_BLOCKING)
    with skipping_unmappable():
        voxelise(start + length[:, None] * way, m)
        before = m.cast_rays(start, way, max_range=float(length.max()))
        return float(np.mean(before < 0.8 * length - 2 * _BLOCKING))
    return 0.0
