# SPDX-License-Identifier: BSD-3-Clause
"""The command line on damaged files, each tried in a process of its own with limits.

usage: python outcomes.py FIRST COUNT SCRATCH SAMPLE ...     (prints one line of JSON for each file)
       python outcomes.py --one SCRATCH ARGUMENT ...          (of the command line: prints one)

Only two outcomes are right: the file is "read", or "refused" by status 1 and one clear line that names it.
With either, lines may stand beside it that say what was skipped or left out, and name the file.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import shutil
import signal
import sys
import time
from pathlib import Path
from random import Random

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # Threads do not survive a fork.

MEMORY = 1 << 30  # More than the process has at first [bytes].
SECONDS = 20  # Of processor time: other work on the machine does not count.
WAITING = 6  # Times as long it may take in all, by the clock.
LONGEST = 700  # Characters of a line, without the names of files.
_DIGITS = re.compile(r"\d{41,}")
_NOTE = re.compile(
    r" messages? found in it| scans had no pose| each beam at its own time| without return "
    r"|: it is taken as fixed$|^ndtree: field of view of | poses are those of the matching"
    r"|: do both count alike\?$| numbers a point in |^ndtree: (the camera is|depths are) taken as "
)


def info_of(path: Path | str, *options: str) -> list[str]:
    """The call that reads all of a file: of logs a look, maps are read as a whole."""
    is_map = Path(path).suffix.lower() in (".ndt", ".bt", ".ot", ".yaml", ".yml", ".tiles")
    return ["info", str(path), *([] if is_map else ["--look"]), *options]


def outcome_of(arguments: list[str], scratch: Path, *, seconds: int = SECONDS) -> tuple[str, str]:
    """Run the command line in a fork; "read", "refused", or what is wrong, and what it wrote to stderr."""
    errors = scratch / "stderr"
    child = os.fork()
    if child == 0:
        _run(arguments, errors, seconds)
    status = _waited(child, WAITING * seconds)
    said = errors.read_text(errors="backslashreplace") if errors.exists() else ""
    said = re.sub(r"\n {2,}", " ", said)  # Long messages are parted, and go on in lines of their own.
    if status is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        return "never ends", said
    if os.WIFSIGNALED(status):
        return f"killed by {signal.Signals(os.WTERMSIG(status)).name}", said
    return _judged(os.WEXITSTATUS(status), said, scratch), said


def _judged(code: int, said: str, scratch: Path) -> str:
    lines = said.splitlines()
    errors = [line for line in lines if not line.startswith("ndtree: skipped ")]
    if code not in (0, 1):
        return f"ends with status {code}"
    if code == 0:  # What was read is said of it.
        errors = [line for line in errors if not _NOTE.search(line)]
    else:
        errors = [
            line for line in errors if not re.search(" messages? found in it", line) or ", found " in line
        ]
    if len(errors) != code:
        return "a traceback" if "Traceback" in said else f"{len(errors)} lines of errors with status {code}"
    for line in lines:
        bare = line.replace(str(scratch), "")
        if not line.startswith("ndtree: ") or (str(scratch) not in line and not _NOTE.search(line)):
            return "a line that names no file"
        if len(bare) > LONGEST or _DIGITS.search(bare):
            return "a line that is not clear"
    return "refused" if code else "read"


def _waited(child: int, seconds: float) -> int | None:
    end = time.monotonic() + seconds
    pause = 0.0005
    while time.monotonic() < end:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return status
        time.sleep(pause)
        pause = min(2 * pause, 0.05)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def _run(arguments: list[str], errors: Path, seconds: int) -> None:
    code = 99
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
        held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (held + MEMORY, held + MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
        from ndtree.cli import main

        sys.argv = ["ndtree", *arguments]
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0 if end.code is None else 98
        sys.stderr.flush()
    except BaseException:
        import traceback

        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(code)


def tried(sample_name: str, first: int, count: int, scratch: Path):
    """Yields a dict for each damaged file; damaged ones whose outcome is wrong stay in `scratch`."""
    from damage import damage_one
    from samples import SAMPLES, recorded_samples

    from ndtree.cli.commands import every

    every()  # Loaded once, and not in each fork.

    with contextlib.suppress(ImportError):
        import laspy  # noqa: F401
        import PIL.Image  # noqa: F401
        import pypcd4  # noqa: F401
        import trimesh  # noqa: F401
        import yaml  # noqa: F401
    every = {**SAMPLES, **recorded_samples(Path(os.environ.get("NDTREE_DATA", "/nonexistent")))}
    sample = every[sample_name]
    whole = scratch / "whole"
    whole.mkdir(parents=True)
    opened = sample.make(whole).relative_to(whole)
    for number in range(first, first + count):
        here = scratch / f"{number}"
        shutil.copytree(whole, here / "data")
        seed = f"{sample_name} {number}"
        what = damage_one(here / "data", seed)
        path = here / "data" / opened
        if sample.pack:
            path = sample.pack(path)
        options = [str(path / option) if option.endswith(".txt") else option for option in sample.options]
        if not sample_name.startswith("map") and Random(seed).random() < 0.4:
            options.append("--keep-going")
        begin = time.monotonic()
        outcome, said = outcome_of(info_of(path, *options), here)
        yield {
            "sample": sample_name, "number": number, "damaged": what, "outcome": outcome,
            "said": said[-2000:], "seconds": round(time.monotonic() - begin, 3),
        }  # fmt: skip
        if outcome in ("read", "refused"):
            shutil.rmtree(here)


if __name__ == "__main__":
    if sys.argv[1] == "--one":
        print(json.dumps(outcome_of(sys.argv[3:], Path(sys.argv[2]))))
        sys.exit()
    for name in sys.argv[4:]:
        for one in tried(name, int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3], name)):
            print(json.dumps(one), flush=True)
