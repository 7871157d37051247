# SPDX-License-Identifier: BSD-3-Clause
"""Shows how far a build is, from its log: what was compiled, how many of how many, how long yet.

usage: python3 build_progress.py LOG BUILD_FOLDER

A line that changes on a terminal, now and then a line elsewhere. Runs until it is sent SIGTERM.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import time
from pathlib import Path

#: Seconds between looks at the log, and between lines where there is no terminal.
LOOK, LINE = 0.5, 30.0
#: Processor time [s] of parts, by the name of what is made, measured with GCC 12; the first that fits counts.
COSTS = (
    (re.compile(r"\.(a|so|pyd|dylib)$|/ndtree-[\w-]+$|verify_globs"), 0.3),  # Linking.
    (re.compile(r"/prebuilt/maps_\d"), 28.0),
    (re.compile(r"/map_\d"), 23.0),
    (re.compile(r"/comparison\.cpp"), 20.0),
    (re.compile(r"/unity_\d|/logs\.cpp"), 15.0),
    (re.compile(r"/layers_\d"), 16.0),
    (re.compile(r"/npz\.cpp"), 1.3),
    (re.compile(r""), 9.0),
)
#: What a first build in the folder may be asked for, but the tools and the module do not need.
_OTHERS = re.compile(r"(^|/)(tests?|fuzz)/|ndtree_headers_|ndtree-bench")
#: Ninja's lines and make's, which pip indents; ninja counts what it does before building as 0.
_NINJA = re.compile(r"^ *\[([1-9]\d*)/(\d+)\] (.*?) *$", re.M)
_MAKE = re.compile(r"^ *\[ *(\d+)%\] (.*?) *$", re.M)
_PATH = re.compile(r"\S*[./]\S+$")
#: Processor time that was spent on a part in work, on average [s].
_HALF = 8.0
#: Less than this share, or time [s], tells nothing of the time that is left.
_LEAST, _SOONEST = 0.08, 5.0


def cost(path: str) -> float:
    """Processor time of a part [s], by the name of what it makes."""
    return next(seconds for pattern, seconds in COSTS if pattern.search(path))


def objects_of(ninja: str) -> list[str]:
    """What is compiled in a first build, from the text of build.ninja."""
    made = re.findall(r"^build ([^:|\s]+\.(?:o|obj|gch|pch))(?: \|[^:]*)?: ", ninja, re.M)
    return [path for path in dict.fromkeys(made) if not _OTHERS.search(path)]


def share(log: str, objects: list[str], jobs: int = 1) -> tuple[float, str]:
    """How much of a build is done, 0 to 1, and the count and the last part in words, from its log so far.

    A first build is weighed by what parts cost, and the parts in work, one a job, count half. Where only some
    have to be made anew, or there is no plan, which ones are not known beforehand, and all count alike.
    """
    lines = _NINJA.findall(log)
    if lines:
        done, total, _ = lines[-1]
        # Lines since the count began: one log may hold several builds.
        begin = max((i for i, line in enumerate(lines) if line[0] == "1"), default=0)
        finished = [_path(what) for _, _, what in lines[begin:]]
        text = f"{done} of {total}, last {Path(finished[-1]).name.removesuffix('.o')}"
        if not objects or len(objects) > int(total):
            return int(done) / int(total), text
        rest = sum(cost(path) for path in set(objects).difference(finished))
        in_work = min(jobs * _HALF, 0.5 * rest)
        whole = sum(map(cost, finished)) + rest
        return (whole - rest + in_work) / whole, text
    percent = _MAKE.findall(log)
    if percent:
        return int(percent[-1][0]) / 100, f"{percent[-1][0]} %, last {Path(_path(percent[-1][1])).name}"
    return 0.0, "looking for what is there"


def left(done: float, seconds: float) -> float | None:
    """How long it takes yet [s]; None as long as too little is done."""
    return seconds * (1 - done) / done if done >= _LEAST and seconds >= _SOONEST else None


def line_of(text: str, done: float, seconds: float) -> str:
    """One line: the count, the time so far, and the time left."""
    rest = left(done, seconds)
    if rest is None:
        return f"{text}, {clock(seconds)}"
    return f"{text}, {clock(seconds)}, some {clock(rest)} left"


def clock(seconds: float) -> str:
    """Minutes and seconds."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def _path(what: str) -> str:
    found = _PATH.search(what.split(" && ")[0])
    return found[0] if found else what


def main(log: str, folder: str) -> None:
    """Shows it until SIGTERM."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    signal.signal(signal.SIGINT, lambda *_: sys.exit(0))
    is_terminal = sys.stdout.isatty()
    begin, said = time.monotonic(), 0.0
    objects: list[str] = []
    jobs = int(os.environ.get("CMAKE_BUILD_PARALLEL_LEVEL") or os.cpu_count() or 1)
    try:
        while True:
            time.sleep(LOOK)
            try:
                text = Path(log).read_text(errors="replace")
            except OSError:
                continue
            if not objects and "/" in text:
                plan = Path(folder, "build.ninja")
                objects = objects_of(plan.read_text(errors="replace")) if plan.is_file() else []
            done, what = share(text, objects, jobs)
            now = time.monotonic()
            line = line_of(what, done, now - begin)
            if is_terminal:
                sys.stdout.write(f"\r\x1b[2K{line[: shutil.get_terminal_size().columns - 1]}")
                sys.stdout.flush()
            elif now - begin - said >= LINE:
                said = now - begin
                print(line, flush=True)
    finally:
        if is_terminal:
            sys.stdout.write("\r\x1b[2K")
            sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:3])
