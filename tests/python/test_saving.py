# SPDX-License-Identifier: BSD-3-Clause
"""Whatever happens while a file is written, its place holds the old one or the new one, whole."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import signal
import stat
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("PIL")
pytest.importorskip("pypcd4")
pytest.importorskip("trimesh")
pytest.importorskip("meshio")
pytest.importorskip("rosbags")

import ndtree
from ndtree import plot
from ndtree.base.files import replaced, replaced_together

Save = Callable[[ndtree.OccupancyMap, Path], None]


def _picture(m: ndtree.OccupancyMap, path: Path) -> None:
    plot.overview(m, path, dpi=20)


#: Everything that writes files of maps: by ending, and how.
WRITERS: dict[str, Save] = {
    **{
        ending: ndtree.convert
        for ending in (".ndt .bt .ot .yaml .png .bag .mcap .db3 .ply .pcd .glb .gltf .vtu .npz .npy".split())
    },
    "-picture.png": _picture,
}
FLAT = (".yaml", ".png", "-picture.png")
#: Writers that go to a file's place each in a way of its own; that the others go there, a full disk tells.
SOME = pytest.mark.parametrize("ending", [".ndt", ".yaml", ".png", ".mcap", ".npz", "-picture.png"])


def small_map(dim: int, seed: int) -> ndtree.OccupancyMap:
    random = np.random.default_rng(seed)
    m = ndtree.AdaptiveMap(dim=dim, min_cell_size=0.2)
    m.insert(random.normal(0, 1 + seed, (40, dim)), np.zeros(dim))
    return m


MAPS = {dim: [small_map(dim, seed) for seed in (1, 2)] for dim in (2, 3)}


def maps_for(ending: str) -> list[ndtree.OccupancyMap]:
    return MAPS[2 if ending in FLAT else 3]


def save(ending: str, which: int, path: Path) -> None:
    WRITERS[ending](maps_for(ending)[which], path)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def in_child(run: Callable[[], None]) -> int:
    """Its process, which ends with status 0, or 1 if an OSError that names a file came, or 2."""
    child = os.fork()
    if child:
        return child
    code = 2
    try:
        run()
        code = 0
    except OSError as error:
        code = 1 if error.filename else 3
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def status_of(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def status_when_interrupted(child: int) -> int:
    """Asks again after a while: Python drops an interrupt that comes where nothing can be raised."""
    while True:
        os.kill(child, signal.SIGINT)
        for _ in range(500):
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.01)


# --- What is there already --------------------------------------------------------------------------


@SOME
def test_links_are_followed_and_the_mode_is_kept(ending: str, tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "a", tmp_path / "b"
    folder.mkdir()
    elsewhere.mkdir()
    there, link = elsewhere / f"there{ending}", folder / f"link{ending}"
    link.symlink_to(there)
    save(ending, 0, link)  # A link to nothing.
    assert link.is_symlink() and there.is_file()
    first = there.read_bytes()
    there.chmod(0o640)
    save(ending, 1, link)
    assert link.is_symlink() and stat.S_IMODE(there.stat().st_mode) == 0o640
    assert there.read_bytes() != first


@SOME
def test_a_new_file_has_the_mode_that_the_process_gives(ending: str, tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        save(ending, 0, tmp_path / f"new{ending}")
    finally:
        os.umask(before)
    for path in tmp_path.iterdir():
        assert stat.S_IMODE(path.stat().st_mode) == 0o640, path


@SOME
def test_a_file_with_several_names_is_refused(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"one{ending}"
    path.touch()
    os.link(path, tmp_path / "other")
    with pytest.raises(OSError, match="2 names") as caught:
        save(ending, 0, path)
    assert caught.value.filename == str(path)
    assert contents(tmp_path) == {path.name: b"", "other": b""}


@SOME
def test_a_pipe_gets_the_file_and_stays(ending: str, tmp_path: Path) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    if ending in (".yaml", ".png"):
        (folder / "pipe.pgm").write_text("P5 image")  # Of a pair, each is written by its own kind.
    path = folder / f"pipe{ending}"
    os.mkfifo(path)
    with pytest.raises(OSError, match="nobody reads"):  # And does not wait for a reader.
        save(ending, 0, path)
    got: list[bytes] = []
    thread = threading.Thread(target=lambda: got.append(path.read_bytes()))
    thread.start()
    for _ in range(1000):
        try:
            save(ending, 0, path)
            break
        except OSError as error:
            assert error.errno == errno.ENXIO  # The reader has not come yet.
            time.sleep(0.01)
    thread.join(20)
    assert path.is_fifo()
    assert len(got[0]) > 20 and not any(path.name.startswith(".") for path in folder.iterdir())
    if ending in (".ndt", ".npz"):
        save(ending, 0, tmp_path / f"same{ending}")
        assert got[0] == (tmp_path / f"same{ending}").read_bytes()


@SOME
def test_folders_and_missing_folders_are_refused(ending: str, tmp_path: Path) -> None:
    (tmp_path / f"folder{ending}").mkdir()
    for path in (tmp_path / f"folder{ending}", tmp_path / "none" / f"a{ending}"):
        with pytest.raises(OSError):
            save(ending, 0, path)
    assert [path.name for path in tmp_path.iterdir()] == [f"folder{ending}"]


@SOME
def test_names_may_be_as_long_as_the_system_takes_them(ending: str, tmp_path: Path) -> None:
    longest = 254 if ending == ".png" else 255  # A .yaml stands beside it.
    path = tmp_path / ("n" * (longest - len(ending)) + ending)
    save(ending, 0, path)
    assert path.stat().st_size > 0
    too_long = tmp_path / ("n" * (256 - len(ending)) + ending)
    with pytest.raises(OSError, match=os.strerror(errno.ENAMETOOLONG)):
        save(ending, 0, too_long)


def test_what_may_not_be_written_is_refused(tmp_path: Path) -> None:
    """By a user who is not root, since permissions do not stop root."""
    folder = Path(f"/tmp/ndtree-test-{os.getpid()}")
    folder.mkdir()
    try:
        path = folder / "a.ndt"
        path.touch()
        path.chmod(0o444)
        folder.chmod(0o777)

        def as_nobody() -> None:
            if os.geteuid() == 0:
                os.setegid(65534)
                os.seteuid(65534)
            MAPS[2][0].save(path)

        assert status_of(in_child(as_nobody)) == 1
        path.chmod(0o666)
        folder.chmod(0o555)
        assert status_of(in_child(as_nobody)) == 1
        assert contents(folder) == {"a.ndt": b""}
    finally:
        folder.chmod(0o777)
        shutil.rmtree(folder)


# --- What happens meanwhile -------------------------------------------------------------------------


@pytest.mark.parametrize("ending", WRITERS)
def test_a_full_disk_leaves_the_old_file(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    save(ending, 0, path)
    before = contents(tmp_path)
    size = max(map(len, before.values()))
    limits = [0, 1, size // 2, size - 1]

    def run() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        save(ending, 0, path)

    refused = 0
    for limit in limits:
        status = status_of(in_child(run))
        refused += status == 1
        assert status in (0, 1), (limit, status)
        assert contents(tmp_path).keys() == before.keys()
        if status == 1:
            assert contents(tmp_path) == before, limit
    assert refused >= 3 - (ending in (".bag", ".mcap", ".db3"))  # These have times in them, and other sizes.


def kept(path: Path) -> dict[str, bytes]:
    """What a writer has written at a name: more than one file for some."""
    return {one.name: one.read_bytes() for one in path.parent.iterdir() if not one.name.startswith(".")}


@SOME
def test_kills_leave_one_of_both_files(ending: str, tmp_path: Path) -> None:
    """At random instants; NDTREE_KILLS of them, else 3."""
    if ending == ".mcap":
        pytest.skip("has the time of writing in it, and is written as the others")
    folder = tmp_path / "a"
    folder.mkdir()
    path = folder / f"a{ending}"
    possible = []
    for which in (0, 1):
        save(ending, which, path)
        possible.append(kept(path))
    random, kills = Random(ending), int(os.environ.get("NDTREE_KILLS", 3))
    begin = time.monotonic()
    save(ending, 0, path)
    once = time.monotonic() - begin
    left = missing = 0

    def run() -> None:
        for i in range(100000):
            save(ending, i % 2, path)

    for _ in range(kills):
        child = in_child(run)
        time.sleep(0.01 + random.uniform(0, 4 * once))
        os.kill(child, signal.SIGKILL)
        assert status_of(child) == -signal.SIGKILL
        found = kept(path)
        if ending in (".yaml", ".png") and path.with_suffix(".yaml").name not in found:
            missing += 1  # Between two renames: nothing rather than what describes another image.
        else:
            assert found in possible, (ending, sorted(found))
        left += len(list(folder.glob(".*")))
    save(ending, 1, path)
    assert contents(folder) == possible[1]  # Nothing hidden is left, either.
    print(f"{ending}: {kills} kills, {left} hidden files left and removed, {missing} pairs missing")


@pytest.mark.parametrize("ending", [".ndt", ".vtu", "-picture.png"])
def test_an_interrupt_leaves_nothing_behind(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    save(ending, 0, path)
    possible = [kept(path)]
    save(ending, 1, path)
    possible.append(kept(path))
    random = Random(7)
    begun, begin = os.pipe()
    for _ in range(6):

        def run() -> None:
            try:
                signal.signal(signal.SIGINT, signal.default_int_handler)
                os.write(begin, b".")
                for i in range(100000):
                    save(ending, i % 2, path)
            except KeyboardInterrupt:
                pass
            except TypeError as error:  # NumPy's, of an interrupt that comes while it compares rows.
                if "structured arrays" not in str(error):
                    raise
            except ValueError as error:  # Matplotlib's, of one that comes while it asks for a matrix.
                if "affine transformation" not in str(error):
                    raise

        child = in_child(run)
        os.read(begun, 1)  # On a busy machine it may take the child a while to get there.
        time.sleep(random.uniform(0, 0.07))
        assert status_when_interrupted(child) == 0
        assert contents(tmp_path) in possible
    os.close(begun)
    os.close(begin)


def test_an_interrupt_while_a_path_says_its_text_stays_one() -> None:
    class Slow:
        def __fspath__(self) -> str:
            raise KeyboardInterrupt

    for call in (ndtree.load, MAPS[2][0].save, lambda path: ndtree.load(path=path)):
        with pytest.raises(KeyboardInterrupt):
            call(Slow())


def test_of_a_pair_both_are_replaced_or_none(tmp_path: Path) -> None:
    one, other = tmp_path / "a.pgm", tmp_path / "a.yaml"
    for there in (True, False):
        one.unlink(missing_ok=True)
        if there:
            one.write_text("P5 old")
        with pytest.raises(OSError) as caught, replaced_together(one, other) as parts:
            for part in parts:
                part.write_text("new")
            other.mkdir()  # No file can take this place any more.
        assert caught.value.filename == str(other)
        other.rmdir()
        assert contents(tmp_path) == ({one.name: b"P5 old"} if there else {})
    one.write_text("P5 old")
    other.write_text("image: old")
    with replaced_together(one, other) as parts:
        for part in parts:
            part.write_text("new")
    assert contents(tmp_path) == {"a.pgm": b"new", "a.yaml": b"new"}


def test_errors_of_libraries_become_those_of_the_file(tmp_path: Path) -> None:
    import sqlite3

    with pytest.raises(OSError, match="OperationalError: database or disk is full") as caught:
        with replaced(tmp_path / "a.db3"):
            raise sqlite3.OperationalError("database or disk is full")
    assert caught.value.filename == str(tmp_path / "a.db3")
    with pytest.raises(ValueError, match="its own"), replaced(tmp_path / "a.db3"):
        raise ValueError("its own")
    assert not contents(tmp_path)


_SHIM = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>
static void note(const char* what, const char* name) {
  FILE* log = fopen(getenv("NDTREE_CALLS"), "a");
  fprintf(log, "%s %s\\n", what, name);
  fclose(log);
}
int fsync(int fd) {
  char link[64], name[4096] = {0};
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  if (readlink(link, name, sizeof name - 1) < 0) return -1;
  note("fsync", name);
  return ((int (*)(int))dlsym(RTLD_NEXT, "fsync"))(fd);
}
int rename(const char* from, const char* to) {
  note("rename", to);
  return ((int (*)(const char*, const char*))dlsym(RTLD_NEXT, "rename"))(from, to);
}
"""


def test_content_is_on_the_disk_before_the_name_and_the_name_after_it(tmp_path: Path) -> None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler: calls of the system cannot be noted")
    (tmp_path / "shim.c").write_text(_SHIM)
    shim = tmp_path / "shim.so"
    subprocess.run([compiler, "-shared", "-fPIC", tmp_path / "shim.c", "-o", shim, "-ldl"], check=True)
    folder, calls = tmp_path / "a", tmp_path / "calls"
    folder.mkdir()
    program = (
        "import numpy as np, ndtree; m = ndtree.AdaptiveMap(dim=2); m.insert(np.ones((3, 2)), np.zeros(2));"
        f"m.save({str(folder / 'a.ndt')!r}); m.save_map_server({str(folder / 'a.yaml')!r})"
    )
    environment = {**os.environ, "LD_PRELOAD": str(shim), "NDTREE_CALLS": str(calls)}
    subprocess.run([sys.executable, "-c", program], env=environment, check=True)
    said = [line.split(" ", 1) for line in calls.read_text().splitlines()]
    assert [what for what, _ in said] == [
        *("fsync", "rename", "fsync"),
        *("fsync", "fsync", "rename", "rename", "fsync", "fsync"),
    ]
    names = [Path(name) for _, name in said]
    assert names[1:3] == [folder / "a.ndt", folder]
    assert names[5:] == [folder / "a.pgm", folder / "a.yaml", folder, folder]
    assert {name.parent for name in (names[0], *names[3:5])} == {folder}


# --- From the command line --------------------------------------------------------------------------


def test_the_command_line_checks_before_the_work(tmp_path: Path) -> None:
    from calling import cli

    log = tmp_path / "a.txt"
    log.write_text("0 0 1 1\n0 0 1 2\n")
    target = tmp_path / "a.ndt"
    target.touch()
    os.link(target, tmp_path / "other.ndt")
    done = cli("map", log, "-o", target)
    said = " ".join(done.output.split())
    assert done.exit_code == 1 and f"{target}: cannot be written: has 2 names" in said
    (tmp_path / "other.ndt").unlink()
    figures = tmp_path / "figures.json"
    figures.symlink_to("real.json")
    done = cli("map", log, "-o", target, "--json", figures)
    assert done.exit_code == 0, done.output
    assert figures.is_symlink() and json.loads((tmp_path / "real.json").read_text())["scans"] == 1
