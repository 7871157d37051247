# SPDX-License-Identifier: BSD-3-Clause
"""A yard with a gate and parked cars that follow the hour: a map whose third axis is the time of day."""

import argparse

import numpy as np
from matplotlib.figure import Figure

import ndtree

HOUR = 0.1  # What an hour is long on the third axis: one of the smallest cells [m].
WALLS = [(-0.2, -0.2, 24, 0), (-0.2, 11.8, 24, 12), (-0.2, 0, 0, 12), (23.8, 0, 24, 4), (23.8, 7, 24, 12)]
GATE, PLACES = (23.8, 4, 24, 7), [(2 + 2.6 * i, 7, 3.8 + 2.6 * i, 11.2) for i in range(8)]
TIMES = [(7, 16), (8, 15), (8, 17), (9, 18), (9, 16), (10, 19), (18, 8), (19, 7)]  # A car comes, and leaves.
REACH, ANGLES = 20.0, np.linspace(0, 2 * np.pi, 360, endpoint=False)


def boxes_at(hour, random):
    """What stands: walls, the gate outside 7 to 19 h, each car on nine days of ten."""
    days = [(hour - a) % 24 < (b - a) % 24 for a, b in TIMES]
    cars = [place for place, is_day in zip(PLACES, days) if is_day and random.uniform() < 0.9]
    return WALLS + [GATE] * (not 7 <= hour < 19) + cars


def ranges(origin, ways, boxes):
    planes = (np.array(boxes, float).reshape(-1, 1, 2, 2) - origin) / ways[:, None]
    enter, leave = planes.min(axis=2).max(axis=2), planes.max(axis=2).min(axis=2)
    return np.where((enter > 0) & (enter < leave), enter, np.inf).min(axis=0)


def scans_of(day):
    """Hour, origin, end points, what returned, and which beams go where something may change."""
    random = np.random.default_rng(day)
    for hour in range(24):
        boxes = boxes_at(hour, random)
        for origin in ([4.0, 3.5], [12.0, 3.5], [20.0, 3.5]):
            angles = ANGLES + random.uniform(0.001, 0.02)
            ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
            far, empty, full = (ranges(origin, ways, b) for b in (boxes, WALLS, [*WALLS, GATE, *PLACES]))
            ends = origin + np.minimum(far + random.normal(0, 0.01, len(far)), REACH)[:, None] * ways
            yield hour, origin, ends, far < REACH, empty != full


def in_time(points, hours):
    return np.column_stack([points, HOUR * np.broadcast_to(hours, len(points))])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", nargs="?", default="timetable.png", help="file to draw the answers in")
    parser.add_argument("--days", type=int, default=8, help="that are mapped; the next one judges")
    arguments = parser.parse_args()
    options = {"min_cell_size": 0.1, "max_cell_size": 1.6, "range_sigma": 0.01}
    one, *hourly = (ndtree.AdaptiveMap(dim=2, **options) for _ in range(25))
    timed, random = ndtree.AdaptiveMap(dim=3, **options), np.random.default_rng(0)
    for hour, origin, ends, returned, _ in (scan for i in range(arguments.days) for scan in scans_of(i)):
        times = hour + random.uniform(0, 1, len(ends))  # So that all of the hour is seen.
        timed.insert(in_time(ends, times), in_time([origin] * len(ends), times), returned=returned)
        for m in (one, hourly[hour]):
            m.insert(ends, origin, returned=returned)
    names = ("one map, kept up to date", "a map an hour", "x, y, time of day")
    cells = [sum(m.stats().observed_leaves for m in some) for some in ([one], hourly, [timed])]
    truth = [[ndtree.HeldOutTruth(), ndtree.HeldOutTruth()] for _ in names]  # Of all beams; of what changes.
    for hour, origin, ends, returned, changes in scans_of(arguments.days):
        at = (timed, in_time(ends, hour + 0.5), in_time([origin], hour + 0.5)[0])
        for of, (m, points, start) in zip(truth, ((one, ends, origin), (hourly[hour], ends, origin), at)):
            for i, use in enumerate((changes | True, changes)):
                of[i] += m.evaluate(points[use], start, returned=returned[use])
        one.insert(ends, origin, returned=returned)
    accuracy = [[t.balanced_accuracy for t in of] for of in truth]
    for name, right, count in zip(names, accuracy, cells):
        print(f"{name:<24}: {right[0]:.1%} right, where it changes {right[1]:.1%}; {count} cells")
    grid = np.stack(np.meshgrid(np.arange(-1, 27, 0.1), np.arange(-1, 13, 0.1)), axis=-1).reshape(-1, 2)
    figure = Figure(figsize=(9.6, 5.2), layout="constrained")
    for ax, hour in zip(figure.subplots(2, 2).ravel(), (None, 3, 12, 18)):
        state = one.state(grid) if hour is None else timed.state(in_time(grid, hour + 0.5))
        ax.imshow(np.array([1, 0, 0.8])[state].reshape(140, 280), origin="lower", cmap="gray", vmin=0, vmax=1)
        ax.set(title="one map, at midnight" if hour is None else f"at {hour} h", xticks=[], yticks=[])
    figure.savefig(arguments.picture, dpi=80)
