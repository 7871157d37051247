# SPDX-License-Identifier: BSD-3-Clause
"""Logs of a fleet mapped by tasks, against one map that takes all scans in, in their order."""

import contextlib
import functools
import importlib.util
import itertools
import json
import math
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import turned

import ndtree
from ndtree import distributed
from ndtree.base import engines as base_engines
from ndtree.distributed import plan
from ndtree.distributed.blocks import FAR, Block, divided
from ndtree.distributed.engines import Engine, LocalEngine, ProcessEngine
from ndtree.distributed.scans import BatchWriter, StoredScans
from ndtree.tiles import MANIFEST, in_order, open_tiles, storage_of

SEEDS = {"ann": 1, "bob": 2, "eve": 3}


def make_map():
    return ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, max_cell_size=0.8, range_sigma=0.02)


@functools.cache
def robot(seed: int, scans: int = 24, late: float = 0.0) -> list[ndtree.Scan]:
    """One that drives through the office; its clock is that of the others."""
    return [
        ndtree.Scan(scan.endpoints, scan.origin, scan.returned, scan.stamp + late)
        for scan in ndtree.simulate("office", seed=seed, scans=scans)
    ]


def fleet(scans: int = 24):
    return {name: functools.partial(robot, seed, scans) for name, seed in SEEDS.items()}


def serial(logs, m=None, max_range=math.inf, no_return="free"):
    m = make_map() if m is None else m
    for _, scan in in_order({name: source() for name, source in logs.items()}):
        scan = scan.returned_only() if no_return == "ignore" else scan
        scan.insert_into(m, max_range=max_range)
    return m


class Unreliable(Engine):
    """One task at a time; some are done twice, some are lost half-way and done again."""

    workers = 3

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._results: dict[int, object] = {}
        self.twice = 0

    def submit(self, function, *arguments):
        result = function(*arguments)
        if self._random.random() < 0.4:
            self.twice += 1
            result = function(*arguments)
        self._results[len(self._results)] = result
        return len(self._results) - 1

    def done_of(self, handles):
        return {self._random.choice(sorted(handles))}

    def result(self, handle):
        return self._results[handle]

    def close(self):
        pass


OPTIONS = {"tile_size": 5.0, "block_beams": 2_000, "batch_beams": 2_000, "checkpoint_beams": 1_500}


def unsure(seed: int) -> list[ndtree.Scan]:
    """A robot whose poses have covariances, by which beams reach other blocks."""
    rng = np.random.default_rng(seed)
    return [
        ndtree.Scan(
            scan.endpoints, scan.origin, scan.returned, scan.stamp,
            pose_covariance=np.diag(rng.uniform(0, 0.3, 3) ** 2 * (1, 1, 0.01)),
        )
        for scan in robot(seed, 8)
    ]  # fmt: skip


def test_poses_that_are_not_sure_make_the_serial_map_too(tmp_path):
    logs = {name: functools.partial(unsure, seed) for name, seed in SEEDS.items()}
    distributed.map(logs, tmp_path / "a", workers=1, like=make_map(), max_range=8.0, **OPTIONS)
    whole = serial(logs, max_range=8.0)
    assert open_tiles(tmp_path / "a").to_map().to_bytes() == whole.to_bytes()
    sure = {name: functools.partial(robot, seed, 8) for name, seed in SEEDS.items()}
    assert whole.to_bytes() != serial(sure, max_range=8.0).to_bytes()


@pytest.mark.parametrize(
    ("engine", "workers", "block_beams", "no_return"),
    [
        ("local", 1, 10**9, "free"),
        ("local", 1, 1, "free"),
        ("local", 4, 2_000, "ignore"),
        ("processes", 2, 2_000, "free"),
    ],
)
def test_the_map_is_the_serial_one(tmp_path, engine, workers, block_beams, no_return):
    url = tmp_path / "a"
    report = distributed.map(
        fleet(), url, engine=engine, workers=workers, like=make_map(), max_range=8.0, no_return=no_return,
        **{**OPTIONS, "block_beams": block_beams},
    )  # fmt: skip
    whole = serial(fleet(), max_range=8.0, no_return=no_return)
    tiles = open_tiles(url)
    assert tiles.to_map().to_bytes() == whole.to_bytes()
    assert report.scans == 72 and report.tiles > 10 and len(report.records) == report.blocks
    assert report.blocks == 1 if block_beams == 10**9 else report.blocks > 6
    assert report.blocks >= report.tiles or block_beams > 1
    assert (report.block_beams > report.beams) == (report.blocks > 1)
    assert sum(record.weight for record in report.records) == pytest.approx(report.beams)
    assert report.written_bytes > report.scan_bytes > 16 * report.beams
    assert 0.0 <= report.idle < 1.0 and report.engine_seconds >= 0.0 and report.peak_memory > 1 << 20
    assert report.insert_seconds <= report.task_seconds and report.cpu_seconds > 0.0
    assert not (url / "run-000001" / "work").exists()


def test_tasks_that_run_twice_and_in_any_order_change_nothing(tmp_path):
    one = distributed.map(fleet(), tmp_path / "a", engine="local", workers=3, like=make_map(), **OPTIONS)
    engine = Unreliable(5)
    distributed.map(fleet(), tmp_path / "b", engine=engine, like=make_map(), **OPTIONS)
    assert engine.twice > 3 and one.blocks > 8
    for name in sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.ndt")):
        assert (tmp_path / "b" / name).read_bytes() == (tmp_path / "a" / name).read_bytes()
    assert (tmp_path / "b" / MANIFEST).read_bytes() == (tmp_path / "a" / MANIFEST).read_bytes()


class Dying(LocalEngine):
    """Raises after this many results."""

    def __init__(self, left: int) -> None:
        super().__init__(2)
        self.left = left

    def result(self, handle):
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().result(handle)


def test_a_run_that_was_stopped_goes_on(tmp_path):
    whole = serial(fleet(12))
    for left in (0, 3, 8):
        url = tmp_path / str(left)
        engine = Dying(left)
        with pytest.raises(KeyboardInterrupt):
            distributed.map(fleet(12), url, engine=engine, like=make_map(), **OPTIONS)
        engine.close()  # What runs is finished.
        assert not (url / MANIFEST).exists()
        done = [json.loads(path.read_bytes()) for path in url.rglob("work/*.json") if path.stem != "plan"]
        assert len(done) >= left - len(SEEDS)
        # With another number of workers, too: the plan is there.
        report = distributed.map(fleet(12), url, engine="local", workers=1, like=make_map(), **OPTIONS)
        assert open_tiles(url).to_map() == whole
        seconds = {record.seconds for record in report.records}
        assert {one["seconds"] for one in done} <= seconds  # What was done is not done again.
    # Another run at the same place begins anew.
    distributed.map(fleet(5), url, engine="local", like=make_map(), **OPTIONS)
    assert open_tiles(url).to_map() == serial(fleet(5))
    assert {path.name for path in url.iterdir()} == {MANIFEST, "tiles", "run-000002"}


def test_workers_that_are_killed_begin_at_the_last_state(tmp_path):
    random = np.random.default_rng(8)
    print("seed 8")
    url, engine, kills = tmp_path / "a", ProcessEngine(2), 0
    over = threading.Event()

    def kill() -> None:
        nonlocal kills
        while not over.wait(0.002) and kills < 10:
            pids = [child.process.pid for child in list(engine._running.values())]
            if pids and list(url.rglob("work/*.ndt")):
                with contextlib.suppress(ProcessLookupError):  # It has just ended.
                    os.kill(int(random.choice(pids)), signal.SIGKILL)
                    kills += 1
                over.wait(random.uniform(0.0, 0.1))

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        options = {**OPTIONS, "checkpoint_beams": 200}
        report = distributed.map(fleet(), url, engine=engine, like=make_map(), **options)
    finally:
        over.set()
        thread.join()
        engine.close()
    assert kills == 10
    assert any(record.resumed for record in report.records)
    assert open_tiles(url).to_map().to_bytes() == serial(fleet()).to_bytes()
    assert not (url / "run-000001" / "work").exists()


def test_a_task_that_always_kills_its_process_is_given_up():
    engine = ProcessEngine(2, most_deaths=3)
    try:
        dead, good, wrong = (
            engine.submit(os._exit, 7),
            engine.submit(math.sqrt, 4.0),
            engine.submit(math.sqrt, -1.0),
        )
        left = {dead, good, wrong}
        while left:
            left -= engine.done_of(left)
        assert engine.result(good) == 2.0
        with pytest.raises(ValueError, match="math domain error"):
            engine.result(wrong)
        with pytest.raises(RuntimeError, match="a task's process ended 3 times, last with exit status 7"):
            engine.result(dead)
    finally:
        engine.close()


def test_processes_that_are_not_forked_need_functions_of_modules(tmp_path, monkeypatch):
    spawned = multiprocessing.get_context("spawn")
    monkeypatch.setattr(base_engines.multiprocessing, "get_context", lambda kind: spawned)
    with pytest.raises(ValueError, match=r"engine = 'processes': .*must be a path, or a function"):
        distributed.map({"a": lambda: robot(1, 2)}, tmp_path / "a", like=make_map(), **OPTIONS)
    engine = ProcessEngine(1)
    try:
        handle = engine.submit(math.sqrt, 4.0)
        assert engine.done_of({handle}) == {handle} and engine.result(handle) == 2.0
    finally:
        engine.close()


def test_blocks_fill_space_and_weigh_about_the_same():
    random = np.random.default_rng(3)
    print("seed 3")
    cases = 0
    for dim in (2, 3):
        for parts in (1, 2, 3, 7, 16):
            tiles = np.unique(
                random.normal(0.0, [30.0, *[5.0] * (dim - 1)], (2_000, dim)).astype(int), axis=0
            )
            weights = {tuple(tile): float(random.uniform(0.5, 1.5)) for tile in tiles.tolist()}
            blocks = divided(Block.everywhere(dim), weights, parts)
            assert len(blocks) == parts
            homes = [[tile in block for block in blocks].index(True) for tile in weights]
            assert all(sum(tile in block for block in blocks) == 1 for tile in weights)
            load = np.bincount(homes, list(weights.values()))
            assert load.max() < 1.5 * load.mean()
            # Each corner of space is in one of them, too.
            for corner in itertools.product((-FAR, FAR - 1), repeat=dim):
                assert sum(corner in block for block in blocks) == 1
                cases += 1
    assert cases == 60
    assert divided(Block.everywhere(2), {(3, 4): 1.0}, 5) == [Block.everywhere(2)]  # A tile stays whole.
    assert len(divided(Block.everywhere(2), {(3, 4): 1.0, (3, 5): 1e-9}, 5)) == 2


def test_blocks_have_no_more_tiles_than_fit_into_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(plan, "MOST_TILES", 20)
    options = {**OPTIONS, "block_beams": 10**9}
    report = distributed.map(fleet(12), tmp_path / "a", engine="local", workers=1, like=make_map(), **options)
    assert report.blocks > 3 and all(len(record.entries) <= 20 for record in report.records)
    assert open_tiles(tmp_path / "a").to_map().to_bytes() == serial(fleet(12)).to_bytes()


def test_scans_come_back_as_they_were_stored(tmp_path):
    """Of any types, with and without what is optional, with one origin or many."""
    random = np.random.default_rng(2)
    print("seed 2")
    scans = []
    for i in range(60):
        n = int(random.integers(0, 50))
        kind = [np.float32, np.float64][random.integers(2)]
        origin = random.normal(size=(n, 2) if random.random() < 0.3 else 2).astype(kind)
        returned = random.random(n) < 0.5 if random.random() < 0.5 else None
        sigma = random.uniform(0.01, 0.1, n).astype(np.float32) if random.random() < 0.5 else None
        scans += [ndtree.Scan(random.normal(size=(n, 2)).astype(kind), origin, returned, i, sigma)] * 2
    storage, places = storage_of(tmp_path), []
    writer = BatchWriter(storage, "run", "a/b", 80)
    for scan in scans:
        places.append(writer.add(scan))
    writer.store()
    assert len({batch for batch, *_ in places}) > 30 and max(at for _, at, *_ in places) > 0
    stored = StoredScans(storage, "run", {})
    for i in random.permutation(len(scans)).tolist():
        scan, found = scans[i], stored.get("a/b", i, places[i])
        for name in ("endpoints", "origin", "returned", "range_sigma"):
            was, now = getattr(scan, name), getattr(found, name)
            assert (was is None) == (now is None)
            if was is not None:
                assert was.dtype == now.dtype
                np.testing.assert_array_equal(was, now)


def test_new_poses_map_what_they_touch_anew(tmp_path):
    url = tmp_path / "a"
    first = distributed.map(fleet(), url, engine="local", like=make_map(), **OPTIONS)
    untouched = open_tiles(url).manifest.tiles
    poses = {"bob": {3: turned(2, 0.01, (0.05, -0.1)), 4: turned(2, 0.02, (0.1, -0.1))}}
    for more in ({}, {"ann": {0: turned(2, 0.5, (-30.0, 40.0))}}, {"bob": {3: np.eye(3)}}):
        poses = {log: {**poses.get(log, {}), **more.get(log, {})} for log in {**poses, **more}}
        report = distributed.remap(url, poses, engine="local")
        logs = {
            name: functools.partial(
                lambda seed, of: [
                    distributed.moved(scan, of[i]) if i in of else scan for i, scan in enumerate(robot(seed))
                ],
                seed,
                poses.get(name, {}),
            )
            for name, seed in SEEDS.items()
        }
        assert open_tiles(url).to_map().to_bytes() == serial(logs).to_bytes()
        assert 0 < report.tiles < first.tiles or "ann" in more
    kept = [tile for tile, entry in open_tiles(url).manifest.tiles.items() if untouched.get(tile) == entry]
    assert kept
    assert distributed.remap(url, poses, engine="local").blocks == 0
    for wrong, said in (
        ({"joe": {}}, "log 'joe': must be one of ann, bob, eve"),
        ({"bob": {24: np.eye(3)}}, "log 'bob': scan 24: there are 24"),
        ({"bob": {1: np.eye(4)}}, r"scan 1: pose has shape \(4, 4\): must be \(3, 3\)"),
        ({"bob": {1: 2 * np.eye(3)}}, "scan 1: pose: its rotation is not one"),
    ):
        with pytest.raises(ValueError, match=said):
            distributed.remap(url, wrong, engine="local")


def test_sessions_of_other_days_follow_each_other(tmp_path):
    logs = {
        "monday": functools.partial(robot, 1, 15),
        "tuesday": functools.partial(robot, 1, 15, 86_400.0),
        "a late one": functools.partial(robot, 2, 15, 2 * 86_400.0),
    }
    distributed.map(logs, tmp_path / "a", engine="local", like=make_map(), **OPTIONS)
    m = make_map()
    for name in ("monday", "tuesday", "a late one"):
        for scan in logs[name]():
            scan.insert_into(m)
    assert open_tiles(tmp_path / "a").to_map() == m


def test_scans_that_no_map_takes_are_left_out(tmp_path):
    scans = robot(1, 10)
    far = ndtree.Scan(np.array([[1e9, 0.0]]), np.zeros(2))
    logs = {"a": lambda: [*scans[:5], far, *scans[5:]]}
    report = distributed.map(logs, tmp_path / "a", engine="local", like=make_map(), **OPTIONS)
    assert report.refused == 1 and report.scans == 10
    assert open_tiles(tmp_path / "a").to_map() == serial({"a": lambda: scans})


def test_wrong_calls_are_refused_in_one_line(tmp_path):
    def refusal(logs=None, url=tmp_path / "a", **options):
        with pytest.raises((TypeError, ValueError, OSError, ImportError)) as error:
            distributed.map(fleet() if logs is None else logs, url, **{"engine": "local", **options})
        assert "\n" not in str(error.value)
        return str(error.value)

    assert refusal({}) == "no logs: must be at least one"
    assert refusal(engine="spark") == "engine = 'spark': must be one of processes, local, ray, dask"
    assert refusal(tile_sizes=1).startswith("map(): no argument tile_sizes, expected tile_size, max_range")
    assert refusal(workers=0) == "workers = 0: must be >= 1"
    assert refusal(block_beams=0) == "block_beams = 0: must be >= 1"
    assert refusal(no_return="auto") == "no_return = 'auto': must be 'free' or 'ignore'"
    assert refusal(["x/a.log", "y/a.log"]).startswith("y/a.log: another log is called a.log")
    assert "no scans, expected at least one" in refusal({"a": lambda: iter(())}, like=make_map())
    assert "2-D, and the map 3-D" in refusal(like=ndtree.AdaptiveMap(dim=3))


needs_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed: pip install 'ndtree-mapping[ray]'"
)
needs_dask = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="Dask is not installed: pip install 'ndtree-mapping[dask]'",
)

CHILD = """
import sys
sys.path.insert(0, sys.argv[4])
from ndtree import distributed
from test_distributed import OPTIONS, fleet, make_map
workers = int(sys.argv[3])
distributed.map(fleet(), sys.argv[1], engine=sys.argv[2], workers=workers, like=make_map(), **OPTIONS)
"""


def run_child(url, engine: str, workers: int) -> subprocess.Popen:
    here = os.path.dirname(__file__)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([here, os.environ.get("PYTHONPATH", "")])}
    return subprocess.Popen(
        [sys.executable, "-c", CHILD, str(url), engine, str(workers), here], env=environment
    )


def test_the_demo_ends_with_a_table_and_a_picture(tmp_path):
    demo = Path(__file__).resolve().parents[2] / "tools" / "fleet-demo"
    call = [sys.executable, demo, "--engine", "local", "--scans", "3", "-o", tmp_path]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.search(r"the same map, byte for byte +yes", done.stdout)
    assert (tmp_path / "street.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
@pytest.mark.parametrize(
    "engine", [pytest.param("ray", marks=needs_ray), pytest.param("dask", marks=needs_dask)]
)
def test_engines_make_the_serial_map(tmp_path, engine):
    for workers in (1, 2):
        url = tmp_path / str(workers)
        assert run_child(url, engine, workers).wait(timeout=300) == 0
        assert open_tiles(url).to_map() == serial(fleet())


def test_a_run_killed_at_any_time_goes_on(tmp_path):
    random = np.random.default_rng(6)
    print("seed 6")
    kills = 0
    while True:
        child = run_child(tmp_path / "a", "processes", 2)
        begun = time.monotonic()
        while kills < 3 and child.poll() is None:
            work = list((tmp_path / "a").rglob("work/*"))
            if len(work) > 8 * kills or time.monotonic() - begun > 60:
                time.sleep(random.uniform(0.0, 0.05))
                break
            time.sleep(0.005)
        if kills < 3 and child.poll() is None:
            os.kill(child.pid, signal.SIGKILL)
            kills += 1
        if child.wait() == 0:
            break
    assert kills
    assert open_tiles(tmp_path / "a").to_map() == serial(fleet())
