# SPDX-License-Identifier: BSD-3-Clause
"""What is decided of a log is a value, and a file that maps the same robot in the same way."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calling import cli
from test_live_decisions import robot

import ndtree
from ndtree.live.ros.parameters import ROWS, config_of
from ndtree.logs.core.joined import JoinedLog
from ndtree.logs.core.log import SizedLog
from ndtree.logs.core.rules import GIVEN, MEASURED, USUAL
from ndtree.logs.ros.reading import MessageReader
from ndtree.study.config import load
from ndtree.study.run import jobs_of, opened
from ndtree.tuning.config import Config
from ndtree.tuning.inspection import inspect


def run(*arguments: object) -> Any:
    done = cli(*arguments)
    assert done.exit_code == 0, done.output
    return done


def carmen(path: Path, limit: float = 20.0) -> Path:
    """A laser in a hall that is longer than it sees: what it does not reach is at its limit, and 0 a few."""
    generator = np.random.default_rng(3)
    angle = -np.pi / 2 + np.arange(180) * np.pi / 180
    lines = []
    for i in range(60):
        with np.errstate(divide="ignore"):
            ranges = np.abs(2 / np.sin(angle)) + generator.normal(0, 0.01, 180)
        ranges = np.where(ranges < limit, ranges, limit)
        ranges[generator.random(180) < 0.02] = 0
        text = " ".join(f"{one:.2f}" for one in ranges)
        lines.append(f"FLASER 180 {text} {0.05 * i:.3f} 0 0 {0.05 * i:.3f} 0 0 {i} host {i}\n")
    path.write_text("".join(lines))
    return path


@pytest.fixture(params=["bag", "carmen", "npz"])
def log(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == "npz":
        ndtree.simulate("office", scans=40).save(tmp_path / "a.npz")
        return tmp_path / "a.npz"
    return carmen(tmp_path / "a.log") if request.param == "carmen" else robot(tmp_path, "mcap", stands=1.0)


def test_a_file_of_what_was_decided_makes_the_same_map(log: Path, tmp_path: Path) -> None:
    first, again, file = tmp_path / "first.ndt", tmp_path / "again.ndt", tmp_path / "robot.toml"
    chosen = run("map", log, "-o", first, "--write-config", file)
    assert "chosen:" in chosen.output
    said = run("map", log, "-o", again, "--config", file)
    assert first.read_bytes() == again.read_bytes()
    assert "chosen:" not in said.output, "nothing was left to look for"
    looked = tmp_path / "looked.toml"
    run("info", log, "--write-config", looked)
    assert looked.read_text() == file.read_text()


def test_a_flag_is_worth_more_than_the_file(log: Path, tmp_path: Path) -> None:
    file, given, mixed = tmp_path / "a.toml", tmp_path / "given.ndt", tmp_path / "mixed.ndt"
    run("info", log, "--write-config", file)
    run("map", log, "-o", given, "--config", file, "--min-cell-size", "0.1", "--no-return", "free")
    config = Config.load(file).overridden(Config.of(min_cell_size=0.1, no_return="free").values)
    config.save(tmp_path / "b.toml")
    run("map", log, "-o", mixed, "--config", tmp_path / "b.toml")
    assert given.read_bytes() == mixed.read_bytes()
    assert ndtree.load(given).min_cell_size == 0.1


def test_each_value_knows_where_it_is_from(log: Path) -> None:
    config = inspect(log, Config.of(max_range=15.0))
    sources = {name: one.source for name, one in config.values.items()}
    assert sources["max_range"] == GIVEN and sources["no_return"] == MEASURED
    assert all(source in (GIVEN, MEASURED, USUAL) for source in sources.values())
    assert all(one.why for name, one in config.values.items() if one.source != GIVEN)
    text = config.toml()
    assert all(f"# {source}" in text for source in set(sources.values()))
    assert "believed_range" not in sources, "a limit was given"


def test_python_reads_and_maps_as_the_commands(log: Path, tmp_path: Path) -> None:
    written = tmp_path / "a.ndt"
    run("map", log, "-o", written)
    config = ndtree.inspect(log)
    m = ndtree.AdaptiveMap(dim=config.get("dim"), **config.options)
    for scan in config.read(log):
        config.usable(scan).insert_into(m, max_range=config.max_range)
    assert m.to_bytes() == ndtree.load(written).to_bytes()


def test_looking_changes_no_log(log: Path) -> None:
    source = ndtree.read(log)
    before = source.rules
    config = inspect(source)
    assert source.rules is before and not source.skipped
    assert config.ruled(source).rules != before


def test_a_look_decodes_a_sample_and_sees_what_all_scans_show(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = ndtree.read(robot(tmp_path, "mcap", stands=1.0, rate=0.01))
    decoded = []
    measured = MessageReader.measured
    monkeypatch.setattr(MessageReader, "measured", lambda *one: decoded.append(1) or measured(*one))
    look = ndtree.first_look(source)
    assert len(source) > 800 and len(decoded) < 0.7 * len(source)
    monkeypatch.setattr(type(source), "sampled", lambda log: log)
    whole = ndtree.first_look(source)
    assert len(decoded) > len(source) and look.scans == whole.scans
    assert look.beams == pytest.approx(whole.beams, rel=0.01)
    assert (look.options, look.no_returns, look.max_range) == (
        whole.options,
        whole.no_returns,
        whole.max_range,
    )
    for one, other in zip(look.sample, whole.sample, strict=True):
        np.testing.assert_array_equal(one.endpoints, other.endpoints)


@pytest.mark.parametrize("text, message", [
    ("[sensor]\nrange_sigma = 'x'", "sensor.range_sigma = 'x': expected a number"),
    ("[map]\ntopic = '/scan'", "map.topic = '/scan': expected no such key"),
    ("[robot]\ndim = 2", r"robot = {'dim': 2}: expected no such key, but \[log\], \[sensor\] and \[map\]"),
    ("log = 3", r"log = 3: expected a section \[log\]"),
    ("[map", "expected TOML"),
])  # fmt: skip
def test_a_wrong_file_is_named_with_key_and_value(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=message):
        Config.load(file)


def test_words_that_do_not_exist_are_refused() -> None:
    with pytest.raises(TypeError, match="cell: no such value, expected one of"):
        Config.of(cell=0.1)


def test_poses_that_are_given_take_the_place_of_the_files(tmp_path: Path) -> None:
    config = Config.of(fixed_frame="map", mount="0,0,0").overridden(Config.of(odometry="/odom").values)
    assert config.reading == {"mount": "0,0,0", "odometry": "/odom"}


def test_a_study_reads_a_file(log: Path, tmp_path: Path) -> None:
    inspect(log).save(tmp_path / "robot.toml")
    file = tmp_path / "study.toml"
    file.write_text(
        f"[logs.a]\npath = {json.dumps(str(log))}\nconfig = 'robot.toml'\nevery = 2\n[maps.fixed]\n"
    )
    (job,) = jobs_of(load(file))
    assert job.log.config.no_return in ("free", "ignore") and job.log.config.get("every") == 2
    assert len(list(opened(job.log))) == (len(list(ndtree.read(log))) + 1) // 2


def test_a_node_takes_a_file_and_its_own_parameters(tmp_path: Path) -> None:
    Config.of(fixed_frame="odom", max_range=12.0, range_sigma=0.02).save(tmp_path / "robot.toml")
    values = {row.key: row.start for row in ROWS}
    values |= {"config": str(tmp_path / "robot.toml"), "max_range": 8.0}
    config = config_of(values.__getitem__, {"min_cell_size": 0.1})
    assert (config.get("fixed_frame"), config.max_range) == ("odom", 8.0)
    assert config.options == {"range_sigma": 0.02, "min_cell_size": 0.1}


def test_a_fleet_takes_a_file(log: Path, tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text(
        '[log]\nevery = 2\n[sensor]\nrange_sigma = 0.03\nno_return = "ignore"\n[map]\nmin_cell_size = 0.2\n'
    )
    words = ("--config", tmp_path / "robot.toml", "--quiet")
    run("fleet", log, "-o", tmp_path / "a.tiles", "--engine", "local", "--workers", 1, *words)
    run("map", log, "-o", tmp_path / "a.ndt", *words)
    fleet, one = ndtree.open_tiles(tmp_path / "a.tiles"), ndtree.load(tmp_path / "a.ndt")
    assert fleet.min_cell_size == one.min_cell_size == 0.2
    at = np.concatenate([scan.endpoints for scan in ndtree.read(log)])
    assert np.array_equal(fleet.state(at), one.state(at)) and len(at) > 100


class Hall(SizedLog):
    """A laser in a hall of 8 by 6 m, whose ranges may tell their noise."""

    format = "hall"

    def __init__(self, sigma: float, tells: bool = False) -> None:
        super().__init__("hall", 2)
        self._sigma, self._tells = sigma, tells

    def __len__(self) -> int:
        return 20

    def _scans(self) -> Iterator[ndtree.Scan]:
        generator = np.random.default_rng(5)
        angle = np.linspace(-np.pi, np.pi, 720, endpoint=False)
        way = np.column_stack([np.cos(angle), np.sin(angle)])
        exact = np.minimum(4 / np.maximum(np.abs(way[:, 0]), 1e-9), 3 / np.maximum(np.abs(way[:, 1]), 1e-9))
        for _ in range(len(self)):
            ends = way * (exact + generator.normal(0, self._sigma, exact.shape))[:, None]
            yield ndtree.Scan(
                ends, np.zeros(2), range_sigma=np.full(720, self._sigma) if self._tells else None
            )


@pytest.mark.parametrize("sigma", [0.05, 0.08])
def test_noise_is_measured_on_a_log_of_any_kind(tmp_path: Path, sigma: float) -> None:
    Hall(sigma).save(tmp_path / "hall.npz")
    config = inspect(tmp_path / "hall.npz")
    assert config.values["range_sigma"].source == MEASURED
    assert config.options["range_sigma"] == pytest.approx(sigma, rel=0.15)


def test_noise_is_measured_where_its_growth_alone_was_given() -> None:
    config = inspect(Hall(0.05), Config.of(range_sigma_quadratic=0.001))
    assert config.values["range_sigma"].source == MEASURED
    assert config.options["range_sigma"] == pytest.approx(0.05, rel=0.15)
    assert config.options["range_sigma_quadratic"] == 0.001
    assert "range_sigma" not in inspect(Hall(0.05), Config.of(range_sigma=0.01)).notes[0]


def test_the_usual_noise_is_told_where_none_can_be_measured(tmp_path: Path) -> None:
    few = tmp_path / "few.npz"
    np.savez(few, origins=np.zeros((1, 2)), points=np.array([[3.0, 1.0]]), offsets=[0, 1])
    assert (
        inspect(few).notes[0]
        == "chosen: dim 2 range_sigma 0.03 no_return ignore (sigma is usual for such sensors)"
    )


def test_the_noise_that_a_log_tells_is_not_measured() -> None:
    config = inspect(Hall(0.05, tells=True))
    assert "range_sigma" not in config.values and not any("sigma is" in note for note in config.notes)
    both = inspect(JoinedLog([Hall(0.08), Hall(0.05, tells=True)]))
    assert both.options["range_sigma"] == pytest.approx(0.08, rel=0.15), "of those that do not tell it"
