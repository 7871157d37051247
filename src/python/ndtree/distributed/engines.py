# SPDX-License-Identifier: BSD-3-Clause
"""What runs tasks: processes of this machine (`ProcessEngine`), threads of this process, Ray or Dask."""

from __future__ import annotations

import concurrent.futures
import os
from collections.abc import Callable, Collection
from typing import Any

from ndtree._lazy import install_of
from ndtree.base.engines import Engine, ProcessEngine

ENGINES = ("processes", "local", "ray", "dask")
_MISSING = "engine = {0!r}: {0} is not installed: {1}"


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


class RayEngine(Engine):
    """Ray: the cluster that this process has joined, or else workers on this machine."""

    def __init__(self, workers: int | None) -> None:
        try:
            import ray
        except ImportError:
            raise ImportError(_MISSING.format("ray", install_of("ray"))) from None
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
            raise ImportError(_MISSING.format("dask", install_of("dask"))) from None
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
