# SPDX-License-Identifier: BSD-3-Clause
"""Tasks that run at once, each in a process of its own."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass
from multiprocessing import connection
from typing import Any


class Engine(ABC):
    """Runs functions somewhere.

    `workers`: How many run at once.
    """

    workers: int

    @abstractmethod
    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Begin a task; returns a handle."""

    @abstractmethod
    def done_of(self, handles: Collection[Any]) -> set[Any]:
        """Wait until one of some tasks is done, and return all that are."""

    @abstractmethod
    def result(self, handle: Any) -> Any:
        """What a task that is done returned; what it raised is raised."""

    @abstractmethod
    def close(self) -> None:
        """Give back what was taken."""


class ProcessEngine(Engine):
    """A process for each task, as many at a time as there are workers; one that dies is begun again.

    `method` ({"fork", "spawn"}): How processes begin; where they are forked, tasks need not be pickled. Left
        out, "fork" where it is safe.
    `most_deaths`: Of the processes of one task, before it is given up.
    """

    def __init__(self, workers: int | None, method: str | None = None, most_deaths: int = 100) -> None:
        self.workers = workers or os.cpu_count() or 1
        usual = "fork" if sys.platform == "linux" else "spawn"
        self._context: Any = multiprocessing.get_context(method or usual)
        self._most_deaths = most_deaths
        self._waiting: deque[tuple[int, Callable[..., Any], tuple[Any, ...]]] = deque()
        self._running: dict[int, _Child] = {}
        self._results: dict[int, tuple[bool, Any]] = {}
        self._deaths: dict[int, int] = {}
        self._count = 0

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        self._count += 1
        self._waiting.append((self._count, function, arguments))
        self._begin_more()
        return self._count

    def done_of(self, handles: Collection[Any]) -> set[Any]:
        while not (done := {handle for handle in handles if handle in self._results}):
            ends = [end for child in self._running.values() for end in (child.pipe, child.process.sentinel)]
            ready = set(connection.wait(ends))
            for number, child in list(self._running.items()):
                if child.pipe in ready or child.process.sentinel in ready:
                    self._end(number, child)
            self._begin_more()
        return done

    def result(self, handle: Any) -> Any:
        is_good, value = self._results.pop(handle)
        if is_good:
            return value
        raise value

    def close(self) -> None:
        self._waiting.clear()
        for child in self._running.values():
            child.process.kill()
            child.process.join()
        self._running.clear()

    def _begin_more(self) -> None:
        while self._waiting and len(self._running) < self.workers:
            number, function, arguments = self._waiting.popleft()
            ours, theirs = self._context.Pipe(duplex=False)
            process = self._context.Process(target=_serve, args=(theirs, function, arguments), daemon=True)
            try:
                process.start()
            except (pickle.PicklingError, AttributeError, TypeError) as error:
                raise ValueError(
                    f"engine = 'processes': {error}: must be a path, or a function of a module; or take "
                    "engine = 'local'"
                ) from error
            theirs.close()
            self._running[number] = _Child(process, ours, function, arguments)

    def _end(self, number: int, child: _Child) -> None:
        """Take the result of a process, or begin its task again."""
        del self._running[number]
        try:
            self._results[number] = child.pipe.recv()
        except EOFError:
            child.process.join()
            self._deaths[number] = self._deaths.get(number, 0) + 1
            if self._deaths[number] < self._most_deaths:
                self._waiting.appendleft((number, child.function, child.arguments))
            else:
                code = child.process.exitcode
                how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit status {code}"
                times = f"{self._most_deaths} times, last " if self._most_deaths > 1 else ""
                self._results[number] = False, RuntimeError(f"a task's process ended {times}{how}")
        child.pipe.close()
        child.process.join()


@dataclass
class _Child:
    """A process with its task."""

    process: Any
    pipe: Any
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


def _serve(pipe: Any, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Do a task in a process of its own, which ends with the one that began it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # The other one ends this.
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        answer = True, function(*arguments)
    except BaseException as error:
        answer = False, error
    try:
        pipe.send(answer)
    except (pickle.PicklingError, TypeError, AttributeError):
        pipe.send((False, RuntimeError(f"{type(answer[1]).__name__}: {answer[1]}")))
    pipe.close()
    os._exit(0)  # What the other process has open is not to be flushed here.


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
