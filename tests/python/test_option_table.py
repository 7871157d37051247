# SPDX-License-Identifier: BSD-3-Clause
"""An option of a map is one row of the library's table: all else comes from it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from tempfile import TemporaryDirectory

import pytest
from snippets import ROOT

import ndtree
from ndtree._native import _core
from ndtree.base.checks import integer, number
from ndtree.base.options import default_of, option, options_of
from ndtree.distributed.engines import ENGINES
from ndtree.evaluation.exploring import STRATEGIES
from ndtree.evaluation.sampling import AUTO
from ndtree.live.ros.parameters import ROWS, check, config_of, in_parameters
from ndtree.logs import FORMATS
from ndtree.logs.core.rules import INVALID, NO_ECHO
from ndtree.logs.poses.covariances import IGNORE, USE
from ndtree.logs.ros.messages.sweep import BY_WORD
from ndtree.logs.ros.survey import POSE_NAMES
from ndtree.maps.kinds import KINDS, MAP_OPTIONS
from ndtree.maps.writers import FORMATS as WRITERS
from ndtree.maps.writers import STATES

#: Loads the compiled module with a row more, before anything reads the table.
WITH_A_ROW = """
import importlib.util, sys
from pathlib import Path
import ndtree

folder = Path(ndtree.__file__).parent / "_native"
file = next(folder.glob("_core.*so")) if list(folder.glob("_core.*so")) else next(folder.glob("_core*.pyd"))
spec = importlib.util.spec_from_file_location("ndtree._native._core", file)
core = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(core)
rows = core.option_table()
row = ("wall_sag", 0.25, 0.0, 1.0, " m", ["evidence"], "SAG", "How far a wall sags.", "in old houses")
core.option_table = lambda: [*rows, row]
import ndtree._native
sys.path.insert(0, {tools!r})
"""
#: Where a row is found: what prints a text, and what stands in it.
PLACES = {
    "signature": ("import inspect; print(inspect.signature(ndtree.AdaptiveMap))", "wall_sag: 'float' = 0.25"),
    "not of others": ("import inspect; print('wall_sag' in str(inspect.signature(ndtree.FixedMap)))",
        "False"),
    "flag": ("from ndtree.cli.commands.pages import pages; print(pages()['map', True])",
        "  --wall-sag SAG          How far a wall sags [m] (default: 0.25 m)."),
    "file": ("print(ndtree.Config.of(wall_sag=0.5).toml())", "[map]\nwall_sag = 0.5"),
    "parameter": (
        "from ndtree.live.ros.parameters import Parameters; "
        "print(Parameters({'wall_sag': 1}, lambda name, value: value, print).map_options)",
        "{'wall_sag': 1.0}",
    ),
    "stub": ("import option_stubs as o; print(o.stub(o.STUB.read_text(), core.option_table()))",
        '    wall_sag : float\n        How far a wall sags [m] ("evidence").'),
    "types": ("import option_stubs as o; print(o.typing(o.TYPING.read_text(), core.option_table()))",
        "    max_memory: float\n    wall_sag: float\n"),
    "page": ("import docs_site; print(docs_site._options_table())",
        "| `wall_sag` | 0.25 | adaptive | How far a wall sags [m]. |"),
    "all flags": ("from ndtree.cli.commands.pages import table_of_options; print(dict(table_of_options()))",
        "('--wall-sag SAG', '0.25 m', 'in old houses', "),
}  # fmt: skip


#: In one process, after what is above: what each place prints, or how it fails.
PRINTED = """
import contextlib, io, json, traceback
said = {{}}
for place, (prints, _) in {places!r}.items():
    with contextlib.redirect_stdout(io.StringIO()) as out:
        try:
            exec(prints, globals().copy())
        except Exception:
            said[place] = None
            traceback.print_exc()
        else:
            said[place] = out.getvalue()
print(json.dumps(said))
"""


@cache
def printed(code: str) -> dict[str, str]:
    code = (code + PRINTED).format(
        tools=str(ROOT / "tools"), places=PLACES if code is WITH_A_ROW else OPTION_PLACES
    )
    with TemporaryDirectory() as folder:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("place", PLACES)
def test_a_row_is_found_everywhere(place: str) -> None:
    if place in ("page",):
        pytest.importorskip("griffe", reason="griffe is not installed: the pages' tables are made with it")
        pytest.importorskip("viser", reason="viser is not installed: the page of the viewer is described")
    pytest.importorskip("typer")
    assert PLACES[place][1] in printed(WITH_A_ROW)[place]


#: Loads the table of options with a row more, before anything reads it.
WITH_AN_OPTION = """
import sys, types
from pathlib import Path
import ndtree._native
import ndtree.base.option

name, head = "ndtree.base.options", '    "Which part of the log?": (\\n'
file = Path(ndtree.__file__).parent / "base" / "options.py"
row = 'Option("drum", int, "Beat of a drum.", "BEAT", "", "at dances", "map live node", 2, "/s", (1, 9)'
text = file.read_text()
assert head in text
module = sys.modules[name] = types.ModuleType(name)
exec(text.replace(head, head + row + ', role="select"),\\n'), module.__dict__)
sys.path.insert(0, {tools!r})
"""
OPTION_PLACES = {
    "help": ("from ndtree.cli.commands.pages import pages; print(pages()['live', True])",
        "  --drum BEAT             Beat of a drum (default: 2 /s)."),
    "not of others": ("from ndtree.cli.commands.pages import pages; print('--drum' in pages()['info', True])",
        "False"),
    "flag": (
        "from typer.testing import CliRunner; from ndtree.cli.commands import app\n"
        "print(CliRunner().invoke(app, ['map', 'a.bag', '--drum', '0']).output)",
        "ndtree: --drum 0: must be a whole number from 1 to 9",
    ),
    "all flags": ("from ndtree.cli.commands.pages import table_of_options; print(dict(table_of_options()))",
        "('--drum BEAT', '2 /s', 'at dances', 'map, live')"),
    "file": (
        "open('a.toml', 'w').write('[log]\\ndrum = 3')\n"
        "from ndtree.tuning.config import Config; print(Config.load('a.toml').toml())",
        "[log]\ndrum = 3",
    ),
    "parameter": (
        "from ndtree.live.ros.parameters import Parameters\n"
        "from ndtree.live.ros.parameters import config_of\n"
        "held = Parameters({'drum': 3}, lambda name, value: value, print)\n"
        "print(config_of(held.value).selection)",
        "{'drum': 3}",
    ),
    "limits": (
        "from ndtree.live.ros.parameters import Parameters\n"
        "try: Parameters({'drum': 10}, lambda name, value: value, print)\n"
        "except ValueError as error: print(error)",
        "drum = 10: must be a whole number from 1 to 9",
    ),
}  # fmt: skip


@pytest.mark.parametrize("place", OPTION_PLACES)
def test_an_option_is_found_everywhere(place: str) -> None:
    pytest.importorskip("typer")
    assert OPTION_PLACES[place][1] in printed(WITH_AN_OPTION)[place]


def test_words_are_those_of_the_program() -> None:
    """Words and defaults that stand in the table are what those who take them know."""
    known: dict[str, tuple[str, Iterable[str]]] = {
        "sweep": ("map", BY_WORD), "pose_covariance": ("map", (AUTO, IGNORE, USE)),
        "strategy": ("explore", STRATEGIES), "zero_is": ("map", (NO_ECHO, INVALID)),
        "no_return": ("map", ("free", "ignore", AUTO)), "engine": ("fleet", ENGINES),
    }  # fmt: skip
    for name, (command, words) in known.items():
        assert set(option(name, command).words) == set(words), name
    for name, command, words in (
        ("maps", "compare", KINDS),
        ("format", "map", FORMATS),
        ("format", "convert", [one.name for one in WRITERS]),
        ("states", "convert", STATES),
        ("poses", "map", POSE_NAMES.split(", ")),
    ):
        said = option(name, command).help
        assert re.findall(r"[\w-]+", said[said.index(words[0]) :])[: len(words)] == list(words), name


def test_users_choose_few_options() -> None:
    assert len(MAP_OPTIONS) <= 18
    assert {one.name for one in MAP_OPTIONS} == {*ndtree.default_options(), "branching", "refinement"}


def test_constants_say_where_they_come_from() -> None:
    constants = [row for row in _core.option_table() if row[6] is None]
    assert len(constants) > 10
    for name, value, least, most, *_, source, when in constants:
        assert least <= value <= most and len(source) > 20 and not when, name
        with pytest.raises(TypeError, match=f"no option {name}"):
            ndtree.AdaptiveMap(dim=2, **{name: value})


def test_a_node_takes_points_with_commas_as_they_are_typed() -> None:
    for name, value in (("box", "-2,-2,-0.2,3,3,2.2"), ("mount", "0,0,90deg"), ("initial_pose", "1,2,0")):
        row = next(one for one in options_of("node") if one.key == name)
        assert row.taken(value) == value and row.taken("") == ""


def test_a_node_leaves_out_empty_topics_and_repetitions() -> None:
    row = next(one for one in options_of("node") if one.key == "topics")
    for given, taken in (
        (["/a", ""], ["/a"]),
        (["", "/a", "/b", "/a"], ["/a", "/b"]),
        ("/a", ["/a"]),
        (["", ""], [""]),
        ([], [""]),
    ):
        assert row.taken(given) == taken
        values = {one.key: one.start for one in ROWS} | {"topics": given}
        assert config_of(values.__getitem__).get("topic") == (taken if any(taken) else None)


@pytest.mark.parametrize("name, given, expected", [
    ("topics", 5, "a list of names"),
    ("topics", ["/a", 5], "a list of names"),
    ("fixed_cells", "yes", "true or false"),
    ("no_return", "maybe", "one of auto, free, ignore"),
])  # fmt: skip
def test_a_node_names_the_parameter_that_is_wrong(name: str, given: object, expected: str) -> None:
    with pytest.raises(ValueError) as caught:
        check(name, given)
    said = f"{name} = {given}: must be {expected}"
    assert str(caught.value) == in_parameters(caught.value) == said


def test_limits_of_nodes_are_not_those_of_the_command_line() -> None:
    """A node's sliders end where values are of use; who types may go on."""
    of_nodes = {
        "pixel_stride": (1, 64), "stride": (1, 1000), "every": (1, 100000), "queue": (1, 100000),
        "follow_memory": (1, 1e6), "window": (0, 1e6), "dim": (0, 3), "diagnostics_period": (0.01, 1000),
        **dict.fromkeys(("look", "patience", "robot_radius", "grid_cell_size"), (0, 1000)),
        **dict.fromkeys(("grid_clear", "grid_stays", "ground_slope", "grid_period"), (0, 1000)),
        **dict.fromkeys(("cells_period", "frontiers_period", "octomap_period"), (0, 1000)),
        "octomap_cell_size": (0, 1000),
    }  # fmt: skip
    assert {row.key: row.range for row in ROWS if row.key in of_nodes} == of_nodes
    with pytest.raises(ValueError, match=r"patience = 1001\.0: must be a number from 0 to 1,000"):
        check("patience", 1001.0)
    for name, value in (("queue", 200000), ("follow_memory", 0.5), ("patience", 5000.0), ("every", 10**7)):
        assert option(name, "live").check(value) == value


def test_limits_are_said_as_they_are() -> None:
    assert integer(1, 10**6).expected == "a whole number from 1 to 1,000,000"
    assert number(0.01, 1e6).expected == "a number from 0.01 to 1,000,000"
    assert number(-1e6, 2.5).expected == "a number from -1,000,000 to 2.5"
    assert number(0.0, above=True).expected == "a number > 0" and integer(1).expected == "a whole number >= 1"


def test_words_that_may_be_repeated_are_words_still() -> None:
    row = option("strategy", "explore")
    assert row.check("nearest") == "nearest" and row.check(["nearest", "random"]) == ["nearest", "random"]
    for wrong in ("foo", ["nearest", "foo"], ["random", "random"]):
        with pytest.raises(ValueError):
            row.check(wrong)
    pytest.importorskip("typer")
    from calling import cli

    done = cli("explore", "office", "--strategy", "foo")
    assert done.exit_code == 2
    assert "--strategy foo: must be one of information, nearest, random" in done.stderr
    assert "list" not in done.stderr


def test_a_default_is_that_of_one_taker() -> None:
    with pytest.raises(ValueError, match="look: commands differ"):
        default_of("look")
    assert (
        default_of("look", "node") == default_of("look", "live") == 2.0
        and default_of("look", "info") is False
    )
    assert default_of("patience") == 1.0


def test_a_node_describes_its_parameters_in_its_own_words() -> None:
    """No flags, bags and placeholders of the command line; and what 0 or nothing means, where that is off."""
    said = {row.key: row.description for row in ROWS}
    for name, text in said.items():
        assert name == "grid_high" or text[0] in text[0].upper() + "[", name
        assert not re.search(r"(^|\s)-\w\b|\bLOG\b|\bMAP\b|ROS bag", text), name
    for name in ("dim", "max_range", "window", "fade"):
        assert "; 0: " in said[name], name
    assert "; none: " in said["topics"] and "X,Y,YAW" in said["initial_pose"]
