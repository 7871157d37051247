# SPDX-License-Identifier: BSD-3-Clause
"""Scans of a log that are needed several times."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from ndtree.base.scan import Scan
from ndtree.logs.core.log import Log

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
