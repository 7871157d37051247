# SPDX-License-Identifier: BSD-3-Clause
"""The pages of --help are those of the commands, short, complete, and come at once."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rich")

from calling import cli

import ndtree
from ndtree.base import options
from ndtree.base.options import OPTIONS, QUESTIONS
from ndtree.cli.commands import COMMANDS, every
from ndtree.cli.commands.app import USUAL
from ndtree.cli.commands.pages import MOST_LINES, pages, table_of_options
from ndtree.cli.help import FOLDER, page_asked_for, path_of


def options_of(command: str) -> list[str]:
    return [
        one.name for one in every()[command].params if one.param_type_name == "option" and one.name != "help"
    ]


def test_pages_are_those_of_the_commands() -> None:
    """With NDTREE_UPDATE_DOCS in the environment, they are written."""
    made = {command: text for (command, whole), text in pages().items() if not whole}
    for command, text in made.items():
        file = Path(path_of(command))
        if "NDTREE_UPDATE_DOCS" in os.environ:
            file.write_text(text)
        assert file.read_text() == text, "NDTREE_UPDATE_DOCS=1 pytest tests/python/test_help.py mends it"
    assert sorted(os.listdir(FOLDER)) == sorted(os.path.basename(path_of(c)) for c in made)
    assert len(made) == 1 + len(COMMANDS)


def test_a_page_is_short() -> None:
    for command in ("ndtree", *COMMANDS):
        text = Path(path_of(command)).read_text()
        assert len(text.splitlines()) <= MOST_LINES
        assert max(map(len, text.splitlines())) <= 104
        assert command == "ndtree" or f"more: ndtree {command} --help-all" in text


def test_every_option_has_its_default_and_is_in_the_table() -> None:
    made = pages()
    for command in COMMANDS:
        text = " ".join(made[command, True].replace(", --no-", "/").split())
        names = options_of(command)
        assert names
        for name in names:
            flag = max(next(one for one in every()[command].params if one.name == name).opts, key=len)
            assert re.search(rf"{flag}[ ,/](?:(?! --).)*\((?:must be given|default: [^)]+)\)", text), flag
        assert sorted(names) == sorted(one.name for one in options.options_of(command))
        assert len(USUAL[command]) <= 5 and set(USUAL[command]) <= set(names)


def test_a_row_is_of_commands_that_there_are() -> None:
    assert {taker for one in OPTIONS for taker in one.of.split()} == {*COMMANDS, "node"}
    shown = [question for question, _ in table_of_options()]
    assert shown == [
        question for question, rows in QUESTIONS.items() if any(one.of != "node" for one in rows)
    ]


def test_defaults_are_those_of_the_program() -> None:
    """Where a parameter has one; those of the maps' options are the maps' own."""
    made, checked = pages(), 0
    for command in COMMANDS:
        text = " ".join(made[command, True].split())
        for parameter in every()[command].params:
            value = getattr(parameter.default, "value", parameter.default)
            if parameter.name in ndtree.default_options():
                value = ndtree.default_options()[parameter.name]
                if command in ("compare", "demo") or not parameter.name.startswith("range_sigma"):
                    assert f"(default: {value:g}" in text, parameter.name
                    checked += 1
            elif isinstance(value, (int, str)) and not isinstance(value, bool):
                flag = max(parameter.opts, key=len)
                assert re.search(rf"{flag} (?:(?! --).)*\(default: {re.escape(str(value))}", text), flag
                checked += 1
    assert checked > 50


def test_the_command_prints_its_page() -> None:
    made = pages()
    for command in COMMANDS:
        for words in (["--help"], ["nothing", "-h", "--no-such"], ["nothing", "--help-all"]):
            done = cli(command, *words)
            assert (done.exit_code, done.stderr) == (0, ""), command
            assert done.stdout == made[command, "--help-all" in words]


def test_behind_two_dashes_nothing_is_asked_for() -> None:
    assert page_asked_for(["map", "--", "--help"]) is None
    assert page_asked_for(["map", "a.bag"]) is None
    assert page_asked_for(["--help"]) == page_asked_for(["--help-all"]) == Path(path_of("ndtree")).read_text()
    assert page_asked_for(["nope", "--help"]) is None
    assert page_asked_for(["../../x", "--help"]) is None


def test_a_page_comes_without_what_makes_it() -> None:
    """No typer, no NumPy, no compiled module, so that it takes hardly longer than to start Python."""
    code = (
        "import sys; sys.argv = ['ndtree', 'map', '--help']\n"
        "from ndtree.cli import main\ntry: main()\nexcept SystemExit as end: status = end.code\n"
        "print(status, *sorted(name for name in sys.modules if name.startswith('ndtree')))\n"
        "print(*(name for name in ('typer', 'rich', 'numpy') if name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    page = Path(path_of("map")).read_text()
    assert (
        done.stdout
        == page
        + "0 ndtree ndtree._lazy ndtree.base ndtree.base.exit_status ndtree.cli ndtree.cli.help "
        "ndtree.cli.interrupt\n\n"
    )


def test_no_words_get_the_page_and_a_wrong_call() -> None:
    done = cli()
    assert done.exit_code == 2 and done.stdout == "" and done.stderr == pages()["ndtree", False]
