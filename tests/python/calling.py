# SPDX-License-Identifier: BSD-3-Clause
"""Calls commands in the process of the tests."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("typer")

from typer.testing import CliRunner

from ndtree.cli.commands import app


def cli(*words: object) -> Any:
    """What became of ``ndtree`` with these words: status, output, and what was said of it."""
    return CliRunner().invoke(app, [str(word) for word in words])
