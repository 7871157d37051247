# SPDX-License-Identifier: BSD-3-Clause
"""A log whose scans are where an alignment puts them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ndtree.alignment.planar import Floats, placed, seen_from
from ndtree.alignment.sensor_scans import pose_in_log
from ndtree.base.scan import Scan
from ndtree.logs.core.log import DerivedLog, Log


class AlignedLog(DerivedLog):
    """A log with other poses, one for each of its scans; it is read as lazily as the log.

    Raises ValueError when it is read, if the log has another number of scans than there are poses.
    """

    def __init__(self, log: Log, poses: Floats) -> None:
        super().__init__(log)
        self._poses = poses

    def __len__(self) -> int:
        return len(self._poses)

    def _moved(self, scan: Scan, pose: Floats) -> Scan:
        return moved(scan, pose)

    def _scans(self) -> Iterator[Scan]:
        count = 0
        for scan in self._log:
            if count == len(self._poses):
                break
            yield self._moved(scan, self._poses[count])
            count += 1
        else:
            if count == len(self._poses):
                return
        raise ValueError(f"{self.name}: has not the {len(self._poses)} scans that were aligned")


def moved(scan: Scan, pose: Floats) -> Scan:
    """A scan whose sensor is at another pose."""
    before = pose_in_log(scan)

    def there(points: Floats) -> Floats:
        return placed(pose, seen_from(before, np.atleast_2d(points).astype(np.float64)))

    origin = there(scan.origin)
    return replace(
        scan,
        endpoints=there(scan.endpoints),
        origin=origin[0] if scan.origin.ndim == 1 else origin,
        heading=None if scan.heading is None else float(pose[2]),
        pose_covariance=None,  # That of the log's pose.
    )
