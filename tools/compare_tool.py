# SPDX-License-Identifier: BSD-3-Clause
"""Calls ndtree-compare, for the scripts in this folder."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def compared(source: str, options: list[str], report: Path) -> dict:
    """What ndtree-compare says of a log, or of "world NAME", and writes to `report`. Leaves on its errors."""
    log = ["--world", source.removeprefix("world ")] if source.startswith("world ") else [source]
    done = subprocess.run(
        [_tool(), *log, *options, "--json", str(report)], stdout=subprocess.DEVNULL, check=False
    )
    if done.returncode:
        sys.exit(done.returncode)
    return json.loads(report.read_text())


def _tool() -> str:
    for place in (shutil.which("ndtree-compare"), ROOT / "build" / "release" / "tools" / "ndtree-compare"):
        if place and Path(place).exists():
            return str(place)
    sys.exit(f"{Path(sys.argv[0]).name}: ndtree-compare is not on PATH: run tools/demo first")
