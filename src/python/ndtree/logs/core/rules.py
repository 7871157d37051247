# SPDX-License-Identifier: BSD-3-Clause
"""How a log is read: decided before it is, and the same for all of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ndtree.logs.core.silence import CutOff

NO_ECHO, INVALID = "no-echo", "invalid"
#: Not known where the ranges of a log end: its first loop looks.
UNSEARCHED = CutOff(math.inf, 0.0)


@dataclass(frozen=True)
class Rules:
    """What readers obey; see `Log.ruled`.

    Attributes
    ----------
    keep_going : bool
        Pass over what is damaged instead of raising.
    strict : bool
        Raise for scans whose pose is not known, and for files that end too early, instead of leaving out what
        cannot be used.
    no_return_range : float or None
        Up to where a beam that met nothing is free [m] if the log does not say; None: it says nothing then.
    zero_is : {"no-echo", "invalid"} or None
        What beams with a range of 0 mean: that nothing was hit, or nothing at all. None: not stated, and they
        mean nothing.
    cut_off : CutOff or None
        Where readings are a driver's way to say that nothing was hit.
    """

    keep_going: bool = False
    strict: bool = False
    no_return_range: float | None = None
    zero_is: str | None = None
    cut_off: CutOff | None = UNSEARCHED


GIVEN, MEASURED, USUAL = "given", "measured", "usual"


@dataclass(frozen=True)
class Decision:
    """A value of how a log is read or mapped: given by a user, measured on the log, or what is usual; why."""

    value: Any
    source: str = GIVEN
    why: str = ""
