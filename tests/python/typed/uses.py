# SPDX-License-Identifier: BSD-3-Clause
"""Calls as users write them, for the type checker: it is read, never run."""

import pickle
from pathlib import Path
from typing import Union

import numpy as np
from numpy.typing import NDArray
from typing_extensions import assert_type

import ndtree
from ndtree.typing import FixedMapOptions, MapOptions, SimulationOptions, StateName, UnknownAs

options: MapOptions = {"min_cell_size": 0.05, "range_sigma": 0.02}
adaptive = ndtree.AdaptiveMap(dim=2, refinement="paper", **options)
again = ndtree.AdaptiveMap(dim=adaptive.dim, **adaptive.options)
equal: FixedMapOptions = {"min_cell_size": 0.1}
fixed = ndtree.FixedMap(dim=3, branching=3, **equal)
simulated: SimulationOptions = {"outlier_rate": 0.0}
log = ndtree.simulate("office", scans=20, **simulated)
size: float = adaptive.options["min_cell_size"]

points: NDArray[np.float64] = np.zeros((3, 4, 2))
report = adaptive.insert(points, [0.0, 0.0], max_range=20)
assert_type(report, ndtree.InsertReport)
assert_type(report.returned, int)
assert_type(adaptive.state(points), NDArray[np.int8])
assert_type(adaptive.state([1.0, 2.0]), int)
assert_type(adaptive.state([[1.0, 2.0]]), NDArray[np.int8])
assert_type(adaptive.probability((1.0, 2.0)), float)
assert_type(adaptive.probability(points, of="hit"), NDArray[np.float32])
assert_type(adaptive.probability((1.0, 2.0), interval=0.9), tuple[float, float, float])
assert_type(adaptive.probability(points, interval=0.9)[1], NDArray[np.float32])
assert_type(adaptive.certify(log), ndtree.Certificate)
assert_type(adaptive.min_cell_size, float)
assert_type(adaptive.to_grid([[0, 0], [1, 1]]), NDArray[np.int8])
assert_type(adaptive.to_grid([[0, 0], [1, 1]], 0.1, values="log_odds"), NDArray[np.float32])
assert_type(adaptive.cast_rays([0, 0], points), NDArray[np.float64])
assert_type(adaptive.cast_rays([0, 0], points, at="cell"), NDArray[np.float64])
assert_type(adaptive.cast_rays([0, 0], points, details=True), ndtree.RayEnds)
assert_type(adaptive.cast_rays([0, 0], points, unknown="stop", details=True)[0].lower, NDArray[np.float64])

states: list[StateName] = ["free", "unknown"]
leaves = adaptive.leaves(states=states)
assert_type(leaves, ndtree.Leaves)
assert_type(leaves[leaves.state == 1], ndtree.Leaves)
assert_type([leaf.size for leaf in leaves], list[NDArray[np.float64]])
assert_type(adaptive.stats().pruned_leaves, Union[int, None])

unknown: UnknownAs = "occupied"
body = ndtree.Sphere(0.2) | ndtree.Box((0.5, 0.3))
assert_type(adaptive.collides(body, [0.0, 0.0, 0.0], unknown=unknown), bool)
assert_type(adaptive.collides(body, [[0.0, 0.0], [1.0, 1.0]]), NDArray[np.bool_])
assert_type(ndtree.view(adaptive).url, str)
field = adaptive.distance_field([[0, 0], [1, 1]], 0.1, unknown=unknown)
assert_type(field.gradient(points), NDArray[np.float64])
assert_type([f.center for f in adaptive.frontiers()], list[NDArray[np.float64]])
assert_type(ndtree.from_grid(np.zeros((2, 2), np.int8), [0, 0], 0.1), ndtree.AdaptiveMap)
assert_type(ndtree.from_grid(np.zeros((2, 2), np.int8), [0, 0], 0.1, refinement="fixed"), ndtree.FixedMap)
adaptive.save(Path("map.ply"))
assert_type(adaptive == fixed, bool)
loaded: ndtree.AdaptiveMap = pickle.loads(pickle.dumps(adaptive))

#: Each of these lines has a mistake that the checker must see.
ndtree.AdaptiveMap(dim=2, refinement="fixed")  # wrong: arg-type
ndtree.AdaptiveMap(dim=2, cell_size=0.1)  # wrong: call-arg
ndtree.AdaptiveMap(min_cell_size=0.1)  # wrong: call-arg
ndtree.simulate("ofice")  # wrong: arg-type
ndtree.simulate("office", outliers=0.1)  # wrong: call-arg
adaptive.collides(body, points, unknown="pass")  # wrong: call-overload
adaptive.to_grid([[0, 0], [1, 1]], values="states")  # wrong: call-overload
adaptive.leaves(states=["full"])  # wrong: list-item
misspelt: MapOptions = {"min_cel_size": 0.1}  # wrong: typeddict-unknown-key
