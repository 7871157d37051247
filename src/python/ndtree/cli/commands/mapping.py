# SPDX-License-Identifier: BSD-3-Clause
"""One log becomes one map: inserted scan by scan, and what is said of it."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray

from ndtree._errors import WrongValue, key, located, marked, naming
from ndtree._native._core import OccupancyMap
from ndtree.base.progress import Progress
from ndtree.base.scan import Scan
from ndtree.base.words import listed, number_of
from ndtree.cli.commands.figures import counted, map_figures, print_map
from ndtree.cli.commands.logs import skipped, timed
from ndtree.cli.commands.messages import indented
from ndtree.cli.commands.pictures import draw
from ndtree.cli.commands.progress import busy, mapping_progress, progress
from ndtree.evaluation.moved import MovedPoints
from ndtree.logs import Log
from ndtree.logs.core.joined import Again
from ndtree.tuning.config import Config
from ndtree.tuning.first_look import Scale
from ndtree.tuning.inspection import BEYOND_MEMORY


@dataclass
class StaticScans:
    """Scans of a log without end points on what moved."""

    points: MovedPoints
    seconds: float
    moved: int = 0
    kept: int = 0  # Cells of thin things.

    @classmethod
    def of(cls, log: Log, config: Config, progress: Progress) -> "StaticScans":
        """Reads the log, and goes over its scans twice."""
        begin = time.perf_counter()
        points = MovedPoints(log, config.options, config.max_range, config.no_return).look(progress)
        return cls(points, time.perf_counter() - begin)

    def take(self, scan: Scan) -> Scan:
        cut = self.points.without(scan)
        if cut is not scan:
            self.moved += int(np.count_nonzero(scan.did_return)) - int(np.count_nonzero(cut.returned))
        return cut

    def finish(self, target: OccupancyMap) -> None:
        self.kept = self.points.keep_standing(target)

    def figures(self) -> dict[str, Any]:
        return {
            "points": self.moved,
            "kept_cells": self.kept,
            "seconds": self.seconds,
            "poses": self.points.noise.figures(),
        }

    def __str__(self) -> str:
        noise = f"; {self.points.noise}" if self.points.noise.is_notable else ""
        kept = f"; {number_of(self.kept, 'cell')} of thin things stay occupied" if self.kept else ""
        moved = number_of(self.moved, "point")
        return f"{moved} moved and were left out, found in {self.seconds:.3f} s{kept}{noise}"


@dataclass(frozen=True)
class Mapped:
    """A map, and what it is from."""

    log: Log
    target: OccupancyMap
    config: Config
    report: dict[str, int]
    scans: int
    seconds: float
    read_seconds: float
    track: NDArray[np.float64]  # (2, dim): least and largest coordinates of the sensor [m].
    absurd: Optional[str]
    static_scans: Optional[StaticScans] = None

    def figures(self) -> dict[str, Any]:
        return {
            "log": self.log.name,
            "format": self.log.format,
            "uses": self.log.uses,
            "notes": self.log.notes,
            "chosen": None if self.config.look is None else self.config.look.figures(),
            "scans": self.scans,
            "beams": self.report,
            "absurd": self.absurd,
            "seconds": self.seconds,
            "read_seconds": self.read_seconds,
            "skipped": skipped(self.log),
            **({} if self.static_scans is None else {"moved": self.static_scans.figures()}),
            **self._of_map,
        }

    @cached_property
    def _of_map(self) -> dict[str, Any]:
        """Takes a pass over the leaves: of a map that is done, once."""
        return map_figures(self.target)

    def print(self, *written: Optional[Path]) -> None:
        """What was mapped, and which files were written: the map first."""
        print(f"{self.log.name}: {number_of(self.scans, 'scan')}, {counted(self.report)}")
        lines = [f"uses {self.log.uses}"] if self.log.uses else []
        for line in [*lines, *self.config.notes] + ([self.absurd] if self.absurd else []):
            print(indented(line))
        if self.static_scans is not None:
            print(indented(str(self.static_scans)))
        print_map(self._of_map)
        files = listed([path for path in written if path])
        print(f"read in {self.read_seconds:.3f} s, inserted in {self.seconds:.3f} s; wrote {files}")


@dataclass
class Passage:
    """The scans of a log on their way into a map, and what became of them."""

    log: Log
    config: Config
    read_seconds: float = 0.0
    again: Optional[Again] = None  # Its scans, where others have gone over them.
    scans: int = 0
    ignored: int = 0  # Beams without return, which the settings leave out.
    invalid: int = 0  # Of these, those without a direction or length.

    @cached_property
    def scale(self) -> Scale:
        """What of the inserted scans is absurd."""
        size = self.config.new_map(self.log.dim).options["min_cell_size"]
        return Scale(size, self.config.get("max_range", math.inf))

    def into(
        self, insert: Callable[[Scan], Any], is_final: Callable[[ValueError], bool] = lambda _: False
    ) -> Iterator[tuple[Scan, Any]]:
        """Each scan that was inserted, with what that gave; skips others, unless an error `is_final`."""
        for number, (scan, took) in enumerate(timed(self.log if self.again is None else self.again)):
            self.read_seconds += took
            whole, scan = scan, self.config.usable(scan)
            if len(scan) < len(whole):
                left_out = ~whole.did_return
                way = (whole.endpoints - whole.origin)[left_out]
                self.invalid += int(np.count_nonzero(~np.isfinite(way).all(axis=1) | ~way.any(axis=1)))
                self.ignored += len(way)
            name = f"{self.log.name}: scan {number}"
            try:
                one = insert(scan)
            except ValueError as error:
                if is_final(error):
                    raise
                named = naming(error, "max_range", "min_cell_size", "range_sigma")
                self.log.skip("scans that cannot be mapped", located(name, named))
                continue
            except MemoryError as error:
                said = ValueError(str(error) if "max_memory" in str(error) else BEYOND_MEMORY)
                raise located(name, naming(said, "max_range", "min_cell_size", "max_memory")) from None
            self.scans += 1
            self.scale.add(scan)
            yield scan, one

    def report(self, counts: dict[str, int]) -> dict[str, int]:
        """What a map counted, with the beams that it never saw. @raises ValueError if it saw nothing."""
        if not self.scans:
            raise self.log.without_scans()
        if self.ignored:
            counts = {**counts, "beams": counts["beams"] + self.ignored}
            counts["invalid"] += self.invalid
            counts["ignored"] = self.ignored - self.invalid
        if not any(counts[kind] for kind in ("returned", "not_returned", "beyond_max_range")):
            some = [key(name) for name in ("min_range", "max_range", "box") if name in self.config.values]
            found = f"{number_of(self.scans, 'scan')}, {counted(counts)}"
            why = f", with {listed(some)}" if some else ""
            why += "".join(f"; {marked(note)}" for note in self.log.notes)
            raise WrongValue(f"{self.log.name}: nothing to map in {found}{why}")
        return counts


def mapped(
    log: Log,
    config: Config,
    *,
    read_seconds: float = 0.0,
    observers: Sequence[Any] = (),
    static: bool = False,
) -> Mapped:
    """Insert all scans of a log as it was decided; observers see the map after each.

    With `static`, its scans are gone over twice before, for what moved, and beams do not end there.
    """
    target = config.new_map(log.dim)
    counts = dict.fromkeys(("beams", "returned", "not_returned", "beyond_max_range", "invalid"), 0)
    seconds = 0.0
    track = np.full((2, log.dim), np.nan)
    static_scans: Optional[StaticScans] = None
    if static:
        with progress() as show:
            static_scans = StaticScans.of(log, config, show)
    again = None if static_scans is None else static_scans.points.again
    passage = Passage(log, config, read_seconds, again)

    def insert(scan: Scan) -> Any:
        scan = scan if static_scans is None else static_scans.take(scan)
        return scan.insert_into(target, max_range=config.max_range)

    with mapping_progress(again or log, target) as advance:
        for scan, one in passage.into(insert):
            counts = {key: count + getattr(one, key) for key, count in counts.items()}
            seconds += one.seconds
            origins = np.atleast_2d(scan.origin)
            if len(origins):
                track = np.stack([np.fmin(track[0], origins.min(0)), np.fmax(track[1], origins.max(0))])
            for observer in observers:
                observer.update(target, scan)
            advance(passage.scans, counts["beams"])
    report = passage.report(counts)
    if static_scans is not None:
        static_scans.finish(target)
    absurd = passage.scale.warning()
    return Mapped(
        log, target, config, report, passage.scans, seconds, passage.read_seconds, track, absurd, static_scans
    )


def written(done: Mapped, output: Path, plot: Any = None, picture: Optional[Path] = None) -> None:
    """Write the map, and then its picture: where that fails, the map is there."""
    done.target.save(output)
    if plot and picture:
        with busy(f"drawing {picture}"):
            draw(done.target, picture, track=done.track)
