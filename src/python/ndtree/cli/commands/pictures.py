# SPDX-License-Identifier: BSD-3-Clause
"""Pictures, pages and films of maps."""

import math
import statistics
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Optional

from ndtree._native._core import OccupancyMap
from ndtree.base.exit_status import WrongCall
from ndtree.base.files import replaced
from ndtree.cli.commands.logs import made
from ndtree.cli.commands.output import is_stdout


@contextmanager
def observers_of(
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
        from ndtree.plot.record import Recorder

        film = made(lambda: Recorder(record, **({} if every is None else {"every": every})))
    try:
        if watch:
            from ndtree.viewer import PORT, Viewer

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


def stay(page: Any, m: OccupancyMap, json_file: Optional[Path]) -> None:
    """Keeps a page with the map as it became, until the user interrupts."""
    page.show(m)
    with suppress(KeyboardInterrupt):
        print(f"{page.url} until Ctrl-C", file=sys.stderr if is_stdout(json_file) else sys.stdout, flush=True)
        page.wait()
    page.close()


def parsed_slice(text: Optional[str]) -> tuple[Optional[int], Optional[float]]:
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


def suited(m: OccupancyMap, color: Optional[str], axis: Optional[int]) -> OccupancyMap:
    """The map, if it can be shown so."""
    if m.dim != 3 and axis is not None:
        raise WrongCall(f"--slice: the map is {m.dim}-D, only 3-D maps can be cut")
    if m.dim != 3 and color == "height":
        raise WrongCall(f"--color height: the map is {m.dim}-D and has none, expected size or probability")
    return m


def plotting() -> Any:
    """The module that draws; @raises ImportError that names the extra."""
    from ndtree import plot

    return plot


def draw(
    m: OccupancyMap,
    path: Path,
    color: Optional[str] = None,
    cut: tuple[Optional[int], Optional[float]] = (None, None),
    *,
    track: Any = None,
) -> None:
    """Draws a map, cut at a slice if there is one; a flat one with the robot's track in the frame."""
    axis, at = cut
    plot = plotting()
    more: dict[str, Any] = {} if color is None else {"color": color}
    if m.dim == 2:
        plot.overview(m, path, track=track, **more)
        return
    if axis is not None:
        more.update(slice_axis=axis, slice_at=at)
        if axis == 2:
            more["cut_above"] = at
    plot.overview_3d(m, path, **more)


def draw_tracks(plot: Any, tracks: Mapping[str, tuple[OccupancyMap, Any]], path: Path) -> None:
    """Maps beside each other by their titles, each with a track (n, dim) through it, in space from above."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0 * len(tracks), 4.0), layout="constrained")
    for ax, (title, (m, track)) in zip(figure.subplots(1, len(tracks), squeeze=False)[0], tracks.items()):
        if m.dim == 3:  # The middle of the track's heights: where half of it is above.
            height = statistics.median(track[:, 2].tolist())
            plot.slice(m, z=height, ax=ax)
            title = f"{title}, map at z = {height:.2f} m"
        else:
            plot.occupancy(m, ax)
        ax.plot(*track.T[:2], color="tab:red", linewidth=1.5)
        ax.set_title(title, fontsize=10)
    with replaced(path) as part:
        figure.savefig(part, format=path.suffix[1:], dpi=90, bbox_inches="tight")
