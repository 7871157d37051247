# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree live``: a recording is mapped as on a robot, message by message as they come."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from ndtree.alignment.writing import is_trajectory
from ndtree.base.exit_status import WrongCall
from ndtree.base.files import replaced
from ndtree.base.words import number_of
from ndtree.cli.commands.app import command, examples, reports_errors
from ndtree.cli.commands.figures import map_figures, print_map
from ndtree.cli.commands.flags import map_options, require_taken
from ndtree.cli.commands.logs import inspected, load_map, made, new_map, open_log
from ndtree.cli.commands.messages import in_words
from ndtree.cli.commands.options import Json, LogArgument, Port, World
from ndtree.cli.commands.output import is_stdout, write_json
from ndtree.cli.commands.shows import (
    FoxgloveOption,
    RerunOption,
    foxglove_sink,
    rerun_sink,
    wait_at,
)
from ndtree.live import (
    Corrections,
    Fading,
    Intake,
    LiveMapper,
    Localization,
    Localizer,
    MessagesIntake,
    Saver,
    ScansIntake,
    Way,
    Window,
    play,
)
from ndtree.live.corrections import MEMORY
from ndtree.live.localizing import ODOMETRY, place_of, quaternion_of
from ndtree.live.mapper import PATIENCE, QUEUE
from ndtree.live.messages import LOOK, NOT_SELECTED
from ndtree.live.playing import messages_of, scans_of
from ndtree.live.serving import MapServer, address_of
from ndtree.logs import recognised
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.files.bag import Bag, open_bag
from ndtree.logs.ros.messages.beams import short
from ndtree.logs.ros.sensors import listed
from ndtree.logs.ros.survey import PATH
from ndtree.tuning.config import Config

#: How often a page is drawn anew, and a line on a terminal [s].
PAGE, LINE = 0.5, 0.5


_World = Annotated[Optional[World], typer.Option(help="Simulate instead of a LOG.", show_default=False)]
_Output = Annotated[
    Optional[Path],
    typer.Option("--output", "-o", metavar="MAP", help="Where the map is written at the end."),
]
_Rate = Annotated[
    float, typer.Option(help="Seconds of LOG in one second; 0: as fast as it goes, none is dropped.")
]
_Queue = Annotated[int, typer.Option(min=1, help="Scans that wait at most; of more, the oldest is dropped.")]
_LookFor = Annotated[
    float, typer.Option("--look", help="Of a ROS bag: messages that decide what is mapped and how \\[s].")
]
_Window = Annotated[
    Optional[float],
    typer.Option(help="Forget what is farther from the sensor than this \\[m].", show_default=False),
]
_Fade = Annotated[
    Optional[float],
    typer.Option(help="Forget what was not seen for this long \\[s].", show_default=False),
]
_Follow = Annotated[
    Optional[str],
    typer.Option(
        metavar="TOPIC|tf",
        help="Move scans when a SLAM corrects poses: its nav_msgs/Path, or jumps of map to odom.",
        show_default=False,
    ),
]
_FollowFrame = Annotated[
    Optional[str],
    typer.Option(help="The frame that the poses of the Path are of.", show_default=False),
]
_FollowMemory = Annotated[float, typer.Option(help="Scans that can move \\[MiB]; of more, the oldest stay.")]
_Localize = Annotated[
    Optional[Path],
    typer.Option(
        metavar="MAP",
        help="Find scans in this 2-D map by their odometry instead of mapping; -o gets poses (TUM).",
        show_default=False,
    ),
]
_Guess = Annotated[
    Optional[str],
    typer.Option(
        metavar="X,Y,YAW", help="Where the sensor is in the MAP at first \\[m, rad].", show_default=False
    ),
]
_SaveEvery = Annotated[
    Optional[float], typer.Option(help="Write MAP so often, too \\[s].", show_default=False)
]
_Serve = Annotated[
    Optional[str],
    typer.Option(
        metavar="[HOST:]PORT",
        help="Give it to ndtree view http://HOST:PORT; only of this computer, unless HOST says more.",
        show_default=False,
    ),
]


@command(
    "live",
    epilog=examples(
        "ndtree live drive.bag --watch",
        "ndtree live drive.bag -o drive.ndt --rate 0",
        "ndtree live drive.bag -o drive.ndt --rate 4 --queue 20 --window 30 --save-every 60",
        "ndtree live tuesday.bag --resume monday.ndt -o both.ndt --rate 0",
        "ndtree live --world office --rate 0",
        "ndtree live drive.bag --serve 8090",
        "ndtree live drive.bag --foxglove 8765",
        "ndtree live drive.bag --rerun drive.rrd --rate 0",
    ),
)
@reports_errors
@map_options
def live(
    log: LogArgument = None,
    world: _World = None,
    output: _Output = None,
    rate: _Rate = 1.0,
    queue: _Queue = QUEUE,
    patience: Annotated[float, typer.Option(help="A scan waits for its pose at most \\[s].")] = PATIENCE,
    look_for: _LookFor = LOOK,
    window: _Window = None,
    fade: _Fade = None,
    follow: _Follow = None,
    follow_frame: _FollowFrame = None,
    follow_memory: _FollowMemory = MEMORY / 2**20,
    localize: _Localize = None,
    guess: _Guess = None,
    save_every: _SaveEvery = None,
    resume: Annotated[Optional[Path], typer.Option(metavar="MAP", help="Go on with a saved map.")] = None,
    fixed: Annotated[bool, typer.Option("--fixed", help="All cells of one size.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Show it on a page while it grows.")] = False,
    port: Port = None,
    serve: _Serve = None,
    foxglove: FoxgloveOption = None,
    rerun: RerunOption = None,
    json_file: Json = None,
    given: Any = None,
) -> None:
    """Map a recording as a robot would: message by message, at its own pace, and say what was dropped.

    If none was, the map is that of "ndtree map" with the same options: byte for byte of up to a minute, and
    of more if what is chosen by the first minute is what all of it says. For a robot that runs ROS 2 there
    is the node ndtree_map.
    """
    if save_every is not None and output is None:
        raise WrongCall("--save-every: expected -o MAP, too")
    if port is not None and not watch:
        raise WrongCall("--port: is for the page of --watch")
    if follow is None and follow_frame is not None:
        raise WrongCall("--follow-frame: expected --follow, too")
    for flag, other in (("window", window), ("fade", fade), ("resume", resume), ("fixed", fixed or None)):
        if follow is not None and other is not None:
            raise WrongCall(f"--{flag}: not with --follow, whose map is of scans alone, with adaptive cells")
    if guess is not None and localize is None:
        raise WrongCall("--guess: expected --localize, too")
    others = {"window": window, "fade": fade, "resume": resume, "follow": follow, "save-every": save_every}
    for flag, other in (*others.items(), ("fixed", fixed or None), *((name, name) for name in given.typed)):
        if localize is not None and other is not None:
            raise WrongCall(f"--{flag.replace('_', '-')}: not with --localize, which makes no map")
    if rate < 0:
        raise WrongCall(f"--rate {rate:g}: must be >= 0; 0 is as fast as it goes")
    target = None
    if resume is not None:
        if given.typed or fixed:
            flag = "fixed" if fixed else given.typed[0].replace("_", "-")
            raise WrongCall(f"--{flag}: the map of --resume has its own options")
        target = load_map(resume)
        given = given.overridden(Config.of(**target.options).values)
    given = given.overridden(Config.of(fixed=fixed or None).values)
    localizer = None
    if localize is not None:
        target = load_map(localize)
        place = None if guess is None else made(lambda: place_of(guess))
        localizer = made(lambda: Localizer(target, place))
        given = Config.of(fixed_frame=ODOMETRY).overridden({**given.values, **Config.of(dim=2).values})
    found: list[Localization] = []
    made(lambda: new_map(given.get("dim", 2), given) if target is None else None)
    sinks: list[Any] = [made(lambda: Saver(output, save_every))] if save_every is not None else []
    kept = None if window is None else made(lambda: Window(window))
    corrections = None if follow is None else made(lambda: Corrections(memory=int(follow_memory * 2**20)))
    fading = None if fade is None else made(lambda: Fading(fade))
    with ExitStack() as stack:
        how = {"look": look_for, "follow": follow or "", "body": follow_frame or ""}
        intake, items = _source(log, world, given, stack, how, localizes=localize is not None)
        sinks += [_served(serve, stack)] if serve is not None else []
        page = _Page(port) if watch else None
        sinks += [page] if page is not None else []
        way = Way()
        server = None
        if foxglove is not None:
            server = foxglove_sink(foxglove, lambda: _frame(intake), way, stack)
        sinks += [server] if server is not None else []
        sinks += [rerun_sink(rerun, way, stack)] if rerun is not None else []
        mapper = LiveMapper(
            intake,
            target=target,
            make=lambda dim, options: new_map(dim, Config.of(**options, fixed=fixed or None)),
            queue=queue,
            patience=patience,
            window=kept,
            fading=fading,
            sinks=sinks,
            way=way,
            corrections=corrections,
            localizer=localizer,
            localized=found.append,
        )
        begin = time.perf_counter()
        try:
            with mapper, _line(mapper):
                play(items, mapper, rate=rate)
        except KeyboardInterrupt:
            mapper.close()
        seconds = time.perf_counter() - begin
        if given.get("strict") and mapper.figures.left_out.keys() - {NOT_SELECTED}:
            raise ValueError(f"{log}: {mapper.figures.summary()}; expected none with --strict")
        if localizer is not None:
            _report_places(mapper, localizer, found, output, json_file, str(log))
        else:
            _report(mapper, seconds, output, json_file, str(log or f"world {world and world.value}"))
        if page is not None:
            page.stay()
        elif server is not None:
            wait_at(server.url)


def _source(
    path: Optional[Path],
    world: Optional[World],
    given: Config,
    stack: ExitStack,
    how: dict[str, Any],
    *,
    localizes: bool,
) -> tuple[Intake, Iterator[tuple[Any, float]]]:
    """How a recording is judged, and what is in it."""
    follow = how["follow"]
    if path is not None and recognised(path, format=given.get("format")) == "rosbag":
        require_taken(given, path)
        bag = stack.enter_context(open_bag(str(path.parent if path.name == "metadata.yaml" else path)))
        _check_followed(bag, follow)
        return made(lambda: MessagesIntake(str(path), given, **how)), messages_of(bag)
    if localizes:
        raise WrongCall("--localize: expected a ROS bag, whose transforms have the odometry")
    if follow:
        raise WrongCall("--follow: expected a ROS bag, which has the poses that a SLAM corrects")
    log, config = inspected(open_log(path, world, given), given)
    return ScansIntake(config, log.dim), scans_of(log)


def _check_followed(bag: Bag, follow: str) -> None:
    """Refuse to follow what no SLAM tells of its poses."""
    topic = bag.topic(follow) if follow and plain(follow) != "tf" else None
    if not follow or plain(follow) == "tf" or (topic is not None and topic.type == PATH):
        return
    found = "is not there" if topic is None else f"is of type {short(topic.type)}"
    raise WrongCall(
        f"--follow {follow}: {found}, expected tf, or a Path as one of {listed(bag.of_type(PATH))}"
    )


def _served(serve: str, stack: ExitStack) -> MapServer:
    """What gives the map to who asks, until the command ends."""
    host, port = made(lambda: address_of(serve))
    server = MapServer(port, host=host)
    stack.callback(server.close)
    print(f"ndtree view {server.url} shows the map as it grows", file=sys.stderr, flush=True)
    return server


def _frame(intake: Intake) -> str:
    log = intake.log if isinstance(intake, MessagesIntake) else None
    return "map" if log is None else log.fixed_frame


class _Page:
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
def _line(mapper: LiveMapper) -> Iterator[None]:
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


def _report_places(
    mapper: LiveMapper,
    localizer: Localizer,
    found: list[Localization],
    output: Optional[Path],
    json_file: Optional[Path],
    name: str,
) -> None:
    """What was found, as a trajectory and in a line."""
    figures = mapper.figures
    if not found:
        raise ValueError(f"{name}: no scan could be looked for: {figures.summary()}")
    known = [one for one in found if not one.is_lost]
    if output is not None:
        with replaced(output, is_trajectory) as written, open(written, "w", encoding="ascii") as file:
            for one in known:
                numbers = (one.body[0, 2], one.body[1, 2], 0.0, *quaternion_of(one.body))
                file.write(f"{one.stamp:.9f} {' '.join(f'{x:.9g}' for x in numbers)}\n")
    if not is_stdout(json_file):
        print(f"{name}: {figures.summary()}")
        for line in mapper.intake.said():
            print(f"  {line}")
        lost = f"lost {number_of(localizer.times_lost, 'time')}" if localizer.times_lost else "never lost"
        print(
            f"{len(known)} of {len(found)} scans found, {lost}; from arrival to "
            f"pose {1e3 * figures.delay(0.5):.1f} ms, and 99 % within {1e3 * figures.delay(0.99):.1f} ms"
            + (f"; wrote {output}" if output else "")
        )
    write_json(
        {
            "log": name,
            "live": figures.as_dict(),
            "found": len(known),
            "times_lost": localizer.times_lost,
            "is_lost": localizer.is_lost,
        },
        json_file,
    )


def _report(
    mapper: LiveMapper, seconds: float, output: Optional[Path], json_file: Optional[Path], name: str
) -> None:
    figures = mapper.figures
    if not figures.mapped:
        raise ValueError(f"{name}: nothing was mapped: {figures.summary()}")
    m = mapper.snapshot()
    if output is not None:
        m.save(output)
    of_map = map_figures(m)
    if not is_stdout(json_file):
        print(f"{name}: {figures.summary()}")
        for line in mapper.intake.said():
            print(f"  {line}")
        print_map(of_map)
        median, late = (1e3 * figures.delay(q) for q in (0.5, 0.99))
        print(
            f"{seconds:.3f} s, {figures.insert_seconds:.3f} s of them in the map; from arrival to map "
            f"{median:.1f} ms, and 99 % within {late:.1f} ms" + (f"; wrote {output}" if output else "")
        )
    for sink, error in mapper.failures.items():
        print(f"ndtree: {sink}: {error}", file=sys.stderr)
    write_json({"log": name, "seconds": seconds, "live": figures.as_dict(), **of_map}, json_file)
