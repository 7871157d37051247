# SPDX-License-Identifier: BSD-3-Clause
"""Signals and forks at any instant of a call: it has happened, or it has not, without deadlock."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ndtree

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and forks of POSIX")

Map = ndtree.OccupancyMap


class Stop(Exception):
    """What a signal's handler raises here."""


def scan(beams: int, reach: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    return np.random.default_rng(seed).uniform(-reach, reach, (beams, 2)), np.zeros(2)


def mapped(beams: int, reach: float, seed: int = 1, **options: Any) -> Map:
    m = ndtree.AdaptiveMap(dim=2, **options)
    m.insert(*scan(beams, reach, seed))
    return m


@pytest.fixture
def on_alarm() -> Any:
    """Sets what SIGALRM does; afterwards it does what it did."""
    before = signal.getsignal(signal.SIGALRM)
    yield lambda handler: signal.signal(signal.SIGALRM, handler)
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


MORE = scan(4000, 6.0, 2)
CHANGES: dict[str, Callable[[Map], Any]] = {
    "insert": lambda m: m.insert(*MORE),
    "merge": lambda m: m.merge(mapped_twice),
    "compress": lambda m: m.compress(max_loss=1e4),
    "crop": lambda m: m.crop([[-2, -2], [2, 3]]),
    "clear": lambda m: m.clear([[-2, -2], [2, 3]]),
    "mark": lambda m: m.mark(ndtree.Sphere(3.0), "free"),
}
mapped_twice = mapped(2000, 6.0, 3)


@pytest.mark.parametrize("layers", [None, {"time": "latest"}])
@pytest.mark.parametrize("name", CHANGES)
def test_what_a_signal_ends_has_not_happened(name: str, layers: Any, on_alarm: Any) -> None:
    def stop(*_: object) -> None:
        raise Stop

    on_alarm(stop)
    change = CHANGES[name]
    first = mapped(2000, 6.0, layers=layers)
    begin = first.to_bytes()
    after = first.snapshot()
    start = time.perf_counter()
    change(after)
    whole = time.perf_counter() - start
    end = after.to_bytes()
    assert begin != end
    seen = {"stopped": 0, "done": 0, "late": 0}
    for instant in np.linspace(2e-5, 1.2 * whole, 30):
        m = first.snapshot()
        stopped = done = False
        try:
            signal.setitimer(signal.ITIMER_REAL, instant)
            change(m)
            done = True
            time.sleep(0.001)
            signal.setitimer(signal.ITIMER_REAL, 0)
        except Stop:
            stopped = not done
        now = m.to_bytes()
        assert now in (begin, end)
        if not stopped:
            assert now == end
        # Where Python looks at signals next is behind the call, on the same line; that is an instant, too.
        seen["late" if stopped and now == end else "stopped" if stopped else "done"] += 1
    # All are where a call commits and then looks once more.
    assert seen["late"] <= 6, seen
    assert seen["stopped"] > 0, seen


def test_a_handler_may_ask_other_maps_and_is_told_that_it_cannot_ask_this_one(on_alarm: Any) -> None:
    m, other = mapped(2000, 6.0), mapped(100, 3.0)
    big = scan(400_000, 30.0)
    answers: list[Any] = []

    def ask(*_: object) -> None:
        answers.append(other.stats().leaves)
        other.insert(*scan(10, 1.0))
        for call in (m.stats, lambda: m.insert(*scan(10, 1.0))):
            try:
                answers.append(call())
            except RuntimeError as error:
                answers.append(str(error))

    on_alarm(ask)
    signal.setitimer(signal.ITIMER_REAL, 0.02)
    report = m.insert(*big)
    assert report.beams == 400_000
    assert len(answers) == 3 and answers[0] > 1
    for text in answers[1:]:
        assert "in use by the call that this signal's handler has interrupted" in text


def test_a_handler_may_ask_the_map_that_is_asked(on_alarm: Any) -> None:
    m = mapped(2000, 6.0)
    points = np.random.default_rng(1).uniform(-6, 6, (400_000, 2))
    answers: list[Any] = []

    def ask(*_: object) -> None:
        answers.append(m.stats().leaves)
        with pytest.raises(RuntimeError, match="in use by the call"):
            m.crop([[-1, -1], [1, 1]])

    on_alarm(ask)
    signal.setitimer(signal.ITIMER_REAL, 0.01)
    m.nearest_occupied(points)
    assert answers == [m.stats().leaves]


def child_of(work: Callable[[], bool]) -> int:
    """A forked process that ends with status 0 if `work` says that all is well."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            signal.alarm(20)  # If it waits for ever.
            status = 0 if work() else 2
        finally:
            os._exit(status)
    return child


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork.*:DeprecationWarning")
def test_a_child_can_use_a_map_that_a_thread_was_changing() -> None:
    m = ndtree.AdaptiveMap(dim=2)
    field_of = mapped(2000, 6.0)
    finished = threading.Event()

    def change() -> None:
        seed = 0
        while not finished.is_set():
            m.insert(*scan(3000, 6.0, seed := seed + 1))

    def look() -> None:
        while not finished.is_set():
            m.state(MORE[0])
            field_of.to_bytes()

    def work() -> bool:
        again = ndtree.from_bytes(m.to_bytes())
        m.insert(*MORE)
        again.insert(*MORE)
        field_of.insert(*MORE)
        return m.to_bytes() == again.to_bytes()

    threads = [threading.Thread(target=change), threading.Thread(target=look)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(8):
            time.sleep(0.01)
            assert os.waitpid(child_of(work), 0)[1] == 0
    finally:
        finished.set()
        for thread in threads:
            thread.join()


def moving() -> tuple[ndtree.ScanHistory, dict[int, Any]]:
    """A history, and poses whose change takes some tenths of a second."""
    h = ndtree.ScanHistory(dim=2)
    for key in range(4):
        h.insert(key, scan(60_000, 30.0, key)[0], (0.1 * key, 0.0, 0.0))
    return h, {key: (0.1 * key + 0.3, 0.0, 0.0) for key in range(4)}


def test_a_handler_is_told_that_it_cannot_ask_the_history_that_moves(on_alarm: Any) -> None:
    h, poses = moving()
    answers: list[str] = []

    def ask(*_: object) -> None:
        for call in (lambda: len(h), lambda: h.map, lambda: h.remove([0])):
            with pytest.raises(
                RuntimeError, match="in use by the call that this signal's handler"
            ) as refused:
                call()
            answers.append(str(refused.value))

    on_alarm(ask)
    signal.setitimer(signal.ITIMER_REAL, 0.02)
    h.move(poses)
    assert len(answers) == 3 and len(h) == 4


def test_who_waits_for_a_history_hears_signals(on_alarm: Any) -> None:
    def stop(*_: object) -> None:
        raise Stop

    h, poses = moving()
    finished = threading.Event()

    def move() -> None:
        sign = 1
        while not finished.is_set():
            h.move({key: (sign * x, y, yaw) for key, (x, y, yaw) in poses.items()})
            sign = -sign

    thread = threading.Thread(target=move)
    thread.start()
    try:
        on_alarm(stop)
        time.sleep(0.02)
        begin = time.perf_counter()
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(Stop):
            while True:
                h.remove([])
        assert time.perf_counter() - begin < 1.0
    finally:
        finished.set()
        thread.join()


class Bad:
    """An array that fails."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise self.error


class OfItsOwn(ValueError):
    """An error of an array's own."""


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), MemoryError("none"), SystemExit(3), OSError("gone"), OfItsOwn("lost")]
)
def test_what_an_array_raises_is_passed_on(error: BaseException) -> None:
    m = mapped(100, 3.0)
    grid = ndtree.from_grid
    for call in (
        lambda bad: m.insert(bad, np.zeros(2)),
        lambda bad: m.insert(np.ones((1, 2)), bad),
        lambda bad: m.insert(np.ones((1, 2)), np.zeros(2), returned=bad),
        lambda bad: m.crop(bad),
        lambda bad: m.transformed(bad),
        lambda bad: grid(bad, [0, 0], 0.1),
    ):
        with pytest.raises(type(error)) as raised:
            call(Bad(error))
        assert raised.value is error


def test_an_argument_that_is_no_array_keeps_the_cause() -> None:
    m = mapped(100, 3.0)
    with pytest.raises(TypeError, match="box: must be an array of numbers") as raised:
        m.crop([[1, 2], [3]])
    assert isinstance(raised.value.__cause__, ValueError)
    with pytest.raises(TypeError, match="box: must be an array of numbers") as raised:
        m.crop(Bad(TypeError("not now")))
    assert str(raised.value.__cause__) == "not now"


@pytest.mark.parametrize("start", [["-m", "ndtree"], ["ndtree"]])
def test_ctrl_c_while_the_command_is_imported_is_no_traceback(start: list[str], tmp_path: Any) -> None:
    site = tmp_path / "typer.py"  # Imported by the command, late: says that it is there, and waits.
    site.write_text("import sys, time\nprint('here', flush=True)\ntime.sleep(20)\n")
    script = tmp_path / "ndtree"
    script.write_text("from ndtree.cli import main\nmain()\n")
    command = [sys.executable, *(start if len(start) > 1 else [str(script)]), "info", "nothing"]
    folder = os.path.dirname(os.path.dirname(ndtree.__file__))
    path = os.pathsep.join([str(tmp_path), folder, os.environ.get("PYTHONPATH", "")])
    if len(start) == 1:
        (tmp_path / "run").mkdir()
        script = script.rename(tmp_path / "run" / "ndtree")
        command[1] = str(script)
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "here\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (130, "")


def test_a_planner_that_was_stopped_answers_as_a_new_one(on_alarm: Any) -> None:
    def stop(*_: object) -> None:
        raise Stop

    on_alarm(stop)
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05)
    m.mark([[-20.0, -20.0], [20.0, 20.0]], "free")
    for corner in np.random.default_rng(5).uniform(-19.0, 18.0, (500, 2)):
        m.mark([corner, corner + 0.4], "occupied")
    start, goal, body = np.full(2, -19.5), np.full(2, 19.5), ndtree.Sphere(0.2)
    goals = np.random.default_rng(6).uniform(-19.0, 19.0, (50, 2))
    begin = time.perf_counter()
    expected = ndtree.Planner(m, body).plan(start, goal)
    whole = time.perf_counter() - begin
    ways = ndtree.Planner(m, body).ways(start, goals)
    assert expected
    stopped = 0
    for instant in np.linspace(1e-3, 1.2 * whole, 12):
        planner = ndtree.Planner(m, body)
        try:
            signal.setitimer(signal.ITIMER_REAL, instant)
            planner.plan(start, goal)
            signal.setitimer(signal.ITIMER_REAL, 0)
        except Stop:
            stopped += 1
        np.testing.assert_array_equal(planner.plan(start, goal).points, expected.points)
        np.testing.assert_array_equal(planner.ways(start, goals), ways)
    assert stopped > 0


def test_long_calls_stop_soon(on_alarm: Any) -> None:
    """Of seconds, which each takes if it is not stopped."""

    def stop(*_: object) -> None:
        raise Stop

    on_alarm(stop)
    m, sensor = mapped(2000, 6.0), ndtree.RangeSensor.laser(max_range=20.0, beams=20_000)
    poses = np.random.default_rng(7).uniform(-5.0, 5.0, (5000, 3))
    x, y = (one.ravel() for one in np.mgrid[-3:3:0.02, -3:3:0.02])
    points = np.column_stack((x, y, 0.05 * np.sin(x)))
    for call in (
        lambda: m.information_gain(poses, sensor, threads=1),
        lambda: m.information_gain(poses, sensor, threads=3),
        lambda: ndtree.Matcher(points, cell_size=0.02, radius=0.5),
    ):
        begin = time.perf_counter()
        with pytest.raises(Stop):
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            call()
        assert time.perf_counter() - begin < 3.0
