# SPDX-License-Identifier: BSD-3-Clause
"""What runs tasks: processes of this machine, threads of this process, Ray or Dask."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import warnings
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass
from multiprocessing import connection
from typing import Any

ENGINES = ("processes", "local", "ray", "dask")
_MOST_DEATHS = 100  # Of the processes of one task, before it is given up.
_MISSING = "engine = {0!r}: {0} is not installed: pip install 'ndtree-mapping[{0}]'"


class Engine(ABC):
    """Runs functions somewhere.

    Attributes
    ----------
    workers : int
        How many run at once.
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


class LocalEngine(Engine):
    """Threads of this process; insertion leaves the interpreter's lock to others."""

    def __init__(self, workers: int | None) -> None:
        self.workers = workers or os.cpu_count() or 1
        self._pool = concurrent.futures.ThreadPoolExecutor(self.workers)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return self._pool.submit(function, *arguments)

    def done_of(self, handles: Collection[Any]) -> set[Any]:
        first = concurrent.futures.FIRST_COMPLETED
        return set(concurrent.futures.wait(handles, return_when=first).done)

    def result(self, handle: Any) -> Any:
        return handle.result()

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)


class ProcessEngine(Engine):
    """A process for each task, as many at a time as there are workers; one that dies is begun again.

    Where processes can be forked safely, tasks need not be pickled.
    """

    def __init__(self, workers: int | None) -> None:
        self.workers = workers or os.cpu_count() or 1
        self._context: Any = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")
        self._waiting: deque[tuple[int, Callable[..., Any], tuple[Any, ...]]] = deque()
        self._running: dict[int, _Child] = {}
        self._results: dict[int, tuple[bool, Any]] = {}
        self._deaths: dict[int, int] = {}
        self._count = 0

    @property
    def pids(self) -> list[int]:
        """Of the processes that run now."""
        return [child.process.pid for child in list(self._running.values())]

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
            with warnings.catch_warnings():  # Of forks beside threads: children use none of these.
                warnings.simplefilter("ignore", DeprecationWarning)
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
            if self._deaths[number] < _MOST_DEATHS:
                self._waiting.appendleft((number, child.function, child.arguments))
            else:
                code = child.process.exitcode
                error = RuntimeError(
                    f"a task's process ended {_MOST_DEATHS} times, last with exit status {code}"
                )
                self._results[number] = False, error
        child.pipe.close()
        child.process.join()


class RayEngine(Engine):
    """Ray: the cluster that this process has joined, or else workers on this machine."""

    def __init__(self, workers: int | None) -> None:
        try:
            import ray
        except ImportError:
            raise ImportError(_MISSING.format("ray")) from None
        self._ray: Any = ray
        self._is_ours = not ray.is_initialized()
        if self._is_ours:
            # Scans and tiles go through the map's folder: there is next to nothing in Ray's store.
            ray.init(
                num_cpus=workers,
                include_dashboard=False,
                object_store_memory=200_000_000,
                log_to_driver=False,
                configure_logging=False,
            )
        self.workers = workers or int(ray.cluster_resources().get("CPU", 1))
        self._remote = ray.remote(num_cpus=1, max_retries=-1)(_call)
        if self._is_ours:  # A worker's process begins with its first task.
            ray.get([self._remote.remote(_import_tasks, ()) for _ in range(self.workers)])

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return self._remote.remote(function, arguments)

    def done_of(self, handles: Collection[Any]) -> set[Any]:
        done, _ = self._ray.wait(list(handles), num_returns=1)
        return set(done)

    def result(self, handle: Any) -> Any:
        try:
            return self._ray.get(handle)
        except self._ray.exceptions.RayTaskError as error:
            raise error.cause from None

    def close(self) -> None:
        if self._is_ours:
            self._ray.shutdown()


class DaskEngine(Engine):
    """Dask: the client that this process has, or else processes on this machine."""

    def __init__(self, workers: int | None) -> None:
        try:
            import dask
            import distributed
        except ImportError:
            raise ImportError(_MISSING.format("dask")) from None
        self._wait: Any = distributed.wait
        try:
            self._client: Any = distributed.get_client()
            self._is_ours = False
        except ValueError:
            settings = {"distributed.scheduler.allowed-failures": 1_000}
            # Dask's own choice gives memory back at once: each scan's arrays would be paged in anew.
            for name in ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"):
                settings[f"distributed.nanny.pre-spawn-environ.{name}"] = 1 << 25
            with dask.config.set(settings):
                self._client = distributed.Client(
                    n_workers=workers or os.cpu_count(), threads_per_worker=1, dashboard_address=None
                )
            self._is_ours = True
        self.workers = workers or sum(self._client.nthreads().values())

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return self._client.submit(function, *arguments, pure=False)

    def done_of(self, handles: Collection[Any]) -> set[Any]:
        return set(self._wait(list(handles), return_when="FIRST_COMPLETED").done)

    def result(self, handle: Any) -> Any:
        return handle.result()

    def close(self) -> None:
        if self._is_ours:
            self._client.close()
            self._client.cluster.close()


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


def _call(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    return function(*arguments)


def _import_tasks() -> None:
    """Load what tasks need."""
    import ndtree.distributed.stages  # noqa: F401


def engine_of(engine: str | Engine, workers: int | None) -> Engine:
    """The engine of a name; an engine is itself.

    Raises ValueError if there is none of the name, or the number of workers is not at least 1; ImportError if
    it is not installed; it names the extra.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}: must be >= 1")
    if isinstance(engine, Engine):
        return engine
    kinds = {"processes": ProcessEngine, "local": LocalEngine, "ray": RayEngine, "dask": DaskEngine}
    made = kinds.get(engine)
    if made is None:
        raise ValueError(f"engine = {engine!r}: must be one of {', '.join(ENGINES)}")
    return made(workers)
