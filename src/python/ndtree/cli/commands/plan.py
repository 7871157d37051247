# SPDX-License-Identifier: BSD-3-Clause
"""``ndtree plan``: a way for a robot through a map."""

from pathlib import Path
from typing import Any

import numpy as np

from ndtree._errors import naming
from ndtree._native._core import Sphere
from ndtree._native.results import Path as Way
from ndtree.base.exit_status import WrongCall
from ndtree.base.words import number_of
from ndtree.cli.commands.flags import Call, MapArgument, command
from ndtree.cli.commands.logs import load_map
from ndtree.cli.commands.messages import in_words
from ndtree.cli.commands.output import check_picture, is_stdout, write, write_json
from ndtree.cli.commands.pictures import draw_tracks, plotting

#: By the ending of the file: how a way is written.
ENDINGS = (".csv", ".yaml", ".json")


@command(
    "plan",
    usual="start_at goal radius unknown_space picture",
    examples=(
        "ndtree plan office.ndt --from 2,4 --to 22,17 --body 0.3",
        "ndtree plan office.ndt --from 2,4 --to 22,17 --body 0.3 -o path.csv --picture path.png",
        "ndtree plan campus.bt --from 0,0,1 --to 40,10,1 --body 0.35 --unknown free -o path.json",
    ),
)
def plan(source: MapArgument, call: Call) -> None:
    """Find a short path for a robot through a map.

    The path is straight between its points, free for the whole ball that moves along it, and nearly the
    shortest. Exit status 1 if there is none.
    """
    if call.output is not None and not is_stdout(call.output) and call.output.suffix.lower() not in ENDINGS:
        raise WrongCall(f"-o {call.output}: the name must end in {', '.join(ENDINGS)}")
    plot = plotting() if call.picture is not None else None
    check_picture(plot, call.picture)
    m = load_map(source)
    if call.picture is not None and m.dim > 3:
        raise WrongCall(f"--picture {call.picture}: {source} is {m.dim}-D, expected 2-D or 3-D")
    ends = _point("--from", call.start_at, m.dim), _point("--to", call.goal, m.dim)
    body, unknown = Sphere(call.radius), _unknown(call.unknown_space)
    limits: dict[str, Any] = {"clearance": call.clearance, "max_seconds": call.max_seconds}
    try:
        way = m.plan(*ends, body=body, unknown=unknown, **limits)
    except ValueError as error:
        raise ValueError(in_words(naming(error, "start", "goal"))) from None
    if not way:
        raise ValueError(f"no path found: {way.reason}")
    if call.output is not None:
        _write(way, call.output)
    if plot is not None and call.picture is not None:
        draw_tracks(plot, {f"{way.length:.1f} m": (m, way.points)}, call.picture)
    if not is_stdout(call.output):
        print(
            f"{source}: a path of {way.length:.2f} m in {number_of(len(way) - 1, 'segment')}; the body keeps "
            f"{way.clearance:.2f} m away from obstacles (--clearance M for more)"
        )


def _point(flag: str, text: str, dim: int) -> list[float]:
    try:
        point = [float(word) for word in text.split(",")]
    except ValueError:
        point = []
    if len(point) != dim or not np.isfinite(point).all():
        raise WrongCall(f"{flag} {text}: expected {','.join('XYZ'[:dim])} in metres, of a {dim}-D map")
    return point


def _unknown(text: str) -> Any:
    if text in ("blocked", "free"):
        return text
    try:
        cost = float(text)
    except ValueError:
        cost = np.nan
    if not cost >= 1.0:
        raise WrongCall(f"--unknown {text}: expected blocked, free or a cost >= 1")
    return cost


def _write(way: Way, output: Path) -> None:
    rows = [[f"{value:.9f}" for value in point] for point in way.points.tolist()]
    if output.suffix.lower() == ".csv":
        lines = [",".join("xyz"[: way.points.shape[1]]), *map(",".join, rows)]
        write(lambda: "\n".join(lines) + "\n", output)
    elif output.suffix.lower() == ".yaml":
        lines = [f"length: {way.length:.6f}", f"clearance: {way.clearance:.6f}", "points:"]
        lines += [f"  - [{', '.join(row)}]" for row in rows]
        write(lambda: "\n".join(lines) + "\n", output)
    else:
        figures = {name: getattr(way, name) for name in ("length", "clearance", "expanded")}
        write_json({**figures, "points": way.points.tolist()}, output)
