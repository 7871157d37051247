# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of things, for people."""

from __future__ import annotations


def number_of(count: int, thing: str, grouping: str = "") -> str:
    """As "1 scan" and "20 scans"; with ``","`` as `grouping`, thousands stand apart."""
    return f"{count:{grouping}} {thing}{'' if count == 1 else 's'}"
