# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree live``: a recording is mapped as on a robot, message by message as they come."""

import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from typing import Any, Optional

from ndtree.alignment.aligning import moves
from ndtree.base.exit_status import WrongCall
from ndtree.base.options import flag_of
from ndtree.cli.commands.flags import Call, LogArgument, command, require_taken
from ndtree.cli.commands.live_reports import Page, line, report, report_places
from ndtree.cli.commands.logs import inspected, load_map, made, open_log
from ndtree.cli.commands.messages import laid_out
from ndtree.cli.commands.shows import sinks_of, url_of, wait_at
from ndtree.live import (
    Intake,
    LiveMapper,
    LiveSettings,
    Localization,
    MessagesIntake,
    Saver,
    ScansIntake,
    Way,
    play,
)
from ndtree.live.messages import NOT_SELECTED
from ndtree.live.options import LiveOptions
from ndtree.live.playing import messages_of, scans_of
from ndtree.live.serving import MapServer, address_of
from ndtree.live.slam import scans_beside
from ndtree.logs import recognised
from ndtree.logs.poses.transforms import plain
from ndtree.logs.ros.files.bag import Bag, open_bag
from ndtree.logs.ros.messages.beams import short
from ndtree.logs.ros.options import listed
from ndtree.logs.ros.survey import PATH
from ndtree.tuning.config import Config


@command(
    "live",
    usual="rate window watch resume min_cell_size",
    examples=(
        "ndtree live drive.bag --watch",
        "ndtree live drive.bag -o drive.ndt --rate 0",
        "ndtree live drive.bag -o drive.ndt --rate 4 --queue 20 --window 30 --save-every 60",
        "ndtree live tuesday.bag --resume monday.ndt -o both.ndt --rate 0",
        "ndtree live --world office --rate 0",
        "ndtree live laser.bag --slam -o office.ndt",
        "ndtree live more.bag --slam --resume office.ndt -o office.ndt",
        "ndtree live drive.bag --serve 8090",
        "ndtree live drive.bag --foxglove 8765",
        "ndtree live drive.bag --rerun drive.rrd --rate 0",
    ),
)
def live(call: Call, given: Config, log: LogArgument = None) -> None:
    """Map a recording as a robot would: message by message, at its own pace, and say what was dropped.

    If nothing was dropped, the map is byte for byte that of "ndtree map" with the same options; of recordings
    longer than a minute, if the first minute leads to the same choices. On a robot with ROS, run the node
    ndtree_map.
    """
    _refuse_mixtures(call, given)
    run = _Run(call, given)
    with ExitStack() as stack:
        items = run.prepared(stack)
        begin = time.perf_counter()
        # A user who interrupts gets a map of all that came until then.
        with run.mapper, line(run.mapper), suppress(KeyboardInterrupt):
            play(items, run.mapper, rate=call.rate)
        run.report(time.perf_counter() - begin)


def _refuse_mixtures(call: Call, given: Config) -> None:
    """Refuse flags that do not go together, beside those of `LiveOptions`."""
    saved = call.localize is not None or (call.slam and call.resume is not None)
    for one, value, needs, is_there in (
        ("save-every", call.save_every, "-o MAP", call.output is not None),
        ("follow-frame", call.follow_frame, "--follow", call.follow is not None),
        ("guess", call.initial_pose, "--localize, or --slam with --resume", saved),
    ):
        if value is not None and not is_there:
            raise WrongCall(f"--{one}: expected {needs}, too")
    if call.port is not None and not call.watch:
        raise WrongCall("--port: is for the page of --watch")
    for name in (["save_every"] if call.save_every is not None else []) + given.typed:
        if call.localize is not None:
            raise WrongCall(f"{flag_of(name)}: not with --localize, which makes no map")
    if call.resume is not None and (given.typed or call.fixed):
        name = "fixed" if call.fixed else given.typed[0]
        raise WrongCall(f"{flag_of(name)}: the map of --resume has its own options")


class _Run:
    """A recording that is played, and what becomes of it."""

    mapper: LiveMapper

    def __init__(self, call: Call, given: Config) -> None:
        self._call, self._options = call, made(lambda: LiveOptions(vars(call)))
        self._given, self._begun = self._options.beginning(given, load_map)
        if call.resume is None and call.localize is None and not call.slam:
            made(lambda: self._given.new_map(self._given.get("dim", 2)))
        self._found: list[Localization] = []
        self._how = LiveSettings()
        self._page: Optional[Page] = None
        self._url = ""

    def prepared(self, stack: ExitStack) -> Iterator[tuple[Any, float]]:
        """What is in the recording, for a mapper that is there then."""
        call, options = self._call, self._options
        served = [_server(call.serve, stack)] if call.serve is not None else []
        intake, items = _source(call, self._given, options, stack)
        for server in served:
            print(f"ndtree view {server.url} shows the map as it grows", file=sys.stderr, flush=True)
        moving = None
        if call.slam and not isinstance(intake, MessagesIntake):
            moving = moves(open_log(call.log, call.world, self._given))
        self._how = made(lambda: options.settings(self._given, self._begun, odometry=moving))
        every = call.save_every
        session = (lambda: self.mapper.session()) if call.slam else None
        saver = [] if every is None else [made(lambda: Saver(call.output, every, session))]
        way = Way()
        self.mapper = LiveMapper(
            intake,
            self._how,
            sinks=[*saver, *served, *self._sinks(intake, way, stack)],
            way=way,
            localized=self._found.append if self._how.localizer is not None else None,
        )
        return items

    def _sinks(self, intake: Intake, way: Way, stack: ExitStack) -> list[Any]:
        """What shows the map while it grows."""
        call = self._call
        self._page = Page(call.port) if call.watch else None
        shown = sinks_of(call, lambda: _frame(intake), way, stack)
        self._url = url_of(shown)
        return [*filter(None, [self._page]), *shown]

    def report(self, seconds: float) -> None:
        """Say and write what was made in so long, and show it until the user interrupts."""
        call, mapper = self._call, self.mapper
        if self._given.get("strict") and mapper.figures.left_out.keys() - {NOT_SELECTED}:
            raise ValueError(f"{call.log}: {mapper.figures.summary()}; expected none with --strict")
        name = str(call.log or f"world {call.world}")
        slam, is_paced = self._how.slam, call.rate > 0
        if self._how.localizer is not None:
            files = call.output, call.json_file
            report_places(mapper, self._how.localizer, self._found, files, name, is_paced)
        else:
            report(mapper, seconds, (call.output, call.json_file), name, slam, is_paced)
            if slam is not None and call.output is not None:
                mapper.session().save(scans_beside(call.output))
        if self._page is not None:
            self._page.stay()
        elif self._url:
            wait_at(self._url)


def _source(
    call: Call, given: Config, options: LiveOptions, stack: ExitStack
) -> tuple[Intake, Iterator[tuple[Any, float]]]:
    """How a recording is judged, and what is in it."""
    path = call.log
    if path is not None and recognised(path, format=given.get("format")) == "rosbag":
        require_taken(given, path)
        bag = stack.enter_context(open_bag(str(path.parent if path.name == "metadata.yaml" else path)))
        _check_followed(bag, options.follow or "")
        for damage in bag.damage:
            _note_damage(f"{damage}, expected a whole bag", given.get("strict"))
        messages = messages_of(bag, lambda error: _note_damage(error, not given.get("keep_going")))
        return made(lambda: options.intake(str(path), given)), messages
    if options.localize is not None:
        raise WrongCall("--localize: expected a ROS bag, whose transforms have the odometry")
    if options.follow:
        raise WrongCall("--follow: expected a ROS bag, which has the poses that a SLAM corrects")
    log, config = inspected(open_log(path, call.world, given), given)
    return ScansIntake(config, log.dim, log), scans_of(log)


def _note_damage(error: Any, ends: Any) -> None:
    """Say what is damaged and go on, or end there, as ``ndtree map``."""
    if ends:
        raise ValueError(error)
    print(laid_out(error), file=sys.stderr)


def _check_followed(bag: Bag, follow: str) -> None:
    """Refuse to follow what no SLAM tells of its poses."""
    if plain(follow) in ("", "tf"):
        return
    topic = bag.topic(follow)
    if topic is None or topic.type != PATH:
        found = "is not there" if topic is None else f"is of type {short(topic.type)}"
        paths = bag.of_type(PATH)
        others = f", or a Path as one of {listed(paths)}" if paths else ""
        raise WrongCall(f"--follow {follow}: {found}, expected tf{others}")


def _server(serve: str, stack: ExitStack) -> MapServer:
    """What gives the map to who asks, until the command ends."""
    host, port = made(lambda: address_of(serve))
    server = MapServer(port, host=host)
    stack.callback(server.close)
    return server


def _frame(intake: Intake) -> str:
    log = intake.log if isinstance(intake, MessagesIntake) else None
    return "map" if log is None else log.fixed_frame
