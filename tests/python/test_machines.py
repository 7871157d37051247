# SPDX-License-Identifier: BSD-3-Clause
"""The same scans make the same file on x86-64 and on ARM, with no flag of the compiler that says so.

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


def tool(name: str) -> str:
    return shutil.which(name) or pytest.skip(f"no {name} here")


def compiling(compiler: str, program: Path, *flags: str) -> subprocess.Popen[bytes]:
    source = ROOT / "tests" / "cpp" / "alone" / "same_map.cpp"
    return subprocess.Popen(
        [
            *(compiler, "-std=c++17", "-O2", "-static", "-pthread", *flags),
            *(f"-I{ROOT / 'include'}", f"-isystem{EIGEN}", str(source), "-o", str(program)),
        ]
    )


def test_maps_are_the_same_on_arm_to_the_last_bit(tmp_path: Path) -> None:
    if platform.machine() != "x86_64":
        pytest.skip("compares x86-64 with ARM")
    here, there, emulator = tool("g++"), tool("aarch64-linux-gnu-g++"), tool("qemu-aarch64-static")
    if not EIGEN.is_dir():
        pytest.skip(f"no {EIGEN}")
    programs = {
        "x86-64": (here, ()),
        "x86-64 with FMA": (here, ("-mfma",)),
        "arm": (there, ("-DNDTREE_NO_SIMDE",)),
        "arm with SIMDe, if it is there": (there, ()),
    }
    compilers = [compiling(c, tmp_path / name, *flags) for name, (c, flags) in programs.items()]
    assert [c.wait() for c in compilers] == [0] * len(compilers)
    has_fma = " fma " in Path("/proc/cpuinfo").read_text(encoding="utf-8")
    maps, widths = {}, {}
    for name in programs:
        if "FMA" in name and not has_fma:
            continue
        run = [emulator] if "arm" in name else []
        for width in (1, 8):
            file = tmp_path / "map.ndt"
            done = subprocess.run(
                [*run, tmp_path / name, file, str(width)], check=True, capture_output=True, text=True
            )
            maps[name, width] = file.read_bytes()
            widths[name, width] = int(done.stdout)
    assert widths["arm", 8] == 1  # Without SIMDe.
    if Path("/usr/include/simde/x86/avx2.h").exists():
        assert widths["arm with SIMDe, if it is there", 8] == 8
    expected = maps["x86-64", 1]
    assert len(expected) > 100_000
    assert [name for name, map in maps.items() if map != expected] == []
