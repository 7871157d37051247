# SPDX-License-Identifier: BSD-3-Clause
"""A robot explores an unknown office: it drives where a metre shows the most, until all is seen."""

import sys

import numpy as np

import ndtree
from ndtree import plot

RADIUS, RANGE, STRIDE = 0.2, 12.0, 1.0  # Of the robot, of its laser, and at least between two looks [m].
LASER, EXPECTED = (ndtree.RangeSensor.laser(max_range=RANGE, beams=beams) for beams in (720, 120))
body, world, rng = ndtree.Sphere(RADIUS), ndtree.simulate("office"), np.random.default_rng(1)
m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.05, range_sigma=0.02)
track, seen, done = [np.array(world[0].origin)], set(), False  # Where it was; places that show nothing new.
planner = ndtree.Planner(m, body)
looks = 0
while not done and (looks := looks + 1) < 1000:
    ranges = world.distance(track[-1], LASER.directions, max_range=RANGE)
    ends = np.where(np.isnan(ranges), RANGE, ranges + rng.normal(0.0, 0.02, len(ranges)))
    m.insert(track[-1] + ends[:, None] * LASER.directions, track[-1], returned=~np.isnan(ranges))
    m.mark(ndtree.Sphere(RADIUS + 0.05), "free", [*track[-1], 0.0])  # Where it is, it may be.
    planner.update(m)
    lower, upper = np.floor(np.array(m.bounds()))
    lattice = np.mgrid[lower[0] : upper[0] + 1 : 0.5, lower[1] : upper[1] + 1 : 0.5].reshape(2, -1).T
    places = np.array([place for place in lattice[m.state(lattice) == 0] if tuple(place) not in seen])
    places = places.reshape(-1, 2)[~m.collides(body, places.reshape(-1, 2), unknown="occupied")]
    gains = m.information_gain(places, EXPECTED).volume
    seen.update(tuple(place) for place in places[gains < RADIUS**2])
    best = np.argsort(-gains / (1.0 + np.linalg.norm(places - track[-1], axis=1)))[:64]
    places, gains = places[best], gains[best]
    worth = np.where(gains < RADIUS**2, 0.0, gains / (1.0 + planner.ways(track[-1], places)))
    done = not (worth > 0.0).any()
    if not done:
        way = planner.plan(track[-1], places[worth.argmax()]).points
        along = np.linalg.norm(np.diff(way, axis=0), axis=1).cumsum()
        track.extend(way[1 : 2 + np.searchsorted(along, min(STRIDE, along[-1]))])
print(f"{looks} looks, {'nothing left to see' if done else 'not done'}: {m}")
ax = plot.occupancy(m)
ax.plot(*np.array(track).T, color="tab:red", linewidth=1.0)
ax.figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "explore.png", dpi=90, bbox_inches="tight")
