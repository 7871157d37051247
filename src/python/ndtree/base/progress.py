# SPDX-License-Identifier: BSD-3-Clause
"""How far a long call is."""

from __future__ import annotations

from collections.abc import Callable

#: Called as ``progress(what, done, total)``: the step, and how much of it is done; a total of 0 is unknown.
Progress = Callable[[str, int, int], None]


def no_progress(what: str, done: int, total: int) -> None:
    """A `Progress` that shows nothing."""
