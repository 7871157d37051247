# SPDX-License-Identifier: BSD-3-Clause
"""Odometry that stalled and caught up: the scans before are placed again."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from ndtree.alignment.motion import AS_BEFORE, NO_ODOMETRY, best_near, pieces_of
from ndtree.alignment.planar import Floats, between, composed, placed, turned
from ndtree.alignment.sensor_scans import SensorScan, Track
from ndtree.alignment.sliding_map import SlidingMap

_STALLED = 0.2  # Of what the sensor moves from scan to scan, more than which odometry tells something.


def place_again(
    track: Track,
    near: SlidingMap,
    recent: Sequence[SensorScan],
    told: Callable[[SensorScan, SensorScan], Floats],
    least: float,
) -> bool:
    """Place the scans before a leap again: odometry stalled and caught up before it.

    From the scan after which odometry stands still, each is matched around where an even motion has it, and
    around where odometry has it from here, with what was seen before and the last scan: not with each other.
    What fits best in all counts, if it is likelier.

    Parameters
    ----------
    track : Track
        It is changed.
    near : SlidingMap
        The track's.
    recent : sequence of SensorScan
        Its last scans.
    told : callable
        How odometry has the second scan as seen from the first.
    least : float
        Nearer than this to where they are, nothing is tried [m].

    Returns
    -------
    bool
        Whether scans have moved.
    """
    last = len(track.poses) - 1
    anchor = _stands_since(track, recent)
    if anchor >= last - 1 or (track.final and anchor < track.keys[track.final - 1]):
        return False
    scans = recent[len(recent) + anchor - last : -1]
    end, now = np.array(track.poses[last]), np.array(track.poses[anchor + 1 : last])
    moved = end - track.poses[anchor]
    moved[2] = math.remainder(moved[2], 2.0 * math.pi)
    evenly = track.poses[anchor] + np.linspace(0.0, 1.0, last - anchor + 1)[1:-1, None] * moved
    if np.abs(evenly - now)[:, :2].max() < least:
        return False
    if not scans[0].has_heading:
        evenly[:, 2] = now[:, 2]
    by_odometry = [composed(end, told(recent[-1], one)) for one in scans]
    known = int(np.searchsorted(track.keys, anchor, side="right"))
    matcher = near.matcher_of(known, placed(end, recent[-1].points))
    free = NO_ODOMETRY.sigmas(moved / (last - anchor), True)
    pieces = [pieces_of(scan) for scan in scans]
    most = sum(many * matcher.score(one.points, pose) for one, pose, many in zip(scans, now, pieces))
    most -= AS_BEFORE
    best = None
    for guesses in (evenly, by_odometry):
        found = [best_near(matcher, *each, free, many) for *each, many in zip(scans, guesses, pieces)]
        fits = sum(one.score * many for one, many in zip(found, pieces))
        if fits > most:
            best, most = found, fits
    if best is None:
        return False
    for i, (scan, one) in enumerate(zip(scans, best), anchor + 1):
        track.poses[i] = one.pose
        n = int(np.searchsorted(track.keys, i))
        if n < len(track.keys) and track.keys[n] == i:
            near.move(n, scan, one.pose)
            track.covariances[n - 1] = turned(one.covariance, track.poses[track.keys[n - 1]][2])
    for n in range(int(np.searchsorted(track.keys, anchor + 1)), len(track.keys)):
        track.relations[n - 1] = between(track.poses[track.keys[n - 1]], track.poses[track.keys[n]])
    return True


def _stands_since(track: Track, recent: Sequence[SensorScan]) -> int:
    """The scan after which odometry stands still, up to the one before the last."""
    last = len(track.poses) - 1
    first = last - len(recent) + 1
    told = np.diff([scan.pose[:2] for scan in recent[:-1]], axis=0).reshape(-1, 2)
    way = float(np.hypot(*(track.poses[last] - track.poses[first])[:2]))
    is_told = np.hypot(*told.T) > _STALLED * way / max(last - first, 1)
    return first + int(np.flatnonzero(is_told)[-1]) + 1 if is_told.any() else first
