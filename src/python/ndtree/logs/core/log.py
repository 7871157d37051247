# SPDX-License-Identifier: BSD-3-Clause
"""What all logs have in common, and those whose lines a parser reads."""

from __future__ import annotations

import contextlib
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ndtree._errors import Text, WrongValue, key
from ndtree._native import _core
from ndtree._native._checked import checked
from ndtree.base.files import require_no_input
from ndtree.base.scan import Scan
from ndtree.base.words import number_of
from ndtree.logs.core.archive import save_archive
from ndtree.logs.core.failures import NoPose, readable
from ndtree.logs.core.plain_file import DamagedStream, open_plain
from ndtree.logs.core.rules import UNSEARCHED, Decision, Rules, Selection
from ndtree.logs.core.silence import CutOff, CutOffSearch, without_padding

if TYPE_CHECKING:
    from typing_extensions import Self

#: The kind of scans that are left out unless `Log.strict`.
UNPOSED = "scans without a pose"


@dataclass
class Skipped:
    """What was passed over of one kind: how often, what was said of the first, and of all together."""

    count: int
    first: str
    summary: str | None = None


def require_log(log: object) -> None:
    """Refuse a file's name in the place of a log."""
    if isinstance(log, (str, os.PathLike)):
        name = os.fspath(log)
        raise TypeError(f"log = {name!r}: expected a Log, as of:\n  ndtree.read({name!r})")


def is_sampled(number: int, sensors: int = 1) -> bool:
    """Whether `spread` looks at a scan, of those from 0 on, before it knows how many there are."""
    run = number // (_core.sample_run * sensors)
    return run % _core.sample_step(run * _core.sample_run + 1) == 0


@checked
class Log(ABC):
    """An iterable of `Scan`; every loop starts again from the first.

    Attributes
    ----------
    path : str or None
        The file; None for a simulated log.
    format : str
        The word for ``format=`` of `read`, or "simulated".
    dim : int
        Number of coordinates of a point.
    uses : str
        What of the file is read, where it holds more than one log.
    hint : str
        What may help where no scan has a pose.
    rules : Rules
        How it is read; `ruled` gives the same log with others.
    notes : list of str
        What the reader decided, and a user should know, each in one line.
    knows_no_returns : bool
        Whether the scans may say of beams that nothing was hit.
    is_depth_camera : bool
        Whether ranges are from structured light or stereo, whose noise grows with the squared range.
    sensors_read : int
        How many sensors its scans are of.
    sensor : str
        Which of several the last loop's last scan is of.
    may_be_zero : bool
        Whether the format can tell such beams, and their directions.
    zeros : int
        Such beams in what the last loop has read.
    may_be_cut_off : bool
        Whether readings at the log's largest range may be a driver's way to say that nothing was hit.
    marks_no_returns : bool
        Whether the format has a mark for beams without return.
    may_be_padded : bool
        Whether beams that end nearer than 1 mm to their sensor are padding, and become invalid; those of no
        length are so already. Not where the unit of length is not known, nor where another log has looked.
    has_sensor : bool
        Whether its points were measured from somewhere; else cells with a point are occupied, none is free.
    skipped : dict of str to Skipped
        By kind, what the last loop has passed over so far.
    """

    format: str
    uses: str = ""
    hint: str = ""
    knows_no_returns = True
    is_depth_camera = False
    sensors_read = 1
    sensor = ""
    may_be_padded = True
    may_be_zero = False
    may_be_cut_off = False
    marks_no_returns = False
    has_sensor = True

    def __init__(self, path: str | None, dim: int) -> None:
        self.path = path
        self.dim = dim
        self.rules = Rules()
        self._decided: list[str] = []
        self._begin()
        self._found: list[CutOff | None] = []  # Once it was searched, also for those with other rules.
        self._is_sampled = False

    def _begin(self) -> None:
        """Forget what earlier loops have seen."""
        self.skipped: dict[str, Skipped] = {}
        self._unposed: dict[str, float] = {}
        self._seen: list[str] = []
        self._done = self.zeros = 0

    @property
    def notes(self) -> list[str]:
        """What was decided when it was opened, and what the last loop has seen; a line each."""
        return [Text(one) for one in (*self._decided, *self._seen)]

    @property
    def decisions(self) -> dict[str, Decision]:
        """What opening it has decided, by the words of `read`: the same words make the same log."""
        return {}

    def ruled(self, **changes: Any) -> Self:
        """The same log, read in another way: `changes` are fields of `Rules`."""
        other = copy(self)
        other.rules = replace(self.rules, **changes)
        other._decided = list(self._decided)
        other._begin()
        return other

    def sampled(self) -> Self:
        """The same log for `spread`: scans that it passes over may come without beams, as not decoded."""
        other = self.ruled()
        other._is_sampled = True
        return other

    def _passed_over(self) -> Scan | None:
        """What stands for the next scan if it need not be decoded."""
        if not self._is_sampled or is_sampled(self._done, self.sensors_read):
            return None
        return Scan(np.empty((0, self.dim)), np.zeros(self.dim))

    def noted(self, line: str) -> Self:
        """The same log with a note that it was opened with."""
        other = self.ruled()
        other._decided.append(line)
        return other

    @property
    def name(self) -> str:
        """How reports call the log: by its path."""
        return self.path or self.format

    def __iter__(self) -> Iterator[Scan]:
        self._begin()
        limit = self.limit()
        try:
            with readable(self.path, f"cannot be read as a {self.format} log"):
                for scan in self._scans():
                    self._done += 1
                    yield self.completed(scan, limit)
            if self._unposed and not self._done:
                self._sum_up_unposed()
                left_out = self.skipped[UNPOSED]
                hint = f"; {self.hint}" if self.hint else ""
                raise ValueError(f"{self.name}: {left_out.summary}{hint}; the first: {left_out.first}")
        except (ValueError, OSError) as error:
            if not self._done:  # There is nothing to keep.
                raise
            self.skip("ends that cannot be read", error)
        finally:
            self._sum_up_unposed()

    def completed(self, scan: Scan, limit: CutOff | None = None) -> Scan:
        """A scan as it was read, without padding, and with beams cut off at a limit."""
        if self.may_be_padded:
            scan = _without_padding(scan)
        return scan if limit is None else limit.applied(scan)

    def limit(self) -> CutOff | None:
        """Where its ranges end; without a rule the log is read once for it, whatever is damaged."""
        if self.rules.cut_off is not UNSEARCHED:
            return self.rules.cut_off
        if not self.may_be_cut_off:
            return None
        if not self._found:
            self._found.append(self._search())
        return self._found[0]

    def _search(self) -> CutOff | None:
        search = CutOffSearch(says_itself=self.marks_no_returns)
        with contextlib.suppress(ValueError, OSError):
            for scan in self.ruled(cut_off=None)._scans():
                search.add(scan)
                if search.is_said:
                    break
        return search.found()

    @property
    def needs_search(self) -> bool:
        """Whether a loop over all of it will find where its ranges end, and nothing else says it."""
        return self.may_be_cut_off and self.rules.cut_off is UNSEARCHED and not self._found

    @property
    def cut_off(self) -> float | None:
        """The log's largest range [m], if readings there are taken as beams that met nothing."""
        limit = self.limit()
        return None if limit is None else limit.at

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """First and last time [s] of "scans" and of "poses", where the log has them apart."""
        return {}

    @property
    def share_read(self) -> float | None:
        """How much of the log the last loop has read, 0 to 1; None where that is not known."""
        return None

    def select(
        self,
        *,
        every: int = 1,
        start: float | None = None,
        stop: float | None = None,
        min_range: float = 0.0,
        stride: int = 1,
        box: tuple[ArrayLike, ArrayLike] | None = None,
        origin: ArrayLike | None = None,
    ) -> Log:
        """A part of the log, read as lazily as the log itself.

        Parameters
        ----------
        every : int
            Of the scans that `start` and `stop` leave, the first and every n-th after it.
        start, stop : float, optional
            Only scans at these times since the log's first scan, [start, stop) [s]. Reading ends with the
            first scan at `stop` or later. For logs whose scans have stamps.
        min_range : float
            Shorter beams are left out [m].
        stride : int
            Of each scan's beams, the first and every n-th after it.
        box : (lower, upper), optional
            Two points (dim,) [m]: of each beam what lies up to where it leaves [lower, upper). Beams that end
            in the box stay as they are. Others that pass it say that it is free up to where they leave it.
            The rest is left out. Beams from outside keep their origin: the way to the box is free, too.
        origin : (dim,), optional
            Point of the log that becomes the map's origin [m], for far-away coordinates. It is subtracted
            first, in double precision: `box` is in the map.

        Raises
        ------
        ValueError
            If a value is out of its limits, or does not fit the log's ``dim``.
        """
        parts = {"every": every, "start": start, "stop": stop, "min_range": min_range, "stride": stride}
        return SelectedLog(self, Selection(self.dim, **parts, box=box, origin=origin))

    def save(
        self, path: str | os.PathLike[str], *, progress: Callable[[str, int, int], None] | None = None
    ) -> int:
        """Write all scans to one .npz file, which `read` reads.

        Parameters
        ----------
        path : str or path
            Its name ends in .npz; it appears whole or not at all.
        progress : callable, optional
            Called as ``progress(what, done, total)`` with numbers of scans.

        Returns
        -------
        int
            Number of scans.

        Raises
        ------
        OSError
            If the file cannot be written.
        ValueError
            If the log is damaged or empty, or its beams have origins or noise of their own, for which the
            file has no place.
        """
        if self.path is not None:
            require_no_input(path, [self.path])
        return save_archive(self._watched(progress), path, self.name)

    def _watched(self, progress: Callable[[str, int, int], None] | None) -> Iterator[Scan]:
        total = len(self) if isinstance(self, SizedLog) else 0
        for done, scan in enumerate(self, start=1):
            yield scan
            if progress is not None:
                progress("writing", done, total)

    @abstractmethod
    def _scans(self) -> Iterator[Scan]:
        """Read the scans from the first on."""

    def without_scans(self) -> ValueError:
        """The error of who needs a scan and was given none."""
        return ValueError(f"{self.name}: no scans, expected at least one")

    def skip(self, kind: str, error: Exception) -> None:
        """Raise an error, or with ``keep_going`` note it: the reader then goes on behind the damage.

        `kind` is in the plural, as in "scans without a pose"; a reader returns where nothing can follow.
        """
        if not self.rules.keep_going:
            raise error
        self._note(kind, error)

    def _leave_out(self, kind: str, error: Exception, summary: str | None = None) -> None:
        """Note what cannot be used but is no damage either; with ``strict`` raise it."""
        if self.rules.strict:
            raise error
        self._note(kind, error, summary)

    def _note(self, kind: str, error: Exception, summary: str | None = None) -> None:
        if kind in self.skipped:
            self.skipped[kind].count += 1
        else:
            self.skipped[kind] = Skipped(1, str(error), summary)

    def _leave_out_unposed(self, error: NoPose) -> None:
        """Note a scan at whose time no pose is known; with ``strict`` raise it."""
        self._leave_out(UNPOSED, error)
        self._unposed[error.where] = max(self._unposed.get(error.where, 0.0), error.seconds)

    def _sum_up_unposed(self) -> None:
        """Say once how many scans had no pose, and why."""
        if not self._unposed:
            return
        left_out = self.skipped[UNPOSED]
        ways = {
            "before": "the poses begin {} s later",
            "after": "the poses end {} s earlier",
            "in a gap": "the poses have gaps of up to {} s",
        }
        seconds = {at: f"{s:.2f}" if s < 1e9 else f"{s:.3g}" for at, s in self._unposed.items()}
        why = ", ".join(text.format(seconds[at]) for at, text in ways.items() if at in seconds)
        total = left_out.count + self._done
        left_out.summary = f"{left_out.count} of {total} scans had no pose: {why}"

    def __repr__(self) -> str:
        return f"<{self.format} log {self.path or self.name!r}, {self.dim}-D>"


def _without_padding(scan: Scan) -> Scan:
    """The scan without padding; beams of no length stay as they are, for they are invalid already."""
    ends = without_padding(scan.endpoints, scan.origin)
    if ends is scan.endpoints:
        return scan
    without_length = (scan.endpoints == scan.origin).all(axis=1)
    ends[without_length] = scan.endpoints[without_length]
    return replace(scan, endpoints=ends)


class LineLog(Log):
    """A text file, packed by gzip or not, whose lines a parser turns into scans."""

    path: str
    may_be_cut_off = True
    _place = 0

    @property
    def share_read(self) -> float | None:
        """By the place in the file, packed or not."""
        return min(1.0, self._place / max(os.path.getsize(self.path), 1))

    def _parsed(self, parse: Callable[[str], Scan | None]) -> Iterator[Scan]:
        """Scans that a parser finds in the lines; its errors get the file's name."""
        with open_plain(self.path) as file:
            try:
                for line in file:
                    try:
                        scan = parse(line.decode("utf-8", "replace").rstrip("\r\n"))
                    except ValueError as error:
                        self.skip("damaged lines", ValueError(f"{self.path}: {error}"))
                        continue
                    if scan is not None:
                        self._place = file.place
                        yield scan
            except DamagedStream as error:
                self.skip(f"damaged {error.kind} streams", error)


class SizedLog(Log):
    """A log that knows its number of scans without being read."""

    @abstractmethod
    def __len__(self) -> int: ...

    @property
    def share_read(self) -> float | None:
        """By the number of scans."""
        return self._done / max(len(self), 1)

    def __repr__(self) -> str:
        return f"<{self.format} log {self.path or self.name!r}, {self.dim}-D, {number_of(len(self), 'scan')}>"


class DerivedLog(Log):
    """A log that is read from another one, as lazily as that is."""

    may_be_padded = False

    def __init__(self, log: Log) -> None:
        super().__init__(log.path, log.dim)
        self.format, self.uses, self.rules = log.format, log.uses, log.rules
        self.knows_no_returns, self.has_sensor = log.knows_no_returns, log.has_sensor
        self.is_depth_camera, self.may_be_zero = log.is_depth_camera, log.may_be_zero
        self._log = log

    def ruled(self, **changes: Any) -> Self:
        other = super().ruled(**changes)
        other._log = self._log.ruled(**changes)
        return other

    def completed(self, scan: Scan, limit: CutOff | None = None) -> Scan:
        """The scan itself: the other log has done it."""
        return scan

    def without_scans(self) -> ValueError:
        """As of the other log."""
        return self._log.without_scans()

    # As of the other log, which has applied the limit to its scans, too.
    name = property(attrgetter("_log.name"))
    decisions = property(attrgetter("_log.decisions"))
    cut_off = property(attrgetter("_log.cut_off"))
    spans = property(attrgetter("_log.spans"))
    share_read = property(attrgetter("_log.share_read"))
    sensors_read, sensor = property(attrgetter("_log.sensors_read")), property(attrgetter("_log.sensor"))
    skipped = property(attrgetter("_log.skipped"), lambda self, _: None)
    zeros = property(attrgetter("_log.zeros"), lambda self, _: None)

    def limit(self) -> CutOff | None:
        return self._log.limit()

    @property
    def notes(self) -> list[str]:
        """Of the other log, and its own."""
        return [*self._log.notes, *super().notes]


class SelectedLog(DerivedLog):
    """The part of a log that `Log.select` chose."""

    def __init__(self, log: Log, selection: Selection) -> None:
        super().__init__(log)
        self._selection = selection

    def without_scans(self) -> ValueError:
        """The error, which names the times that were asked for."""
        times = {"start": self._selection.start, "stop": self._selection.stop}
        given = [f"{key(name)} = {time:g} s" for name, time in times.items() if time is not None]
        if not given:
            return super().without_scans()
        said = f"no scans with {' and '.join(given)}, expected seconds after the log's first scan"
        return WrongValue(f"{self.name}: {said}")

    def _scans(self) -> Iterator[Scan]:
        return self._selection.of(self._log, self.name)
