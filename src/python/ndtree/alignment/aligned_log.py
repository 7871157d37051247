# SPDX-License-Identifier: BSD-3-Clause
"""A log whose scans are where an alignment puts them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ndtree.alignment.planar import Floats, placed, seen_from
from ndtree.alignment.sensor_scans import pose_in_log
from ndtree.base.scan import Scan
from ndtree.logs.core.log import Log


class AlignedLog(Log):
    """A log with other poses, one for each of its scans; it is read as lazily as the log.

    Raises
    ------
    ValueError
        When it is read, if the log has another number of scans than there are poses.
    """

    may_be_padded = False

    def __init__(self, log: Log, poses: Floats) -> None:
        super().__init__(log.path, log.dim)
        self.format, self.uses, self.keep_going = log.format, log.uses, log.keep_going
        self.strict, self.notes, self.knows_no_returns = log.strict, log.notes, log.knows_no_returns
        self.is_depth_camera, self.is_raw = log.is_depth_camera, log.is_raw
        self.has_sensor = log.has_sensor
        self.skipped = log.skipped
        self.zero_is, self.may_be_zero = log.zero_is, log.may_be_zero
        self.no_return_range = log.no_return_range
        self._log = log
        self._poses = poses

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def name(self) -> str:
        """How reports call the log: as itself."""
        return self._log.name

    @property
    def cut_off(self) -> float | None:
        """As of the log."""
        return self._log.cut_off

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """As of the log."""
        return self._log.spans

    @property
    def share_read(self) -> float | None:
        """As of the log."""
        return self._log.share_read

    def _scans(self) -> Iterator[Scan]:
        self._log.zero_is = self.zero_is
        count = 0
        for scan in self._log:
            if count == len(self._poses):
                break
            yield moved(scan, self._poses[count])
            count += 1
        else:
            if count == len(self._poses):
                self.zeros = self._log.zeros
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
    )
