# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree map``: a log becomes a map."""

import time
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from ndtree._flags import map_options, reading_options
from ndtree._progress import mapping_progress
from ndtree.commands.app import app, examples, reports_errors
from ndtree.commands.figures import counted, map_figures, print_map
from ndtree.commands.logs import limit_of, made, new_map, settled, skipped, timed, warn_of_skipped
from ndtree.commands.map_tiles import is_tiled, map_into_tiles
from ndtree.commands.options import Dim, GivenLog, Json, MaxRange, NoReturnKind, NoReturnOption, Port
from ndtree.commands.output import check_picture, check_target, is_stdout, write_json
from ndtree.commands.pictures import draw, observers_of, plotting, stay
from ndtree.exit_status import WrongCall
from ndtree.files import replaced
from ndtree.settings import BEYOND_MEMORY


@app.command(
    "map",
    epilog=examples(
        "ndtree map drive.bag",
        "ndtree map intel.log.gz -o intel.ndt --picture intel.png",
        "ndtree map room.npz -o room.ndt --min-cell-size 0.025 --range-sigma-quadratic 0.0015",
        "ndtree map drive.bag -o drive.ndt --topic /scan --fixed-frame map --from 10 --keep-going",
        "ndtree map city.bag -o city.tiles --max-resident 500MB",
    ),
)
@reports_errors
@reading_options
@map_options
def map_(
    log: GivenLog,
    output: Annotated[
        Optional[Path],
        typer.Option(
            "--output",
            "-o",
            metavar="MAP",
            help="Where the map is written; else LOG's name with .ndt, here. .tiles: a folder of tiles.",
        ),
    ] = None,
    fixed: Annotated[bool, typer.Option("--fixed", help="All cells of one size.")] = False,
    picture: Annotated[Optional[Path], typer.Option(metavar="PNG", help="Draw the map, too.")] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Show it on a page while it grows.")] = False,
    port: Port = None,
    record: Annotated[
        Optional[Path], typer.Option(metavar="FILE", help="Film how it grows: .mp4 or .gif.")
    ] = None,
    record_every: Annotated[
        Optional[int],
        typer.Option(min=1, help="Scans from picture to picture of the film; else 10.", show_default=False),
    ] = None,
    max_resident: Annotated[
        Optional[str],
        typer.Option(
            metavar="SIZE",
            help="Memory of the cells of a .tiles map, as 500MB; else 2GiB.",
            show_default=False,
        ),
    ] = None,
    tile_size: Annotated[
        Optional[float],
        typer.Option(
            help="Least edge of its tiles \\[m]; else that of 16 largest cells.", show_default=False
        ),
    ] = None,
    dim: Dim = None,
    max_range: MaxRange = None,
    no_return: NoReturnOption = NoReturnKind.auto,
    json_file: Json = None,
    options: Any = None,
    reading: Any = None,
) -> None:
    """Build a map from a log, and write it to a file.

    A map in tiles may be larger than memory, and one that was killed goes on where it was.
    """
    begin = time.perf_counter()
    output = _named_as(log) if output is None else output
    limit = limit_of(max_range)
    opened = reading.open(log, dim, max_range)
    read_seconds = time.perf_counter() - begin
    plot = plotting() if picture else None
    tiled = is_tiled(output)
    _refuse_others(
        output,
        {"--max-resident": max_resident, "--tile-size": tile_size}
        if not tiled
        else {"--picture": picture, "--watch": watch or None, "--record": record},
        tiled,
    )
    for path in (None if tiled else output, json_file, record):
        check_target(path)
    check_picture(plot, picture)
    made(lambda: new_map(opened.dim, fixed, options))
    settings = settled(opened, options, limit, no_return.value, with_sigma=True)
    if tiled:
        found = map_into_tiles(opened, output, settings, fixed, tile_size, max_resident)
        figures = {"format": opened.format, "uses": opened.uses, "skipped": skipped(opened), **found}
        if not is_stdout(json_file):
            known = f", {found['known_scans']} of them known already" if found["known_scans"] else ""
            print(f"{log}: {found['scans']} scans{known}, {counted(found['beams'])}")
            for line in settings.lines():
                print(f"  {line}")
            print(
                f"  {found['observed_leaves']:,} cells in {found['tiles']} tiles of {found['tile_size']:g} m"
                f", {found['bytes'] / 1e6:.1f} MB"
            )
            print(
                f"read in {found['read_seconds']:.3f} s, inserted in {found['seconds']:.3f} s; wrote {output}"
            )
        write_json(figures, json_file)
        warn_of_skipped(opened)
        return
    target = new_map(opened.dim, fixed, settings.options)
    report = dict.fromkeys(("beams", "returned", "not_returned", "beyond_max_range", "invalid"), 0)
    seconds, scans, ignored = 0.0, 0, 0
    looking_on = observers_of(watch, port, record, record_every)
    with looking_on as observers, mapping_progress(opened, target) as advance:
        for number, (scan, took) in enumerate(timed(opened)):
            read_seconds += took
            if settings.no_return == "ignore":
                beams = len(scan)
                scan = scan.returned_only()
                ignored += beams - len(scan)
            try:
                one = scan.insert_into(target, max_range=settings.max_range)
            except ValueError as error:
                opened._skip("scans that cannot be mapped", ValueError(f"{log}: scan {number}: {error}"))
                continue
            except MemoryError:
                raise ValueError(f"{log}: scan {number}: {BEYOND_MEMORY}") from None
            report = {key: count + getattr(one, key) for key, count in report.items()}
            seconds += one.seconds
            scans += 1
            for observer in observers:
                observer.update(target, scan)
            advance(scans, report["beams"])
        if not scans:
            raise ValueError(f"{log}: no scans, expected at least one")
    if ignored:
        report = {**report, "beams": report["beams"] + ignored, "ignored": ignored}
    if not any(report[kind] for kind in ("returned", "not_returned", "beyond_max_range")):
        raise ValueError(f"{log}: nothing to map in {scans} scans, {counted(report)}")
    if plot and picture:
        with replaced(picture) as path:
            draw(plot, target, path)
    target.save(output)
    figures = {
        "log": str(log),
        "format": opened.format,
        "uses": opened.uses,
        "chosen": None if settings.look is None else settings.look.figures(),
        "scans": scans,
        "beams": report,
        "seconds": seconds,
        "read_seconds": read_seconds,
        "skipped": skipped(opened),
        **map_figures(target),
    }
    if not is_stdout(json_file):
        print(f"{log}: {scans} scans, {counted(report)}")
        for line in ([f"uses {opened.uses}"] if opened.uses else []) + settings.lines():
            print(f"  {line}")
        print_map(target)
        written = " and ".join(str(path) for path in (output, picture, record) if path)
        print(f"read in {read_seconds:.3f} s, inserted in {seconds:.3f} s; wrote {written}")
        print(f"look at it: ndtree view {output} --open")
    write_json(figures, json_file)
    warn_of_skipped(opened)
    if watch:
        stay(observers[0], target, json_file)


def _refuse_others(output: Path, given: dict[str, Any], tiled: bool) -> None:
    for flag, value in given.items():
        if value is not None:
            raise WrongCall(f"{flag}: is {'not ' if tiled else ''}for a map in tiles, -o {output}")


#: Endings that stand behind another one.
_OUTER = (".gz", ".zst", ".zstd", ".active")


def _named_as(log: Path) -> Path:
    """A map in this folder with a log's name, if there is none yet: nothing is replaced that nobody named."""
    path = log.resolve()
    name = Path(path.name)
    if not path.is_dir():
        name = Path(name.stem) if name.suffix in _OUTER else name
        name = Path(name.stem)
    target = Path(f"{name}.ndt")
    if target.exists():
        raise WrongCall(f"{target}: is there already, expected -o MAP, which may be the same")
    return target
