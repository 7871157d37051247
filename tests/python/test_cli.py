# SPDX-License-Identifier: BSD-3-Clause
"""The command line does what the library does, and where it cannot, ends with one line and a status."""

from __future__ import annotations

import csv
import gzip
import io
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rich")
pytest.importorskip("matplotlib")

from calling import cli as run
from conftest import arrays_of, text_log

import ndtree

IS_ROOT = hasattr(os, "geteuid") and os.geteuid() == 0


def plain(text: str) -> str:
    """Without colours, frames and line breaks."""
    return " ".join(re.sub(r"\x1b\[[0-9;]*m|[│╭╮╰╯─]", " ", text).split())


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A text log of a simulated office."""
    return text_log(
        tmp_path_factory.mktemp("logs") / "office.txt", ndtree.simulate("office", seed=2, scans=20)
    )


@pytest.fixture(scope="module")
def log_3d(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a simulated apartment."""
    path = tmp_path_factory.mktemp("logs") / "apartment.npz"
    np.savez(path, **arrays_of(ndtree.simulate("apartment", seed=2, scans=6)))
    return path


# --- What the commands do ---------------------------------------------------------------------------


def test_map_writes_the_map_that_the_library_makes(log: Path, tmp_path: Path) -> None:
    target, picture, figures = tmp_path / "a.ndt", tmp_path / "a.png", tmp_path / "a.json"
    done = run(
        "map", log, "-o", target, "--picture", picture, "--json", figures,
        "--min-cell-size", 0.1, "--max-range", 9, "--sample-beams", 3, "--no-return", "free",
        "--range-sigma", 0.03,
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    by_hand = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, sample_beams=3)
    for scan in ndtree.read(log):
        scan.insert_into(by_hand, max_range=9)
    assert ndtree.load(target).to_bytes() == by_hand.to_bytes()
    assert picture.read_bytes().startswith(b"\x89PNG")
    written = json.loads(figures.read_text())
    assert written["stats"]["updates"] == by_hand.stats().updates
    assert written["options"]["sample_beams"] == 3
    assert written["scans"] == 20
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a.ndt", "a.png"]
    assert f"wrote {target} and {picture}" in done.output


def test_a_map_without_a_name_gets_that_of_its_log(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    packed = tmp_path / "a.b.txt.gz"
    packed.write_bytes(gzip.compress(log.read_bytes()))
    done = run("map", packed, "--every", 10)
    assert done.exit_code == 0 and "ndtree view a.b.ndt" in done.output
    before = (tmp_path / "a.b.ndt").read_bytes()
    done = run("map", packed, "--every", 5)
    assert done.exit_code == 2 and "a.b.ndt: is there already, expected -o MAP" in done.output
    assert (tmp_path / "a.b.ndt").read_bytes() == before
    assert run("map", packed, "--every", 5, "-o", "a.b.ndt").exit_code == 0


def test_compare_prints_and_writes_the_figures(log: Path, tmp_path: Path) -> None:
    figures, table, picture = tmp_path / "a.json", tmp_path / "a.csv", tmp_path / "a.png"
    done = run(
        "compare", log, "--maps", "adaptive,fixed,fixed@0.2", "--held-out", 5, "--repeat", 2,
        "--json", figures, "--csv", table, "--picture", picture,
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    written = json.loads(figures.read_text())
    again = ndtree.compare(ndtree.read(log), ("adaptive", "fixed", "fixed@0.2"), held_out=5)
    assert written["scans_mapped"] == 16
    for one, other in zip(written["maps"], again["maps"]):
        assert all(one[key] == other[key] for key in ("cells", "updates", "truth"))
        assert f"{one['cells']:,}" in done.output
        assert one["seconds"]["runs"] == 2
    assert len(list(csv.DictReader(io.StringIO(table.read_text())))) == 3
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_demo_takes_beams_without_return_as_map_and_compare_do(tmp_path: Path) -> None:
    """Whole rooms would be free outside of the walls if the simulated laser's no-returns were believed."""
    office = tmp_path / "office.npz"
    assert run("simulate", "office", "-o", office, "--scans", 160).exit_code == 0
    chosen = {}
    for name, call in (
        ("demo", ("demo", "--scans", 160, "--output", tmp_path / "pictures")),
        ("demo of the log", ("demo", office, "--output", tmp_path / "pictures")),
        ("compare", ("compare", office, "--maps", "adaptive")),
        ("map", ("map", office, "-o", tmp_path / "a.ndt")),
    ):
        done = run(*call)
        assert done.exit_code == 0, done.output
        (chosen[name],) = re.findall(r"--no-return (\w+)", done.output)
    assert chosen == dict.fromkeys(chosen, "ignore")


def test_a_grid_of_a_3d_map_without_heights_says_that_the_floor_is_in_it(
    log_3d: Path, tmp_path: Path
) -> None:
    run("map", log_3d, "-o", tmp_path / "m.ndt")
    for more, says in ((), True), (("--height", 0.1, 1.8), False):
        done = run("convert", tmp_path / "m.ndt", tmp_path / "m.yaml", *more)
        assert done.exit_code == 0 and ("the floor's" in done.output) == says


def test_demo_ends_with_three_calls_that_work(log: Path, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a log.txt").write_bytes(log.read_bytes())
    done = run("demo", "a log.txt", "--every", 2, "--max-range", 5, "--no-return", "free", "--seed", 3)
    assert done.exit_code == 0, done.output
    lines = done.output.split("Next, with the same log:")[1].splitlines()
    calls = [call for call in (shlex.split(line, comments=True) for line in lines) if call]
    assert [call[:2] for call in calls] == [["ndtree", "map"], ["ndtree", "view"], ["ndtree", "convert"]]
    assert sorted(calls[0][3:-2]) == ["--every=2", "--max-range=5.0", "--no-return=free"]
    made = run(*calls[0][1:])
    assert made.exit_code == 0, made.output
    assert Path(calls[0][-1]).is_file() and calls[1][2] == calls[2][2] == calls[0][-1]
    converted = run(*calls[2][1:])
    assert converted.exit_code == 0, converted.output
    assert Path(calls[2][3]).read_text().startswith("image: ")
    simulated = run("demo", "--scans", 10, "--output", "b").output.split("Next, with a log of your own")[1]
    assert re.findall(r"ndtree (\w+) drive.bag", simulated) == ["info", "map", "demo"]


def test_info_of_a_log_and_of_a_map(log: Path, log_3d: Path, tmp_path: Path) -> None:
    done = run("info", log, "--json", tmp_path / "log.json")
    assert done.exit_code == 0, done.output
    written = json.loads((tmp_path / "log.json").read_text())
    scans = list(ndtree.read(log))
    assert written["scans"] == len(scans) == 20
    assert written["beams"]["beams"] == sum(len(scan) for scan in scans)
    assert written["beams"]["not_returned"] == sum(int((~scan.returned).sum()) for scan in scans)
    assert "text log, 2-D, 20 scans" in done.output
    assert "npz log, 3-D, 6 scans" in run("info", log_3d).output

    m = ndtree.AdaptiveMap(dim=2)
    scans[0].insert_into(m)
    m.save(tmp_path / "a.ndt")
    done = run("info", tmp_path / "a.ndt", "--json", "-")
    # A file does not tell how unknown space above max_cell_size is divided.
    assert json.loads(done.stdout)["stats"]["leaves"] == ndtree.from_bytes(m.to_bytes()).stats().leaves
    assert f"{m.stats().observed_leaves} observed leaves" in run("info", tmp_path / "a.ndt").output


def test_info_of_a_long_log_keeps_a_sample_of_its_ranges(log_3d: Path, monkeypatch: Any) -> None:
    whole = json.loads(run("info", log_3d, "--json", "-").stdout)["range"]
    monkeypatch.setattr("ndtree.cli.commands.figures.RANGE_SAMPLE", 5000)
    sample = json.loads(run("info", log_3d, "--json", "-").stdout)["range"]
    assert sample["max"] == whole["max"]
    assert sample["median"] == pytest.approx(whole["median"], rel=0.1)


def test_parts_of_a_log_are_those_of_the_library(log: Path, log_3d: Path, tmp_path: Path) -> None:
    target = tmp_path / "a.ndt"
    flags = "--every 2 --stride 3 --min-range 1 --origin=1,-2 --box=-3,-3,4,5 --no-return=free".split()
    done = run("map", log, "-o", target, "--json", tmp_path / "a.json", *flags)
    assert done.exit_code == 0, done.output
    by_hand = ndtree.AdaptiveMap(dim=2)
    chosen = ndtree.read(log).select(every=2, stride=3, min_range=1, origin=(1, -2), box=((-3, -3), (4, 5)))
    for scan in chosen:
        scan.insert_into(by_hand)
    assert ndtree.load(target).to_bytes() == by_hand.to_bytes()
    written = json.loads((tmp_path / "a.json").read_text())
    assert (written["scans"], written["format"], written["skipped"]) == (10, "text", {})
    assert written["read_seconds"] > 0 and written["seconds"] > 0
    assert re.search(r"read in \d+\.\d{3} s, inserted in \d+\.\d{3} s; wrote", done.output)
    for command in (("info", log), ("calibrate", log)):
        done = run(*command, "--every", 4, "--json", tmp_path / "b.json")
        assert done.exit_code == 0, done.output
    assert json.loads((tmp_path / "b.json").read_text())["scans"] == 5
    done = run("compare", log, "--every", 4, "--held-out", 0, "--maps", "fixed", "--json", "-")
    assert json.loads(done.stdout)["scans_mapped"] == 5
    stamped = tmp_path / "stamped.npz"
    with np.load(log_3d) as arrays:
        np.savez(stamped, stamps=7.0 + np.arange(6), **arrays)
    for flags, scans in ((("--from", 2), 4), (("--to", 2), 2), (("--from", 1, "--to", 3, "--every", 5), 1)):
        done = run("info", stamped, *flags, "--json", "-")
        assert json.loads(done.stdout)["scans"] == scans
    refused(run("info", log, "--from", 1), 1, f"{log}: its scans have no times")


def test_what_is_damaged_is_passed_over_and_counted(log: Path, tmp_path: Path) -> None:
    damaged, figures = tmp_path / "log.txt", tmp_path / "a.json"
    damaged.write_text(log.read_text() + "0 0 1 x\n0 0 1\n0 0 1e13 0\n5 5 6 6\n")
    refused(run("map", damaged, "-o", tmp_path / "a.ndt"), 1, f"{damaged}: line")
    done = run("map", damaged, "-o", tmp_path / "a.ndt", "--keep-going", "--json", figures)
    assert done.exit_code == 0, done.output
    written = json.loads(figures.read_text())
    kinds = {kind: one["count"] for kind, one in written["skipped"].items()}
    assert kinds == {"damaged lines": 2, "scans that cannot be mapped": 1}
    assert written["scans"] == 21
    assert ndtree.load(tmp_path / "a.ndt").state([[6.0, 6.0]]) == 1
    said = " ".join(done.stderr.split())
    assert said.count("ndtree: ") == 2
    assert said.startswith(f"ndtree: skipped 2 damaged lines, the first: {damaged}: line ")
    for command in ("info", "compare"):
        more = ("--held-out", 0) if command == "compare" else ()
        done = run(command, damaged, "--keep-going", "--box=-99,-99,99,99", *more)
        assert "skipped 2 damaged lines" in done.stderr, command
    hopeless = tmp_path / "hopeless.log"
    hopeless.write_text("FLASER 3 1.0\n")
    refused(run("map", hopeless, "-o", tmp_path / "b.ndt", "--keep-going"), 1, "no FLASER or ROBOTLASER1")


def test_a_bag_is_listed_and_mapped(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from bags import Messages, write_bag

    make = Messages("mcap")
    content = [make.fixed(0, "odom", "laser", [1, 2, 0], at=1.0)]
    content += [("/scan", 1.0 + i, make.laser(1.0 + i, "laser", [1, 2, np.inf])) for i in range(4)]
    content += [("/rear", 2.0, make.laser(2.0, "away", [1, 2]))]
    bag = write_bag(tmp_path / "bag", make, content)
    listed = [
        f"{bag}: 3.0 s from 1.000 to 4.000 s",
        "/rear sensor_msgs/msg/LaserScan 1 away",
        "/scan sensor_msgs/msg/LaserScan 4 laser",
        "/tf_static tf2_msgs/msg/TFMessage 1",
    ]
    done = run("info", bag, "--topic", "/rear")
    assert done.exit_code == 1
    assert "no transform to away, the frame of /rear, expected one of:" in plain(done.stderr)
    assert "the frames of /tf are laser, odom" in plain(done.stderr)
    for line in listed:
        assert line in plain(done.stdout)
    done = run("info", bag, "--topic", "/scan", "--json", tmp_path / "a.json")
    assert done.exit_code == 0, done.output
    more = "rosbag log, 2-D, 4 scans in 3.0 s", "uses /scan (LaserScan in laser), poses in odom"
    for line in (*listed, *more):
        assert line in plain(done.stdout)
    written = json.loads((tmp_path / "a.json").read_text())
    assert written["contents"]["topics"][1]["messages"] == 4
    assert written["beams"] == {"beams": 12, "returned": 8, "not_returned": 4, "invalid": 0}
    done = run("map", bag, "-o", tmp_path / "a.ndt", "--topic", "scan", "--fixed-frame", "odom")
    assert done.exit_code == 0, done.output
    assert ndtree.load(tmp_path / "a.ndt").state([[1.0 + 0.0707 / 2, 1.0025]]) == -1
    assert ndtree.load(tmp_path / "a.ndt").state([[1 + np.cos(1.5), 2 - np.sin(1.5)]]) == 1


# --- What is refused --------------------------------------------------------------------------------


def refused(done: Any, status: int, *expected: str) -> None:
    assert done.exit_code == status, done.output
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert done.stdout == ""
    first, *more = done.stderr.splitlines()
    assert first.startswith("ndtree: ") and all(line.startswith("  ") for line in more), done.stderr
    said = " ".join(done.stderr.split())
    for text in expected:
        assert text in said


def test_a_scan_that_cannot_be_mapped_is_named(tmp_path: Path) -> None:
    log = tmp_path / "far.txt"
    log.write_text("0 0 1 1\n1 0 1e13 0\n")
    for arguments in (("map", log, "-o", tmp_path / "a.ndt"), ("compare", log, "--held-out", 0)):
        refused(run(*arguments), 1, f"{log}: scan 1: beam 0 is 1e+13 m long")
    assert [path.name for path in tmp_path.iterdir()] == ["far.txt"]


@pytest.mark.parametrize("option", ["-o", "--picture", "--json"])
@pytest.mark.parametrize("where", ["no folder", "a folder", "read-only"])
def test_unwritable_output_is_refused_before_the_work(
    option: str, where: str, log: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    target = folder / "a.png"
    if where == "a folder":
        target.mkdir(parents=True)
    elif where == "read-only":
        if IS_ROOT:
            folder = Path("/proc")
            target = folder / "a.png"
        else:
            folder.mkdir(mode=0o500)
    arguments = ["map", log, option, target]
    if option != "-o":
        arguments += ["-o", tmp_path / "a.ndt"]
    elif where == "a folder":  # There the map has the log's name.
        assert run(*arguments).exit_code == 0
        assert [path.name for path in target.iterdir()] == [f"{log.stem}.ndt"]
        return
    refused(run(*arguments), 1, str(target))
    assert not (tmp_path / "a.ndt").exists()


# --- The process ------------------------------------------------------------------------------------


def start(*arguments: object, code: str = "") -> subprocess.CompletedProcess[str]:
    program = f"{code}\nimport sys; sys.argv[0] = 'ndtree'\nfrom ndtree.cli import main; main()"
    command = [sys.executable, "-c", program, *(str(argument) for argument in arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("unbuffered", [False, True])
def test_a_reader_that_leaves_does_not_stop_the_work(unbuffered: bool, log: Path, tmp_path: Path) -> None:
    program = "import sys; sys.argv[0] = 'ndtree'; from ndtree.cli import main; main()"
    read, write = os.pipe()
    os.close(read)
    target = tmp_path / "a.ndt"
    call = [sys.executable, *(["-u"] if unbuffered else []), "-c", program, "map", log, "-o", target]
    done = subprocess.run(call, stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")
    assert ndtree.load(target).stats().observed_leaves > 100


def test_without_a_terminal_a_line_says_now_and_then_how_far_it_is(monkeypatch, capsys) -> None:
    from ndtree.cli.commands import progress

    monkeypatch.setattr(progress.sys.stderr, "isatty", lambda: False)
    m = ndtree.AdaptiveMap(dim=2)
    log = SimpleNamespace(share_read=0.25)
    for every, lines in ((1e6, 0), (0.0, 2)):
        monkeypatch.setattr(progress, "LINE_EVERY", every)
        with progress.progress() as report:
            report("looking at the log", 3, 20)
            report("looking at the log", 4, 0)
        said = capsys.readouterr()
        assert said.out == "" and len(said.err.splitlines()) == lines
        assert not lines or said.err == "looking at the log: 3 of 20\nlooking at the log: 4\n"
        with progress.mapping_progress(log, m) as report:
            report(7, 700)
        said = capsys.readouterr().err
        assert said.startswith("25 %: 7 scans, ") if lines else said == ""


def test_the_process_has_the_exit_status(log: Path, tmp_path: Path) -> None:
    done = start("info", log)
    assert (done.returncode, done.stderr) == (0, ""), "no progress bar without a terminal"
    assert "20 scans" in done.stdout
    bad = start("info", tmp_path / "none.log")
    assert bad.returncode == 1
    assert bad.stderr == f"ndtree: {tmp_path / 'none.log'}: No such file or directory\n"
    assert start("info").returncode == 2


@pytest.mark.parametrize("missing", ["typer", "rich"])
def test_without_the_extra_it_is_named(missing: str) -> None:
    done = start("info", "x", code=f"import sys; sys.modules[{missing!r}] = None")
    assert done.returncode == 2
    assert done.stderr.splitlines()[1].startswith("    pip install 'typer>=")


def test_without_matplotlib_maps_are_made_and_pictures_refused(log: Path, tmp_path: Path) -> None:
    code = "import sys; sys.modules['matplotlib'] = None"
    assert start("map", log, "-o", tmp_path / "a.ndt", code=code).returncode == 0
    done = start("map", log, "-o", tmp_path / "b.ndt", "--picture", tmp_path / "b.png", code=code)
    assert done.returncode == 2
    assert "pip install 'matplotlib>=" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["a.ndt"]


def test_the_map_is_there_when_its_picture_fails(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any, **__: Any) -> None:
        assert [path.name for path in tmp_path.iterdir()] == ["a.ndt"], "nor is there a hidden file by then"
        raise MemoryError

    monkeypatch.setattr("ndtree.plot.overview", fails)
    done = run("map", log, "-o", tmp_path / "a.ndt", "--picture", tmp_path / "a.png")
    assert done.exit_code == 1
    assert ndtree.load(tmp_path / "a.ndt").stats().observed_leaves > 0
    assert [path.name for path in tmp_path.iterdir()] == ["a.ndt"]


def test_a_terminal_sees_how_far_the_map_is(log: Path, tmp_path: Path) -> None:
    pty = pytest.importorskip("pty")
    code = "import ndtree.cli.commands.progress; ndtree.cli.commands.progress.REFRESH = 0\n"
    program = f"{code}from ndtree.cli import main; main()"
    near, far = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
    call = [sys.executable, "-c", program, "map", str(log), "-o", str(tmp_path / "a.ndt")]
    process = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=far, env=environment)
    os.close(far)
    seen = b""
    while True:
        try:
            part = os.read(near, 4096)
        except OSError:  # The other end is closed.
            break
        if not part:
            break
        seen += part
    os.close(near)
    assert process.wait() == 0
    assert re.search(r"20 scans, [\d,]+ beams/s, [\d,]+ leaves, [\d.]+ MiB", plain(seen.decode()))
