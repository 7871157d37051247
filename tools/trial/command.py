# SPDX-License-Identifier: BSD-3-Clause
"""The command line, run in this process: what it answers, and which doubts come with it."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

#: Lines that tell a user to look again: each names what is unsure, or what is not in the answer.
_DOUBT = re.compile(
    r"doubt|unsure|not sure|cannot tell|could not be|poses drift|poses err|lie apart|not fit"
    r"|contradict|passed over|[1-9]\d* (left out|dropped)|lost [1-9]|withdrawn|too late|no pose|jumps? back"
)


@dataclass(frozen=True)
class Done:
    """How a command ended."""

    status: int
    text: str
    figures: dict[str, Any]

    @property
    def error(self) -> str:
        lines = [line for line in self.text.splitlines() if line.startswith("ndtree:")]
        return lines[-1] if lines else self.text[-200:]

    @property
    def unknown(self) -> list[str]:
        """What is said, in words and JSON, of space that was seen and is not known."""
        chosen = self.figures.get("chosen") or {}
        said = [str(one) for one in (*self.figures.get("notes", ()), chosen.get("no_return_why", ""))]
        text = " ".join(self.text.split())
        return [one for one in said if "stays unknown" in one and one in text]

    @property
    def doubts(self) -> list[str]:
        """What the command says against its own answer, in words or as ``doubts`` in its JSON."""
        said = [line.strip() for line in self.text.splitlines() if _DOUBT.search(line)]
        return said + list(self.figures.get("doubts") or [])


def run(*arguments: object) -> Done:
    """Run ``ndtree`` with these arguments; an argument behind ``--json`` is read afterwards."""
    from typer.testing import CliRunner

    from ndtree.cli.commands import app

    words = [str(one) for one in arguments]
    done = CliRunner().invoke(app, words)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    figures: dict[str, Any] = {}
    if "--json" in words:
        path = Path(words[words.index("--json") + 1])
        figures = json.loads(path.read_text()) if path.exists() else {}
    return Done(done.exit_code, done.output, figures)
