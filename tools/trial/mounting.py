# SPDX-License-Identifier: BSD-3-Clause
"""Judge of where a sensor is said to sit on its robot, and how far its clock to be off."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from trial import bag, faults
from trial.command import run
from trial.outcome import Case, Outcome, limit
from trial.robots import Recording, laser, matrices, planar, poses_along, record, rings
from trial.setup_in_space import driven

_SCANS, _EVERY = 80, 0.1  # [s]
_STEP = 0.02  # Of the poses that are told [s].


def mount_trial(case: Case) -> tuple[Recording, Outcome]:
    """What ``ndtree calibrate --find-mount`` says, from nothing but the robot's poses."""
    rng, outcome, dim = case.rng, Outcome(), case.dim
    mount = np.r_[rng.uniform(-0.3, 0.3, 2), rng.choice([rng.uniform(-0.3, 0.3), rng.uniform(-np.pi, np.pi)])]
    late = rng.uniform(-0.15, 0.15)
    seat = matrices(mount[None, :2], mount[2:], 0.0)[0]
    stamps = _EVERY * np.arange(_SCANS)
    if dim == 2:
        sensor = laser(rng, beams=int(rng.choice([180, 360, 720])))
        sensed = poses_along(case.world, rng, _SCANS, "drives")
    else:
        sensor = rings(rng, int(rng.choice([16, 32])))
        sensed = driven(case.world, rng)(stamps) @ seat
    r = record(case.world.scene, sensor, sensed, rng)
    times = np.arange(-0.2, stamps[-1] + 0.2, _STEP)
    r.told = r.true @ np.linalg.inv(seat)
    if case.fault == "drift":
        r.told = faults.drift(replace(r, true=r.told), rng).told
    base = planar(r.told)
    base[:, 2] = np.unwrap(base[:, 2])
    if case.fault == "noisy":
        base += rng.normal(0, [0.01, 0.01, 0.003], base.shape)
    told = np.c_[[np.interp(times + late, stamps, column) for column in base.T]].T
    is_hung = dim == 2 and bool(rng.random() < 0.3)
    with tempfile.TemporaryDirectory() as folder:
        path, figures = Path(folder) / "log.bag", Path(folder) / "found.json"
        if dim == 2:
            readings = r.ranges[:, ::-1] if is_hung else r.ranges
            bag.write(r, path, readings, [(float(t), float(t) - 0.01, one) for t, one in zip(times, told)])
        else:
            quaternions = np.c_[np.zeros((len(told), 2)), np.sin(told[:, 2] / 2), np.cos(told[:, 2] / 2)]
            places = np.c_[told[:, :2], np.full(len(told), case.world.height)]
            clouds = [(float(stamp), r.points(i)) for i, stamp in enumerate(stamps)]
            bag.write_clouds(path, clouds, list(zip(times.tolist(), places, quaternions)))
        done = run("calibrate", path, "--find-mount", "--json", figures)
    outcome.words = done.doubts
    if done.status:
        outcome.refused = done.error
        return r, outcome
    found = done.figures
    off = {"x": found["x"] - mount[0], "y": found["y"] - mount[1], "time": found["time_offset"] + late}
    off["yaw"] = float(np.degrees(np.angle(np.exp(1j * (found["yaw"] - mount[2])))))
    sigma = dict(zip(("x", "y", "yaw", "time"), found["sigma"]))
    sigma["yaw"] = float(np.degrees(sigma["yaw"]))
    outcome.may_doubt = np.ptp(base[:, 2]) <= 1.0 or not case.world.is_tellable
    for name in (one for one in off if one not in found["untold"]):
        most = max(limit(f"mount {name}" if name in ("yaw", "time") else "mount place"), 3 * sigma[name])
        outcome.figures[name] = round(off[name], 4)
        if abs(off[name]) > most:
            outcome.faults.append(f"{name} {off[name]:.3g} off, told sigma {sigma[name]:.2g}")
    if "yaw" not in found["untold"] and not outcome.may_doubt and is_hung != (abs(found["others"][1]) > 3.0):
        outcome.faults.append("upside down")
    if outcome.faults:
        outcome.words = []
    return r, outcome
