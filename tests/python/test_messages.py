# SPDX-License-Identifier: BSD-3-Clause
"""Many wrong calls: each ends with a status and a few short lines, in the words that were typed."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("typer")
pytest.importorskip("rich")
pytest.importorskip("matplotlib")

from calling import cli

import ndtree
from ndtree._errors import Text, WrongValue, key, located
from ndtree.cli.commands import every
from ndtree.cli.commands.messages import in_words, laid_out
from ndtree.logs import READER_OPTIONS


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs, maps and files that are neither."""
    folder = tmp_path_factory.mktemp("wrong")
    for world, name in (("office", "office"), ("apartment", "rooms")):
        log = ndtree.simulate(world, scans=2)
        log.save(folder / f"{name}.npz")
        m = ndtree.AdaptiveMap(dim=log.dim)
        for scan in log:
            scan.insert_into(m)
        m.save(folder / f"{name}.ndt")
    (folder / "a.txt").write_text("hello\n")
    (folder / "b.toml").write_text("hello\n")
    (folder / "few.txt").write_text("0 0 1 1\n0 0 1 2\n")
    (folder / "far.txt").write_text("0 0 1e6 1\n0 0 1 2\n")
    (folder / "empty").mkdir()
    (folder / "cut.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    (folder / "damaged.ndt").write_bytes((folder / "office.ndt").read_bytes()[:-9])
    return folder


#: A call, its status, and what must be named: the value, the place, or what was expected.
CALLS: tuple[tuple[str, int, str], ...] = (
    ("mpa office.npz", 2, "mpa: no such command: did you mean map?"),
    ("map", 2, "LOG... is missing, expected ndtree map LOG..."),
    ("map nothing.bag", 1, "nothing.bag: No such file"),
    ("map empty -o o.ndt", 1, "empty: is an empty directory, expected"),
    ("map a.txt -o o.ndt", 1, "a.txt: line 1: found 'hello', expected"),
    ("map cut.bag -o o.ndt", 1, "cut.bag"),
    ("map office.ndt", 2, "office.ndt: is a map, expected a log; to look at it: ndtree view office.ndt"),
    ("map office.npz", 2, "office.ndt: is there already, expected -o MAP; to replace it: -o office.ndt"),
    ("map office.npz -o", 2, "-o: a value is missing, expected PATH"),
    ("map office.npz -o o.ndt --dim 5", 2, "--dim 5: must be a whole number from 2 to 3"),
    ("map office.npz -o o.ndt --min-cell-size abc", 2, "--min-cell-size abc: must be a number"),
    ("map office.npz -o o.ndt --min-cell-size -1", 2, "--min-cell-size -1: must be in [1e-09, 1000000] m"),
    ("map office.npz -o o.ndt --max-cell-size 0.01", 2,
        "--max-cell-size 0.01: must be at least --min-cell-size"),
    ("map office.npz -o o.ndt --branching 7", 2, "--branching 7"),
    ("map office.npz -o o.ndt --resolution 0.1", 2,
        "--resolution: no such option: did you mean --min-cell-size?"),
    ("map office.npz -o o.ndt --max-memory 9000", 1, "more than --max-memory 9000 bytes: expected shorter"),
    ("map office.npz new.ndt", 2, "new.ndt: expected a log; to write the map there: -o new.ndt"),
    ("convert office.ndt a.yaml --resolution 1", 2, "no such option: did you mean --cell-size?"),
    ("plan office.ndt --start 1,2", 2, "--start: no such option: did you mean --from?"),
    ("plan office.ndt --radius 1", 2, "--radius: no such option: did you mean --body?"),
    ("convert rooms.ndt a.yaml --height 50 60", 2, "--height 50 to 60 m: must be heights of observed cells"),
    ("clean office.npz -o x.txt", 2, "x.txt: expected .npz, .ply, .pcd"),
    ("live office.npz --rate inf", 2, "--rate inf: must be a number >= 0"),
    ("map office.npz -o o.ndt --rate 0", 2, "--rate: no such option here: it is one of ndtree live"),
    ("map office.npz -o o.ndt --min-range 9 --max-range 3", 2, "--min-range 9 m: must be < --max-range 3 m"),
    ("map office.npz -o o.ndt --min-range 500", 1, "nothing to map in 2 scans, 0 beams, with --min-range"),
    ("map office.npz -o o.ndt --fixed --refinement paper", 2, "--refinement: not with --fixed"),
    ("align office.npz -o p.ndt", 2, "-o p.ndt: poses are text, expected another ending"),
    ("fleet office.npz -o office.ndt", 2, "is a file, expected a folder"),
    ("view rooms.ndt --png a.png --slice z=100", 2, "--slice 100 m: must be from -"),
    ("map office.npz -o o.ndt --max-rang 3", 2, "did you mean --max-range?"),
    ("map office.npz -o o.ndt --topic /scan", 2, "--topic: an .npz recording takes no such option"),
    ("map office.npz -o o.ndt --max-range -3", 2, "--max-range -3: must be a number > 0 m"),
    ("map office.npz -o o.ndt --no-return maybe", 2, "--no-return maybe: must be one of auto, free, ignore"),
    ("map office.npz -o o.ndt --picture a.txt", 2, "--picture a.txt: the name must end in"),
    ("map office.npz -o o.ndt --box 1,2", 2, "--box 1,2: expected 4 numbers"),
    ("map office.npz -o o.ndt --origin 1", 2, "--origin 1: expected 2 numbers"),
    ("map office.npz -o o.ndt --every 0", 2, "--every 0: must be a whole number >= 1"),
    ("map office.npz -o o.ndt --port 99", 2, "--port: is for the page of --watch"),
    ("map office.npz -o o.ndt --refinement foo", 2, "--refinement foo: must be 'evidence' or 'paper'"),
    ("map office.npz -o o.ndt --significance 0.9", 2,
        "--significance: --refinement evidence has no use for it"),
    ("map office.npz -o o.ndt --merge-loss 3", 2, "--merge-loss: no such option"),
    ("map office.npz -o o.ndt --fixed --max-cell-size 3", 2, "--max-cell-size: --fixed has no use for it"),
    ("map bag --mount 1,2", 2, "--mount 1,2: 2 numbers, expected x,y,z,roll,pitch,yaw or x,y,yaw"),
    ("map office.npz -o o.xyz", 2, "o.xyz: no format has this ending, expected one of .ndt"),
    ("map office.npz rooms.npz --merge -o o.ndt", 1, "rooms.npz: is 3-D, must be 2-D as office.npz"),
    ("map office.npz office.npz", 2, "would both be office.ndt, expected different names"),
    ("map office.npz -o o.tiles --max-resident big", 2, "--max-resident big: must be a number of bytes"),
    ("map office.npz -o o.tiles --max-resident 1", 2, "--max-resident 1 bytes: must be at least"),
    ("map office.npz -o o.tiles --tile-size -1", 2, "--tile-size -1 m: must be > 0"),
    ("map office.npz -o o.ndt --json rooms.npz", 2,
        "--json rooms.npz: is an .npz recording, expected a new name, or --force"),
    ("info office.npz rooms.npz", 2, "rooms.npz: more than the command takes, expected FILE"),
    ("info office.ndt --look", 2, "--look: is for a LOG, and office.ndt is a map"),
    ("info damaged.ndt", 1, "damaged.ndt"),
    ("view", 2, "MAP is missing, expected ndtree view MAP"),
    ("view office.npz", 1, "office.npz: an .npz recording, expected a map of ndtree's"),
    ("view office.ndt --picture a.png", 2, "--picture: no such option: did you mean --png?"),
    ("plan office.ndt --from 1 --to 8,3 --body 0.2", 2, "--from 1: expected X,Y in metres"),
    ("explore castle", 2, "WORLD castle: must be one of office, apartment ndtree explore --help"),
    ("demo --world office", 2,
        "--world: no such option here: it is one of ndtree live and ndtree compare ndtree demo"),
    ("map office.npz -o o.ndt --box 1,1,0,0", 2,
        "--box from [1.0, 1.0] to [0.0, 0.0]: must be lower < upper"),
    ("map office.npz -o o.bt", 2, "-o o.bt: the log is 2-D, and such files hold 3-D maps"),
    ("convert office.ndt a.pgm --states free", 2, "takes no such option, it takes --cell-size, --height"),
    ("map a.txt", 1, "which kinds there are: ndtree map --help"),
    ("view office.ndt --slice q=1", 2, "--slice q=1: expected an axis and a position in metres, as in z=1.2"),
    ("view office.ndt --slice z=1 --png a.png", 2, "--slice: the map is 2-D"),
    ("view office.ndt --color height --png a.png", 2,
        "--color height: the map is 2-D and has none, expected"),
    ("view office.ndt --png a.png --open", 2, "--open: is for the page, not for --png"),
    ("convert office.ndt", 2, "OUT is missing, expected ndtree convert MAP OUT"),
    ("convert office.npz a.ply", 1, "office.npz: an .npz recording, expected"),
    ("convert office.ndt a.yaml --height 1 2", 2, "--height: a map in the plane has none"),
    ("convert rooms.ndt a.yaml --height 2 1", 2, "--height 2 to 1 m: must be from low to high"),
    ("convert office.ndt a.ply --states foo", 2, "--states foo: must be some of occupied, free, frontier"),
    ("compare", 2, "expected either LOG or --world"),
    ("compare office.ndt", 2, "office.ndt is a map, expected a second one"),
    ("compare office.npz --maps foo", 2, "--maps foo: must be one of adaptive, paper, fixed"),
    ("compare office.npz --held-out 1", 2, "--held-out 1: must be 0, or at least 2"),
    ("compare office.npz --maps fixed --picture a.png", 2, "--picture: expected at least two maps"),
    ("compare office.ndt rooms.ndt", 1, "office.ndt is 2-D and rooms.ndt 3-D"),
    ("simulate", 2, "WORLD is missing, expected ndtree simulate WORLD"),
    ("simulate moon", 2, "moon: must be one of office, apartment, street"),
    ("simulate office -o a.csv", 2, "-o a.csv: the name must end in .npz"),
    ("simulate office", 2, "office.npz: is there already, expected -o LOG"),
    ("calibrate office.npz --find-mount", 2, "--find-mount: office.npz is not a ROS bag"),
    ("study b.toml", 1, "b.toml"),
    ("fleet office.npz", 2, "--output is missing, expected PATH"),
    ("compare office.npz --maps fixed,fixed", 2, "--maps fixed,fixed: must be different"),
    ("compare office.npz --maps fixed@big", 2, "expected a cell size in metres behind the @"),
    ("compare office.npz --scans 3", 2, "--scans: is for simulated logs only"),
    ("compare --world office --dim 3", 2, "--dim 3: the office is 2-D"),
    ("compare --world office --min-range 1", 2, "--min-range: is for a LOG"),
    ("compare office.ndt office.ndt --held-out 5", 2, "--held-out: is for a LOG"),
    ("compare office.ndt a.txt", 1, "a.txt"),
    ("convert office.ndt a.ndt --cell-size 1", 2, "--cell-size: format ndtree"),
    ("info office.npz --origin-of-scan a,b,c", 2, "--origin-of-scan a,b,c: expected three numbers"),
    ("map far.txt --dim 2", 1,
        "with cells of 0.05 m at most 52428.8 m; set --max-range, or a larger --min-cell-size"),
    ("info office.npz --origin 1,a", 2, "--origin 1,a: expected 2 numbers with commas"),
    ("info office.npz --from 3 --to 2", 2, "--from 3 s, --to 2 s: must be 0 <= --from < --to"),
    ("demo --to 2", 2, "--to: is for a LOG, not for the simulated office"),
    ("map office.npz -o far.txt/o.tiles", 1, "far.txt/o.tiles: cannot be written: Not a directory"),
    ("map office.npz -o /proc/none/o.tiles", 1, "/proc/none/o.tiles: cannot be written"),
    ("demo office.npz --output far.txt/o", 1, "far.txt/o: cannot be written: Not a directory"),
    ("map office.npz -o o.tiles --watch", 2, "--watch: is not for a map in tiles, -o o.tiles"),
    ("view office.ndt --slice 1.2", 2, "--slice 1.2: expected an axis and a position in metres"),
    ("view office.ndt --slice z=nan", 2, "--slice z=nan: expected an axis"),
    ("view office.ndt --png a.png --log b", 2, "--log: is for the page, not for --png"),
    ("calibrate few.txt", 1, "few.txt: 2 beams returned, expected at least 100"),
    ("calibrate office.npz --json /nowhere/a.json", 1, "/nowhere/a.json: cannot be written"),
)  # fmt: skip

#: Names of Python's that no terminal shows: with an underscore, and not of a file's.
NAMES = {one.name for command in every().values() for one in command.params} | {
    one.name for one in READER_OPTIONS
}
PYTHONIC = re.compile(
    rf"\b(?:{'|'.join(name for name in sorted(NAMES) if '_' in name)})\b|\w\(|\bkeyword\b|Traceback"
)


def said(call: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(folder)
    return cli(*shlex.split(call))


@pytest.mark.parametrize("call, status, expected", CALLS, ids=[call for call, _, _ in CALLS])
def test_a_wrong_call_ends_in_short_lines(
    call: str, status: int, expected: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = sorted(path.name for path in folder.iterdir())
    done = said(call, folder, monkeypatch)
    assert done.exit_code == status, done.output
    assert done.stdout == ""
    first, *more = done.stderr.splitlines()
    assert first.startswith("ndtree: ") and "ndtree: ndtree" not in first
    assert all(line.startswith("  ") for line in more), done.stderr
    assert all(len(line) < 160 for line in (first, *more)), done.stderr
    assert expected in " ".join(done.stderr.split()), done.stderr
    assert not PYTHONIC.search(done.stderr), done.stderr
    assert sorted(path.name for path in folder.iterdir()) == before


def test_the_sample_is_large_and_of_all_commands() -> None:
    assert len(CALLS) >= 60
    assert {call.split()[0] for call, _, _ in CALLS} > set(every()) - {"demo"}


@pytest.mark.parametrize(
    "text, expected",
    [
        (WrongValue.of("min_cell_size", "-1.0", "> 0 m"), "--min-cell-size -1: must be > 0 m"),
        (WrongValue.of("no_return", "'maybe'", "free"), "--no-return maybe: must be free"),
        (located("a.bag", WrongValue.of("every", 0, ">= 1")), "a.bag: --every 0: must be >= 1"),
        (f"a.bag: {key('base_frame')} = x: not in /tf", "a.bag: --base-frame x: not in /tf"),
        (f"{key('mount')} = '1,2': two", "--mount 1,2: two"),
        (f"{key('start')} = 3 s, {key('stop')} = 2 s", "--from 3 s, --to 2 s"),
        (Text(f"{key('align')} finds poses"), "--align finds poses"),
        ("every beam with min_cell_size = 3", None),
    ],
)
def test_options_become_flags(text: str | Exception, expected: str | None) -> None:
    assert in_words(text) == (text if expected is None else expected)


def test_an_option_is_a_keyword_of_python_where_nothing_spells_it() -> None:
    said = f"{key('align')} finds poses"
    assert Text(said) == str(WrongValue(said)) == "align finds poses"
    assert in_words(located("b", WrongValue(said))) == "b: --align finds poses"


def test_long_messages_are_parted_and_lose_no_word() -> None:
    words = [f"word{i}" for i in range(200)]
    text = laid_out("a.bag: " + " ".join(words[:90]) + ", expected " + " ".join(words[90:]) + "\n  --still")
    lines = text.splitlines()
    assert all(len(line) < 160 for line in lines) and lines[-1] == "    --still"
    assert " ".join(text.split()) == "ndtree: a.bag: " + " ".join(words[:90]) + ", expected " + " ".join(
        [*words[90:], "--still"]
    )


# --- What is printed, and what is not -----------------------------------------------------------------


def test_json_alone_prints(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for call in ("info office.npz --json", "info --json -- office.npz", "info office.ndt --json --quiet"):
        done = said(call, folder, monkeypatch)
        assert done.exit_code == 0, done.output
        assert json.loads(done.stdout) and done.stderr == ""


def test_quiet_says_nothing_but_what_is_wrong(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for call in (
        f"map office.npz -o {tmp_path / 'a.ndt'} --quiet",
        "info office.npz -q",
        "info office.ndt -q",
    ):
        done = said(call, folder, monkeypatch)
        assert (done.exit_code, done.output) == (0, ""), call
    assert (tmp_path / "a.ndt").exists()
    done = said("map a.txt -q -o o.ndt", folder, monkeypatch)
    assert done.exit_code == 1 and done.stderr.startswith("ndtree: a.txt: line 1")
    done = said(f"map office.npz a.txt -q -o {tmp_path}", folder, monkeypatch)
    assert done.exit_code == 1 and done.stdout == "" and done.stderr.startswith("ndtree: a.txt: line 1")
