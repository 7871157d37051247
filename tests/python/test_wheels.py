# SPDX-License-Identifier: BSD-3-Clause
"""``tools/wheels``: what it links runs with an older glibc, and unfit wheels and wrong calls are named."""

from __future__ import annotations

import ctypes
import importlib.util
import platform
import shutil
import subprocess
import sys
import time
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
NEWEST = (2, 28)
#: Calls what came after glibc 2.28, by headers and within libstdc++; Python's own functions stay undefined.
SOURCE = """
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <filesystem>
#include <mutex>
#include <random>
#include <shared_mutex>
#include <string>
#include <thread>

extern "C" void PyErr_Clear();
extern "C" void call_python() { PyErr_Clear(); }
extern "C" double distance(double x, double y) { return std::hypot(x, y) + std::log(x) - std::log(x); }
extern "C" double size(const char* path) { return static_cast<double>(std::filesystem::file_size(path)); }
extern "C" int differ() { std::random_device device; return device() != device(); }
extern "C" int number(const char* text) { return std::stoi(text); }
extern "C" int caught(const char* text) {
  try { return std::stoi(text); } catch (const std::exception&) { return -1; }
}
std::chrono::steady_clock::time_point in(int ms) {
  return std::chrono::steady_clock::now() + std::chrono::milliseconds(ms);
}
extern "C" int sum_of_threads() {
  int sum = 0; std::mutex mutex;
  auto add = [&] { for (int i = 0; i < 1000; ++i) { const std::lock_guard lock(mutex); ++sum; } };
  std::thread first(add), second(add); first.join(); second.join();
  return sum;
}
extern "C" int times_out(int ms) {
  std::mutex mutex; std::condition_variable condition; std::unique_lock lock(mutex);
  return !condition.wait_until(lock, in(ms), [] { return false; });
}
extern "C" int lock_times_out(int ms) {
  std::shared_timed_mutex mutex; bool locked = true; mutex.lock();
  std::thread other([&] { locked = mutex.try_lock_shared_until(in(ms)); });
  other.join(); mutex.unlock();
  return !locked && mutex.try_lock_for(std::chrono::milliseconds(ms));
}
"""


@pytest.fixture(scope="module")
def wheels() -> ModuleType:
    loader = SourceFileLoader("ndtree_tools_wheels", str(ROOT / "tools/wheels"))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(ROOT / "tools"))
    sys.modules[loader.name] = module
    try:
        loader.exec_module(module)
    finally:
        sys.path.remove(str(ROOT / "tools"))
    return module


def needs(library: Path) -> tuple[set[str], set[str]]:
    """The libraries that one names, and the versions that it wants of them."""
    said = subprocess.run(
        ["readelf", "--dynamic", "--version-info", "--wide", library],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    named = {line.split("[")[1].rstrip("]") for line in said.splitlines() if "(NEEDED)" in line}
    return named, {line.split("Name: ")[1].split()[0] for line in said.splitlines() if "Name: " in line}


@pytest.fixture(scope="module")
def linked(wheels: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same objects, linked as usual and for the older glibc."""
    if platform.libc_ver()[0] != "glibc" or not shutil.which("g++") or not shutil.which("readelf"):
        pytest.skip("links with glibc and GCC alone")
    folder = tmp_path_factory.mktemp("linked")
    (folder / "source.cpp").write_text(SOURCE)
    common = ["g++", "-shared", "-pthread", folder / "source.o"]
    subprocess.run(["g++", "-std=c++17", "-fPIC", "-c", folder / "source.cpp", "-o", common[-1]], check=True)
    glibc = wheels.OldGlibc(folder / "glibc", NEWEST)
    subprocess.run([*common, "-o", folder / "usual.so"], check=True)
    subprocess.run([*common, *glibc.link_options, "-o", folder / "old.so"], check=True)
    return {name: folder / f"{name}.so" for name in ("usual", "old")}


def test_what_is_linked_wants_nothing_newer(wheels: ModuleType, linked: dict[str, Path]) -> None:
    old_glibc = sys.modules["old_glibc"]
    named, versions = needs(linked["old"])
    glibc = [version for version in map(old_glibc.parse_version, versions) if version]
    assert glibc
    assert max(glibc) <= NEWEST
    assert not any(version.startswith("GLIBCXX") for version in versions)
    assert not any(name.startswith("libstdc++") for name in named)
    assert {"libc.so.6", "libpthread.so.0"} <= named
    assert wheels.foreign_symbols(linked["old"]) == []
    if tuple(int(part) for part in platform.libc_ver()[1].split(".")) >= (
        2,
        35,
    ):  # What was to be avoided is there.
        usual = [version for version in map(old_glibc.parse_version, needs(linked["usual"])[1]) if version]
        assert max(usual) > NEWEST


def test_what_is_linked_does_what_it_did(linked: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"12345")
    for library in map(ctypes.CDLL, map(str, linked.values())):
        library.distance.restype = library.size.restype = ctypes.c_double
        library.distance.argtypes = [ctypes.c_double, ctypes.c_double]
        assert library.distance(3, 4) == 5
        assert library.size(str(tmp_path / "file").encode()) == 5
        assert library.differ() == 1
        assert library.number(b"123") == 123
        assert library.caught(b"text") == -1
        assert library.sum_of_threads() == 2000
        for wait in (library.times_out, library.lock_times_out):
            start = time.monotonic()
            assert wait(50) == 1
            assert 0.045 < time.monotonic() - start < 10


LISTING = """
Symbol table '.dynsym' contains 9 entries:
   Num:    Value          Size Type    Bind   Vis      Ndx Name
     0: 0000000000000000     0 NOTYPE  LOCAL  DEFAULT  UND
     1: 0000000000000010    10 FUNC    GLOBAL DEFAULT   15 memcpy@@GLIBC_2.14
     2: 0000000000000010    10 IFUNC   GLOBAL DEFAULT   15 memcpy@GLIBC_2.2.5
     3: 0000000000000020    10 FUNC    GLOBAL DEFAULT   15 pthread_once@@GLIBC_2.34
     4: 0000000000000020    10 FUNC    GLOBAL DEFAULT   15 pthread_once@GLIBC_2.2.5
     5: 0000000000000030    10 FUNC    WEAK   DEFAULT   15 arc4random@@GLIBC_2.36
     6: 0000000000000040     8 OBJECT  GLOBAL DEFAULT   16 stderr@@GLIBC_2.2.5
     7: 0000000000000000     0 FUNC    GLOBAL DEFAULT  UND __tls_get_addr@GLIBC_2.3 (4)
     8: 0000000000000050    10 FUNC    GLOBAL DEFAULT   15 __libc_main@@GLIBC_PRIVATE
"""


@pytest.mark.parametrize(
    ("newest", "libc", "libpthread"),
    [
        ((2, 28), {"memcpy": "GLIBC_2.14", "stderr": "GLIBC_2.2.5"}, {"pthread_once": "GLIBC_2.2.5"}),
        ((2, 13), {"memcpy": "GLIBC_2.2.5", "stderr": "GLIBC_2.2.5"}, {"pthread_once": "GLIBC_2.2.5"}),
        ((2, 35), {"memcpy": "GLIBC_2.14", "pthread_once": "GLIBC_2.34", "stderr": "GLIBC_2.2.5"}, {}),
    ],
)
def test_each_symbol_has_its_newest_version_until_then(
    wheels: ModuleType, newest: tuple[int, ...], libc: dict[str, str], libpthread: dict[str, str]
) -> None:
    old_glibc = sys.modules["old_glibc"]
    found = old_glibc.symbols_until(old_glibc.defined_symbols(LISTING), newest)
    assert {symbol.name: symbol.version for symbol in found["libc.so.6"]} == libc
    assert {symbol.name: symbol.version for symbol in found["libpthread.so.0"]} == libpthread
    assert {symbol.name: symbol.size for symbol in found["libc.so.6"]}["stderr"] == 8


@pytest.mark.parametrize(
    ("platform_tag", "size", "expected"),
    [
        ("manylinux_2_28_x86_64", 5_999_999, None),
        ("manylinux_2_17_x86_64.manylinux2014_x86_64", 1, None),
        ("manylinux_2_35_x86_64.manylinux_2_28_x86_64", 1, None),
        ("manylinux1_i686", 1, None),
        ("manylinux_2_31_x86_64", 1, "manylinux_2_31_x86_64: wants a newer glibc than 2.28"),
        ("linux_x86_64", 1, "linux_x86_64: expected manylinux, of glibc 2.28 or older"),
        ("musllinux_1_2_x86_64", 1, "musllinux_1_2_x86_64: expected manylinux, of glibc 2.28 or older"),
        ("manylinux_2_28_x86_64", 6_540_000, "6.54 MB: expected at most 6 MB"),
    ],
)
def test_an_unfit_wheel_is_told(
    wheels: ModuleType, tmp_path: Path, platform_tag: str, size: int, expected: str | None
) -> None:
    wheel = tmp_path / f"ndtree_mapping-1.2.3-cp311-cp311-{platform_tag}.whl"
    with wheel.open("wb") as file:
        file.truncate(size)
    assert wheels.problems_of(wheel, NEWEST) == ([] if expected is None else [expected])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--glibc", "2.17"], "--glibc 2.17: expected 2.28 or later"),
        (["--glibc", "new"], "--glibc new: expected 2.28 or later"),
        (["--debian", "../etc"], "--debian ../etc: expected a release's name"),
        (["--python", "/nowhere/python3"], "--python /nowhere/python3: is no Python 3 that runs"),
        (["--python", "/bin/true"], "--python /bin/true: is no Python 3 that runs"),
        (["--fast"], "unrecognized arguments: --fast"),
    ],
)
def test_a_wrong_call_is_told_in_one_line(arguments: list[str], said: str, tmp_path: Path) -> None:
    folder = tmp_path / "index"
    done = subprocess.run(
        [sys.executable, ROOT / "tools/wheels", *arguments, folder],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode in (1, 2)
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not folder.exists()
