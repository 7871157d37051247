# SPDX-License-Identifier: BSD-3-Clause
"""The commands of the command line: demo, map, compare, calibrate, view and info."""

import errno
import functools
import json
import math
import sys
import time
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Callable, Optional

import numpy as np
import typer

import ndtree
from ndtree._core import OccupancyMap, ReplacedFile
from ndtree._flags import Reading, map_options, reading_options
from ndtree._options import KINDS, make_map
from ndtree._progress import mapping_progress, progress
from ndtree.comparison import DEFAULT_MAPS, Comparison, compare
from ndtree.conversion import convert
from ndtree.exit_status import BAD_INPUT, WRONG_CALL, WrongCall
from ndtree.files import replaced
from ndtree.map_comparison import compare_maps
from ndtree.maps import is_map, open_map
from ndtree.prospect import prospect_of
from ndtree.readers import FORMATS, Log, simulate
from ndtree.scan import Scan
from ndtree.settings import Settings, settle
from ndtree.writers import FORMATS as MAP_FORMATS
from ndtree.writers import STATES as CELL_STATES
from ndtree.writers import format_of


def _examples(*lines: str) -> str:
    return "\n\n".join(("Examples:", *lines))


def _endings() -> str:
    every = dict.fromkeys(suffix for one in MAP_FORMATS for suffix in one.suffixes)
    return f"Its ending says what is written: {', '.join(every)}."


app = typer.Typer(
    name="ndtree",
    help="Occupancy maps whose cells adapt to what is measured.",
    epilog="Exit status: 0 done, 1 the input is bad, 2 the call is wrong.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


class World(str, Enum):
    """Worlds to simulate."""

    office = "office"
    apartment = "apartment"
    street = "street"


class NoReturnKind(str, Enum):
    """What a beam without return says."""

    auto = "auto"
    free = "free"
    ignore = "ignore"


class CellColor(str, Enum):
    """What the colors of cells say."""

    height = "height"
    size = "size"
    probability = "probability"


# --- Options that commands share --------------------------------------------------------------------

LogArgument = Annotated[
    Optional[Path],
    typer.Argument(metavar="LOG", help=f"File or folder: {', '.join(FORMATS)}.", show_default=False),
]
GivenLog = Annotated[Path, typer.Argument(metavar="LOG", help=f"File or folder: {', '.join(FORMATS)}.")]
Dim = Annotated[
    Optional[int], typer.Option(min=2, max=3, help="2 or 3; else what the log says.", show_default=False)
]
MaxRange = Annotated[
    Optional[float],
    typer.Option(help="Longer beams are free space up to here \\[m]; else no limit.", show_default=False),
]
NoReturnOption = Annotated[
    NoReturnKind,
    typer.Option(help="What a beam without return says: free up to its end point, or nothing; auto: see."),
]
Port = Annotated[
    Optional[int],
    typer.Option(min=0, max=65535, help="Of the page; else 8080. 0: any free one.", show_default=False),
]
Json = Annotated[
    Optional[Path], typer.Option("--json", metavar="FILE", help="Write all figures; - for standard output.")
]
Scans = Annotated[Optional[int], typer.Option(min=1, help="Simulate this many scans.", show_default=False)]
Seed = Annotated[int, typer.Option(min=0, help="Of the simulated log.")]
HeldOut = Annotated[int, typer.Option(min=0, help="Keep each N-th scan for the truth; 0: none.")]
Repeat = Annotated[int, typer.Option(min=1, help="Runs in turns, for the times.")]


def reports_errors(command: Callable[..., None]) -> Callable[..., None]:
    """Ends a command with one line and the right exit status where the input or the call is bad."""

    @functools.wraps(command)
    def guarded(**arguments: Any) -> None:
        try:
            with np.errstate(all="ignore"):  # Absurd numbers in a log are counted, or refused by name.
                command(**arguments)
        except BrokenPipeError:
            raise
        except WrongCall as error:
            _end(str(error), WRONG_CALL)
        except OSError as error:
            where = f"{error.filename}: " if error.filename else ""
            _end(f"{where}{error.strerror or error}", BAD_INPUT)
        except ImportError as error:
            _end(str(error), WRONG_CALL)
        except (ValueError, MemoryError, RuntimeError) as error:
            _end(str(error) or "not enough memory", BAD_INPUT)

    return guarded


def _end(message: str, status: int) -> None:
    print(f"ndtree: {' '.join(message.split())}", file=sys.stderr)
    raise typer.Exit(status)


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"ndtree {ndtree.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


# --- Commands ---------------------------------------------------------------------------------------


@app.command(epilog=_examples("ndtree demo", "ndtree demo intel.log.gz --output pictures"))
@reports_errors
@reading_options
@map_options
def demo(
    log: LogArgument = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the pictures.")] = Path(
        "ndtree-demo"
    ),
    dim: Dim = None,
    max_range: MaxRange = None,
    no_return: NoReturnOption = NoReturnKind.auto,
    scans: Scans = None,
    seed: Seed = 1,
    json_file: Json = None,
    options: Any = None,
    reading: Any = None,
) -> None:
    """Map a log in several ways, print what each map costs and how true it is, and draw them.

    Without LOG it simulates an office.
    """
    opened = _open(log, World.office if log is None else None, dim, reading, scans, seed, max_range)
    size = options.get("min_cell_size", ndtree.default_options()["min_cell_size"])
    maps = ["adaptive", "fixed", f"fixed@{2 * size:g}"]
    if ndtree.has_octomap:
        maps.append("octomap")
    plot = _plot()
    _check_target(json_file)
    comparison = _compare(
        opened, maps, options, max_range=max_range, no_return=no_return.value, json_file=json_file
    )
    _warn_of_skipped(opened)
    if not _is_stdout(json_file):
        print(comparison)
    _write_json(comparison, json_file)
    objects = comparison.map_objects
    output.mkdir(parents=True, exist_ok=True)
    pictures = [output / f"adaptive-{name.replace('@', '-')}.png" for name in maps[1:3]]
    for name, path in zip(maps[1:3], pictures):
        _draw_side_by_side(plot, objects["adaptive"], objects[name], path)
    say = sys.stderr if _is_stdout(json_file) else sys.stdout
    print(file=say)
    for path in pictures:
        print(path, file=say)


@app.command(
    "map",
    epilog=_examples(
        "ndtree map intel.log.gz -o intel.ndt --picture intel.png",
        "ndtree map room.npz -o room.ndt --min-cell-size 0.025 --range-sigma-quadratic 0.0015",
        "ndtree map drive.bag -o drive.ndt --topic /scan --fixed-frame map --from 10 --keep-going",
    ),
)
@reports_errors
@reading_options
@map_options
def map_(
    log: GivenLog,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="MAP", help="Where the map is written.")],
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
    dim: Dim = None,
    max_range: MaxRange = None,
    no_return: NoReturnOption = NoReturnKind.auto,
    json_file: Json = None,
    options: Any = None,
    reading: Any = None,
) -> None:
    """Build a map from a log, and write it to a file."""
    begin = time.perf_counter()
    limit = _limit(max_range)
    opened = reading.open(log, dim, max_range)
    read_seconds = time.perf_counter() - begin
    plot = _plot() if picture else None
    for path in (output, json_file, record):
        _check_target(path)
    _check_picture(plot, picture)
    _made(lambda: _new_map(opened.dim, fixed, options))
    settings = _settled(opened, options, limit, no_return.value, with_sigma=True)
    target = _new_map(opened.dim, fixed, settings.options)
    report = dict.fromkeys(("beams", "returned", "not_returned", "beyond_max_range", "invalid"), 0)
    seconds, scans, ignored = 0.0, 0, 0
    looking_on = _observers(watch, port, record, record_every)
    with looking_on as observers, mapping_progress(opened, target) as advance:
        for number, (scan, took) in enumerate(_timed(opened)):
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
    if plot and picture:
        with replaced(picture) as path:
            _draw(plot, target, path)
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
        "skipped": _skipped(opened),
        **_map_figures(target),
    }
    if not _is_stdout(json_file):
        print(f"{log}: {scans} scans, {_beams(report)}")
        for line in ([f"uses {opened.uses}"] if opened.uses else []) + settings.lines():
            print(f"  {line}")
        _print_map(target)
        written = " and ".join(str(path) for path in (output, picture, record) if path)
        print(f"read in {read_seconds:.3f} s, inserted in {seconds:.3f} s; wrote {written}")
        print(f"look at it: ndtree view {output} --open")
    _write_json(figures, json_file)
    _warn_of_skipped(opened)
    if watch:
        _stay(observers[0], target, json_file)


@app.command(
    "compare",
    epilog=_examples(
        "ndtree compare intel.log.gz --max-range 20 --no-return ignore --json intel.json",
        "ndtree compare --world apartment --maps adaptive,fixed,fixed@0.1,octomap --picture rooms.png",
        "ndtree compare hall.ndt hall.bt --picture differences.png",
    ),
)
@reports_errors
@reading_options
@map_options
def compare_(
    context: typer.Context,
    log: Annotated[
        Optional[Path],
        typer.Argument(metavar="LOG | A", help="A log, or the first of two maps.", show_default=False),
    ] = None,
    other: Annotated[
        Optional[Path],
        typer.Argument(
            metavar="B", help="The second: .ndt, .bt, .ot or map_server's .yaml.", show_default=False
        ),
    ] = None,
    world: Annotated[
        Optional[World], typer.Option(help="Simulate this instead of LOG.", show_default=False)
    ] = None,
    maps: Annotated[
        Optional[str],
        typer.Option(
            help=f"Of {', '.join(KINDS)}, with @ and a cell size where it differs.", show_default=False
        ),
    ] = None,
    held_out: HeldOut = 10,
    repeat: Repeat = 1,
    dim: Dim = None,
    max_range: MaxRange = None,
    no_return: NoReturnOption = NoReturnKind.auto,
    scans: Scans = None,
    seed: Seed = 1,
    json_file: Json = None,
    csv_file: Annotated[
        Optional[Path], typer.Option("--csv", metavar="FILE", help="Write a line a map.")
    ] = None,
    picture: Annotated[
        Optional[Path],
        typer.Option(metavar="PNG", help="Draw the first two maps side by side, or how A and B differ."),
    ] = None,
    options: Any = None,
    reading: Any = None,
) -> None:
    """Compare maps of the same log: cells, updates, time, memory, and truth on scans held out.

    Or two maps A and B of any kind: their states cell by cell, and how far their surfaces are apart.
    """
    if log is not None and (other is not None or is_map(log)):
        _compare_two(context, log, other, json_file, picture)
        return
    if (log is None) == (world is None):
        raise WrongCall("compare: expected either LOG or --world")
    opened = _open(log, world, dim, reading, scans, seed, max_range)
    names = [name.strip() for name in maps.split(",")] if maps is not None else None
    plot = _plot() if picture else None
    for path in (json_file, csv_file):
        _check_target(path)
    _check_picture(plot, picture)
    if picture and names is not None and len(names) < 2:
        raise WrongCall("--picture: expected at least two maps")
    comparison = _compare(
        opened,
        names,
        options,
        max_range=max_range,
        no_return=no_return.value,
        held_out=held_out,
        repeat=repeat,
        json_file=json_file or csv_file,
    )
    _warn_of_skipped(opened)
    if plot and picture:
        _draw_side_by_side(plot, *list(comparison.map_objects.values())[:2], picture)
    if not (_is_stdout(json_file) or _is_stdout(csv_file)):
        print(comparison)
    _write(comparison.to_csv, csv_file)
    _write_json(comparison, json_file)


@app.command(
    epilog=_examples(
        "ndtree calibrate intel.log.gz --max-range 20 --no-return ignore",
        "ndtree calibrate room.npz --json room.json",
    )
)
@reports_errors
@reading_options
def calibrate(
    log: GivenLog,
    dim: Dim = None,
    max_range: MaxRange = None,
    no_return: NoReturnOption = NoReturnKind.auto,
    limit: Annotated[
        Optional[int], typer.Option(min=1, help="Only so many scans from the beginning.", show_default=False)
    ] = None,
    find_mount: Annotated[
        bool,
        typer.Option("--find-mount", help="Of a ROS bag: find where the sensor sits on its base, instead."),
    ] = False,
    json_file: Json = None,
    reading: Any = None,
) -> None:
    """Estimate the options of the sensor from a log: the noise of its ranges, and its error rates."""
    if find_mount:
        _find_mount(log, dim, reading, json_file)
        return
    far = _limit(max_range)
    opened = reading.open(log, dim, max_range)
    _check_target(json_file)
    settings = _settled(opened, {}, far, no_return.value)
    with progress() as advance:
        figures = ndtree.calibrate(
            opened,
            max_range=settings.max_range,
            no_return=settings.no_return,
            limit=limit,
            progress=advance,
        )
    _warn_of_skipped(opened)
    if not _is_stdout(json_file):
        _print_settings(opened, settings)
        print(figures)
        flags = [f"--{name.replace('_', '-')} {value:.3g}" for name, value in figures.options().items()]
        if flags:
            print(f"\nfor ndtree map and ndtree compare: {' '.join(flags)}")
    _write(figures.to_json, json_file)


@app.command(
    epilog=_examples(
        "ndtree view intel.ndt --open",
        "ndtree view room.ndt --color size --slice z=1.2 --log room.npz",
        "ndtree view room.ndt --png room.png --color probability",
    )
)
@reports_errors
@reading_options
def view(
    map_file: Annotated[
        Path, typer.Argument(metavar="MAP", help="A map: .ndt, .bt, .ot, or map_server's .yaml.")
    ],
    color: Annotated[
        Optional[CellColor],
        typer.Option(help="What colors say; else height, in 2-D probability.", show_default=False),
    ] = None,
    slice_: Annotated[
        Optional[str], typer.Option("--slice", metavar="AXIS=M", help="Cut a 3-D map, as at z=1.2.")
    ] = None,
    png: Annotated[
        Optional[Path], typer.Option(metavar="FILE", help="Draw it into this file instead of a page.")
    ] = None,
    free: Annotated[
        Optional[bool], typer.Option("--free/--no-free", help="Show free cells.", show_default=False)
    ] = None,
    unknown: Annotated[
        Optional[bool], typer.Option("--unknown", help="Show unknown cells by free ones.", show_default=False)
    ] = None,
    log: Annotated[
        Optional[Path], typer.Option(metavar="LOG", help="Show where its scans were taken.")
    ] = None,
    port: Port = None,
    open_: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    reading: Any = None,
) -> None:
    """Show a map on an interactive page of this computer until Ctrl-C, or draw it into a file."""
    axis, at = _parsed_slice(slice_)
    if log is None:
        reading.require_none("a map alone")
    if png is not None:
        for flag, value in (("--free", free), ("--unknown", unknown), ("--log", log), ("--port", port)):
            if value is not None:
                raise WrongCall(f"{flag}: is for the page, not for --png")
        if open_:
            raise WrongCall("--open: is for the page, not for --png")
        plot = _plot()
        _check_picture(plot, png, "--png")
        m = _suited(_load(map_file), color, axis)
        _draw(plot, m, png, color, axis, at)
        print(f"wrote {png}")
        return
    from ndtree.snapshot import Look
    from ndtree.view import PORT, Viewer

    m = _suited(_load(map_file), color, axis)
    look = Look.of(m.dim, color=color and color.value, free=free, unknown=unknown, axis=axis, slice_at=at)
    opened = reading.open(log, None) if log is not None else None
    with Viewer(m, port=PORT if port is None else port, look=look) as page:
        if opened is not None:
            with progress() as advance:
                for done, scan in enumerate(opened, start=1):
                    page.add_track(scan)
                    advance("reading", done, _length(opened))
            page.refresh()
        with suppress(KeyboardInterrupt):
            print(f"{map_file}: {page.url} until Ctrl-C", flush=True)
            if open_:
                webbrowser.open(page.url)
            page.wait()


@app.command(
    "convert",
    epilog=_examples(
        "ndtree convert hall.ndt hall.bt",
        "ndtree convert hall.ndt hall.yaml --height 0.1 1.8",
        "ndtree convert hall.ndt hall.ply --states occupied,frontier",
    ),
)
@reports_errors
def convert_(
    source: Annotated[Path, typer.Argument(metavar="MAP", help=".ndt, .bt, .ot, or map_server's .yaml.")],
    output: Annotated[Path, typer.Argument(metavar="OUT", help=_endings())],
    format: Annotated[
        Optional[str],
        typer.Option(
            help=f"Where the ending does not say: {', '.join(one.name for one in MAP_FORMATS)}.",
            show_default=False,
        ),
    ] = None,
    cell_size: Annotated[
        Optional[float],
        typer.Option(
            help="Of OctoMaps, images and grids \\[m]; else the map's smallest.", show_default=False
        ),
    ] = None,
    height: Annotated[
        Optional[tuple[float, float]],
        typer.Option(
            metavar="LOW HIGH", help="Of an image of a 3-D map: cells within \\[m].", show_default=False
        ),
    ] = None,
    states: Annotated[
        Optional[str],
        typer.Option(help=f"Which cells, of {', '.join(CELL_STATES)}.", show_default=False),
    ] = None,
    faces: Annotated[bool, typer.Option("--faces", help="A mesh in a .ply, instead of points.")] = False,
) -> None:
    """Write a map as a file of another kind."""
    given: dict[str, Any] = {
        "cell_size": cell_size,
        "height": height,
        "states": states.split(",") if states is not None else None,
        "faces": faces or None,
    }
    options = {name: value for name, value in given.items() if value is not None}
    _made(lambda: format_of(output, format, options))
    _check_target(output)
    convert(source, output, format=format, **options)
    print(f"{source}: wrote {output}")


@app.command(
    epilog=_examples("ndtree info intel.log.gz", "ndtree info drive.bag", "ndtree info intel.ndt --json -")
)
@reports_errors
@reading_options
def info(
    path: Annotated[Path, typer.Argument(help="A map, or a log.")],
    dim: Dim = None,
    json_file: Json = None,
    reading: Any = None,
) -> None:
    """Say what is in a map or a log."""
    _check_target(json_file)
    if is_map(path):
        reading.require_none("a map")
        loaded = _load(path)
        figures = {"map": str(path), **_map_figures(loaded)}
        if not _is_stdout(json_file):
            print(f"{path}: {loaded!r}")
            _print_map(loaded)
    else:
        held = reading.contents(path)
        if held and not _is_stdout(json_file):
            _print_contents(path, held)
        opened = reading.open(path, dim)
        figures = {**_log_figures(opened), "contents": held, "skipped": _skipped(opened)}
        if not _is_stdout(json_file):
            _print_log(figures)
        if opened.is_raw:
            with progress() as advance:
                prospect = prospect_of(opened, progress=advance)
            figures["prospect"] = prospect.figures()
            if not _is_stdout(json_file):
                for line in prospect.lines():
                    print(f"  {line}")
        _warn_of_skipped(opened)
    _write_json(figures, json_file)


# --- Logs and maps ----------------------------------------------------------------------------------


def _load(path: Path) -> OccupancyMap:
    """A map of any kind; an image that does not begin at a whole number of pixels from 0 is sampled anew."""
    placed = open_map(path)
    return placed.resampled(placed.cell_size)


def _open(
    path: Optional[Path],
    world: Optional[World],
    dim: Optional[int],
    reading: Reading,
    scans: Optional[int] = None,
    seed: int = 1,
    max_range: Optional[float] = None,
) -> Log:
    if path is not None:
        if scans is not None:
            raise WrongCall("--scans: is for simulated logs only")
        return reading.open(path, dim, max_range)
    if world is None:
        raise WrongCall("expected a LOG")
    reading.require_none(f"the simulated {world.value}")
    simulated = simulate(world.value, seed=seed, scans=scans)
    if dim not in (None, simulated.dim):
        raise WrongCall(f"--dim {dim}: the {world.value} is {simulated.dim}-D")
    return simulated


def _timed(log: Log) -> Iterator[tuple[Scan, float]]:
    """Scans, and how long it took to read each [s]."""
    scans = iter(log)
    while True:
        begin = time.perf_counter()
        scan = next(scans, None)
        if scan is None:
            return
        yield scan, time.perf_counter() - begin


def _skipped(log: Log) -> dict[str, Any]:
    return {kind: {"count": one.count, "first": one.first} for kind, one in log.skipped.items()}


def _warn_of_skipped(log: Log) -> None:
    """One line for each thing that the reader decided, and each kind of what was passed over."""
    for note in log.notes:
        print(f"ndtree: {note}", file=sys.stderr)
    for kind, one in log.skipped.items():
        if one.summary is not None:
            print(f"ndtree: {one.summary}", file=sys.stderr)
            continue
        first = " ".join(one.first.split())
        print(f"ndtree: passed over {one.count} {kind}, the first: {first}", file=sys.stderr)


def _length(log: Log) -> int:
    return len(log) if hasattr(log, "__len__") else 0


def _limit(max_range: Optional[float]) -> float:
    if max_range is None:
        return math.inf
    if not max_range > 0:
        raise WrongCall(f"--max-range {max_range:g}: must be > 0 m")
    return max_range


def _made(make: Callable[[], Any]) -> Any:
    """What `make` makes; options that it refuses are a wrong call, not bad input."""
    try:
        return make()
    except (ValueError, TypeError, RuntimeError) as error:
        raise WrongCall(str(error)) from None


def _new_map(dim: int, fixed: bool, options: dict[str, Any]) -> OccupancyMap:
    if not fixed:
        return ndtree.AdaptiveMap(dim=dim, **options)
    return ndtree.FixedMap(
        dim=dim,
        **{("cell_size" if name == "min_cell_size" else name): value for name, value in options.items()},
    )


def _find_mount(path: Path, dim: Optional[int], reading: Reading, json_file: Optional[Path]) -> None:
    """Where the sensor of a bag sits, from where its map is sharpest."""
    from ndtree.readers.ros.mounting import find_mount
    from ndtree.readers.rosbag import RosbagLog

    _check_target(json_file)
    if reading.selection:
        raise WrongCall("--find-mount: looks at the whole log, expected no part of it")
    opened = reading.with_default("mount", "0,0,0").open(path, dim)
    if not isinstance(opened, RosbagLog):
        raise WrongCall(f"--find-mount: {path} is no ROS bag")
    with progress() as advance:
        found = find_mount(opened, progress=advance)
    if not _is_stdout(json_file):
        print(f"{path}: {found}")
    _write_json(found.figures(), json_file)


def _settled(
    log: Log, options: dict[str, Any], max_range: float, no_return: str, *, with_sigma: bool = False
) -> Settings:
    with progress() as advance:
        return settle(
            log,
            options=options,
            max_range=max_range,
            no_return=no_return,
            with_sigma=with_sigma,
            progress=advance,
        )


def _print_settings(log: Log, settings: Settings) -> None:
    """What was chosen, before what it was chosen for."""
    for line in settings.lines():
        print(f"{log.name}: {line}")


def _compare(
    log: Log,
    maps: Optional[Sequence[str]],
    options: dict[str, Any],
    *,
    max_range: Optional[float],
    no_return: str,
    json_file: Optional[Path],
    **more: Any,
) -> Comparison:
    limit = _limit(max_range)
    if more.get("held_out") == 1:
        raise WrongCall("--held-out 1: must be 0, or at least 2, or nothing is left to map")
    maps = maps or DEFAULT_MAPS
    if len(set(maps)) != len(maps):
        raise WrongCall(f"--maps {','.join(maps)}: must be different")
    settings = dict(options)
    size = settings.pop("min_cell_size", None)
    for name in maps:
        _made(functools.partial(make_map, name, dim=log.dim, cell_size=size, **settings))
    settings = _settled(log, options, limit, no_return)
    limit, no_return = settings.max_range, settings.no_return
    with progress() as advance:
        try:
            found = compare(
                log, maps, max_range=limit, no_return=no_return, progress=advance, **more, **options
            )
        except ValueError as error:
            if str(error).startswith(log.name):
                raise
            raise ValueError(f"{log.name}: {error}") from None
    if not _is_stdout(json_file):
        _print_settings(log, settings)
    return found


def _compare_two(
    context: typer.Context,
    a: Path,
    b: Optional[Path],
    json_file: Optional[Path],
    picture: Optional[Path],
) -> None:
    if b is None:
        raise WrongCall(f"compare: {a} is a map, expected a second one")
    _refuse_others(context, ("log", "other", "json_file", "picture"), f"is for a LOG, and {a} is a map")
    _check_target(json_file)
    _check_picture(_plot() if picture else None, picture)
    comparison = compare_maps(a, b)
    if picture:
        comparison.draw(picture)
    if not _is_stdout(json_file):
        print(comparison)
    _write(comparison.to_json, json_file)


def _refuse_others(context: typer.Context, allowed: Sequence[str], why: str) -> None:
    """Refuses flags that were given, but that nothing would read."""
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if source is not None and source.name == "COMMANDLINE" and parameter.name not in allowed:
            raise WrongCall(f"{parameter.opts[0]}: {why}")


# --- Figures ----------------------------------------------------------------------------------------


def _map_figures(m: OccupancyMap) -> dict[str, Any]:
    stats, leaves = m.stats(), m.leaves()
    counts = ("leaves", "observed_leaves", "nodes", "updates", "splits", "merges", "memory_bytes")
    seen = leaves.observed
    states = {
        state: int(np.count_nonzero(leaves.state[seen] == value))
        for state, value in (("free", 0), ("occupied", 1))
    }
    bounds = None
    if seen.any():
        upper = leaves.lower + leaves.size[:, None]
        bounds = {"lower": leaves.lower[seen].min(axis=0).tolist(), "upper": upper[seen].max(axis=0).tolist()}
    sizes, count = np.unique(leaves.size[seen], return_counts=True)
    return {
        "dim": m.dim,
        "branching": m.branching,
        "refinement": m.refinement,
        "options": m.options,
        "stats": {key: int(getattr(stats, key)) for key in counts},
        "cells": states,
        "cell_sizes": [{"size": float(s), "observed": int(n)} for s, n in zip(sizes, count)],
        "observed_bounds": bounds,
    }


def _print_map(m: OccupancyMap) -> None:
    figures = _map_figures(m)
    stats, states = figures["stats"], figures["cells"]
    print(
        f"  {stats['observed_leaves']} observed leaves of {stats['leaves']}: {states['occupied']} occupied, "
        f"{states['free']} free; {stats['nodes']} nodes in {stats['memory_bytes'] / 2**20:.2f} MiB"
    )
    print(f"  {stats['updates']} updates, {stats['splits']} splits, {stats['merges']} merges")
    if figures["observed_bounds"]:
        print(
            f"  observed from {_point(figures['observed_bounds']['lower'])} "
            f"to {_point(figures['observed_bounds']['upper'])} m"
        )
    for row in figures["cell_sizes"]:
        print(f"  cells of {row['size']:g} m: {row['observed']}")


#: Frames of a bag that are printed.
FRAME_LINES = 60

#: So many of the smallest cells a beam may pass; maps refuse longer ones.
LONGEST_BEAM = 2**20

#: The median range of longer logs is that of every second, fourth, ... beam.
RANGE_SAMPLE = 2_000_000


def _log_figures(log: Log) -> dict[str, Any]:
    beams = dict.fromkeys(("beams", "returned", "not_returned", "invalid"), 0)
    ranges: list[Any] = []
    low, high = np.full(log.dim, np.inf), np.full(log.dim, -np.inf)
    kept, thin = 0, 1
    scans, longest, first, last = 0, 0.0, math.inf, -math.inf
    with progress() as advance:
        for scan in log:
            scans += 1
            first, last = min(first, scan.stamp), max(last, scan.stamp)
            distance = np.linalg.norm(scan.endpoints - scan.origin, axis=1)
            valid = np.isfinite(distance) & (distance > 0)
            returned = valid if scan.returned is None else valid & scan.returned
            beams["beams"] += len(scan)
            beams["invalid"] += int(np.count_nonzero(~valid))
            beams["returned"] += int(np.count_nonzero(returned))
            beams["not_returned"] += int(np.count_nonzero(valid & ~returned))
            ranges.append(distance[returned][::thin])
            kept += len(ranges[-1])
            if kept > RANGE_SAMPLE:
                ranges = [np.concatenate(ranges)[::2]]
                kept, thin = len(ranges[0]), 2 * thin
            if returned.any():
                longest = max(longest, float(distance[returned].max()))
                low = np.minimum(low, scan.endpoints[returned].min(axis=0))
                high = np.maximum(high, scan.endpoints[returned].max(axis=0))
            advance("reading", scans, _length(log))
    if not scans:
        raise ValueError(f"{log.path}: no scans, expected at least one")
    every = np.concatenate(ranges)
    known = every.size > 0
    return {
        "log": str(log.path),
        "format": log.format,
        "uses": log.uses,
        "dim": log.dim,
        "scans": scans,
        "beams": beams,
        "seconds": float(last - first),
        "range": {"median": float(np.median(every)), "max": longest} if known else None,
        "bounds": {"lower": low.tolist(), "upper": high.tolist()} if known else None,
    }


def _print_contents(path: Path, held: dict[str, Any]) -> None:
    """The topics of a bag."""
    start, end = held["start"], held["end"]
    print(f"{path}: {end - start:.1f} s from {start:.3f} to {end:.3f} s")
    rows = [
        (
            topic["topic"],
            topic["type"],
            str(topic["messages"]),
            topic["frame"] or "",
            "" if topic["rate"] is None else f"{topic['rate']:.3g} Hz",
        )
        for topic in held["topics"]
    ]
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(4)]
    for name, type_, messages, frame, rate in rows:
        line = f"  {name:<{widths[0]}}  {type_:<{widths[1]}}  {messages:>{widths[2]}}  "
        line += f"{frame:<{widths[3]}}  {rate}"
        print(line.rstrip())
    if held["frames"]:
        print("  frames:")
        for line in held["frames"][:FRAME_LINES]:
            print(f"    {line}")
        if len(held["frames"]) > FRAME_LINES:
            print(f"    ... and {len(held['frames']) - FRAME_LINES} more")
    for line in held["damage"]:
        print(f"  {line}")


def _print_log(figures: dict[str, Any]) -> None:
    print(
        f"{figures['log']}: {figures['format']} log, {figures['dim']}-D, {figures['scans']} scans"
        + (f" in {figures['seconds']:.1f} s" if figures["seconds"] > 0 else "")
    )
    if figures["uses"]:
        print(f"  uses {figures['uses']}")
    print(f"  {_beams(figures['beams'])}")
    if figures["range"]:
        median, longest = figures["range"]["median"], figures["range"]["max"]
        print(f"  ranges: median {_metres(median)} m, longest {_metres(longest)} m")
        if longest > LONGEST_BEAM * (cell := ndtree.default_options()["min_cell_size"]):
            print(
                f"  beams of more than {LONGEST_BEAM * cell:,.0f} m can be no map's: give `map` a --max-range"
            )
        print(
            f"  end points from {_point(figures['bounds']['lower'])} "
            f"to {_point(figures['bounds']['upper'])} m"
        )


def _beams(counts: dict[str, int]) -> str:
    parts = [f"{count} {key.replace('_', ' ')}" for key, count in counts.items() if key != "beams" and count]
    return f"{counts['beams']} beams: {', '.join(parts)}"


def _point(values: Sequence[float]) -> str:
    return f"({', '.join(_metres(value) for value in values)})"


def _metres(value: float) -> str:
    return f"{value:.2f}" if abs(value) < 1e9 else f"{value:.3g}"  # Not three hundred digits.


# --- Output -----------------------------------------------------------------------------------------


def _write_json(figures: dict[str, Any], target: Optional[Path]) -> None:
    _write(lambda: json.dumps(figures, indent=2, allow_nan=False) + "\n", target)


def _write(text: Callable[[], str], target: Optional[Path]) -> None:
    if target is None:
        return
    if _is_stdout(target):
        sys.stdout.write(text())
        return
    with replaced(target) as path:
        path.write_text(text(), encoding="utf-8")


def _is_stdout(target: Optional[Path]) -> bool:
    return str(target) == "-"


def _check_target(target: Optional[Path]) -> None:
    """Refuses a file that could not be written before the work is done, not after it."""
    if target is None or _is_stdout(target):
        return
    if target.is_dir():
        raise IsADirectoryError(
            errno.EISDIR, "is a folder, expected the name of a file to write", str(target)
        )
    try:
        if not target.is_fifo():  # Whose reader would take the end of this for the end of all.
            ReplacedFile(target).discard()
    except OSError as error:
        raise OSError(error.errno, f"cannot be written: {error.strerror}", str(target)) from None


def _check_picture(plot: Any, target: Optional[Path], flag: str = "--picture") -> None:
    _check_target(target)
    if target is not None and target.suffix.lower() not in plot.FORMATS:
        raise WrongCall(f"{flag} {target}: the name must end in {', '.join(plot.FORMATS)}")


# --- Pages and films --------------------------------------------------------------------------------


@contextmanager
def _observers(
    watch: bool, port: Optional[int], record: Optional[Path], every: Optional[int]
) -> Iterator[list[Any]]:
    """Who looks on while a map grows: a page, which stays, and a film, which is written if all goes well."""
    if port is not None and not watch:
        raise WrongCall("--port: is for the page of --watch")
    if every is not None and record is None:
        raise WrongCall("--record-every: is for --record")
    observers: list[Any] = []
    film = None
    if record is not None:
        from ndtree.record import Recorder

        film = _made(lambda: Recorder(record, **({} if every is None else {"every": every})))
    try:
        if watch:
            from ndtree.view import PORT, Viewer

            observers.append(Viewer(port=PORT if port is None else port))
            print(f"{observers[0].url} shows the map as it grows", file=sys.stderr, flush=True)
        if film is not None:
            observers.append(film)
        yield observers
        if film is not None:
            film.close()
    finally:
        if film is not None:
            film.abandon()


def _stay(page: Any, m: OccupancyMap, json_file: Optional[Path]) -> None:
    """Keeps a page with the map as it became, until the user interrupts."""
    page.show(m)
    with suppress(KeyboardInterrupt):
        print(
            f"{page.url} until Ctrl-C", file=sys.stderr if _is_stdout(json_file) else sys.stdout, flush=True
        )
        page.wait()
    page.close()


def _parsed_slice(text: Optional[str]) -> tuple[Optional[int], Optional[float]]:
    """Axis and position of a slice like z=1.2."""
    if text is None:
        return None, None
    axis, _, value = text.partition("=")
    try:
        at = float(value)
    except ValueError:
        at = math.nan
    if axis not in ("x", "y", "z") or not math.isfinite(at):
        raise WrongCall(f"--slice {text}: expected an axis and a position in metres, as in z=1.2")
    return "xyz".index(axis), at


def _suited(m: OccupancyMap, color: Optional[CellColor], axis: Optional[int]) -> OccupancyMap:
    """The map, if it can be shown so."""
    if m.dim != 3 and axis is not None:
        raise WrongCall(f"--slice: the map is {m.dim}-D, only 3-D maps can be cut")
    if m.dim != 3 and color is CellColor.height:
        raise WrongCall(f"--color height: the map is {m.dim}-D and has none, expected size or probability")
    return m


# --- Pictures ---------------------------------------------------------------------------------------


def _plot() -> Any:
    """The module that draws; @raises ImportError that names the extra."""
    from ndtree import plot

    return plot


def _draw(
    plot: Any,
    m: OccupancyMap,
    path: Path,
    color: Optional[CellColor] = None,
    axis: Optional[int] = None,
    at: Optional[float] = None,
) -> None:
    """Draws a map, cut at a slice if there is one."""
    more: dict[str, Any] = {} if color is None else {"color": color.value}
    if m.dim == 2:
        plot.overview(m, path, **more)
        return
    if axis is not None:
        more.update(slice_axis=axis, slice_at=at)
        if axis == 2:
            more["cut_above"] = at
    plot.overview_3d(m, path, **more)


def _draw_side_by_side(plot: Any, one: OccupancyMap, other: OccupancyMap, target: Path) -> None:
    draw = plot.side_by_side if one.dim == 2 else plot.side_by_side_3d
    with replaced(target) as path:
        draw(one, other, path)
