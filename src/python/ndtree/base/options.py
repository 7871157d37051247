# SPDX-License-Identifier: BSD-3-Clause
"""The options of commands, files and nodes: one table, by the question that each answers.

Flags, keys of files, parameters of the nodes, help and pages are made of it; of maps' options the rows are
the library's.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ndtree._native import _core
from ndtree.base.option import MOST, Option

DEFAULT_REFINEMENT = _core.AdaptiveMap(dim=2).refinement

#: Commands: all; which read a log; which make maps; and which decide what beams say.
_ALL = "demo simulate map align clean live fleet compare study calibrate view plan explore convert info"
_READ = "demo map align clean live compare calibrate view info"
_MADE = "demo map clean live fleet compare"
_MAPPING = f"{_MADE} calibrate"

_SIZES = ("min_cell_size", "max_cell_size", "branching", "refinement", "max_memory")
_NOISE = ("range_sigma", "range_sigma_quadratic")
_OF_SENSORS = (*_NOISE, "beam_divergence", "hit_given_free", "miss_given_occupied")
#: What stands behind the default of an option of the maps.
_MORE = {
    **dict.fromkeys(_NOISE, ", or as measured"), "max_memory": ": 3/4 of the machine's",
    "evidence_half_life": ": never", "beam_divergence": ": lines",
}  # fmt: skip
#: Maps that are compared have the same noise, which is not measured.
_COMPARED = {"range_sigma": {"compare demo": "0.03 m"}, "range_sigma_quadratic": {"compare demo": "0 1/m"}}


def _of_library() -> tuple[Option, ...]:
    ours = ("evidence", "paper", "fixed")
    rows = [
        Option("branching", int, "Children of a node along each axis, N.", "N", "",
               "N = 3: fewer levels, coarser steps", f"{_MADE} node", 2, role="map", section="map",
               read_by=ours),
        Option("refinement", str, "Policy that splits and merges cells.", "NAME", "",
               "paper: the published rules, to compare", f"{_MADE} node", DEFAULT_REFINEMENT, role="map",
               section="map", read_by=ours[:2]),
    ]  # fmt: skip
    for name, default, _, _, unit, read_by, value, what, when in _core.option_table():
        if value is not None:
            first, more, rest = what.rstrip(".").partition(";")
            what = f"{first} [{unit.strip()}]{more}{rest}." if unit.strip() else what
            section = "sensor" if name in _OF_SENSORS else "map"
            rows.append(
                Option(name, float, what, value, _MORE.get(name, ""), when,
                       f"{_MADE} node", default, unit.strip(), but=_COMPARED.get(name, {}), role="map",
                       section=section, read_by=tuple(read_by))
            )  # fmt: skip
    return tuple(rows)


#: Options of the maps, as the library has them.
MAP_OPTIONS = _of_library()


def _maps(*names: str) -> list[Option]:
    return sorted((one for one in MAP_OPTIONS if one.name in names), key=lambda one: names.index(one.name))


def _node(name: str, type: Any, help: str, default: Any = None, **more: Any) -> Option:
    return Option(name, type, help, of="node", default=default, **more)


def _output(of: str, type: Any, help: str, without: str = "", default: Any = None) -> Option:
    when = "always, where the name matters"
    return Option("output", type, help, "PATH", without, when, of, default, flags="--output -o")


def _picture(of: str, help: str) -> Option:
    return Option("picture", Path, help, "FILE", "", "to see the map at once", of)


_POSITIVE = (0.0, math.inf)
_ANY = (-math.inf, math.inf)
_COUNT = (1, math.inf)
#: Of a node's parameters.
_UP_TO_1000, _MANY = (0.0, 1000.0), (1, 100000)
#: What reads an option that is read of logs: commands, or nodes as well; and of all that map beams.
_READ_LIVE, _MAPPING_LIVE = f"{_READ} node", f"{_MAPPING} node"
_WORLDS = ("office", "apartment", "street")

QUESTIONS: dict[str, tuple[Option, ...]] = {
    "What is written, and where?": (
        _output("map", Path, "Where the map is written, or the folder for several. .tiles: a folder of "
                "tiles.", "LOG's name with .ndt, here"),
        _output("demo", Path, "Folder for the pictures.", "", Path("ndtree-demo")),
        _output("simulate", Path, "An .npz file.", "the world's name with .npz, here"),
        _output("align", Path, "The trajectory, as TUM's: t x y z qx qy qz qw.", "", ...),
        _output("clean", Path, "A log, .npz; a cloud, .ply or .pcd; or, for a folder of clouds, a folder.",
                "", ...),
        _output("live", Path, "Where the map is written at the end."),
        _output("fleet", str, "Folder of the map, or a URL of fsspec.", "", ...),
        _output("study", Path, "Folder for the results, instead of CONFIG's.", "as CONFIG says"),
        _output("plan", Path, "The path: .csv, .yaml, .json."),
        Option("map_file", Path, "Write the map of these poses, too.", "MAP", "", "the map of the poses that "
               "were found, too", "align", flags="--map"),
        Option("merge", bool, "One map of all logs, in the order given; they must be in one frame.", "",
               "a map each", "several logs in one frame, one map", "map", False),
        _picture("map", "Draw the map, too."),
        _picture("align", "Draw the end points by the old poses and by the new ones."),
        _picture("clean", "Draw all points, moving ones in red."),
        _picture("compare", "Draw the first two maps side by side, or how A and B differ."),
        _picture("plan", "A picture of the map and the path."),
        _picture("explore", "A picture of maps and paths."),
        Option("json_file", Path, "Write all figures; - for standard output.", "[FILE]", "",
               "figures for a script; alone, it prints them", "demo map align clean live fleet compare study "
               "calibrate explore info", flags="--json"),
        Option("csv_file", Path, "Write a line for each map.", "FILE", "",
               "a table for a spreadsheet; - prints it", "compare", flags="--csv"),
        Option("record", Path, "Film how the map grows: .mp4 or .gif.", "FILE", "", "a film, .mp4 or .gif",
               "map"),
        Option("record_every", int, "Scans between pictures of the film.", "N", "10 scans",
               "a longer or a shorter film", "map", limits=_COUNT),
        Option("format", str, "One of 3dtk, bal, bundler, carmen, colmap, depth_folder, e57, kitti, "
               "kitti_raw, npz, octomap_graph, point_clouds, ptx, rosbag, seven_scenes, text, tum_rgbd, "
               "velodyne.", "NAME", "as the content or the ending says", "a kind that was not recognised",
               _READ, role="read"),
        Option("format", str, "If the ending does not say: ndtree, octomap, map_server, rosbag, ply, pcd, "
               "gltf, vtk, leaves, grid.", "NAME", "as the ending says", "a kind that was not recognised",
               "convert"),
        Option("cell_size", float, "Cell size in all files but .ndt [m].", "M", "the map's own",
               "a coarser file", "convert", unit="m", limits=_POSITIVE, above=True),
        Option("height", tuple[float, float], "Image of a 3-D map: heights of its cells [m].", "LOW HIGH",
               "all heights", "what a robot of that height meets [m]", "convert"),
        Option("wall_depth", float, "In an image, depth to which large occupied cells are drawn behind free "
               "space [m].", "M", "2 sigma and a cell", "walls seen from afar are drawn too thin or thick",
               "convert"),
        Option("states", str, "Cells to write: occupied, free, frontier.", "A,B", "occupied",
               "free cells or frontiers, too", "convert"),
        Option("faces", bool, "A mesh in a .ply, instead of points.", "", "points",
               "a mesh for Blender or MeshLab", "convert", False),
        Option("mark", bool, "Keep all points, with the probability of each in a field moved.", "",
               "what moved is left out", "a viewer shows the probability of each point", "clean", False),
        Option("save_every", float, "Write MAP at this interval, too [s].", "S", "at the end alone",
               "a robot that may lose its power", "live", unit="s", limits=_POSITIVE, above=True),
        Option("serve", str, "Serve it to ndtree view http://HOST:PORT; without HOST, only to this computer.",
               "[HOST:]PORT", "off", "look at it from another computer: ndtree view http://HOST:PORT",
               "live node", of_node="[HOST:]PORT for ndtree view http://HOST:PORT; 0.0.0.0 as the HOST: all "
               "that reach it."),
        Option("foxglove", int, "Serve it to Foxglove, on 8765 or a free port: 0.", "PORT", "off",
               "look at it in Foxglove while it grows", "map live"),
        Option("rerun", str, "Write it for rerun: FILE.rrd, or rerun+http://...", "FILE|URL", "off",
               "look at it in rerun, then or later", "map live"),
        Option("force", bool, "Replace files of any kind, but no input.", "", "", "a file of another kind is "
               "in the way: a bag where a map is written", _ALL, False),
        Option("quiet", bool, "Print errors only.", "", "", "scripts: errors alone are said", _ALL, False,
               flags="--quiet -q"),
    ),
    "How fine is the map?": (
        *_maps(*_SIZES),
        Option("fixed", bool, "All cells of one size.", "", "adaptive", "the baseline: all cells of one size",
               "map live fleet node", parameter="fixed_cells", role="kind", section="map"),
        Option("max_resident", str, "Memory of the cells of a .tiles map, as 500MB.", "SIZE", "2GiB",
               "a .tiles map on a small machine", "map"),
        Option("tile_size", float, "Least edge of tiles [m].", "M", "16 largest cells",
               "many small or few large files", "map fleet"),
    ),
    "How good is the sensor?": (
        Option("max_range", float, "Longer beams are cut off here, and free up to it [m].", "M",
               "as the log says, else none", "far points are noise; missing returns are free up to here",
               _MAPPING_LIVE, unit="m", limits=_POSITIVE, above=True, role="mapping", section="sensor",
               but={"compare demo calibrate": "none"}, of_node="Longer beams are free up to here [m]; 0: no "
               "limit."),
        Option("max_range", float, "Do not match end points farther away [m].", "M",
               "40 m, in space 100 m", "far points are noise; missing returns are free up to here",
               "align", unit="m", limits=_POSITIVE, above=True),
        Option("no_return", ("auto", "free", "ignore"), "A beam without return is free up to its end point, "
               "or ignored.", "", "", "free space is missing, or goes through glass", _MAPPING_LIVE, "auto",
               role="mapping", section="sensor", of_node="Use of a beam without return: free, ignore, or "
               "auto."),
        Option("zero_is", ("no-echo", "invalid"), "Lasers: meaning of range 0, no-echo or invalid.", "",
               "as the log says", "a laser that writes 0", _READ_LIVE, role="format", section="sensor"),
        *_maps(*_NOISE),
        Option("min_range", float, "Leave out shorter beams [m].", "M", "", "the robot sees itself",
               _READ_LIVE, 0.0, "m", _POSITIVE, role="select", section="sensor"),
        Option("fov", float, "Field of view of FLASER records [deg].", "DEG",
               "by PARAM, or the number of beams", "CARMEN logs that do not say", _READ, role="format",
               section="sensor"),
        Option("camera", str, "Depth images: fx,fy,cx,cy[,image values per metre].", "FX,FY,CX,CY",
               "as the log says", "depth images without a calibration", _READ_LIVE, role="format"),
        Option("pixel_stride", int, "Use every n-th row and column of depth images.", "N", "",
               "large depth images: mapping is faster", _READ_LIVE, 1, "", _COUNT, role="format",
               node_limits=(1, 64)),
        Option("pixel_sigma", float, "Structure from motion: standard deviation of a feature's place [px].",
               "PX", "", "structure from motion of another quality", _READ, 1, "px", role="format"),
        Option("body", str, "ROS bags: the robot itself, box:LX,LY,LZ[,X,Y,Z], sphere:, capsule: or "
               "footprint:, + more, @FRAME.", "SHAPE", "", "the robot sees itself: a box, spheres or "
               "capsules", _READ_LIVE, role="format"),
        Option("colors", bool, "ROS bags: colours of clouds become a layer of the map, color.", "", "",
               "clouds have colours, and cells shall have them", _READ_LIVE, flags="--colors/--no-colors",
               role="format", of_node="Colours of clouds become a layer of the map; cells are shown in "
               "them."),
        Option("sweep", ("stamp", "end", "reversed", "reversed-end", "said"), "ROS bags: when beams were "
               "measured: stamp, end, reversed, reversed-end, said.", "NAME", "as the log says",
               "when a sensor's beams were measured, if nothing says so", _READ_LIVE, role="format"),
        Option("pose_covariance", ("auto", "ignore", "use"), "ROS bags: covariances of poses widen beams: "
               "auto, ignore, use.", "", "auto", "poses tell how sure they are, and are believed or not",
               _READ_LIVE, role="format"),
        Option("find_mount", bool, "ROS bags: find where the sensor sits on its base, instead.", "", "",
               "a bag without the place of its sensor", "calibrate", False),
    ),
    "Which part of the log?": (
        Option("topic", str, "ROS bags: topic with scans, clouds or depth images; @SIGMA [m] may follow.",
               "NAME", "the topic that sees most", "a bag with several sensors; repeat it for several",
               _READ_LIVE, repeated=True, parameter="topics", role="format",
               of_node="Topics of sensors, @SIGMA [m] may follow; none: the best one found."),
        Option("dim", int, "Dimensions of the map: 2 or 3.", "2|3", "as the log says",
               "a flat map of a 3-D log, or the reverse", f"{_MAPPING_LIVE} info", limits=(2, 3), role="read",
               section="map", of_node="2 or 3; 0: what the sensors say."),
        Option("every", int, "Use every n-th scan.", "N", "", "mapping is too slow: every n-th scan",
               _READ_LIVE, 1, "", _COUNT, role="select", node_limits=_MANY),
        Option("stride", int, "Use every n-th beam of a scan.", "N", "",
               "scans are too dense: every n-th beam", _READ_LIVE, 1, "", _COUNT, role="select",
               node_limits=(1, 1000)),
        Option("start", float, "Begin at this time after the first scan [s].", "S", "the first scan, 0 s",
               "leave out the beginning", _READ, limits=_POSITIVE, flags="--from", role="select"),
        Option("stop", float, "End at this time after the first scan [s].", "S", "the last scan",
               "leave out the end", _READ, limits=_POSITIVE, flags="--to", role="select"),
        Option("box", list[float], "Cut beams to X,Y[,Z],X,Y[,Z], two corners in the map [m].",
               "X,Y[,Z],X,Y[,Z]", "everything", "one room of a building [m]", _READ_LIVE, role="select",
               of_node="X0,Y0,Z0,X1,Y1,Z1 (X0,Y0,X1,Y1 in 2-D) in the map [m]: nothing is mapped outside."),
        Option("origin", list[float], "Point X,Y[,Z] of the log that becomes the map's origin [m].",
               "X,Y[,Z]", "0,0[,0] m", "coordinates far away, as UTM", _READ, role="select"),
        Option("limit", int, "Use only this many scans, the first ones.", "N", "all scans",
               "a quick estimate", "calibrate", limits=_COUNT),
        Option("config", Path, "A file of TOML that says how LOG is read and mapped.", "FILE", "",
               "the same robot again, or values of your own, with their reasons", f"{_READ_LIVE} fleet",
               of_node="A file of ndtree info --write-config: values of parameters that are not given."),
        Option("write_config", Path, "Write what was decided, and why, as TOML.", "FILE", "",
               "the next log of this robot: --config FILE maps it alike", "map info"),
        Option("keep_going", bool, "Skip damaged parts, and count them.", "", "",
               "a damaged log: read what is whole", _READ, role="read"),
        Option("strict", bool, "Refuse logs with scans whose pose is not known.", "", "",
               "refuse a log with scans without a pose", _READ, role="read"),
        Option("points_only", bool, "Points without poses: cells that hold one are occupied, none is free.",
               "", "", "points alone, without a sensor's place: occupied cells", _READ,
               flags="--points-only/--no-points-only", role="format"),
        Option("origin_of_scan", str, "Points without poses: place X,Y,Z from which all were measured [m].",
               "X,Y,Z", "", "a cloud from one known place [m]", _READ, role="format"),
        Option("points_in", ("sensor", "map"), "Frame of the points of point clouds: sensor or map.", "",
               "sensor", "clouds that are in the map's frame already", _READ, role="format"),
        Option("static", bool, "Leave out what moved, such as people and cars: reads the log 3 times.", "",
               "all that was seen", "people and cars left trails in the map", "map", False),
        Option("look", bool, "Read all of a log, and say what mapping will choose and cost.", "", "",
               "what mapping will choose, and how long it takes", "info", False),
    ),
    "Where was the sensor?": (
        Option("align", bool, "First find the poses of a 2-D log whose own poses drift.", "",
               "as the log says", "a 2-D log whose walls come out double: its poses drift", "map", False),
        Option("loops", bool, "Look for places that were seen before.", "", "", "--no-loops: poses alone "
               "that drift slowly, as from a laser's odometry", "align", True, flags="--loops/--no-loops"),
        Option("trajectory", str, "File of poses: TUM (t x y z qx qy qz qw), KITTI (3x4), EuRoC, g2o, "
               "Open3D's log.", "FILE", "", "poses in a file: TUM or KITTI", _READ, role="format"),
        Option("fixed_frame", str, "ROS bags: frame of the map.", "FRAME", "map, odom, world or a root",
               "another frame for the map", _READ_LIVE, role="format", of_node="Frame of the map; else map, "
               "odom, world or a root of /tf."),
        Option("odometry", str, "ROS bags: topic with Odometry, for poses instead of /tf.", "TOPIC", "/tf",
               "a bag without /tf", _READ_LIVE, role="format"),
        Option("poses", str, "ROS bags: topic with poses: Odometry, PoseStamped, PoseWithCovarianceStamped, "
               "TransformStamped, Path.", "TOPIC", "/tf", "poses of a SLAM in a topic", _READ_LIVE,
               role="format"),
        Option("still", bool, "ROS bags and packets: the sensor stands still.", "", "it moves",
               "the sensor stands", _READ_LIVE, flags="--still/--no-still", role="format",
               of_node="The sensor stands still."),
        Option("mount", str, "ROS bags: sensor on its base, X,Y,Z,ROLL,PITCH,YAW or X,Y,YAW.", "X,Y,Z,R,P,Y",
               "as /tf says", "nothing says where the sensor sits [m, rad]", _READ_LIVE, role="format"),
        Option("sensor_frame", str, "ROS bags: the sensor's frame, whatever its messages say.", "FRAME",
               "as the messages say", "messages with a wrong frame", _READ_LIVE, role="format"),
        Option("base_frame", str, "ROS bags: frame below the mount, frame of the poses, or the frame from "
               "which a cloud was seen.", "FRAME", "the poses' own", "the frame of --mount or of the poses",
               _READ_LIVE, role="format"),
        Option("time_offset", float, "Added to the times of scans to find their poses [s].", "S", "",
               "two clocks", _READ_LIVE, 0.0, "s", _ANY, role="format"),
        Option("deskew", bool, "ROS bags: each beam from the pose of its own time.", "", "",
               "--no-deskew, where beams have no times of their own", _READ_LIVE, True,
               flags="--deskew/--no-deskew", role="format"),
    ),
    "How is it shown?": (
        Option("watch", bool, "Show it on a page while it grows.", "", "", "see the map grow on a page",
               "map live", False),
        Option("png", Path, "Draw it into this file instead of a page.", "FILE", "a page",
               "a picture instead of the page", "view"),
        Option("color", ("height", "size", "probability"), "Meaning of colors; in 2-D probability, or states "
               "(--png).", "", "height; in 2-D probability", "sizes of cells, or how sure", "view"),
        Option("slice_at", str, "Cut a 3-D map, as at z=1.2.", "AXIS=M", "below the ceiling",
               "look into a room, as z=1.2", "view", flags="--slice"),
        Option("free", bool, "Show free cells.", "", "in 2-D", "free cells, too", "view",
               flags="--free/--no-free"),
        Option("unknown", bool, "Show unknown cells by free ones.", "", "", "where the map ends", "view"),
        Option("log", Path, "Its log: shows where scans were taken.", "LOG", "", "where the scans were taken",
               "view"),
        Option("open_", bool, "Open the page in the browser.", "", "", "open the browser", "view", False,
               flags="--open"),
        Option("port", int, "Port of the page; 0: any free one.", "N", "8080; 0: any free one",
               "several pages at once", "map live view", limits=(0, 65535)),
    ),
    "Where may the robot go?": (
        Option("start_at", str, "Start of the robot [m].", "X,Y[,Z]", "", "always", "plan", ...,
               flags="--from"),
        Option("goal", str, "Its goal [m].", "X,Y[,Z]", "", "always", "plan", ..., flags="--to"),
        Option("radius", float, "Radius of a ball around the robot [m].", "M", "", "always", "plan", ...,
               limits=_POSITIVE, flags="--body"),
        Option("clearance", float, "Least distance to obstacles [m].", "M", "", "the robot does not follow "
               "its path exactly", "plan", 0.0, "m", _POSITIVE),
        Option("unknown_space", str, "Unknown space: blocked, free, or a cost >= 1, the factor of its "
               "length.", "blocked|free|COST", "", "the map has holes that the robot may cross", "plan",
               "blocked", flags="--unknown"),
        Option("max_seconds", float, "Longest time of the search [s].", "S", "no limit",
               "a robot that must go on", "plan", limits=_POSITIVE),
        Option("strategy", ("information", "nearest", "random"), "Use this one alone; may be repeated.", "",
               "all three", "one of them alone", "explore", repeated=True),
        Option("from_scan", int, "Scan of the world's own log at which the robot begins.", "N", "",
               "another place to begin at", "explore", 0, "", (0, math.inf)),
    ),
    "What is compared?": (
        Option("maps", str, "Kinds of map: adaptive, paper, fixed, octomap, octomap-scan, octomap-scan-lazy, "
               "octomap-scan-discretized, with @ and a cell size where it differs.", "A,B",
               "adaptive, fixed, octomap", "other kinds, or sizes, as fixed@0.1", "compare"),
        Option("held_out", int, "Keep every N-th scan out of the map to judge it; 0: none.", "N",
               ": every tenth scan", "0: no truth, all scans mapped", "compare", 10, "", (0, math.inf)),
        Option("calibration", bool, "Check whether beams end as often as each map says.", "", "",
               "whether beams end as often as each map says", "compare", False),
        Option("reliability", Path, "Draw reliability diagrams of that.", "FILE", "", "the same as a diagram",
               "compare"),
        Option("certify", bool, "Bound the fraction of free space that is in fact occupied.", "", "",
               "a bound on what is called free but occupied", "compare", False),
        Option("repeat", int, "Runs of each map, in turns, for the times.", "N", "",
               "times that are worth printing", "compare", 1, "", _COUNT),
        Option("world", _WORLDS, "Simulate this instead of LOG.", "NAME", "", "no log at hand",
               "live compare"),
        Option("scans", int, "Simulate this many scans.", "N", "the world's own", "a shorter simulated log",
               "demo simulate compare explore", limits=_COUNT, but={"explore": "1000 at most"}),
        Option("seed", int, "Seed of the simulated log.", "N", "", "another simulated drive",
               "demo simulate compare explore", 1, "", (0, math.inf)),
        Option("people", int, "People who walk, one of them ahead of the sensor.", "N", "0",
               "a world in which things move, with exact truth", "simulate", limits=(0, 1000)),
        Option("doors", int, "Doors of the office that open and close.", "N", "0",
               "an office whose doors open and close", "simulate", limits=(0, 1000)),
        Option("cars", int, "Cars that drive in the street.", "N", "0", "a street with traffic", "simulate",
               limits=(0, 1000)),
    ),
    "How does it run live?": (
        Option("rate", float, "Seconds of LOG played in one second; 0: as fast as possible, nothing is "
               "dropped.", "SPEED", ": the recording's own pace", "0: as fast as it goes, and nothing is "
               "dropped", "live", 1.0, limits=_POSITIVE),
        Option("queue", int, "Most scans that may wait; beyond that, the oldest is dropped.", "N", "",
               "a shorter delay, or fewer drops", "live node", 100, "scans", _COUNT, node_limits=_MANY),
        Option("patience", float, "Longest time that a scan waits for its pose [s].", "S", "",
               "poses come late", "live node", 1.0, "s", _POSITIVE, node_limits=_UP_TO_1000),
        Option("look", float, "ROS bags: length of the beginning that decides what is mapped, and how [s].",
               "S", "", "more messages to decide by, and a later start", "live node", 2.0, "s",
               _POSITIVE, node_limits=_UP_TO_1000),
        Option("window", float, "Forget cells farther from the sensor than this [m].", "M", "the whole map",
               "a robot that needs its surroundings alone", "live node", unit="m", limits=_POSITIVE,
               above=True, of_node="Cells farther from the "
               "sensor are forgotten [m]; 0: none."),
        Option("fade", float, "Forget cells not seen for this long [s].", "S", "nothing fades",
               "things that move all day; walls that are not seen go, too", "live node", unit="s",
               limits=_POSITIVE, above=True, of_node="Cells not seen for this long are forgotten [s]; 0: "
               "none."),
        Option("resume", Path, "Continue a saved map.", "MAP", "an empty map", "continue a saved map",
               "live"),
        Option("slam", bool, "Find the poses of a planar laser from its scans and odometry, and correct "
               "them.", "", "poses are those of the log", "odometry drifts, and no SLAM runs: a planar laser",
               "live node", False, of_node="Find poses of a planar laser by its scans and odometry: "
               "publishes map to odom."),
        Option("localize", Path, "Find scans in this map by their odometry instead of mapping; -o gets "
               "poses (TUM).", "MAP", "it is mapped", "find the robot in a saved map instead", "live node",
               of_node="A saved map to find the robot in, instead of mapping: publishes map to odom."),
        Option("initial_pose", str, "First pose of the sensor in MAP, in 3-D also X,Y,Z,YAW [m, rad].",
               "X,Y,YAW", "anywhere", "where the sensor is in that map at first", "live node",
               flags="--guess",
               of_node="First pose of the sensor in a saved map, X,Y,YAW or X,Y,Z,YAW; else it is "
               "searched for everywhere."),
        Option("follow", str, "Move scans when a SLAM corrects poses: its nav_msgs/Path, or jumps of map to "
               "odom.", "TOPIC|tf", "poses stay", "a SLAM that corrects poses: by its Path, or jumps of tf",
               "live node", of_node="Topic with a SLAM's nav_msgs/Path, or tf: scans move when their poses "
               "are corrected."),
        Option("follow_frame", str, "Frame of the poses in the Path.", "FRAME", "the robot's base",
               "the Path is of another frame", "live node", of_node="Frame of the poses of follow; else the "
               "robot's base."),
        Option("follow_memory", float, "Memory for scans that can move [MiB]; beyond it, the oldest stay.",
               "MIB", "", "a long drive, or less memory: the oldest scans stay then", "live node", 1024.0,
               "MiB", node_limits=(1, MOST)),
    ),
    "On which machines?": (
        Option("engine", ("processes", "local", "ray", "dask"), "Run in processes, in threads, on Ray or on "
               "Dask.", "", "", "several machines", "fleet", "processes"),
        Option("workers", int, "Tasks that run at the same time.", "N", "all cores", "leave cores to others",
               "fleet", limits=_COUNT),
        Option("processes", int, "Jobs that run at the same time; use 1 to measure times.", "N", "one a core",
               "1: times that are worth printing", "study", limits=_COUNT),
    ),
    "How is evidence weighed? (for research)": (
        *(one for one in MAP_OPTIONS if one.name not in (*_SIZES, *_NOISE)),
    ),
    "What else does a node do?": (
        _node("autostart", bool, "Configure and activate at once; else a lifecycle manager does.", True),
        _node("threads", int, "Threads that insert; 0: as many as there are cores.", 1, limits=(0, 256)),
        _node("reliable", bool, "Ask sensors for lost messages again: reliable, not best effort."),
        _node("map_file", str, "File in which the map is saved; its ending decides the format."),
        _node("resume", bool, "Continue the map in map_file, if it is there."),
        _node("save_period", float, "Time between two savings [s]; 0: only at the end."),
        _node("robot_radius", float, "Radius of the ball for which ~/get_plan plans [m].", 0.3,
              limits=_UP_TO_1000, changes=True),
        _node("plan_unknown", ("blocked", "free"), "Unknown space on paths of ~/get_plan: blocked or free.",
              "blocked"),
        _node("grid_cell_size", float, "Cell size of the grid [m]; 0: that of the smallest cells.",
              limits=_UP_TO_1000),
        _node("grid_low", float, "Of a 3-D map, the grid shows cells between this height", 0.1,
              limits=(-MOST, MOST), changes=True),
        _node("grid_high", float, "and this one [m].", 1.8, limits=(-MOST, MOST), changes=True),
        _node("grid_above", ("map", "robot", "ground"), "Zero of these heights: map, its z = 0; robot, its "
              "base; or ground, below each pixel.", "map", changes=True),
        _node("ground_slope", float, "The steepest ground [m/m].", 0.3, limits=_UP_TO_1000, changes=True),
        _node("grid_wall_depth", float, "Depth of the larger occupied cells [m]; 0: 2 sigma and a cell.", 0.0,
              changes=True),
        _node("grid_layers", str, "More grids of other heights, each NAME:LOW,HIGH, on map_NAME.",
              repeated=True),
        _node("grid_clear", float, "The grid is free within this of the robot's base [m].",
              limits=_UP_TO_1000, changes=True),
        _node("grid_stays", float, "Things that come into free space are in the grid after this long [s]; 0: "
              "at once.", 2.0, limits=_UP_TO_1000, changes=True),
        _node("grid_period", float, "Time between grids or updates [s]; 0: after each scan.",
              limits=_UP_TO_1000, changes=True),
        _node("cells_period", float, "Time between messages of cells, as points and markers [s].", 1.0,
              limits=_UP_TO_1000, changes=True),
        _node("filter_speckles", bool, "Leave out occupied cells that have no occupied neighbour.",
              changes=True),
        _node("frontiers_period", float, "Time between messages of frontiers [s].", 2.0, limits=_UP_TO_1000,
              changes=True),
        _node("frontier_cells", float, "Smaller frontiers are left out [faces of smallest cells].", 8.0),
        _node("octomap_period", float, "Time between Octomaps [s].", 2.0, limits=_UP_TO_1000, changes=True),
        _node("octomap_cell_size", float, "Cell size of Octomaps [m]; 0: that of the smallest cells.",
              limits=_UP_TO_1000),
        _node("diagnostics_period", float, "Time between diagnostics [s].", 1.0, limits=(0.01, 1000.0)),
        _node("clear_radius", float, "Distance to the sensor up to which clear_around forgets [m].", 1.0,
              changes=True),
    ),
}  # fmt: skip

OPTIONS: tuple[Option, ...] = tuple(one for rows in QUESTIONS.values() for one in rows)


def options_of(taker: str) -> list[Option]:
    """What a command, or "node", takes."""
    return [one for one in OPTIONS if one.taken_by(taker)]


def option(name: str, taker: str = "") -> Option:
    """The row of a name; of a command or "node" if one is named."""
    return next(one for one in OPTIONS if one.name == name and (not taker or one.taken_by(taker)))


def flag_of(name: str) -> str:
    """The flag of an option."""
    return next((one.flag for one in OPTIONS if one.name == name), f"--{name.replace('_', '-')}")


def default_of(name: str, taker: str = "") -> Any:
    """What the program takes where nothing is said.

    Raises ValueError if that differs between those who take it, and none of them is named.
    """
    found = [one.default for one in OPTIONS if one.name == name and (not taker or one.taken_by(taker))]
    if any(one != found[0] for one in found):
        raise ValueError(f"{name}: commands differ in its default, expected the name of one, or of a node")
    return found[0]
