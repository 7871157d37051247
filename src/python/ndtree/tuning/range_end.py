# SPDX-License-Identifier: BSD-3-Clause
"""Readings around a log's largest range: no echo, if beams of other scans pass where they end.

They are surfaces if nearer readings end there, too, or on the plane that they make, such as the ground.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ndtree._errors import Text, key
from ndtree._native import _core
from ndtree.base.scan import Scan
from ndtree.evaluation.sampling import skipping_unmappable
from ndtree.logs.core.silence import (
    LEAST_NOISY,
    NEAR,
    NOISE_REACH,
    CutOff,
    CutOffSearch,
    Points,
    float32_rounding,
    noise_around,
    ranges_of,
)

#: Cells that are surely smaller than what is asked about them [m]: of points from one place.
_LEAST_CELL = 0.01


@dataclass(frozen=True)
class RangeEnd:
    """Many readings at a sample's largest range, or around it.

    `is_empty`: More of their end points than not are where other scans saw that nothing is. Else nothing
        tells them from a surface that stays as far away, such as a pipe.
    """

    limit: CutOff
    is_empty: bool

    def __str__(self) -> str:
        least, most = self.limit.at - self.limit.tolerance, f"{self.limit.at:.4g}"
        step = 10.0 ** (math.floor(math.log10(least)) - 2)
        below = step * (math.ceil(least / step) - 1)  # In three digits.
        which = f"of {most}" if f"{least:.4g}" == most else f"from {least:.4g} to {most}"
        return Text(
            f"readings {which} m, the log's largest range, are taken as surfaces: its poses cannot tell "
            f"whether something is there. If nothing is: {key('max_range')} {below:.3g}"
        )


def range_end(sample: list[Scan]) -> RangeEnd | None:
    """The peak at the end of the ranges of a sample's returned beams; None without one, or on a surface.

    One of another shape than noise has is a surface unless it is seen that nothing is there.
    """
    if not any(len(scan) for scan in sample):
        return None
    limit, sigma, is_bell = _peak(sample)
    if limit is None:
        return None
    returned = _in_their_plane([replace(scan.returned_only(), range_sigma=None) for scan in sample])
    is_end = [ranges_of(scan) >= limit.at - limit.tolerance for scan in returned]
    ends = np.concatenate([scan.endpoints[there] for scan, there in zip(returned, is_end)]).astype(np.float64)
    if len(ends) < LEAST_NOISY:
        return None
    nearer = [scan.only(~there) for scan, there in zip(returned, is_end)]

    def moved(looking: list[Scan], cell: float) -> float:
        """The median over the ends: more than 0.5 if beams pass them, less if others end there, too."""
        evidence = _core.MovedEvidence(
            dim=ends.shape[1], cell_size=cell, range_sigma=max(sigma, _LEAST_CELL / 2)
        )
        for use, scans in ((evidence.add, returned), (evidence.look, looking)):
            for scan in scans:
                with skipping_unmappable():
                    use(scan.endpoints, scan.origin)
        return float(np.median(evidence.probability(ends)))

    cells = list(_cells(limit, sigma))
    if any(moved(returned, cell) > 0.5 for cell in cells):
        return RangeEnd(limit, is_empty=True)
    is_met = any(moved(nearer, cell) < 0.5 for cell in cells if cell <= NEAR * limit.at)
    is_surface = not is_bell or is_met or _are_in_a_plane(ends, nearer, sigma)
    return None if is_surface else RangeEnd(limit, is_empty=False)


def _peak(sample: list[Scan]) -> tuple[CutOff | None, float, bool]:
    """The end of the ranges, the standard deviation of its noise [m], and whether it has a noise's shape.

    Readings most of which are equal have it, too: none that is measured comes so often to the last bit.
    """
    search = CutOffSearch(says_itself=False, least_scans=2)
    for scan in sample:
        search.add(scan)
    found = search.found()
    if found is not None:
        return found, found.tolerance / 4, True
    ranges = np.concatenate([ranges_of(scan) for scan in sample])
    largest = float(ranges.max())
    if not largest > 0:
        return None, 0.0, False
    farthest = NOISE_REACH * largest
    reach, sigma, is_bell = noise_around(largest - ranges[ranges >= largest - farthest], farthest)
    peak = ranges[ranges >= largest - reach]
    spread = float(np.median(np.abs(peak - np.median(peak))))
    is_bell = is_bell or spread <= max(map(float32_rounding, sample))
    return (CutOff(largest, reach) if 0 < reach <= farthest else None), sigma, is_bell


def _cells(limit: CutOff, sigma: float) -> Iterator[float]:
    """Sizes in which it is asked: beams far apart tell of none that is smaller than their distance."""
    cell = max(2 * sigma, _LEAST_CELL)
    while cell <= NOISE_REACH * limit.at:
        yield cell
        cell *= 2


def _in_their_plane(scans: list[Scan]) -> list[Scan]:
    """Scans of one horizontal plane in two dimensions; others as they are."""
    heights = np.concatenate(
        [part.reshape(-1, part.shape[-1]) for s in scans for part in (s.endpoints, s.origin)]
    )
    heights = heights[np.isfinite(heights).all(axis=1)]
    if heights.shape[1] == 2 or np.ptp(heights[:, 2]) > _LEAST_CELL:
        return scans
    return [replace(s, endpoints=s.endpoints[:, :2], origin=s.origin[..., :2]) for s in scans]


def _are_in_a_plane(ends: Points, nearer: list[Scan], sigma: float) -> bool:
    """Whether end points at a limit make a plane in which as many nearer ones lie, but no sensor.

    What a sensor does not reach is a sphere around it: nothing nearer lies in a plane that touches that.
    """
    middle = ends.mean(axis=0)
    normal = np.linalg.svd(ends - middle, full_matrices=False)[2][-1]

    def aside(points: Points) -> Points:
        return np.abs((points - middle) @ normal)

    least = 4 * max(float(np.sqrt(np.mean(aside(ends) ** 2))), sigma, _LEAST_CELL / 2)
    if any(aside(scan.origin).min() <= least for scan in nearer):
        return False
    return sum(int((aside(scan.endpoints) <= least).sum()) for scan in nearer) >= len(ends)
