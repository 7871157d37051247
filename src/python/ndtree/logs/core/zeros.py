# SPDX-License-Identifier: BSD-3-Clause
"""What a range of 0 means: no echo, or nothing at all."""

from __future__ import annotations

from ndtree.logs.core.rules import INVALID, NO_ECHO
from ndtree.logs.core.source import ReaderOption, WrongOption

ZERO_IS = ReaderOption(
    "zero_is", str, "Of lasers: what range 0 is, no-echo or invalid; else the log decides."
)


def checked(path: str, zero_is: str | None) -> str | None:
    """The same. @raises WrongOption if it is none of these."""
    if zero_is not in (None, NO_ECHO, INVALID):
        raise WrongOption(f"{path}: zero_is = {zero_is!r}: must be {NO_ECHO} or {INVALID}")
    return zero_is
