# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree view``: a map on a page, or in a picture."""

import sys
import time
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from ndtree.base.exit_status import WrongCall
from ndtree.cli.commands.flags import Call, command, opened, require_none
from ndtree.cli.commands.logs import length_of, load_map
from ndtree.cli.commands.output import check_picture
from ndtree.cli.commands.pictures import draw, parsed_slice, plotting, suited
from ndtree.cli.commands.progress import progress
from ndtree.live.serving import RunningMap, is_address
from ndtree.tuning.config import Config

#: How often a live mapper is asked for its map [s], and its rest, in times of what that took.
ASKS, RESTS = 0.5, 4.0
_MAPS = "A map: .ndt, .bt, .ot, .yaml of map_server; http://ROBOT:PORT."


@command(
    "view",
    usual="open_ png color slice_at log",
    examples=(
        "ndtree view intel.ndt --open",
        "ndtree view room.ndt --color size --slice z=1.2 --log room.npz",
        "ndtree view room.ndt --png room.png --color probability",
        "ndtree view http://robot:8090",
    ),
)
def view(
    map_name: Annotated[str, typer.Argument(metavar="MAP", help=_MAPS)], call: Call, given: Config
) -> None:
    """Show a map in the browser until Ctrl-C, or draw it into a file.

    Rooms are cut below their ceiling unless --slice is given; the page's switch "Slice" shows all.
    """
    axis, at = parsed_slice(call.slice_at)
    if call.log is None:
        require_none(given, "a map alone")
    if call.png is not None:
        for flag in ("free", "unknown", "log", "port"):
            if getattr(call, flag) is not None:
                raise WrongCall(f"--{flag}: is for the page, not for --png")
        if call.open_:
            raise WrongCall("--open: is for the page, not for --png")
        plot = plotting()
        check_picture(plot, call.png, "--png")
        m = suited(_loaded(map_name), call.color, axis)
        draw(m, call.png, call.color, (axis, at))
        print(f"wrote {call.png}")
        return
    from ndtree.viewer import PORT, Look, Viewer

    m = suited(_loaded(map_name), call.color, axis)
    shown = {"color": call.color, "free": call.free, "unknown": call.unknown}
    look = Look.below_ceiling(m, **shown, axis=axis, slice_at=at)
    read = opened(given, call.log) if call.log is not None else None
    title = map_name if is_address(map_name) else Path(map_name).name
    with Viewer(m, port=PORT if call.port is None else call.port, look=look, name=title) as page:
        if read is not None:
            with progress() as advance:
                for done, scan in enumerate(read, start=1):
                    page.add_track(scan)
                    advance("reading", done, length_of(read))
            page.refresh()
        with suppress(KeyboardInterrupt):
            print(f"{map_name}: {page.url} until Ctrl-C", flush=True)
            if call.open_:
                webbrowser.open(page.url)
            if is_address(map_name):
                _follow(map_name, page)
            else:
                page.wait()


def _loaded(name: str) -> Any:
    """A map of a file, or of a live mapper, once there is one."""
    if not is_address(name):
        return load_map(Path(name))
    running = RunningMap(name)
    while (m := running.newest()) is None or not m.stats().observed_leaves:
        time.sleep(ASKS)
    return m


def _follow(name: str, page: Any) -> None:
    """Show what becomes of a map that grows elsewhere; without an answer the last one stays."""
    running, is_gone = RunningMap(name), False
    while True:
        begin = time.perf_counter()
        try:
            m, is_gone = running.newest(), False
        except OSError as error:
            if not is_gone:
                print(f"ndtree: {error}", file=sys.stderr, flush=True)
            m, is_gone = None, True
        if m is not None and m.stats().observed_leaves:
            page.show(m)
        time.sleep(max(ASKS, RESTS * (time.perf_counter() - begin)))
