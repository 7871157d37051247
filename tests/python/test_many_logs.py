# SPDX-License-Identifier: BSD-3-Clause
"""Several logs make a map each, or one of all, as each alone and all in a row do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from calling import cli
from typer.testing import CliRunner

import ndtree
from ndtree.cli.commands import app
from ndtree.evaluation.cleaned import writer_of
from ndtree.logs import JoinedLog, read

RUN = CliRunner()


def called(*arguments: object) -> tuple[int, str, str]:
    done = cli(*arguments)
    return done.exit_code, done.stdout, done.stderr


def write(path: Path, scans: list[ndtree.Scan]) -> Path:
    offsets = np.cumsum([0, *(len(scan) for scan in scans)])
    points = np.concatenate([scan.endpoints for scan in scans])
    origins = np.array([np.broadcast_to(scan.origin, scan.endpoints.shape)[0] for scan in scans])
    np.savez(path, points=points, origins=origins, offsets=offsets)
    return path


@pytest.fixture
def logs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    monkeypatch.chdir(tmp_path)
    scans = list(ndtree.simulate("office", scans=15))
    return [write(Path(f"{name}.npz"), scans[i : i + 5]) for name, i in (("a", 0), ("b", 5), ("c", 10))]


@pytest.mark.parametrize("folder", [None, "maps"])
def test_each_log_becomes_the_map_that_it_is_alone(logs: list[Path], folder: str | None) -> None:
    more = () if folder is None else ("-o", folder)
    status, out, _ = called("map", *logs, *more, "--json", "figures.json")
    assert status == 0
    figures = json.loads(Path("figures.json").read_text())["maps"]
    assert [one["log"] for one in figures] == [str(log) for log in logs]
    for log, one in zip(logs, figures):
        assert called("map", log, "-o", "alone.ndt")[0] == 0
        target = Path(folder or "", f"{log.stem}.ndt")
        assert target.read_bytes() == Path("alone.ndt").read_bytes()
        assert one["map"] == str(target) and f"wrote {target}" in out
        assert one["scans"] == 5


def test_merged_logs_become_the_map_of_all_scans_in_that_order(logs: list[Path]) -> None:
    logs = [logs[1], logs[0], logs[2]]
    assert (
        called("map", *logs, "--merge", "-o", "all.ndt", "--no-return", "free", "--range-sigma", 0.03)[0] == 0
    )
    expected = ndtree.AdaptiveMap(dim=2)
    for log in logs:
        for scan in read(log):
            scan.insert_into(expected)
    assert ndtree.load("all.ndt") == expected
    assert expected.stats().observed_leaves > 1000


def test_a_bad_log_does_not_stop_the_others(logs: list[Path]) -> None:
    Path("b.npz").write_bytes(b"PK\3\4 no archive")
    status, _, error = called("map", *logs, "nothing.npz", "-o", "maps", "--json", "figures.json")
    assert status == 1
    assert [line.split(":")[1].strip() for line in error.splitlines()] == ["b.npz", "nothing.npz"]
    assert sorted(path.name for path in Path("maps").iterdir()) == ["a.ndt", "c.ndt"]
    figures = json.loads(Path("figures.json").read_text())["maps"]
    assert ["error" in one for one in figures] == [False, True, False, True]


def test_wrong_calls_write_nothing(logs: list[Path]) -> None:
    Path("sub").mkdir()
    write(Path("sub/a.npz"), list(ndtree.simulate("office", scans=2)))
    write(Path("solid.npz"), list(ndtree.simulate("apartment", scans=1)))
    Path("old.ndt").touch()
    before = sorted(Path().rglob("*"))
    for said, *arguments in (
        ("would both be a.ndt", "a.npz", "sub/a.npz"),
        ("old.ndt: is a file, expected a folder", "a.npz", "b.npz", "-o", "old.ndt"),
        ("expected a folder for 2 maps", "a.npz", "b.npz", "-o", "new.ndt"),
        ("--picture: is for one map", "a.npz", "b.npz", "--picture", "x.png"),
        ("--record: is for one map", "a.npz", "b.npz", "--record", "x.gif"),
        ("--watch: is for one map", "a.npz", "b.npz", "--watch"),
    ):
        status, _, error = called("map", *arguments)
        assert (status, len(error.splitlines())) == (2, 1) and said in error, arguments
        assert sorted(Path().rglob("*")) == before, arguments
    status, _, error = called("map", "a.npz", "solid.npz", "--merge", "-o", "x.ndt")
    assert status == 1 and "solid.npz: is 3-D, must be 2-D as a.npz" in error
    assert sorted(Path().rglob("*")) == before


def test_a_joined_log_counts_what_each_passed_over(logs: list[Path]) -> None:
    joined = JoinedLog([read(log) for log in logs])
    shares = [joined.share_read for _ in joined]
    assert len(shares) == 15 and joined.share_read == 1.0
    assert all(one <= two for one, two in zip(shares, shares[1:]))
    lines = "FLASER 2 1 1 0 0 0 0 0 0 0 a 0\nFLASER damaged\n"
    for name in "xy":
        Path(f"{name}.log").write_text(lines)
    damaged = JoinedLog([read(f"{name}.log", keep_going=True) for name in "xy"])
    assert len(list(damaged)) == 2
    assert [one.count for one in damaged.skipped.values()] == [2]


@pytest.mark.parametrize("world", ["office", "apartment"])
def test_a_simulated_log_as_a_file_is_the_log(tmp_path: Path, world: str) -> None:
    file = tmp_path / "log.npz"
    status, out, _ = called("simulate", world, "-o", file, "--scans", 3, "--seed", 2)
    assert status == 0 and f"wrote {file}: 3 scans" in out
    expected = list(ndtree.simulate(world, scans=3, seed=2))
    for one, other in zip(read(file), expected):
        assert np.array_equal(one.endpoints, other.endpoints, equal_nan=True)
        assert np.array_equal(one.origin, other.origin)
        everything = np.ones(len(other), dtype=bool)
        assert np.array_equal(
            everything if one.returned is None else one.returned,
            everything if other.returned is None else other.returned,
        )
    assert len(read(file)) == 3


def test_any_log_can_be_saved_or_says_why_not(tmp_path: Path) -> None:
    text = tmp_path / "log.log"
    text.write_text("FLASER 2 1 1 0 0 0 0 0 0 7 a 7\nFLASER 2 2 1 0 0 0 0 0 0 8 a 8\n")
    assert read(text).save(tmp_path / "a.npz") == 2
    assert [scan.stamp for scan in read(tmp_path / "a.npz")] == [scan.stamp for scan in read(text)]
    before = sorted(tmp_path.iterdir())
    with pytest.raises(ValueError, match=r"b\.txt: the name must end in \.npz"):
        read(text).save(tmp_path / "b.txt")

    class Each(JoinedLog):
        def _scans(self):  # type: ignore[no-untyped-def]
            yield ndtree.Scan(np.ones((2, 2)), np.zeros((2, 2)))

    for save in (
        lambda: Each([read(text)]).save(tmp_path / "b.npz"),
        lambda: writer_of(Each([read(text)]), tmp_path / "b.npz", False).check(),
    ):
        with pytest.raises(ValueError, match=r"log\.log: scan 0 has an origin for each beam"):
            save()
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("ndtree ma", {"map"}),
        ("ndtree simulate ", {"office", "apartment", "street"}),
        ("ndtree map --watc", {"--watch"}),
    ],
)
def test_shells_complete_commands_values_and_flags(words: str, expected: set[str]) -> None:
    variables = {
        "COMP_WORDS": words,
        "COMP_CWORD": str(words.count(" ")),
        "_NDTREE_COMPLETE": "complete_bash",
    }
    done = RUN.invoke(app, [], prog_name="ndtree", env=variables)
    assert set(done.stdout.split()) == expected
