# SPDX-License-Identifier: BSD-3-Clause
"""What `OccupancyMap.certify` says."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Certificate:
    """At most `at_most` of what a scan finds called free is occupied, with the probability `confidence`.

    Attributes
    ----------
    at_most : float
        Share in [0, 1]; 1 where there are too few scans to say anything.
    confidence : float
        Probability that a scan keeps to it, over the scans that it was computed from and that one.
    scans : int
        Held-out scans that the map calls any point of free.
    worst : float
        The largest of their shares; nan of none.
    free : int
        Points that the map calls free, of all these scans.
    occupied : int
        Those of them that are end points.
    """

    at_most: float
    confidence: float
    scans: int
    worst: float
    free: int
    occupied: int

    def __str__(self) -> str:
        return (
            f"at most {100 * self.at_most:.2f} % of what a scan finds called free is occupied, "
            f"at {100 * self.confidence:g} % ({self.scans} scans held out)"
        )
