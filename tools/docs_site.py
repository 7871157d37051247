# SPDX-License-Identifier: BSD-3-Clause
"""What is made from the package in the pages of docs/: tables of options and formats, docstrings, figures.

Pages are read on a code host, too. So between ``<!-- table: NAME -->`` and ``<!-- end -->`` stands a
table made from the package; a test compares it, and NDTREE_UPDATE_DOCS=1 writes it. What ``help()`` and
``--help-all`` print is on the site alone: ``<!-- reference: NAMES -->`` becomes the docstrings of these
names, and ``<!-- site table: NAME -->`` a table. A page with ``<!-- include: FILE -->`` becomes that
file, ``<!-- figures: FILE NAME -->`` the figures of that name in FILE, ``<!-- site: TEXT -->`` that text,
and a link to a header one to its page.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import griffe

from ndtree._native import _core
from ndtree.cli.commands import every
from ndtree.cli.commands.pages import table_of_options
from ndtree.logs import _TABLE as READERS
from ndtree.logs import READER_OPTIONS
from ndtree.maps.kinds import MAP_OPTIONS
from ndtree.maps.writers import FORMATS as WRITERS

ROOT = Path(__file__).resolve().parents[1]


# --- Pages ------------------------------------------------------------------------------------------


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by MkDocs for each page."""
    markdown = re.sub(
        r"^<!-- reference: ([\w. ]+) -->$", lambda found: _directives(found[1].split()), markdown, flags=re.M
    )
    markdown = re.sub(r"^<!-- site table: (\w+) -->$", lambda found: TABLES[found[1]](), markdown, flags=re.M)
    whole = re.search(r"<!-- include: (\S+) -->", markdown)
    if whole is not None:
        markdown = (ROOT / whole[1]).read_text()
    markdown = re.sub(r"^<!-- (?:table: \w+|end) -->\n", "", markdown, flags=re.M)
    markdown = re.sub(r"<!-- site: (.*?) -->", r"\1", markdown)
    markdown = re.sub(r"\[`([^`]+)`\]\(\.\./include/ndtree/\S+?(\w+)\.hpp\)", _header_page, markdown)
    return re.sub(
        r"^<!-- figures: (\S+) (\w+) -->$", lambda found: figures(found[1], found[2]), markdown, flags=re.M
    )


def filled(markdown: str) -> str:
    """A page with its tables as they are made now."""
    return re.sub(
        r"^<!-- table: (\w+) -->\n.*?<!-- end -->$",
        lambda found: f"<!-- table: {found[1]} -->\n{TABLES[found[1]]().strip()}\n<!-- end -->",
        markdown,
        flags=re.DOTALL | re.MULTILINE,
    )


_WITHOUT_HEADING = "    options:\n      show_root_heading: false\n      show_root_toc_entry: false\n"


def _directives(names: Iterable[str]) -> str:
    """What mkdocstrings makes docstrings of."""
    parts = []
    for name in names:
        part = f"::: {name}\n"
        if isinstance(_found(name), ModuleType):
            part += _WITHOUT_HEADING
        if name == "ndtree.plot":
            part += "      members:\n" + "".join(f"        - {one}\n" for one in _members(_found(name)))
        parts.append(part)
    return "\n".join(parts)


def _header_page(found: re.Match[str]) -> str:
    """The link to a header as that to its page, which Doxygen names so."""
    return f'<a href="cpp/{found[2].replace("_", "__")}_8hpp.html"><code>{found[1]}</code></a>'


def _found(name: str) -> Any:
    """What a dotted name stands for."""
    first, *parts = name.split(".")
    held: Any = import_module(first)
    for number, part in enumerate(parts, start=1):
        if not hasattr(held, part):
            import_module(".".join([first, *parts[:number]]))
        held = getattr(held, part)
    return held


def _members(module: ModuleType) -> list[str]:
    """Public functions and classes of a module."""
    return [name for name in module.__all__ if callable(getattr(module, name)) and name != "Coloring"]


def figures(file: str, name: str) -> str:
    """What stands between the marks of some figures in a file."""
    found = re.search(rf"<!-- figures: {name} -->\n(.*?)<!-- end -->", (ROOT / file).read_text(), re.DOTALL)
    if found is None:
        raise ValueError(f"{file}: no figures of the name {name}")
    return found[1]


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    lines = [list(head)]
    lines.append(["---"] * len(lines[0]))
    lines += [[cell.replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _code(words: Iterable[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)


def _flag(name: str) -> str:
    return f"`--{name.replace('_', '-')}`"


def _number(value: float) -> str:
    return f"{value:.6g}"


# --- Options of the maps ----------------------------------------------------------------------------


#: What maps of a refinement are called.
_KINDS = {"adaptive": "evidence", "paper": "paper", "fixed": "fixed"}


def _options_table() -> str:
    """Each option with its default and the maps that read it, as the library's table has them."""
    rows = []
    for option in MAP_OPTIONS:
        shown = option.default if isinstance(option.default, str) else _number(option.default)
        readers = [kind for kind, name in _KINDS.items() if name in option.read_by]
        rows.append((f"`{option.name}`", shown, ", ".join(readers), option.help))
    return _table(("option", "default", "read by", ""), rows)


# --- Formats ----------------------------------------------------------------------------------------

#: Of each format that is read: the extra that it needs, and where such logs come from.
_READ = {
    "carmen": (
        "",
        "CARMEN and the logs of the Radish and Freiburg collections: `FLASER`, `ROBOTLASER1`, also gzipped",
    ),
    "npz": ("", "`numpy.savez`"),
    "rosbag": (
        "`ros`",
        "`rosbag record`, `ros2 bag record`: LaserScan, MultiEchoLaserScan, PointCloud2, depth Image",
    ),
    "seven_scenes": ("`clouds`", "7-Scenes: depth PNG and a pose each"),
    "tum_rgbd": ("`clouds`", "TUM RGB-D: depth PNG, `depth.txt`, `groundtruth.txt`"),
    "kitti": ("", "KITTI odometry: `velodyne/*.bin`, `calib.txt`, poses"),
    "kitti_raw": ("", "KITTI raw: `velodyne_points/data/*.bin`, `oxts/data/*.txt`, `calib_imu_to_velo.txt`"),
    "e57": ("`e57`", "laser scanners and their programs: a pose for each scan"),
    "ptx": ("", "Leica's and other programs: a pose for each scan"),
    "3dtk": ("", "3DTK: `scan000.3d`, `scan000.pose` or `.frames`"),
    "velodyne": ("`velodyne`", "Wireshark, tcpdump, VeloView: packets of a Velodyne"),
    "depth_folder": ("`clouds`", "Open3D, Redwood: `depth/*.png`, `trajectory.log` or another trajectory"),
    "colmap": ("", "COLMAP's sparse models, text and binary"),
    "bundler": ("", "Bundler, and programs that write `bundle.out`"),
    "bal": ("", "Bundle Adjustment in the Large"),
    "octomap_graph": ("", "OctoMap's scan graphs, `.graph`"),
    "point_clouds": (
        "`clouds`, none for text and `.bin`",
        "a folder of PCD, PLY, LAS, LAZ, text (XYZ, PTS, ASC, CSV) or `.bin` files (KITTI, nuScenes) with a "
        "trajectory, or a pose for each",
    ),
    "text": ("", "your own script: a beam a line"),
}

#: Of each format that is written: the extra that it needs, and who reads it.
_WRITTEN = {
    "ndtree": ("", "`ndtree`, C++ and Python"),
    "octomap": ("", "OctoMap: `octovis`, `octomap_server`"),
    "map_server": ("`convert` for PNG", "map_server, nav2, AMCL"),
    "rosbag": (
        "`ros`",
        "`ros2 bag play`, RViz: `octomap_msgs/Octomap` of a 3-D map, `nav_msgs/OccupancyGrid` of a 2-D one",
    ),
    "ply": ("", "CloudCompare, MeshLab, Blender; `--faces` makes a mesh of it"),
    "pcd": ("`convert`", "PCL, Open3D"),
    "gltf": ("`convert`", "Blender, viewers in web pages"),
    "vtk": ("`convert`", "ParaView, PyVista"),
    "leaves": ("", "`numpy.load`: a record each cell"),
    "grid": ("", "`numpy.load`: a dense array of states"),
}

_STORED = {"file": "file", "folder": "folder", "either": "file or folder"}


def _check(noted: Iterable[str], known: Iterable[str]) -> None:
    differing = set(noted) ^ set(known)
    if differing:
        raise ValueError(
            f"tools/docs_site.py: formats without a note, or notes without a format: {differing}"
        )


def _readers_table() -> str:
    _check(_READ, (one.name for one in READERS))
    rows = []
    for one in READERS:
        extra, source = _READ[one.name]
        options = ", ".join(_flag(name) for name in one.options)
        rows.append((f"`{one.name}`", _STORED[one.stored_as], source, extra, options))
    return _table(("format", "is a", "written by", "extra", "own options"), rows)


def _reader_options_table() -> str:
    rows = ((_flag(one.name), one.shown("map"), one.help) for one in READER_OPTIONS)
    return _table(("option", "default", ""), rows)


def _writers_table() -> str:
    _check(_WRITTEN, (one.name for one in WRITERS))
    rows = []
    for one in WRITERS:
        extra, reader = _WRITTEN[one.name]
        options = ", ".join(_flag(option) for option in one.options)
        rows.append((f"`{one.name}`", _code(one.suffixes), reader, extra, options))
    return _table(("format", "endings", "read by", "extra", "own options"), rows)


# --- Command line -----------------------------------------------------------------------------------


def _flags_table() -> str:
    """Every option of the commands, by the question that it answers."""
    parts = []
    for question, rows in table_of_options():
        parts.append(f"**{question}**\n")
        shown = ((f"`{flag}`", default, when, _takers(commands)) for flag, default, when, commands in rows)
        parts.append(_table(("option", "default", "when to touch it", "of"), shown))
    return "\n".join(parts)


#: Commands that many options have in common: those that read a log, and those that make a map of one.
_READ_A_LOG = ("demo", "map", "align", "clean", "live", "compare", "calibrate", "view", "info")
_MAKE_A_MAP = ("demo", "map", "clean", "live", "fleet", "compare")


def _takers(commands: str) -> str:
    """The commands that take an option, in as few words as say it."""
    if commands == ", ".join(every()):
        return "all"
    left = commands.split(", ")
    for group, words in ((_READ_A_LOG, "all that read a log"), (_MAKE_A_MAP, "all that make a map")):
        if set(group) <= set(left):
            return ", ".join([words, *(one for one in left if one not in group)])
    return commands


def _commands() -> str:
    """A section for each command: what it does, examples, and arguments other than logs."""
    parts: list[str] = []
    for name, command in every().items():
        examples = [line for line in (command.epilog or "").splitlines() if line.startswith("ndtree")]
        paragraphs = map(_plain, (command.help or "").split("\n\n"))
        parts += [f"## ndtree {name}", *paragraphs, "\n".join(["```bash", *examples, "```"])]
        named = [one for one in command.params if one.param_type_name == "argument"]
        arguments = [one for one in named if not _plain(one.help).startswith(("File or folder:", "Files or"))]
        if arguments:
            parts.append(
                _table(("argument", ""), ((_shown(one), _plain(one.help)) for one in arguments)).rstrip()
            )
    return "\n\n".join(parts)


def _shown(parameter: Any) -> str:
    """How an argument is written."""
    return _code((parameter.metavar or parameter.name.upper()).split(" | "))


def _plain(text: str | None) -> str:
    """Help without line breaks and the marks of what prints it."""
    return " ".join((text or "").replace("\\[", "[").split())


# --- Trials -----------------------------------------------------------------------------------------


#: What each capability of tools/trials answers.
_ANSWERS = {
    "map": "where space is free, occupied, unknown; poses are exact",
    "no_return": "whether beams without return are free",
    "noise": "the noise of ranges",
    "setup": "a map from a wrong mount, clock or scale",
    "setup_in_space": "a map from a wrong setup of a 3-D lidar",
    "poses_in_space": "a map of a 3-D lidar from wrong poses",
    "mount": "where a sensor sits on its robot, by `calibrate --find-mount`",
    "align": "the poses of a drive",
    "align_in_space": "the poses of a lidar's drive",
    "slam": "the poses of a drive, scan by scan",
    "match": "one scan's pose in a map, and its covariance",
    "match_in_space": "a lidar's scan in a 3-D map, and its covariance",
    "no_return_in_space": "whether missing echoes of lidars and depth cameras are free",
    "live_in_space": "the map of `ndtree live` of a lidar or a depth camera",
    "localize_in_space": "a lidar in a saved 3-D map",
    "localize": "the robot in a saved map",
    "plan": "paths through that map, for a ball",
    "moved": "`m.moved`: which of a map's points moved",
    "clean": "the points that `ndtree clean` leaves out",
    "static": "the map of `--static`",
    "live": "the map of `ndtree live`, of bags with faults",
    "grid": "the grid for nav2",
}


def _trials_table() -> str:
    """How the last committed trials in random worlds ended, the most often wrong without a word first."""
    counted = json.loads((ROOT / "tools" / "trials_table.json").read_text())
    rows = []
    for name, found in sorted(counted.items(), key=lambda item: -item[1]["counts"][3] / item[1]["trials"]):
        right, doubted, refused, wrong = map(str, found["counts"])
        doubts = f"{doubted} ({found['needless']})" if found["counts"][1] else doubted
        rows.append((f"`{name}`", _ANSWERS[name], str(found["trials"]), right, doubts, refused, wrong))
    head = ("", "answer", "trials", "right", "doubted (though right)", "refused", "wrong without saying so")
    return _table(head, rows)


TABLES: dict[str, Callable[[], str]] = {
    "trials": _trials_table,
    "options": _options_table,
    "readers": _readers_table,
    "reader_options": _reader_options_table,
    "writers": _writers_table,
    "commands": _commands,
    "flags": _flags_table,
}


# --- Reference --------------------------------------------------------------------------------------


def _for_page(docstring: str) -> str:
    """Powers are not bold type, and parameters that share lines get some of their own, for their defaults."""

    def one_each(found: re.Match[str]) -> str:
        return "".join(f"{name}{found[2]}" for name in found[1].split(", "))

    text = re.sub(r"(?<=\w)\*\*(?=\w)", r"\\*\\*", docstring.strip() + "\n")
    return re.sub(r"^(\w+(?:, \w+)+)( : .*\n(?: {4}.*\n)+)", one_each, text, flags=re.MULTILINE)


class CompiledModule(griffe.Extension):
    """Signatures are those of the compiled module's stub; docstrings and defaults are the module's own."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called by griffe for each class, function and attribute."""
        prefix = "ndtree._native._core."
        if obj.is_alias or not obj.path.startswith(prefix):
            return
        found: Any = _core
        for name in obj.path[len(prefix) :].split("."):
            found = getattr(found, name, None)
        text = inspect.cleandoc(getattr(found, "__doc__", None) or "")
        if text.strip() and (obj.is_class or obj.name != "__init__"):
            obj.docstring = griffe.Docstring(_for_page(text), parent=obj, parser="numpy")
        if obj.is_function and (obj.name == "__init__" or not obj.name.startswith("_")):
            self._fill_defaults(obj, inspect.signature(found).parameters)

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Called by griffe when all is read: in a stub, what has overloads has nothing beside them."""
        if pkg.name == "ndtree":
            core = pkg["_native._core"]
            for holder in (core, *core.classes.values()):
                for name, overloads in holder.overloads.items():
                    if overloads and name not in holder.members:
                        holder.set_member(name, overloads[0])
                        overloads[0].overloads = overloads[1:]

    def _fill_defaults(self, function: Any, known: Mapping[str, inspect.Parameter]) -> None:
        for parameter in function.parameters:
            if parameter.default == "...":
                value = known[parameter.name].default
                parameter.default = _number(value) if isinstance(value, float) else repr(value)
