# SPDX-License-Identifier: BSD-3-Clause
"""Where scans were, and what their matches say of odometry."""

from __future__ import annotations

from dataclasses import dataclass, field

from ndtree.alignment.planar import Floats
from ndtree.alignment.sensor_scans import SensorScan


@dataclass(frozen=True)
class Step:
    """A scan whose match contradicts odometry.

    Parameters
    ----------
    scan : int
        Its number.
    is_sure : bool
        Whether it fits as well as others do, and nowhere else near.
    """

    scan: int
    is_sure: bool


@dataclass
class Track:
    """Where scans were, each as it was matched with those before."""

    poses: list[Floats] = field(default_factory=list)  # Of all scans.
    keys: list[int] = field(default_factory=list)  # Scans that are key scans.
    scans: list[SensorScan] = field(default_factory=list)  # Of the key scans.
    way: list[float] = field(default_factory=list)  # Up to each key scan [m].
    relations: list[Floats] = field(default_factory=list)  # Of each key scan to the next.
    covariances: list[Floats] = field(default_factory=list)  # Of these.
    lost: int = 0  # Scans that did not match.
    against: list[Step] = field(default_factory=list)  # Odometry.
    unfixed: list[float] = field(default_factory=list)  # Way of each scan that only odometry tells [m].
    through: list[float] = field(
        default_factory=list
    )  # Of each key scan: points where those before saw through.
    ratios: list[float] = field(default_factory=list)  # Of ways that scans say, to those of odometry.
    final: int = 0  # Key scans up to whose last all stays as it is.

    def copy(self) -> Track:
        """One that can be gone on with by itself."""
        return Track(
            **{name: list(one) if isinstance(one, list) else one for name, one in vars(self).items()}
        )
