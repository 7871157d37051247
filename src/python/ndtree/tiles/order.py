# SPDX-License-Identifier: BSD-3-Clause
"""Logs of several robots in one order: by time, then by name."""

from __future__ import annotations

import heapq
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Union

from ndtree.base.scan import Scan

#: A log, or what opens one wherever a task runs: a path, or a function without arguments.
Source = Union[str, "os.PathLike[str]", Iterable[Scan], Callable[[], Iterable[Scan]]]
Sources = Union[Source, Sequence["str | os.PathLike[str]"], Mapping[str, Source]]


@dataclass(frozen=True)
class Place:
    """Which scan of which log."""

    time: float  # Of the scan, or of an earlier one of its log where clocks went back [s].
    log: str
    number: int  # From 0.

    @property
    def key(self) -> tuple[float, str, int]:
        """By which scans are ordered."""
        return self.time, self.log, self.number


def named(sources: Sources) -> dict[str, Source]:
    """Logs by name, those of files by what they are called, in the order of their names.

    Raises ValueError if there is none, or two have the same name.
    """
    if isinstance(sources, Mapping):
        logs = dict(sources)
    elif isinstance(sources, (str, os.PathLike)):
        logs = {os.path.basename(os.path.normpath(sources)): sources}
    elif isinstance(sources, Sequence) and all(isinstance(one, (str, os.PathLike)) for one in sources):
        logs = {}
        for one in sources:
            name = os.path.basename(os.path.normpath(one))
            if name in logs:
                raise ValueError(f"{os.fspath(one)}: another log is called {name}, too: give names by a dict")
            logs[name] = one
    else:
        path = getattr(sources, "path", None)
        logs = {os.path.basename(path) if path else "log": sources}  # type: ignore[dict-item]
    if not logs:
        raise ValueError("no logs: must be at least one")
    return dict(sorted(logs.items()))


def opened(source: Source) -> Iterable[Scan]:
    """The scans of a log."""
    if isinstance(source, (str, os.PathLike)):
        from ndtree.logs import read

        return read(source)
    return source() if callable(source) else source


def placed(name: str, scans: Iterable[Scan]) -> Iterator[tuple[Place, Scan]]:
    """Scans with their places; in a log, time never goes back, whatever its clock does."""
    time = float("-inf")
    for number, scan in enumerate(scans):
        time = max(time, scan.stamp)
        yield Place(time, name, number), scan


def in_order(logs: Mapping[str, Iterable[Scan]]) -> Iterator[tuple[Place, Scan]]:
    """All scans of some logs: by time, those of one time by the name of their log.

    Of each log the next scan alone is in memory.
    """
    return heapq.merge(*(placed(name, scans) for name, scans in logs.items()), key=lambda one: one[0].key)
