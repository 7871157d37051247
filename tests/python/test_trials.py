# SPDX-License-Identifier: BSD-3-Clause
"""Trials in random worlds: their own ray casting is right, their judges notice, and nothing new is wrong."""

from __future__ import annotations

import json
import runpy
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("typer")

TOOLS = Path(__file__).resolve().parents[2] / "tools"
if not (TOOLS / "trials").exists():
    pytest.skip("the tools are not beside the tests", allow_module_level=True)
sys.path.insert(0, str(TOOLS))

import ndtree
from ndtree.tuning import first_look
from trial import moving, planning, worlds
from trial.capabilities import CAPABILITIES, Trial
from trial.maps import Truth, judge_map, mapped
from trial.outcome import DOUBTED, RIGHT, WRONG, Outcome, limit
from trial.robots import laser, matrices, record
from trial.scene import Scene
from trial.table import Done, new_in, table_of

COMMITTED = json.loads((TOOLS / "trials_table.json").read_text())


def scene_of_all(rng: np.random.Generator) -> Scene:
    """Turned boxes and posts, far from the origin."""
    scene = Scene(3)
    for _ in range(6):
        low = rng.uniform(-4, 4, 3)
        scene.block(low, low + rng.uniform(0.2, 2, 3), yaw=rng.uniform(0, 3))
        scene.cylinders.append((*rng.uniform(-4, 4, 2), rng.uniform(0.05, 0.5), -1.0, rng.uniform(0, 3)))
    return scene.moved(rng.uniform(-3, 3), rng.uniform(-20, 20, 2))


@pytest.mark.parametrize("seed", range(5))
def test_rays_end_where_the_first_solid_begins(seed: int) -> None:
    """Oracle: small steps along each ray, with `is_inside`."""
    rng = np.random.default_rng(seed)
    scene = scene_of_all(rng)
    directions = rng.normal(size=(400, 3)) * [1, 1, 0.3]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    origin = np.array([scene.cylinders[0][0] + 8.0, scene.cylinders[0][1], 0.5])
    assert not scene.is_inside(origin).any()
    found = scene.cast(origin, directions)
    for direction, distance in zip(directions, found):
        before = np.arange(0.005, min(distance, 16.0) - 1e-6, 0.01)
        assert not scene.is_inside(origin + before[:, None] * direction).any()
    met = np.isfinite(found)
    assert scene.is_inside(origin + (found[met, None] + 1e-6) * directions[met]).all() and met.sum() > 5


def test_a_planar_ray_meets_the_nearest_of_segments_and_circles() -> None:
    rng = np.random.default_rng(1)
    scene = Scene(2, circles=[(3.0, 0.4, 0.5)])
    scene.room(-5, -4, 6, 3)
    around = rng.uniform(-np.pi, np.pi, 500)
    directions = np.c_[np.cos(around), np.sin(around)]
    found = scene.cast(np.zeros(2), directions)
    ends = directions * found[:, None]
    x, y = ends.T
    on_wall = np.min(np.abs([x + 5, x - 6, y + 4, y - 3]), axis=0) < 1e-9
    on_post = np.abs(np.hypot(ends[:, 0] - 3, ends[:, 1] - 0.4) - 0.5) < 1e-9
    assert (on_wall | on_post).all() and on_post.sum() > 10
    moved = scene.moved(0.7, np.array([2.0, 1.0]))
    assert np.allclose(moved.cast([2.0, 1.0], _turned(directions, 0.7)), found)


def _turned(points: np.ndarray, by: float) -> np.ndarray:
    c, s = np.cos(by), np.sin(by)
    return points @ np.array([[c, s], [-s, c]])


class Simulated(Scene):
    """The library's simulated office, as a scene."""

    def __init__(self, log: object) -> None:
        super().__init__(2)
        self.log = log

    def cast(self, origins, directions, rng=None):  # type: ignore[no-untyped-def]
        directions = np.atleast_2d(directions)
        origins = np.broadcast_to(np.asarray(origins, float), directions.shape)
        found = np.asarray(self.log.distance(origins, directions, max_range=40.0))
        return np.where(np.isnan(found), np.inf, found)


@pytest.mark.parametrize("seed", range(3))
def test_judges_agree_with_the_simulated_office(seed: int) -> None:
    """Its ray casting is another one, and its robot's poses are its own: equal cells map it rightly."""
    log, rng = ndtree.simulate("office", scans=40, seed=seed), np.random.default_rng(seed)
    xy = np.array([scan.origin for scan in log])
    r = record(Simulated(log), laser(rng, beams=360, view=360), matrices(xy, np.zeros(len(xy))), rng)
    world = worlds.World(Simulated(log), xy)
    outcome = Outcome()
    judge_map(mapped(r, 0.05, is_fixed=True), Truth(world, r, 0.05, rng), outcome)
    assert outcome.verdict == RIGHT, str(outcome)
    assert {"free but hidden", "seen but unknown", "false occupied"} <= outcome.figures.keys()


def test_worlds_are_drawn_by_the_seed_alone() -> None:
    first, again = (Trial.of("map", 8).run()[0] for _ in range(2))
    assert np.array_equal(first.ranges, again.ranges)
    assert not np.array_equal(first.ranges, Trial.of("map", 24, "furniture").run()[0].ranges)


def test_each_row_is_tried_by_the_short_form() -> None:
    for name, one in CAPABILITIES.items():
        trials = [Trial.of(name, seed) for seed in one.short]
        assert {trial.world for trial in trials} == set(one.worlds)
        assert {trial.fault for trial in trials} == set(one.faults)
        pairs = {(t.world, t.fault) for t in (Trial.of(name, seed) for seed in range(1000))}
        assert len(pairs) == len(one.worlds) * len(one.faults)


@cache
def judged(change: float, claim: str) -> Outcome:
    """A room mapped by a laser, whose map is then made wrong in one way."""
    rng = np.random.default_rng(3)
    world = worlds.room(rng)
    sensor = laser(rng, beams=720, view=360)
    xy = np.linspace([1.5, 1.5], [2.5, 1.8], 20)
    r = record(world.scene, sensor, matrices(xy, np.linspace(0, 1, 20)), rng)
    m = mapped(r, 0.05)
    truth, outcome = Truth(world, r, 0.05, rng), Outcome()
    if claim == "rays that pass":
        m.clear(ndtree.Box([change, 20.0]), [3.0, 0.0, 0.0])
    elif claim == "free but hidden":
        m.mark(ndtree.Sphere(change), "free", [-0.5, 2.0, 0.0])
    elif claim == "false occupied":
        m.mark(ndtree.Sphere(change), "occupied", [2.0, 1.2, 0.0])
    elif claim == "seen but unknown":
        m.clear(ndtree.Sphere(change), [2.0, 1.2, 0.0])
    judge_map(m, truth, outcome)
    return outcome


@pytest.mark.parametrize("claim", ["rays that pass", "free but hidden", "false occupied", "seen but unknown"])
def test_judges_of_maps_notice_what_is_wrong(claim: str) -> None:
    assert judged(0.0, "").verdict == RIGHT
    broken = judged(0.4, claim)
    assert broken.verdict == WRONG and any(fault.startswith(claim) for fault in broken.faults), str(broken)


def test_a_match_that_is_too_sure_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice the error that is told is no rounding; and a hundredth of the error passes."""
    real = ndtree.Matcher.match

    def told(factor: float) -> float:
        def match(self: ndtree.Matcher, *arguments: object, **keywords: object) -> object:
            found = real(self, *arguments, **keywords)
            return SimpleNamespace(pose=found.pose, covariance=factor * np.asarray(found.covariance))

        monkeypatch.setattr(ndtree.Matcher, "match", match)
        return Trial.of("match", 2, "room").run()[1].figures["normalized error"]

    first = told(1e4)
    assert first < limit("normalized error")
    assert told(1.0) > 50 * first


def test_a_judge_that_believes_all_beams_without_return_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The row itself tries dark walls with the true one."""

    def always(scans: object) -> object:
        return SimpleNamespace(
            choice="free", share=0.5, beams=9, crossing=0.0, expected=0.0, surfaces=0, erased=0.0,
            are_judged=True, is_measured=True,
        )  # fmt: skip

    monkeypatch.setattr(first_look, "judge", always)
    assert Trial.of("no_return", 1, "room", "dark").run()[1].verdict == WRONG


@pytest.mark.parametrize(
    ("state", "fault"), [("free", "told clearance"), ("free", "through hidden"), ("occupied", "no way")]
)
def test_a_path_through_a_wall_or_none_is_noticed(monkeypatch: pytest.MonkeyPatch, state, fault) -> None:
    def marked(r: object, cell: float, branching: int = 2, is_fixed: bool = False) -> ndtree.OccupancyMap:
        m = mapped(r, cell, branching, is_fixed)
        m.mark(ndtree.Sphere(40.0), state, np.array([0.0, 0.0, 0.0]))
        return m

    monkeypatch.setattr(planning, "mapped", marked)
    outcomes = (Trial.of("plan", seed, "loop", "none").run()[1] for seed in range(4))
    assert any(one.startswith(fault) for outcome in outcomes for one in outcome.faults)


def test_a_doubt_makes_a_wrong_answer_a_doubted_one() -> None:
    outcome = Outcome()
    outcome.expect("ghosts", 50.0)
    assert outcome.verdict == WRONG
    outcome.words = ["not sure"]
    assert outcome.verdict == DOUBTED and not outcome.is_needless
    assert Outcome(words=["not sure"]).is_needless
    assert not Outcome(words=["not sure"], may_doubt=True).is_needless


def command(words: list[str], monkeypatch: pytest.MonkeyPatch) -> object:
    """The status of tools/trials."""
    monkeypatch.setattr(sys, "argv", ["trials", *words])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(TOOLS / "trials"), run_name="__main__")
    return ended.value.code


def test_the_command_draws_a_trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """A line, a picture, and a recording that the library reads."""
    monkeypatch.chdir(tmp_path)
    assert not command(["match", "--world", "room", "--seed", "3", "--picture"], monkeypatch)
    assert capsys.readouterr().out.startswith("match --world room --fault far --seed 3: ")
    assert (tmp_path / "match-room-far-3.png").stat().st_size > 10_000
    assert len(list(ndtree.read(tmp_path / "match-room-far-3.npz"))) == 40


@pytest.mark.parametrize("words", [["maps"], ["--picture"], ["map", "--fault", "jump"], ["--seeds", "9"]])
def test_the_command_refuses_what_it_cannot_do(words: list[str], monkeypatch, capsys) -> None:
    assert command(words, monkeypatch) == 2 and "expected" in capsys.readouterr().err


#: Rows of C++ alone, which tests/cpp tries in worlds of its own: each fault once.
OF_CPP = ("map", "match", "match_in_space", "moved", "plan")
#: Rows whose faults have tests of their own on a drive or two, one trial in five: test_setup_error,
#: test_mismatch, test_setup_in_space, test_align_in_space, test_rosbag_sweeps, test_live_localizing_in_space,
#: test_live, test_live_decisions and test_range_end.
OF_OWN_TESTS = (
    "setup",
    "setup_in_space",
    "poses_in_space",
    "mount",
    "align_in_space",
    "localize_in_space",
    "live",
    "live_in_space",
    "no_return_in_space",
)


@pytest.mark.parametrize("name", CAPABILITIES)
def test_nothing_is_silently_wrong_that_was_not(name: str) -> None:
    """Each world and each fault once; what is wrong today is in the committed table, with its seed."""
    if name == "align_in_space":
        pytest.importorskip("small_gicp", reason="small-gicp is missing: pip install 'ndtree-mapping[lidar]'")
    trials = [Trial.of(name, seed) for seed in CAPABILITIES[name].short]
    if name in OF_OWN_TESTS:
        trials = trials[::5]
    if name in OF_CPP:
        trials = list({trial.fault: trial for trial in trials}.values())
    done = []
    for trial in trials:
        _, outcome = trial.run()
        done.append(Done(trial, outcome.verdict, outcome.is_needless, f"{trial}: {outcome}", 0.0))
    assert COMMITTED[name]["trials"] > max(CAPABILITIES[name].short), "else nothing is compared"
    assert not new_in(table_of(done), COMMITTED)


def test_the_committed_table_counts_its_rows() -> None:
    for name in CAPABILITIES:
        entry = COMMITTED[name]
        for kind in ("worlds", "faults"):
            assert np.array_equal(np.sum(list(entry[kind].values()), axis=0), entry["counts"])
        assert sum(entry["counts"]) == entry["trials"] and len(entry["wrong"]) == entry["counts"][-1]
    assert table_of([]) == {}


@pytest.mark.parametrize(
    ("of_moving", "of_standing", "verdict"),
    [
        (0.9, 0.1, RIGHT), (0.5, 0.1, DOUBTED), (0.45, 0.1, DOUBTED), (0.2, 0.1, WRONG),
        (0.9, 0.5, DOUBTED), (0.9, 0.9, WRONG), (0.2, 0.5, WRONG),
    ],
)  # fmt: skip
def test_a_probability_of_one_half_claims_nothing(of_moving, of_standing, verdict) -> None:
    case = Trial.of("moved", 4, "room", "person").case()
    r, cell, _ = moving.recorded(case)
    outcome = Outcome()
    probability = np.where(r.moving, of_moving, of_standing)
    moving._judge_moved(probability, r, Truth(case.world, r, cell, case.rng), outcome)
    assert outcome.verdict == verdict, outcome
