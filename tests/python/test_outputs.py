# SPDX-License-Identifier: BSD-3-Clause
"""No command and no writer replaces what it reads, nor a file of another kind than it writes."""

from __future__ import annotations

import inspect
import json
import os
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("typer")
pytest.importorskip("rich")
pytest.importorskip("matplotlib")

from calling import cli

import ndtree
from ndtree.cli.commands import every
from ndtree.cli.commands.output import INPUTS, OUTPUTS
from ndtree.logs import Log


def run(line: str) -> Any:
    return cli(*shlex.split(line))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of all kinds that commands read."""
    folder = tmp_path_factory.mktemp("made")
    log = ndtree.simulate("office", seed=2, scans=3)
    log.save(folder / "log.npz")
    m = ndtree.AdaptiveMap(dim=2)
    for scan in log:
        m.insert(scan.endpoints, scan.origin, returned=scan.returned)
    m.save(folder / "map.ndt")
    m.save(folder / "image.yaml")
    np.savez(folder / "arrays.npz", a=np.zeros(3))
    (folder / "poses.txt").write_text("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")
    (folder / "notes.txt").write_text("what was measured where\n")
    (folder / "page.json").write_text("{}\n")
    (folder / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (folder / "drive.bag").write_bytes(b"#ROSBAG V2.0\nno bag behind it")
    (folder / "study.toml").write_text('[logs.one]\npath = "log.npz"\n[maps.a]\n')
    (folder / "clouds").mkdir()
    (folder / "clouds" / "a.pcd").write_bytes(b"# .PCD v.7\n")
    (folder / "clouds" / "b.pcd").write_bytes(b"# .PCD v.7\n")
    return folder


@pytest.fixture
def here(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "here"
    shutil.copytree(made, folder)
    monkeypatch.chdir(folder)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def require_refused(line: str, here: Path, monkeypatch: pytest.MonkeyPatch, said: str) -> None:
    """In one line, with nothing read and all files kept."""
    before = contents(here)
    with monkeypatch.context() as patched:
        patched.setattr(
            "ndtree.tuning.config.Config.read", lambda *_, **__: pytest.fail("the log was opened")
        )
        patched.setattr(Log, "__iter__", lambda _: pytest.fail("the log was read"))
        done = run(line)
    assert done.exit_code == 2, (line, done.output, done.exception)
    assert contents(here) == before, line
    assert said in " ".join(done.stderr.split()) and done.stderr.count("ndtree: ") == 1, (line, done.stderr)
    assert done.stdout == "", line


#: Calls that write to OUT what they read as LOG; the names of all others are in the tables that these obey.
LOG_CALLS = {
    "map LOG -o OUT": "-o", "map LOG -o m.ndt --rerun OUT": "--rerun",
    "map LOG -o m.ndt --force --json OUT": "--json", "map page.json LOG --merge -o OUT": "-o",
    "live LOG -o OUT --rate 0": "-o", "clean LOG -o OUT": "-o", "align LOG -o p.txt --map OUT": "--map",
    "fleet LOG -o a.tiles --json OUT": "--json", "compare LOG --csv OUT": "--csv",
    "view map.ndt --log LOG --png OUT": "--png",
}  # fmt: skip


@pytest.mark.parametrize("call", LOG_CALLS)
@pytest.mark.parametrize("spelling", ["same", "dots", "symlink", "hard link"])
def test_what_is_read_is_not_written(
    call: str, spelling: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = {"same": "log.npz", "dots": "../here/log.npz"}.get(spelling)
    if out is None:
        out = "link.npz"
        (os.symlink if spelling == "symlink" else os.link)("log.npz", out)
    line = call.replace("LOG", "log.npz").replace("OUT", out)
    require_refused(line, here, monkeypatch, f"{LOG_CALLS[call]} {out}: is log.npz, which is read")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("convert map.ndt map.ndt", "OUT map.ndt: is map.ndt, which is read"),
        ("convert image.yaml image.pgm", "OUT image.pgm: is image.pgm, which is read"),
        ("convert image.yaml image.png", "OUT image.yaml: is image.yaml, which is read"),
        ("compare map.ndt image.yaml --json image.yaml", "--json image.yaml: is image.yaml"),
        ("compare map.ndt image.yaml --json image.pgm", "--json image.pgm: is image.pgm"),
        ("live log.npz --localize map.ndt -o map.ndt", "-o map.ndt: is map.ndt, which is read"),
        ("view map.ndt --png map.ndt", "--png map.ndt: is map.ndt"),
        ("map drive.bag --trajectory poses.txt -o poses.txt", "-o poses.txt: is poses.txt"),
        ("align drive.bag --trajectory poses.txt -o poses.txt", "-o poses.txt: is poses.txt"),
        ("study study.toml --json study.toml", "--json study.toml: is study.toml"),
        ("study study.toml --json log.npz", "--json log.npz: is "),
        ("clean clouds -o clouds", "-o clouds: is clouds, which is read"),
        ("clean clouds -o clouds/out", "-o clouds/out: is in clouds, which is read"),
        ("clean clouds -o clouds/more/out.ply", "-o clouds/more/out.ply: is in clouds"),
        ("map clouds -o clouds/map.ndt", "-o clouds/map.ndt: is in clouds"),
        ("map clouds -o clouds/m.tiles", "-o clouds/m.tiles: is in clouds"),
        ("map clouds drive.bag -o clouds", "-o clouds: is clouds"),
        ("fleet clouds -o clouds/m.tiles", "-o clouds/m.tiles: is in clouds"),
        ("demo clouds -o clouds/pictures", "-o clouds/pictures: is in clouds"),
        ("info clouds --json clouds/x.json", "--json clouds/x.json: is in clouds"),
    ],
)
def test_what_an_input_names_and_what_is_in_it_is_not_written(
    line: str, said: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    require_refused(line, here, monkeypatch, said)


@pytest.mark.parametrize("link", [os.symlink, os.link])
def test_what_is_linked_with_a_file_of_an_input_folder_is_not_written(
    link: Any, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link(here / "clouds" / "a.pcd", here / "other.pcd")
    (here / "out").mkdir()
    link(here / "clouds" / "b.pcd", here / "out" / "b.pcd")
    for out in ("other.pcd", "out"):
        require_refused(f"clean clouds -o {out}", here, monkeypatch, "clouds")


#: What is written, and onto which file of another kind.
OTHERS = [
    ("map log.npz -o {}", ["drive.bag", "notes.txt.ndt", "picture.png.ndt", "log2.npz", "page.json.ndt"]),
    ("live log.npz --rate 0 -o {}", ["notes.txt.ndt", "drive.bag"]),
    ("live log.npz --rate 0 --localize map.ndt -o {}", ["notes.txt", "log2.npz", "drive.bag"]),
    ("align log.npz -o {}", ["notes.txt", "log2.npz", "drive.bag", "map.ndt"]),
    ("align log.npz -o new.txt --map {}", ["log2.npz", "notes.txt.ndt"]),
    ("clean log.npz -o {}", ["arrays.npz", "notes.txt.npz", "notes.txt.ply"]),
    ("simulate office -o {}", ["arrays.npz", "notes.txt.npz"]),
    ("convert map.ndt {}", ["log2.npz", "drive.bag", "notes.txt.yaml", "notes.txt.bt"]),
    ("view map.ndt --png {}", ["notes.txt.png", "log2.npz.png"]),
    ("map log.npz -o m.ndt --picture {}", ["notes.txt.png", "drive.bag.pdf"]),
    ("map log.npz -o m.ndt --record {}", ["notes.txt.gif"]),
    ("compare log.npz --csv {}", ["notes.txt", "log2.npz"]),
    ("info log.npz --json {}", ["notes.txt", "log2.npz", "drive.bag.json"]),
]


@pytest.mark.parametrize(("line", "out"), [(line, out) for line, outs in OTHERS for out in outs])
def test_a_file_of_another_kind_is_not_replaced(
    line: str, out: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = "log.npz" if out.startswith("log2") else Path(out).stem if out.count(".") > 1 else out
    if not (here / out).exists():
        shutil.copy(here / source.replace("log2", "log"), here / out)
    require_refused(line.format(out), here, monkeypatch, "or --force to replace it")


@pytest.mark.parametrize(
    "line", ["map log.npz -o {}.ndt", "convert map.ndt {}.ply", "info log.npz --json {}.txt"]
)
def test_force_replaces_a_file_of_any_kind(line: str, here: Path) -> None:
    out = Path(line.format("it").split()[-1])
    shutil.copy("notes.txt", out)
    done = run(f"{line.format('it')} --force")
    assert done.exit_code == 0, done.output
    assert out.read_bytes() != (here / "notes.txt").read_bytes()
    with pytest.raises(FileExistsError):  # Of this call alone.
        ndtree.load("map.ndt").save(shutil.copy("notes.txt", "again.ndt"))


@pytest.mark.parametrize(
    "line",
    [
        "map log.npz -o {}.ndt",
        "convert map.ndt {}.yaml",
        "convert map.ndt {}.ply",
        "convert map.ndt {}.npz",
        "simulate office --scans 2 -o {}.npz",
        "clean log.npz -o {}.npz",
        "info log.npz --json {}.json",
        "view map.ndt --png {}.png",
    ],
)
def test_a_file_of_the_same_kind_and_an_empty_one_are_replaced(line: str, here: Path) -> None:
    call = line.format("it")
    out = Path(call.split()[-1])
    out.touch()
    done = run(call)
    assert done.exit_code == 0, done.output
    assert out.stat().st_size
    os.utime(out, (0, 0))
    assert run(call).exit_code == 0 and out.stat().st_mtime > 0


def test_what_is_beside_an_input_is_written(here: Path) -> None:
    for line in (
        "map log.npz",
        "map log.npz -o other.ndt",
        "convert map.ndt map.ply",
        "map log.npz -o ../here/b.ndt",
    ):
        done = run(line)
        assert done.exit_code == 0, (line, done.output)


def test_every_name_of_a_file_is_one_of_an_input_or_an_output() -> None:
    """So that no command gets a file that nothing looks at; a map to go on with may be the one written."""
    seen, known = set(), {*INPUTS, *OUTPUTS, "resume"}
    for name, one in every().items():
        for parameter in inspect.signature(one.callback).parameters.values():
            if "Path" in repr(parameter.annotation) or parameter.name in known:
                seen.add(parameter.name)
                assert parameter.name in known, (name, parameter.name)
    assert seen == known


def test_writers_of_python_keep_files_of_other_kinds(here: Path) -> None:
    m = ndtree.load("map.ndt")
    log = ndtree.read("log.npz")
    for ending in ("ndt", "png", "bt", "yaml", "pgm"):
        shutil.copy("notes.txt", f"notes.{ending}")
    before = contents(here)
    for write in (
        lambda: m.save("notes.ndt"),
        lambda: m.save_octomap("notes.bt"),
        lambda: m.save_map_server("notes.yaml"),
        lambda: m.save("notes.pgm"),
        lambda: m.save("drive.bag"),
        lambda: m.save("log.npz"),
        lambda: ndtree.convert(m, "log.npz"),
        lambda: log.save("arrays.npz"),
        lambda: ndtree.plot.side_by_side(m, m, "notes.png"),
    ):
        with pytest.raises(FileExistsError, match="holds something else"):
            write()
    for write in (lambda: log.save("log.npz"), lambda: ndtree.convert("map.ndt", "../here/map.ndt")):
        with pytest.raises(ValueError, match="which is read"):
            write()
    assert contents(here) == before
    m.save("map.ndt")
    assert json.loads(Path("page.json").read_text()) == {}
