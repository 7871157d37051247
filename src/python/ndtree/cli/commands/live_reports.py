# SPDX-License-Identifier: BSD-3-Clause
"""What ``ndtree live`` says of its map, while it grows and in the end."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Optional

import numpy as np

from ndtree.alignment.writing import is_trajectory
from ndtree.base.files import replaced
from ndtree.base.words import number_of
from ndtree.cli.commands.figures import map_figures, print_map
from ndtree.cli.commands.messages import in_words, indented
from ndtree.cli.commands.output import is_stdout, write_json
from ndtree.live import LiveMapper, Localization, Localizer, Slam
from ndtree.live.localizing import quaternion_of

#: How often a page is drawn anew, and a line on a terminal [s].
PAGE, LINE = 0.5, 0.5
#: Where the map or the trajectory goes, and the figures.
Files = tuple[Optional[Path], Optional[Path]]


class Page:
    """A page of the map as it grows, as a sink."""

    period = PAGE

    def __init__(self, port: Optional[int]) -> None:
        from ndtree.viewer import PORT, Viewer

        self._viewer = Viewer(port=PORT if port is None else port)
        print(f"{self._viewer.url} shows the map as it grows", file=sys.stderr, flush=True)

    def update(self, m: Any, stamp: float) -> None:
        if m.stats().observed_leaves:
            self._viewer.show(m)

    def stay(self) -> None:
        """Until the user interrupts."""
        print(f"{self._viewer.url} until Ctrl-C", file=sys.stderr, flush=True)
        self._viewer.wait()
        self._viewer.close()


@contextmanager
def line(mapper: LiveMapper) -> Iterator[None]:
    """One line on a terminal that says what becomes of the scans."""
    if not sys.stderr.isatty():
        yield
        return
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(LINE):
            said = in_words(mapper.undecided) or mapper.figures.summary()
            print(f"\r\x1b[2K{said[:110]}", end="", file=sys.stderr, flush=True)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        print("\r\x1b[2K", end="", file=sys.stderr, flush=True)


def _print_head(mapper: LiveMapper, name: str) -> None:
    print(f"{name}: {mapper.figures.summary()}")
    for line in mapper.intake.said():
        print(indented(line))


def _delays(mapper: LiveMapper, what: str, is_paced: bool) -> str:
    """How long scans took; nothing where all of a recording waited from the start."""
    if not is_paced:
        return ""
    median, late = (1e3 * mapper.figures.delay(q) for q in (0.5, 0.99))
    return f"; from arrival to {what}: median {median:.1f} ms, 99 % within {late:.1f} ms"


def _wrote(output: Optional[Path]) -> str:
    return f"; wrote {output}" if output else ""


def report_places(
    mapper: LiveMapper,
    localizer: Localizer,
    found: list[Localization],
    files: Files,
    name: str,
    is_paced: bool,
) -> None:
    """What was found, as a trajectory and in a line."""
    figures, (output, json_file) = mapper.figures, files
    if not found:
        raise ValueError(f"{name}: no scan could be looked for: {figures.summary()}")
    known = [one for one in found if not one.is_lost]
    if not known:
        raise ValueError(f"{name}: found nowhere in the map: {figures.summary()}; expected --guess X,Y,YAW")
    if output is not None:
        with replaced(output, is_trajectory) as written, open(written, "w", encoding="ascii") as file:
            for one in known:
                place = np.zeros(3)
                place[: localizer.dim] = one.body[:-1, -1]
                numbers = (*place, *quaternion_of(one.body))
                file.write(f"{one.stamp:.9f} {' '.join(f'{x:.9g}' for x in numbers)}\n")
    if not is_stdout(json_file):
        _print_head(mapper, name)
        times = localizer.times_lost
        lost = f"lost {number_of(times, 'time')}" if times else "never lost once found"
        counts = f"{len(known)} of {len(found)} scans localized, {lost}"
        print(f"{counts}{_delays(mapper, 'pose', is_paced)}{_wrote(output)}")
    said = {"found": len(known), "times_lost": localizer.times_lost, "is_lost": localizer.is_lost}
    write_json({"log": name, "live": figures.as_dict(), **said}, json_file)


def report(
    mapper: LiveMapper, seconds: float, files: Files, name: str, slam: Optional[Slam], is_paced: bool
) -> None:
    """What was mapped, into a file and in some lines."""
    figures, (output, json_file) = mapper.figures, files
    if not figures.mapped:
        raise ValueError(f"{name}: nothing was mapped: {figures.summary()}")
    m = mapper.snapshot()
    if output is not None:
        m.save(output)
    of_map, poses = map_figures(m), None if slam is None else slam.figures()
    if not is_stdout(json_file):
        _print_head(mapper, name)
        if slam is not None:
            print(indented(slam.summary()))
        print_map(of_map)
        print(
            f"{seconds:.3f} s, of which {figures.insert_seconds:.3f} s inserting"
            f"{_delays(mapper, 'map', is_paced)}{_wrote(output)}"
        )
    for sink, error in mapper.failures.items():
        print(f"ndtree: {sink}: {error}", file=sys.stderr)
    said = {"notes": mapper.intake.said(), **({} if poses is None else {"slam": poses})}
    write_json({"log": name, "seconds": seconds, "live": figures.as_dict(), **said, **of_map}, json_file)
