# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree map``: a log becomes a map, and so do several: one each, one of all, or one in tiles."""

import re
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

import typer

from ndtree._errors import WrongValue
from ndtree.base.exit_status import BAD_INPUT, WrongCall
from ndtree.base.words import number_of
from ndtree.cli.commands.app import print_error, reason_of
from ndtree.cli.commands.figures import counted
from ndtree.cli.commands.flags import Call, GivenLogs, command, opened
from ndtree.cli.commands.logs import inspected, length_of, made, skipped, warn_of_skipped
from ndtree.cli.commands.mapping import Mapped, Passage, mapped, written
from ndtree.cli.commands.messages import in_words, indented
from ndtree.cli.commands.output import check_dim, check_output, check_picture, fits_map, is_stdout, write_json
from ndtree.cli.commands.pictures import observers_of, plotting, stay
from ndtree.cli.commands.progress import progress
from ndtree.cli.commands.shows import showing, wait_at
from ndtree.logs import JoinedLog, Log
from ndtree.maps.open import TILES_SUFFIX, is_map
from ndtree.tiles import TileMapper, open_tiles, storage_of
from ndtree.tiles.mapper import MAX_RESIDENT
from ndtree.tuning.config import Config

_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([kMGT]?)(i?)B?")
_POWERS = {"": 0, "k": 1, "M": 2, "G": 3, "T": 4}


def is_tiled(output: Path) -> bool:
    """Whether a map with this name is one in tiles."""
    return output.suffix.lower() == TILES_SUFFIX


def bytes_of(flag: str, text: Optional[str]) -> int:
    """A size as people write it: 500MB, 2GiB, 1e9 is not one."""
    if text is None:
        return MAX_RESIDENT
    found = _SIZE.fullmatch(text.strip())
    if found is None:
        raise WrongCall(f"{flag} {text}: must be a number of bytes, as 500MB or 2GiB")
    return int(float(found[1]) * (1024 if found[3] else 1000) ** _POWERS[found[2]])


def map_into_tiles(
    log: Log, output: Path, config: Config, tile_size: Optional[float], max_resident: Optional[str]
) -> dict[str, Any]:
    """Map a log, or go on with what was killed. Returns figures."""
    limit = bytes_of("--max-resident", max_resident)
    target = config.new_map(log.dim)
    source = {"log": Path(log.name).name, "no_return": config.no_return, "max_range": str(config.max_range)}
    try:
        mapper = TileMapper(
            storage_of(output), target, tile_size=tile_size, max_resident=limit, made_from=source
        )
    except WrongValue as error:
        if error.option in ("tile_size", "max_resident"):
            raise WrongCall(in_words(error)) from None
        raise
    known = mapper.done
    passage = Passage(log, config)
    with progress() as advance:
        for _ in passage.into(
            lambda scan: mapper.insert(scan, max_range=config.max_range),
            is_final=lambda error: str(error).startswith(str(output)),  # Of the tiles, not of the scan.
        ):
            advance("mapping", passage.scans, length_of(log))
    report = passage.report(dict(mapper.counts))
    mapper.write(complete=True)
    tiles = open_tiles(str(output))
    return {
        "log": str(log.name),
        "scans": passage.scans,
        "known_scans": known,
        "beams": report,
        "absurd": passage.scale.warning(),
        "seconds": mapper.seconds,
        "read_seconds": passage.read_seconds,
        "tiles": len(tiles.manifest.tiles),
        "tile_size": tiles.grid.size,
        "observed_leaves": tiles.observed_leaves,
        "bytes": sum(entry.bytes for entry in tiles.manifest.tiles.values()),
        "max_resident": limit,
    }


def print_tiled(figures: dict[str, Any], config: Config, output: Path) -> None:
    """What map_into_tiles() did."""
    known = f", {figures['known_scans']} of them known already" if figures["known_scans"] else ""
    print(f"{figures['log']}: {number_of(figures['scans'], 'scan')}{known}, {counted(figures['beams'])}")
    for line in [*config.notes] + ([figures["absurd"]] if figures["absurd"] else []):
        print(indented(line))
    print(
        f"  {number_of(figures['observed_leaves'], 'cell')} in {number_of(figures['tiles'], 'tile')} "
        f"of {figures['tile_size']:g} m, {figures['bytes'] / 1e6:.1f} MB"
    )
    print(f"read in {figures['read_seconds']:.3f} s, inserted in {figures['seconds']:.3f} s; wrote {output}")


@command(
    "map",
    usual="min_cell_size max_range topic trajectory picture",
    examples=(
        "ndtree map drive.bag",
        "ndtree map office.npz -o office.ndt --picture office.png",
        "ndtree map room.npz --range-sigma 0.005 --range-sigma-quadratic 0.0015",
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
    for name in logs[1:] if output is None else ():
        if name.suffix in (".ndt", ".bt", ".ot", ".yaml", ".pgm"):
            raise WrongCall(f"{name}: expected a log; to write the map there:\n  -o {name}")
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
