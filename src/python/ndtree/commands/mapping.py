# SPDX-License-Identifier: BSD-3-Clause
"""One log becomes one map: inserted scan by scan, and what is said of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

from ndtree._core import OccupancyMap
from ndtree.commands.figures import counted, map_figures, print_map
from ndtree.commands.logs import made, new_map, settled, skipped, timed
from ndtree.commands.pictures import draw
from ndtree.commands.progress import mapping_progress
from ndtree.files import replaced
from ndtree.readers import Log
from ndtree.settings import BEYOND_MEMORY, Settings


@dataclass(frozen=True)
class Mapped:
    """A map, and what it is from."""

    log: Log
    target: OccupancyMap
    settings: Settings
    report: dict[str, int]
    scans: int
    seconds: float
    read_seconds: float

    def figures(self) -> dict[str, Any]:
        return {
            "log": self.log.name,
            "format": self.log.format,
            "uses": self.log.uses,
            "chosen": None if self.settings.look is None else self.settings.look.figures(),
            "scans": self.scans,
            "beams": self.report,
            "seconds": self.seconds,
            "read_seconds": self.read_seconds,
            "skipped": skipped(self.log),
            **map_figures(self.target),
        }

    def print(self, *written: Optional[Path]) -> None:
        """What was mapped, and which files were written: the map first."""
        print(f"{self.log.name}: {self.scans} scans, {counted(self.report)}")
        for line in ([f"uses {self.log.uses}"] if self.log.uses else []) + self.settings.lines():
            print(f"  {line}")
        print_map(self.target)
        files = " and ".join(str(path) for path in written if path)
        print(f"read in {self.read_seconds:.3f} s, inserted in {self.seconds:.3f} s; wrote {files}")


def mapped(
    log: Log,
    fixed: bool,
    options: dict[str, Any],
    *,
    max_range: float,
    no_return: str,
    read_seconds: float = 0.0,
    observers: Sequence[Any] = (),
) -> Mapped:
    """Insert all scans of a log; observers see the map after each."""
    made(lambda: new_map(log.dim, fixed, options))
    settings = settled(log, options, max_range, no_return, with_sigma=True)
    target = new_map(log.dim, fixed, settings.options)
    report = dict.fromkeys(("beams", "returned", "not_returned", "beyond_max_range", "invalid"), 0)
    seconds, scans, ignored = 0.0, 0, 0
    with mapping_progress(log, target) as advance:
        for number, (scan, took) in enumerate(timed(log)):
            read_seconds += took
            if settings.no_return == "ignore":
                beams = len(scan)
                scan = scan.returned_only()
                ignored += beams - len(scan)
            try:
                one = scan.insert_into(target, max_range=settings.max_range)
            except ValueError as error:
                log._skip("scans that cannot be mapped", ValueError(f"{log.name}: scan {number}: {error}"))
                continue
            except MemoryError:
                raise ValueError(f"{log.name}: scan {number}: {BEYOND_MEMORY}") from None
            report = {key: count + getattr(one, key) for key, count in report.items()}
            seconds += one.seconds
            scans += 1
            for observer in observers:
                observer.update(target, scan)
            advance(scans, report["beams"])
        if not scans:
            raise ValueError(f"{log.name}: no scans, expected at least one")
    if ignored:
        report = {**report, "beams": report["beams"] + ignored, "ignored": ignored}
    if not any(report[kind] for kind in ("returned", "not_returned", "beyond_max_range")):
        raise ValueError(f"{log.name}: nothing to map in {scans} scans, {counted(report)}")
    return Mapped(log, target, settings, report, scans, seconds, read_seconds)


def written(done: Mapped, output: Path, plot: Any = None, picture: Optional[Path] = None) -> None:
    """Write the map, and its picture before it."""
    if plot and picture:
        with replaced(picture) as path:
            draw(plot, done.target, path)
    done.target.save(output)
