# SPDX-License-Identifier: BSD-3-Clause
"""Several logs as one, one after the other; and scans of a log that are needed several times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from ndtree.base.scan import Scan
from ndtree.logs.core.log import Log, Skipped
from ndtree.logs.core.rules import UNSEARCHED

if TYPE_CHECKING:
    from typing_extensions import Self


class JoinedLog(Log):
    """Logs of one place and one frame, read one after the other in the order given.

    Raises
    ------
    ValueError
        If there is none, or they differ in dimension.
    """

    may_be_padded = False

    def __init__(self, logs: Sequence[Log]) -> None:
        if not logs:
            raise ValueError("logs: expected at least one")
        first = logs[0]
        for log in logs:
            if log.dim != first.dim:
                raise ValueError(f"{log.name}: is {log.dim}-D, must be {first.dim}-D as {first.name}")
        more = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
        super().__init__(f"{first.name}{more}", first.dim)
        self._logs = tuple(logs)
        self.format = ", ".join(dict.fromkeys(log.format for log in logs))
        self.uses = "; ".join(f"{log.name}: {log.uses}" for log in logs if log.uses)
        self.rules = replace(first.rules, cut_off=UNSEARCHED)
        self.knows_no_returns = any(log.knows_no_returns for log in logs)
        self.is_depth_camera = all(log.is_depth_camera for log in logs)
        self.has_sensor = any(log.has_sensor for log in logs)
        self.may_be_zero = any(log.may_be_zero for log in logs)
        self._at = 0

    def without_scans(self) -> ValueError:
        """As of the first log."""
        return self._logs[0].without_scans()

    def ruled(self, **changes: Any) -> Self:
        """Of all logs; each keeps the end of its own ranges, beside one of all."""
        other = super().ruled(**changes)
        changes.pop("cut_off", None)
        other._logs = tuple(log.ruled(**changes) for log in self._logs)
        return other

    @property
    def notes(self) -> list[str]:
        """Of all logs."""
        return [*(note for log in self._logs for note in log.notes), *super().notes]

    @property
    def cut_off(self) -> float | None:
        """The largest of all logs."""
        found = [super().cut_off, *(log.cut_off for log in self._logs)]
        return max((limit for limit in found if limit is not None), default=None)

    @property
    def share_read(self) -> float | None:
        """Each log counts alike; None where one cannot tell how much of it is read."""
        if self._at >= len(self._logs):
            return 1.0
        share = self._logs[self._at].share_read
        return None if share is None else (self._at + share) / len(self._logs)

    def _scans(self) -> Iterator[Scan]:
        for i, log in enumerate(self._logs):
            self._at = i
            try:
                yield from log
            finally:
                self.zeros += log.zeros
                for kind, one in log.skipped.items():
                    self._take_over(kind, one)
        self._at = len(self._logs)

    def _take_over(self, kind: str, one: Skipped) -> None:
        before = self.skipped.get(kind)
        if before is None:
            self.skipped[kind] = Skipped(one.count, one.first, one.summary)
            return
        before.count += one.count
        before.summary = "; ".join(text for text in (before.summary, one.summary) if text) or None


_MOST = 1 << 28  # Bytes.


class Again:
    """Scans of a log, as often as needed: decoded once, or each time where they take more than 256 MiB.

    `limit`: Only the first scans, this many.
    """

    def __init__(self, log: Log, limit: int | None = None) -> None:
        self._log = log
        self._limit = limit
        self._kept: list[Scan] | None = None
        self._done = 0

    @property
    def are_kept(self) -> bool:
        """Whether the log itself is read no more."""
        return self._kept is not None

    @property
    def share_read(self) -> float | None:
        """As of the log, of the last loop."""
        return self._done / max(len(self._kept), 1) if self._kept is not None else self._log.share_read

    def __iter__(self) -> Iterator[Scan]:
        if self._kept is not None:
            for done, scan in enumerate(self._kept, start=1):
                self._done = done
                yield scan
            return
        kept: list[Scan] = []
        size = 0
        for scan in islice(self._log, self._limit):
            size += sum(one.nbytes for one in vars(scan).values() if isinstance(one, np.ndarray))
            if size <= _MOST:
                kept.append(scan)
            else:
                kept.clear()
            yield scan
        if size <= _MOST:
            self._kept = kept
