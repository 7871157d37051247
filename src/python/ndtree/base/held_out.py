# SPDX-License-Identifier: BSD-3-Clause
"""Which scans of a log are kept for the truth."""

from __future__ import annotations


def is_held_out(i: int, held_out: int) -> bool:
    """Whether scan i, counted from 0, is kept for the truth: the last of every `held_out`; none if 0."""
    return held_out > 0 and i % held_out == held_out - 1
