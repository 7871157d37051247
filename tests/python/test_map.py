# SPDX-License-Identifier: BSD-3-Clause
"""Maps as Python sees them: what a scan does, and that queries, files and copies agree."""

import copy
import pickle

import numpy as np
import pytest
from conftest import room_scan, with_room

import ndtree
from ndtree._native import _core


def make(kind: str, branching: int, dim: int) -> ndtree.OccupancyMap:
    sizes = {2: 0.8, 3: 0.9, 4: 0.8}
    if kind == "fixed":
        return ndtree.FixedMap(dim=dim, branching=branching, min_cell_size=0.1)
    return ndtree.AdaptiveMap(
        dim=dim, branching=branching, min_cell_size=0.1, max_cell_size=sizes[branching], range_sigma=0.02
    )


@pytest.fixture(params=["adaptive", "fixed"])
def filled(request, shape) -> ndtree.OccupancyMap:
    branching, dim = shape
    return with_room(make(request.param, branching, dim), 5)


@pytest.mark.parametrize("has_own_noise", [False, True])
@pytest.mark.parametrize(
    ("world", "branching", "scans"), [("office", 2, 60), ("office", 3, 30), ("apartment", 2, 3)]
)
def test_smallest_cells_below_the_noise_change_nothing(
    world: str, branching: int, scans: int, has_own_noise: bool
) -> None:
    """Sec. III-A: the cells' size comes from the measurements, not from a choice made before."""
    drive = list(ndtree.simulate(world, scans=scans))
    said = []
    for levels in (0, 1, 2):  # Below cells of 0.1 m.
        m = ndtree.AdaptiveMap(
            dim=drive[0].dim, branching=branching, range_sigma=0.08, max_cell_size=0.9,
            min_cell_size=0.9 / branching ** ({2: 3, 3: 2}[branching] + levels),
        )  # fmt: skip
        for scan in drive:
            sigma = np.full(len(scan), 0.08) if has_own_noise else None
            m.insert(scan.endpoints, scan.origin, returned=scan.returned, max_range=8.0, range_sigma=sigma)
        leaves = m.leaves(states=["free", "occupied"])
        rays = drive[-1].endpoints - drive[-1].origin
        ranges = m.cast_rays(drive[-1].origin, rays[np.isfinite(rays).all(axis=1)])
        said.append((leaves.lower, leaves.size, leaves.probability, ranges))
    assert len(said[0][0]) > 100
    for others in said[1:]:
        for one, other in zip(said[0], others):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def test_counts_of_leaves_are_those_of_the_leaves():
    kinds = ["evidence", "paper", "fixed"] + ["octomap"] * ndtree.has_octomap
    for refinement in kinds:
        kind = {"fixed": ndtree.FixedMap, "octomap": ndtree.OctoMap}.get(refinement, ndtree.AdaptiveMap)
        m = kind(dim=2, **({"refinement": refinement} if kind is ndtree.AdaptiveMap else {}))
        assert not _core.leaf_counts(m)
        with_room(m, 20)
        leaves = m.leaves()
        sizes = np.unique(leaves.size[leaves.observed])
        assert len(sizes) > (kind is ndtree.AdaptiveMap)
        rows = _core.leaf_counts(m)
        assert [row[0] for row in rows] == sizes.tolist()
        for size, *counts in rows:
            some = leaves[leaves.observed & (leaves.size == size)]
            states = [np.count_nonzero(some.state == state) for state in (0, 1)]
            assert counts == [len(some), *states, np.count_nonzero(some.disputed)]


def test_insert_reports_each_outcome(shape):
    branching, dim = shape
    m = make("adaptive", branching, dim)
    axis = np.eye(dim)[0]
    points = np.array([axis, 2 * axis, 9 * axis, 0 * axis, np.full(dim, np.nan), np.full(dim, np.inf)])
    report = m.insert(
        points, np.zeros(dim), returned=np.array([True, False, True, True, True, True]), max_range=5
    )
    assert (report.beams, report.returned, report.not_returned) == (6, 1, 1)
    assert (report.beyond_max_range, report.invalid) == (1, 3)
    assert report.updates == m.stats().updates > 0
    assert report.seconds > 0
    assert "invalid=3" in repr(report)


def test_queries_agree_with_the_leaves(filled):
    leaves = filled.leaves()
    stats = filled.stats()
    assert len(leaves) == stats.leaves == len(leaves.size) == len(leaves.lower)
    assert leaves.observed.sum() == stats.observed_leaves
    centre = leaves.lower + leaves.size[:, None] / 2
    np.testing.assert_array_equal(filled.state(centre), leaves.state)
    np.testing.assert_allclose(filled.probability(centre), leaves.probability)
    np.testing.assert_allclose(
        leaves.probability, 1 / (1 + np.exp(-leaves.log_odds.astype(float))), rtol=1e-6
    )
    np.testing.assert_array_equal(
        filled.state(leaves.lower), leaves.state
    )  # half-open: the lower corner is inside
    assert (leaves.log_odds[~leaves.observed] == 0).all()
    assert (leaves.hits[~leaves.observed] == 0).all()


def test_file_pickle_and_copy_keep_everything(filled, tmp_path):
    path = tmp_path / "room.ndt"
    filled.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["room.ndt"]
    again = ndtree.load(str(path))
    assert type(again) is type(filled)
    bytes_ = filled.to_bytes()
    for other in (again, pickle.loads(pickle.dumps(filled)), copy.copy(filled), copy.deepcopy(filled)):
        assert other.to_bytes() == bytes_
        assert other.options == filled.options
    points, origin = room_scan(filled.dim, 77)
    one, two = copy.copy(filled), ndtree.from_bytes(bytes_)
    one.insert(points, origin)
    assert filled.to_bytes() == bytes_  # a copy is independent
    two.insert(points, origin)
    assert one.to_bytes() == two.to_bytes()  # and goes on as the original would


def test_four_dimensions_hold_time_as_a_fourth_axis():
    """A door on three days (x, y, z, time): closed in the first half, in the second a wall behind it."""
    m = ndtree.AdaptiveMap(dim=4, branching=2, min_cell_size=0.1, max_cell_size=0.8, range_sigma=0.02)
    random = np.random.default_rng(5)
    for i in range(180):
        time = 0.8 * (i % 60 + 0.5) / 60
        target = np.column_stack(
            [np.full(400, 1.05 if time < 0.4 else 2.05), random.uniform(-0.5, 0.5, (400, 2))]
        )
        m.insert(np.column_stack([target, np.full(400, time)]), [0.0, 0.0, 0.0, time])
    at = random.uniform(-0.2, 0.2, (300, 2))
    closed = np.column_stack([np.full(300, 1.05), at, np.full(300, 0.2)])
    opened = closed + np.array([0, 0, 0, 0.4])
    assert m.occupied_within(closed, 0.05).mean() > 0.9
    assert (m.state(opened) == 0).mean() > 0.9
    ahead = np.tile([1.0, 0.0, 0.0, 0.0], (300, 1))
    cell = 0.8  # hits deep inside a cell leave no conflict that would split it further
    for points, distance in ((closed, 1.05), (opened, 2.05)):
        ranges = m.cast_rays(points * [0, 0, 0, 1], ahead, at="cell")
        assert distance - cell <= np.median(ranges) <= distance


@pytest.mark.skipif(not ndtree.has_octomap, reason="built without OctoMap")
@pytest.mark.parametrize("options", [{}, {"insertion": "scan"}], ids=str)
def test_octomap_is_a_map_like_others(options):
    o = ndtree.OctoMap(min_cell_size=0.1, dim=3, **options)
    f = ndtree.FixedMap(min_cell_size=0.1, dim=3)
    for seed in range(20):
        points, origin = room_scan(3, seed)
        assert o.insert(points, origin).returned == f.insert(points, origin).returned == 300
    inside = np.random.default_rng(0).uniform(-1.5, 1.5, (2000, 3))
    known = (o.state(inside) != -1) & (f.state(inside) != -1)
    assert known.mean() > 0.9 and (o.state(inside) == f.state(inside))[known].mean() > 0.98
    again = pickle.loads(pickle.dumps(o))
    np.testing.assert_array_equal(again.probability(inside), o.probability(inside))
