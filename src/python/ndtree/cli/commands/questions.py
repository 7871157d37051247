# SPDX-License-Identifier: BSD-3-Clause
"""The options of all commands, by the question that they answer: their defaults, and when to touch them.

One table for ``--help``, ``--help-all`` and the documentation.
"""

from __future__ import annotations

from dataclasses import dataclass

from ndtree.maps.kinds import MAP_OPTIONS


@dataclass(frozen=True)
class Row:
    """An option."""

    name: str  # Of the command's parameter.
    value: str  # What is typed behind the flag; empty for a switch.
    default: str  # What stands if it is left out, with its unit.
    when: str  # When to touch it.


#: What stands behind the default of an option of the maps.
_MORE = {
    "range_sigma": ", or as measured", "range_sigma_quadratic": ", or as measured",
    "max_memory": ": 3/4 of the machine's", "evidence_half_life": ": never", "beam_divergence": ": lines",
}  # fmt: skip


def _of_maps(*names: str) -> list[Row]:
    """Rows of options of the maps, as the library's table has them."""
    rows = []
    for option in sorted(
        (one for one in MAP_OPTIONS if one.name in names), key=lambda one: names.index(one.name)
    ):
        number = f"{option.default:g}" if isinstance(option.default, float) else f"{option.default}"
        default = f"{number} {option.unit}".strip() + _MORE.get(option.name, "")
        rows.append(Row(option.name, option.placeholder, default, option.when))
    return rows


_SIZES = ("min_cell_size", "max_cell_size", "branching", "refinement", "max_memory")
_NOISE = ("range_sigma", "range_sigma_quadratic")
_OF_EVIDENCE = tuple(one.name for one in MAP_OPTIONS if one.name not in (*_SIZES, *_NOISE))

QUESTIONS: dict[str, tuple[Row, ...]] = {
    "What is written, and where?": (
        Row("output", "PATH", "LOG's name with .ndt, here", "always, where the name matters"),
        Row("map_file", "MAP", "none", "the map of the poses that were found, too"),
        Row("merge", "", "a map each", "several logs in one frame, one map"),
        Row("picture", "FILE", "none", "to see the map at once"),
        Row("json_file", "[FILE]", "none", "figures for a script; alone, it prints them"),
        Row("csv_file", "FILE", "none", "a table for a spreadsheet; - prints it"),
        Row("record", "FILE", "none", "a film, .mp4 or .gif"),
        Row("record_every", "N", "10 scans", "a longer or a shorter film"),
        Row("format", "NAME", "as the content or the ending says", "a kind that was not recognised"),
        Row("cell_size", "M", "the map's own", "a coarser file"),
        Row("height", "LOW HIGH", "all heights", "what a robot of that height meets [m]"),
        Row("wall_depth", "M", "2 sigma and a cell", "walls seen from afar are drawn too thin or thick"),
        Row("states", "A,B", "occupied", "free cells or frontiers, too"),
        Row("faces", "", "points", "a mesh for Blender or MeshLab"),
        Row("mark", "", "what moved is left out", "a viewer shows the probability of each point"),
        Row("save_every", "S", "at the end alone", "a robot that may lose its power"),
        Row("serve", "[HOST:]PORT", "off", "look at it from another computer: ndtree view http://HOST:PORT"),
        Row("foxglove", "PORT", "off", "look at it in Foxglove while it grows"),
        Row("rerun", "FILE|URL", "off", "look at it in rerun, then or later"),
        Row("force", "", "off", "a file of another kind is in the way: a bag where a map is written"),
        Row("quiet", "", "off", "scripts: errors alone are said"),
    ),
    "How fine is the map?": (
        *_of_maps(*_SIZES),
        Row("fixed", "", "adaptive", "the baseline: all cells of one size"),
        Row("max_resident", "SIZE", "2GiB", "a .tiles map on a small machine"),
        Row("tile_size", "M", "16 largest cells", "many small or few large files"),
    ),
    "How good is the sensor?": (
        Row(
            "max_range",
            "M",
            "as the log says, else none",
            "far points are noise; missing returns are free up to here",
        ),
        Row("no_return", "auto|free|ignore", "auto", "free space is missing, or goes through glass"),
        Row("zero_is", "no-echo|invalid", "as the log says", "a laser that writes 0"),
        *_of_maps(*_NOISE),
        Row("min_range", "M", "0 m", "the robot sees itself"),
        Row("fov", "DEG", "by PARAM, or the number of beams", "CARMEN logs that do not say"),
        Row("camera", "FX,FY,CX,CY", "as the log says", "depth images without a calibration"),
        Row("pixel_stride", "N", "1", "large depth images: mapping is faster"),
        Row("pixel_sigma", "PX", "1 px", "structure from motion of another quality"),
        Row("body", "SHAPE", "none", "the robot sees itself: a box, spheres or capsules"),
        Row("colors", "", "off", "clouds have colours, and cells shall have them"),
        Row("sweep", "NAME", "as the log says", "when a sensor's beams were measured, if nothing says so"),
        Row(
            "pose_covariance",
            "auto|ignore|use",
            "auto",
            "poses tell how sure they are, and are believed or not",
        ),
        Row("find_mount", "", "off", "a bag without the place of its sensor"),
    ),
    "Which part of the log?": (
        Row("topic", "NAME", "the topic that sees most", "a bag with several sensors; repeat it for several"),
        Row("dim", "2|3", "as the log says", "a flat map of a 3-D log, or the reverse"),
        Row("every", "N", "1", "mapping is too slow: each n-th scan"),
        Row("stride", "N", "1", "scans are too dense: each n-th beam"),
        Row("start", "S", "the first scan, 0 s", "leave out the beginning"),
        Row("stop", "S", "the last scan", "leave out the end"),
        Row("box", "X,Y[,Z],X,Y[,Z]", "everything", "one room of a building [m]"),
        Row("origin", "X,Y[,Z]", "0,0[,0] m", "coordinates far away, as UTM"),
        Row("limit", "N", "all scans", "a quick estimate"),
        Row("config", "FILE", "none", "the same robot again, or values of your own, with their reasons"),
        Row("write_config", "FILE", "none", "the next log of this robot: --config FILE maps it alike"),
        Row("keep_going", "", "off", "a damaged log: read what is whole"),
        Row("strict", "", "off", "refuse a log with scans without a pose"),
        Row("points_only", "", "off", "points alone, without a sensor's place: occupied cells"),
        Row("origin_of_scan", "X,Y,Z", "none", "a cloud from one known place [m]"),
        Row("points_in", "sensor|map", "sensor", "clouds that are in the map's frame already"),
        Row("static", "", "all that was seen", "people and cars left trails in the map"),
        Row("look", "", "off", "what mapping will choose, and how long it takes"),
    ),
    "Where was the sensor?": (
        Row("align", "", "as the log says", "a 2-D log whose walls come out double: its poses drift"),
        Row("loops", "", "on", "--no-loops: poses alone that drift slowly, as from a laser's odometry"),
        Row("trajectory", "FILE", "none", "poses in a file: TUM or KITTI"),
        Row("fixed_frame", "FRAME", "map, odom, world or a root", "another frame for the map"),
        Row("odometry", "TOPIC", "/tf", "a bag without /tf"),
        Row("poses", "TOPIC", "/tf", "poses of a SLAM in a topic"),
        Row("still", "", "it moves", "the sensor stands"),
        Row("mount", "X,Y,Z,R,P,Y", "as /tf says", "nothing says where the sensor sits [m, rad]"),
        Row("sensor_frame", "FRAME", "as the messages say", "messages with a wrong frame"),
        Row("base_frame", "FRAME", "the poses' own", "the frame that --mount or the poses are of"),
        Row("time_offset", "S", "0 s", "two clocks"),
        Row("deskew", "", "on", "--no-deskew, where beams have no times of their own"),
    ),
    "How is it shown?": (
        Row("watch", "", "off", "see the map grow on a page"),
        Row("png", "FILE", "a page", "a picture instead of the page"),
        Row("color", "height|size|probability", "height; in 2-D probability", "sizes of cells, or how sure"),
        Row("slice_", "AXIS=M", "below the ceiling", "look into a room, as z=1.2"),
        Row("free", "", "in 2-D", "free cells, too"),
        Row("unknown", "", "off", "where the map ends"),
        Row("log", "LOG", "none", "where the scans were taken"),
        Row("open_", "", "off", "open the browser"),
        Row("port", "N", "8080; 0: any free one", "several pages at once"),
    ),
    "Where may the robot go?": (
        Row("start_at", "X,Y[,Z]", "none: must be given", "always"),
        Row("goal", "X,Y[,Z]", "none: must be given", "always"),
        Row("radius", "M", "none: must be given", "always"),
        Row("clearance", "M", "0.0", "the robot does not follow its path exactly"),
        Row("unknown_space", "blocked|free|COST", "blocked", "the map has holes that the robot may cross"),
        Row("max_seconds", "S", "no limit", "a robot that must go on"),
        Row("strategy", "information|nearest|random", "all three", "one of them alone"),
        Row("from_scan", "N", "0", "another place to begin at"),
    ),
    "What is compared?": (
        Row("maps", "A,B", "adaptive, fixed, octomap", "other kinds, or sizes, as fixed@0.1"),
        Row("held_out", "N", "10: each tenth scan", "0: no truth, all scans mapped"),
        Row("calibration", "", "off", "whether beams end as often as each map says"),
        Row("reliability", "FILE", "none", "the same as a diagram"),
        Row("certify", "", "off", "a bound on what is called free but occupied"),
        Row("repeat", "N", "1", "times that are worth printing"),
        Row("world", "NAME", "none", "no log at hand"),
        Row("scans", "N", "the world's own", "a shorter simulated log"),
        Row("seed", "N", "1", "another simulated drive"),
        Row("people", "N", "0", "a world in which things move, with exact truth"),
        Row("doors", "N", "0", "an office whose doors open and close"),
        Row("cars", "N", "0", "a street with traffic"),
    ),
    "How does it go on while it maps?": (
        Row("rate", "SPEED", "1: the recording's own pace", "0: as fast as it goes, and nothing is dropped"),
        Row("queue", "N", "100 scans", "a shorter delay, or fewer drops"),
        Row("patience", "S", "1 s", "poses come late"),
        Row("look_for", "S", "2 s", "more messages to decide by, and a later start"),
        Row("window", "M", "the whole map", "a robot that needs its surroundings alone"),
        Row("fade", "S", "nothing fades", "things that move all day; walls that are not seen go, too"),
        Row("resume", "MAP", "an empty map", "go on with a saved map"),
        Row("slam", "", "poses are those of the log", "odometry drifts, and no SLAM runs: a planar laser"),
        Row("localize", "MAP", "it is mapped", "find the robot in a saved map instead"),
        Row("guess", "X,Y,YAW", "anywhere", "where the sensor is in that map at first"),
        Row("follow", "TOPIC|tf", "poses stay", "a SLAM that corrects poses: by its Path, or jumps of tf"),
        Row("follow_frame", "FRAME", "the robot's base", "the Path is of another frame"),
        Row("follow_memory", "MIB", "1024 MiB", "a long drive, or less memory: the oldest scans stay then"),
    ),
    "On which machines?": (
        Row("engine", "processes|local|ray|dask", "processes", "several machines"),
        Row("workers", "N", "all cores", "leave cores to others"),
        Row("processes", "N", "one a core", "1: times that are worth printing"),
    ),
    "How is evidence weighed? (for research)": (*_of_maps(*_OF_EVIDENCE),),
}

#: Where an option's default is another one in a command.
DEFAULTS = {
    ("convert", "format"): "as the ending says",
    ("plan", "output"): "none",
    ("explore", "scans"): "1000 at most",
    ("demo", "output"): "ndtree-demo",
    ("simulate", "output"): "the world's name with .npz, here",
    ("study", "output"): "as CONFIG says",
    ("align", "output"): "none: must be given",
    ("align", "max_range"): "40 m, by kiss-icp 100 m",
    ("clean", "output"): "none: must be given",
    ("live", "output"): "none",
    ("fleet", "output"): "none: must be given",
    ("calibrate", "max_range"): "none",
    ("compare", "max_range"): "none",
    ("demo", "max_range"): "none",
    ("compare", "range_sigma"): "0.03 m",
    ("demo", "range_sigma"): "0.03 m",
    ("compare", "range_sigma_quadratic"): "0 1/m",
    ("demo", "range_sigma_quadratic"): "0 1/m",
}

#: The five options that people touch, by command; the log and the output stand before them.
TOUCHED = {
    "demo": ("min_cell_size", "max_range", "no_return", "every", "json_file"),
    "simulate": ("scans", "seed", "people", "doors", "cars"),
    "map": ("min_cell_size", "max_range", "topic", "trajectory", "picture"),
    "align": ("map_file", "picture", "max_range", "loops", "every"),
    "clean": ("mark", "picture", "max_range", "topic", "trajectory"),
    "live": ("rate", "window", "watch", "resume", "min_cell_size"),
    "fleet": ("min_cell_size", "max_range", "engine", "workers", "tile_size"),
    "compare": ("world", "maps", "min_cell_size", "max_range", "picture"),
    "study": ("processes", "json_file", "quiet"),
    "calibrate": ("max_range", "no_return", "limit", "find_mount", "json_file"),
    "view": ("open_", "png", "color", "slice_", "log"),
    "explore": ("strategy", "scans", "seed", "picture", "json_file"),
    "plan": ("start_at", "goal", "radius", "unknown_space", "picture"),
    "convert": ("cell_size", "height", "states", "faces", "format"),
    "info": ("look", "topic", "dim", "format", "json_file"),
}


def row_of(name: str) -> Row | None:
    """An option's row."""
    return next((row for rows in QUESTIONS.values() for row in rows if row.name == name), None)
