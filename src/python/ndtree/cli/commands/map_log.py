# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree map``: a log becomes a map, and so do several: one each, or one of all."""

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

import typer

from ndtree.base.exit_status import BAD_INPUT, WrongCall
from ndtree.cli.commands.app import print_error, reason_of
from ndtree.cli.commands.flags import Call, GivenLogs, command, opened
from ndtree.cli.commands.logs import inspected, made, skipped, warn_of_skipped
from ndtree.cli.commands.map_tiles import is_tiled, map_into_tiles, print_tiled
from ndtree.cli.commands.mapping import Mapped, mapped, written
from ndtree.cli.commands.messages import in_words
from ndtree.cli.commands.output import check_dim, check_output, check_picture, fits_map, is_stdout, write_json
from ndtree.cli.commands.pictures import observers_of, plotting, stay
from ndtree.cli.commands.shows import showing, wait_at
from ndtree.logs import JoinedLog, Log
from ndtree.maps.open import is_map
from ndtree.tuning.config import Config


@command(
    "map",
    usual="min_cell_size max_range topic trajectory picture",
    examples=(
        "ndtree map drive.bag",
        "ndtree map office.npz -o office.ndt --picture office.png",
        "ndtree map room.npz -o room.ndt --min-cell-size 0.025 --range-sigma-quadratic 0.0015",
        "ndtree map drive.bag -o drive.ndt --topic /scan --fixed-frame map --from 10 --keep-going",
        "ndtree map monday.bag tuesday.bag -o maps/",
        "ndtree map monday.bag tuesday.bag --merge -o both.ndt",
        "ndtree map drive.log --align -o drive.ndt",
        "ndtree map crowded.bag -o hall.ndt --static",
        "ndtree map city.bag -o city.tiles --max-resident 500MB",
    ),
)
def map_(logs: GivenLogs, call: Call, given: Config) -> None:
    """Build a map from a log, and write it to a file. Several logs make a map each, or with --merge one.

    A map in tiles may be larger than memory; the same call continues a killed run.
    """
    output = call.output
    wanted = _Wanted(given, call.static, call.align, call.write_config)
    if call.align and call.merge:
        raise WrongCall("--align: makes a frame for each log, expected no --merge")
    of_one = {"--picture": call.picture, "--record": call.record, "--watch": call.watch or None}
    of_one |= {"--foxglove": call.foxglove, "--rerun": call.rerun}
    of_tiles = {"--max-resident": call.max_resident, "--tile-size": call.tile_size}
    if len(logs) > 1 and not call.merge:
        of_one["--write-config"] = call.write_config
        _refuse(of_one, "is for one map, expected one LOG, or --merge")
        if output is not None and is_tiled(output):
            raise WrongCall(f"{output}: is a map in tiles, expected one LOG, or --merge")
        _refuse(of_tiles, f"is for a map in tiles, -o {output or 'MAP'}")
        outputs = _maps_in(output, logs)
        for path in outputs:
            check_output("-o", path, logs, fits_map)
        _map_each(logs, outputs, wanted, call.json_file)
        return
    is_folder = output is not None and output.is_dir() and not (call.merge or is_tiled(output))
    if output is None or is_folder:
        output = _named_as(logs[0]) if output is None else output / _map_name(logs[0])
        check_output("-o", output, logs, fits_map)
    begin = time.perf_counter()
    log = wanted.open(logs)
    read_seconds = time.perf_counter() - begin
    plot = plotting() if call.picture else None
    if is_tiled(output):
        _refuse({**of_one, "--static": call.static or None}, f"is not for a map in tiles, -o {output}")
        _map_tiled(wanted, log, output, call)
        return
    _refuse(of_tiles, f"is for a map in tiles, -o {output}")
    check_dim("-o", output, log.dim)
    check_picture(plot, call.picture)
    with ExitStack() as stack:
        shown = showing(call, stack)
        with observers_of(call.watch, call.port, call.record, call.record_every) as observers:
            done = wanted.map(log, read_seconds, [*observers, *filter(None, [shown])])
        if shown is not None:
            shown.end(done.target)
        written(done, output, plot, call.picture)
        figures = done.figures()
        if not is_stdout(call.json_file):
            done.print(output, call.picture, call.record)
            print(f"look at it: ndtree view {output} --open")
        write_json(figures, call.json_file)
        warn_of_skipped(done.log)
        if call.watch:
            stay(observers[0], done.target, call.json_file)
        elif shown is not None and shown.url:
            wait_at(shown.url)


@dataclass(frozen=True)
class _Wanted:
    """How logs are mapped."""

    given: Config
    static: bool
    align: bool
    write_config: Optional[Path]

    def open(self, logs: Sequence[Path]) -> Log:
        found = [_aligned(self.given, log) if self.align else opened(self.given, log) for log in logs]
        return found[0] if len(found) == 1 else JoinedLog(found)

    def config(self, log: Log) -> tuple[Log, Config]:
        """What is decided for a log, and the log as it is read then."""
        made(lambda: self.given.new_map(log.dim))
        log, config = inspected(log, self.given)
        if self.write_config is not None:
            config.save(self.write_config)
        return log, config

    def map(self, log: Log, read_seconds: float, observers: Sequence[Any] = ()) -> Mapped:
        log, config = self.config(log)
        return mapped(log, config, read_seconds=read_seconds, observers=observers, static=self.static)


def _aligned(given: Config, path: Path) -> Log:
    """A log with poses that fit what its scans saw."""
    from ndtree.cli.commands.align import aligned, opened_at_rest  # Not for all other maps.

    found = aligned(opened_at_rest(given, path))
    return found.log.noted(f"aligned: {found}")


def _map_each(
    logs: Sequence[Path], outputs: Sequence[Path], wanted: _Wanted, json_file: Optional[Path]
) -> None:
    """A map of each log; one that cannot be mapped does not stop the others."""
    figures: list[dict[str, Any]] = []
    failed = 0
    for log, output in zip(logs, outputs):
        begin = time.perf_counter()
        try:
            done = wanted.map(wanted.open([log]), time.perf_counter() - begin)
            written(done, output)
        except (OSError, ValueError, MemoryError, RuntimeError) as error:
            failed += 1
            figures.append({"log": str(log), "error": in_words(reason_of(error))})
            print_error(reason_of(error))
            continue
        figures.append({**done.figures(), "map": str(output)})
        if not is_stdout(json_file):
            done.print(output)
        warn_of_skipped(done.log)
    write_json({"maps": figures}, json_file)
    if failed:
        raise typer.Exit(BAD_INPUT)


def _map_tiled(wanted: _Wanted, log: Log, output: Path, call: Call) -> None:
    """A map in tiles of a log, or of several as one."""
    log, config = wanted.config(log)
    about = {"format": log.format, "uses": log.uses, "notes": log.notes, "skipped": skipped(log)}
    figures = {**about, **map_into_tiles(log, output, config, call.tile_size, call.max_resident)}
    if not is_stdout(call.json_file):
        print_tiled(figures, config, output)
    write_json(figures, call.json_file)
    warn_of_skipped(log)


def _refuse(given: dict[str, Any], why: str) -> None:
    for name, value in given.items():
        if value is not None:
            raise WrongCall(f"{name}: {why}")


#: Endings that stand behind another one.
_OUTER = (".gz", ".zst", ".zstd", ".active")


def _map_name(log: Path) -> str:
    """A log's name with the ending of maps."""
    path = log.resolve()
    name = Path(path.name)
    if not path.is_dir():
        name = Path(name.stem) if name.suffix in _OUTER else name
        name = Path(name.stem)
    return f"{name}.ndt"


def _named_as(log: Path) -> Path:
    """A map in this folder with a log's name, if there is none yet: only named files are replaced."""
    target = Path(_map_name(log))
    if log.is_file() and is_map(log):
        raise WrongCall(f"{log}: is a map, expected a log; to look at it:\n  ndtree view {log}")
    if target.exists():
        raise WrongCall(f"{target}: is there already, expected -o MAP; to replace it:\n  -o {target}")
    return target


def _maps_in(folder: Optional[Path], logs: Sequence[Path]) -> list[Path]:
    """A map for each log, in a folder that was named, or in this one."""
    names: dict[str, Path] = {}
    for log in logs:
        name = _map_name(log)
        if name in names:
            raise WrongCall(f"{names[name]} and {log}: would both be {name}, expected different names")
        names[name] = log
    if folder is None:
        return [_named_as(log) for log in logs]
    if not folder.is_dir():
        if folder.exists() or folder.suffix:
            raise WrongCall(f"-o {folder}: expected a folder for {len(logs)} maps, or --merge for one")
        folder.mkdir(parents=True)
    return [folder / name for name in names]
