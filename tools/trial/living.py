# SPDX-License-Identifier: BSD-3-Clause
"""Judges of maps for robots: made while a bag plays, and drawn as a grid to drive by."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import ndtree
from trial import bag, faults
from trial.command import run
from trial.maps import Truth, count_in, distance_to, judge_lost, judge_map, mapped
from trial.outcome import Case, Outcome, limit
from trial.robots import Recording, poses_along, record, rings, small_sensor_of, tilted
from trial.scene import Floats
from trial.sensing import readings_of


def live_trial(case: Case) -> tuple[Recording, Outcome]:
    """``ndtree live`` of a bag, with its defaults."""
    rng, fault, outcome = case.rng, case.fault, Outcome()
    sensor, cell = small_sensor_of(rng, case.dim), 0.05 if case.dim == 2 else 0.1
    true = poses_along(case.world, rng, 60 if case.dim == 2 else 45, "drives")
    if fault == "begins_late":
        true[:20] = true[20]
    r = record(case.world.scene, sensor, true, rng)
    readings = readings_of(r, fault, rng)
    truth = Truth(case.world, r, cell, rng)
    if case.dim == 3 and fault != "largest":  # Clouds and images do not say where such beams went.
        truth.endless = 0.0
    transforms = _transforms(r, fault)
    if fault == "stamps_back":
        r.stamps[35:] -= 1.0
    with tempfile.TemporaryDirectory() as folder:
        log = bag.write(r, Path(folder) / "log.bag", readings, transforms)
        paths = [Path(folder) / name for name in ("live.ndt", "map.ndt", "live.json", "map.json")]
        size = "--min-cell-size", cell
        done = run("live", log, "--rate", "0", "-o", paths[0], "--json", paths[2], *size)
        outcome.words = done.doubts
        if done.status:
            outcome.refused = done.error
            return r, outcome
        m = ndtree.load(paths[0])
        again = run("map", log, "-o", paths[1], "--json", paths[3], *size)
        is_same = not again.status and paths[0].read_bytes() == paths[1].read_bytes()
    outcome.figures["same as map"] = is_same
    outcome.may_doubt = fault in ("begins_late", "missing", "stamps_back")
    outcome.drawn["map"] = m
    if fault != "stamps_back":  # What a clock that jumps back makes of poses, only words can tell.
        judge_map(m, truth, outcome)
        ends = truth.ends[count_in(truth.ends, truth.ends, truth.cell) >= 5]
        if len(ends) >= 100:
            judge_lost(m, truth, outcome, ends)
        outcome.excuse(done.unknown)
    elif not is_same:
        outcome.faults.append("another map than of the recording")
    return r, outcome


def _transforms(r: Recording, fault: str) -> list[tuple[float, float, Floats]]:
    """Stamp, time of arrival and pose as x, y, yaw, z and pitch: 20 a second, as odometry comes."""
    late = 0.3 if fault == "late" else 0.01
    poses, result = tilted(r.told), []
    poses[:, 2] = np.unwrap(poses[:, 2])
    for stamp in np.arange(-0.05, r.stamps[-1] + 0.1, 0.05):
        at = np.clip(stamp, r.stamps[0], r.stamps[-1])
        pose = np.array([np.interp(at, r.stamps, column) for column in poses.T])
        if fault == "begins_late" and stamp < 1.2:
            continue
        if fault == "missing" and 3.0 < stamp < 4.5:
            continue
        result.append((float(stamp), float(stamp + late), pose))
    return result


def grid_trial(case: Case) -> tuple[Recording, Outcome]:
    """The grid of a 3-D map for nav2: obstacles within a band of heights."""
    rng, cell, low, high, outcome = case.rng, 0.1, 0.2, 1.5, Outcome()
    r = record(case.world.scene, rings(rng), poses_along(case.world, rng, 16, "drives"), rng)
    if case.fault == "pitch":
        r = faults.pitch(r, rng)
    truth = Truth(case.world, r, cell, rng)
    m = mapped(r, cell, is_fixed=case.is_fixed)
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "m.ndt", Path(folder) / "m.yaml"
        m.save(source)
        done = run("convert", source, target, "--height", low, high)
        outcome.words = done.doubts
        if done.status:
            outcome.refused = done.error
            return r, outcome
        plan = _Grid(target)
    # Well inside the band: cells have an edge of their own.
    ends = truth.ends
    inside = (ends[:, 2] > low + cell) & (ends[:, 2] < high - cell)
    obstacles = ends[inside & (count_in(ends, ends, cell) >= 5)][::3]
    if len(obstacles) >= 50:
        far = distance_to(obstacles[:, :2], plan.occupied) > truth.margin
        outcome.expect("grid", 100 * np.mean(far), "% of obstacles lost")
        outcome.drawn["obstacles lost"] = obstacles[far]
    flat = ends[(ends[:, 2] > low - truth.margin) & (ends[:, 2] < high + truth.margin)]
    places = truth.points(3000)
    places[:, 2] = rng.uniform(low + cell, high - cell, len(places))
    places = truth.centers(places)
    seen = places[truth.passing(places, range(len(r))) >= 2]
    if len(seen) and len(flat):
        nearest = distance_to(seen[:, :2], flat[::5, :2])
        clear = seen[nearest > truth.margin + cell]
        if len(clear) >= 50:
            taken = distance_to(clear[:, :2], plan.occupied) < 0.5 * cell
            outcome.expect("grid, clear", 100 * np.mean(taken), "% of clear columns occupied", limit("grid"))
            outcome.drawn["clear but occupied"] = clear[taken]
    outcome.drawn["map"] = m
    return r, outcome


class _Grid:
    """An image of map_server's, read as nav2 does: `occupied` are the centers of its black pixels [m]."""

    def __init__(self, path: Path) -> None:
        from PIL import Image

        lines = dict(line.split(":", 1) for line in path.read_text().splitlines() if ":" in line)
        resolution = float(lines["resolution"])
        x, y = (float(one) for one in lines["origin"].strip(" []").split(",")[:2])
        with Image.open(path.parent / lines["image"].strip(" '\"")) as image:
            dark = 1 - np.asarray(image.convert("L"), float) / 255
        row, column = np.nonzero(dark > float(lines["occupied_thresh"]))
        self.occupied = np.c_[x + (column + 0.5) * resolution, y + (len(dark) - row - 0.5) * resolution]
