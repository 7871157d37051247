# SPDX-License-Identifier: BSD-3-Clause
"""The same scans make the same file on x86-64 and on ARM, with no flag of the compiler that says so.

Scans that are simulated or read are the same there, too, with the flag that our own targets have.

Skips where there is no compiler for the other processor, or nothing that runs its programs
(Debian: g++-aarch64-linux-gnu, qemu-user-static, and libsimde-dev for the loops of eight).
"""

from __future__ import annotations

import platform
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EIGEN = Path("/usr/include/eigen3")
FMA = ("-mavx2", "-mfma")  # Of what -march=native says, what could change a map.

RATES = """
#include <cstdio>
#include "ndtree/core/beta.hpp"
int main() {
  for (const int width : {1, 8}) {
    ndtree::Simd::limit(width);
    ndtree::RateComparison rates(0.3);
    for (int i = 0; i < 1000; ++i) {
      const double hits[] = {0.1 * i, 1.7 * i, 3.0, 0.01 * i}, misses[] = {7.3, 0.3 * i, 0.7 * i, 11.9 * i};
      rates.add(hits, misses, 4);
    }
    std::printf("%a\\n", rates.bits_for_many());
  }
}
"""


def tool(name: str) -> str:
    return shutil.which(name) or pytest.skip(f"no {name} here")


def compiling(compiler: str, name: str, program: Path, *flags: str) -> subprocess.Popen[bytes]:
    source = ROOT / "tests" / "cpp" / "alone" / name
    return subprocess.Popen(
        [
            *(compiler, "-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror", "-static", "-pthread", *flags),
            *(f"-I{ROOT / 'include'}", f"-I{ROOT / 'tests' / 'cpp' / 'support'}", f"-isystem{EIGEN}"),
            *(str(source), "-o", str(program)),
        ]
    )


def has_fma() -> bool:
    return " fma " in Path("/proc/cpuinfo").read_text(encoding="utf-8")


@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_sums_are_the_same_where_the_compiler_may_fuse_them(compiler: str, tmp_path: Path) -> None:
    if platform.machine() != "x86_64" or not has_fma():
        pytest.skip("no x86-64 with FMA")
    source = tmp_path / "rates.cpp"
    source.write_text(RATES, encoding="utf-8")
    outputs = set()
    for flags in ((), FMA):
        program = tmp_path / "rates"
        include = f"-I{ROOT / 'include'}"
        subprocess.run(
            [tool(compiler), "-std=c++17", "-O2", *flags, include, source, "-o", program], check=True
        )
        outputs |= set(subprocess.run([program], check=True, capture_output=True, text=True).stdout.split())
    assert len(outputs) == 1


def test_maps_are_the_same_on_arm_to_the_last_bit(tmp_path: Path) -> None:
    if platform.machine() != "x86_64":
        pytest.skip("compares x86-64 with ARM")
    here, there, emulator = tool("g++"), tool("aarch64-linux-gnu-g++"), tool("qemu-aarch64-static")
    if not EIGEN.is_dir():
        pytest.skip(f"no {EIGEN}")
    has_simde = Path("/usr/include/simde/x86/avx2.h").exists()
    programs = {  # However far the compiler optimises, too.
        "x86-64": (here, ("-O1",)),
        "x86-64 with FMA": (here, FMA),
        "arm": (there, ("-DNDTREE_USE_SIMDE",) if has_simde else ()),
    }
    compilers = [
        compiling(c, "same_map.cpp", tmp_path / name, *flags) for name, (c, flags) in programs.items()
    ]
    assert [c.wait() for c in compilers] == [0] * len(compilers)
    maps, widths = {}, {}
    for name in programs:
        if "FMA" in name and not has_fma():
            continue
        run = [emulator] if "arm" in name else []
        for width in (1, 8):
            file = tmp_path / "map.ndt"
            done = subprocess.run(
                [*run, tmp_path / name, file, str(width)], check=True, capture_output=True, text=True
            )
            maps[name, width] = file.read_bytes()
            widths[name, width] = int(done.stdout)
    assert widths["arm", 8] == (8 if has_simde else 1)
    expected = maps["x86-64", 1]
    assert len(expected) > 100_000
    assert [name for name, map in maps.items() if map != expected] == []


def test_scans_that_are_simulated_or_read_are_the_same_on_arm(tmp_path: Path) -> None:
    if platform.machine() != "x86_64" or not has_fma():
        pytest.skip("no x86-64 with FMA: its C library has other sines")
    here, there, emulator = tool("g++"), tool("aarch64-linux-gnu-g++"), tool("qemu-aarch64-static")
    if not EIGEN.is_dir():
        pytest.skip(f"no {EIGEN}")
    flag = "-ffp-contract=off"
    assert flag in (ROOT / "CMakeLists.txt").read_text(encoding="utf-8")
    compilers = [compiling(c, "same_scans.cpp", tmp_path / Path(c).name, "-O1", flag) for c in (here, there)]
    assert [c.wait() for c in compilers] == [0, 0]
    digests = [
        subprocess.run(call, check=True, capture_output=True, text=True).stdout.split()
        for call in ([tmp_path / Path(here).name], [emulator, tmp_path / Path(there).name])
    ]
    assert len(set(digests[0])) == 10
    assert digests[0] == digests[1]
