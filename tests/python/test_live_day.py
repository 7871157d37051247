# SPDX-License-Identifier: BSD-3-Clause
"""A day on the robot, compressed: whatever goes wrong, each scan is counted, and memory stays bounded."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("scipy")
pytest.importorskip("typer")

from calling import cli
from conftest import there
from day import FAULTS, ODD, Day, looped

import ndtree
from ndtree.live import LiveMapper, MessagesIntake, Window, play
from ndtree.tuning.config import Config

#: What has to be given so that what is decided of the first seconds is what a whole recording says.
GIVEN = {"range_sigma": 0.02, "min_cell_size": 0.1}
READING = {"sweep": "stamp"}
SECONDS, OFTEN = 60.0, 20.0
OTHERS = [fault for fault in (*FAULTS, *ODD) if fault != "back"]
BENCH = Path(__file__).parents[2] / "tools/bench/live_day.py"


@cache
def lived_with_faults(seed: int) -> tuple[LiveMapper, int]:
    """What becomes of a minute with all faults but clocks that jump back, and how many scans it has."""
    day = Day(seed, OTHERS, OFTEN)
    return lived(day.messages(SECONDS)), day.scans


def lived(messages: Any, **options: Any) -> LiveMapper:
    """What becomes of messages that are given as fast as they are mapped."""
    intake = MessagesIntake("day", Config.of(**GIVEN, **READING, no_return="free"))
    with LiveMapper(intake, **options) as mapper:
        play(((raw, 1e-9 * raw.received) for raw in messages), mapper, rate=0)
    figures = mapper.figures
    assert figures.received == figures.mapped + figures.dropped + sum(figures.left_out.values())
    assert figures.waiting == 0 and not mapper.failures
    return mapper


def mapped(bag: Path) -> Any:
    """The map of `ndtree map`, and its counts."""
    target, counts = bag.parent / "map.ndt", bag.parent / "map.json"
    words = ["--range-sigma", 0.02, "--min-cell-size", 0.1, "--no-return", "free", "--sweep", "stamp"]
    done = cli("map", bag, "-o", target, "--keep-going", "--json", counts, *words)
    assert done.exit_code == 0, done.stderr
    return ndtree.load(target), json.loads(counts.read_text())


@pytest.mark.parametrize("seed", range(6))
def test_the_map_is_that_of_the_recording_in_spite_of_faults(seed: int, tmp_path: Path) -> None:
    """Sensors that stop and come back, NaN, clocks that jump ahead, tf lost or late, damaged messages, others
    in an unknown frame, two publishers on one topic."""
    mapper, scans = lived_with_faults(seed)
    m, counts = mapped(Day(seed, OTHERS, OFTEN).write(tmp_path / "day", SECONDS))
    figures = mapper.figures
    assert figures.received == scans > 90 and figures.is_complete
    assert figures.mapped == counts["scans"] > 0.2 * scans
    assert mapper.snapshot().to_bytes() == m.to_bytes()


def test_each_fault_is_there() -> None:
    seen = dict.fromkeys(("damaged messages", "messages in other frames", "no pose in time"), 0)
    for seed in range(6):
        for kind, count in lived_with_faults(seed)[0].figures.left_out.items():
            seen[kind] = seen.get(kind, 0) + count
    assert all(seen.values()), seen


@pytest.mark.parametrize("seed", range(2))
def test_a_clock_that_jumps_back_loses_a_second_of_scans_and_counts_them(seed: int, tmp_path: Path) -> None:
    faults = ["back", "nan"]
    mapper = lived(Day(seed, faults, 10 * OFTEN).messages(SECONDS))
    m, counts = mapped(Day(seed, faults, 10 * OFTEN).write(tmp_path / "day", SECONDS))
    jumps = mapper.intake._follower.fallen  # type: ignore[attr-defined]
    assert jumps >= 3
    # A recording knows from its end what jumped; here the first six poses of a new clock are waited for.
    assert abs(mapper.figures.mapped - counts["scans"]) <= 20 * jumps
    points = np.random.default_rng(seed).uniform(*m.bounds(), (20000, 2))
    one, other = mapper.snapshot().state(points), m.state(points)
    both = (one >= 0) & (other >= 0)  # Nothing is where it is not.
    assert np.count_nonzero(both) > 1000 and np.mean(one[both] == other[both]) > 0.98


def test_a_frame_that_nothing_connects_ends_nothing_and_holds_nobody_up() -> None:
    """Messages of a second publisher whose frame is known to none, from the third second on."""
    day = Day(0, [])
    messages = list(day.messages(20.0))
    late = messages[0].received + 3 * 10**9
    odd = [raw for raw in Day(1, ["nowhere"]).messages(20.0) if raw.connection.topic == "/scan"]
    odd = [raw for raw in odd if b"nowhere" in raw.data and raw.received > late][:3]
    assert odd
    mapper = lived(sorted([*messages, *odd], key=lambda raw: raw.received))
    assert mapper.figures.left_out["messages in other frames"] == len(odd)
    alone = lived(messages)
    assert mapper.snapshot().to_bytes() == alone.snapshot().to_bytes()


def test_a_short_queue_counts_what_it_drops() -> None:
    day = Day(3, OTHERS, OFTEN)
    intake = MessagesIntake("day", Config.of(**GIVEN, **READING, no_return="free"))
    with LiveMapper(intake, queue=3) as mapper:
        for raw in day.messages(SECONDS):
            mapper.put(raw, 1e-9 * raw.received)  # Not waiting for anything.
    figures = mapper.figures
    assert figures.received == day.scans
    assert figures.received == figures.mapped + figures.dropped + sum(figures.left_out.values())


def benched(*words: str) -> Any:
    """What a long run says, in which nothing was lost and memory was bounded."""
    done = subprocess.run([sys.executable, str(BENCH), *words, "--json"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["received"] == said["mapped"] + said["dropped"] + said["left out"]
    assert said["resident [MiB]"][-1] - said["resident [MiB]"][1] < 12, said
    return said


@pytest.mark.long
def test_memory_is_bounded_over_hours() -> None:
    """Six minutes of the office here; `tools/bench/live_day.py` plays as many hours as one likes."""
    said = benched("--hours", "0.1")
    assert said["received"] > 4500 and said["map [MiB]"] < 5


@pytest.mark.long
def test_memory_is_bounded_over_a_real_bag_in_a_loop(recordings: Path) -> None:
    bag = there(recordings / "bags/ros1_scan_tf_turtlebot_kinect/test_turtlebot.bag")
    assert benched("--hours", "0.03", "--bag", str(bag))["received"] > 2500


def test_a_bag_in_a_loop_is_mapped_as_if_recorded_so(recordings: Path) -> None:
    bag = there(recordings / "bags/ros2_scan_tf_odom_mac_take_2")
    once, thrice = (list(looped(bag, rounds)) for rounds in (1, 3))
    assert len(thrice) == 3 * len(once)
    one, other = lived(once, window=Window(30.0)), lived(thrice, window=Window(30.0))
    assert 0 <= 3 * one.figures.mapped - other.figures.mapped <= 40
