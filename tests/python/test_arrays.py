# SPDX-License-Identifier: BSD-3-Clause
"""Arrays of any layout and type give the same map; wrong ones give one clear error and change nothing."""

import pickle

import numpy as np
import pytest
from conftest import room_scan

import ndtree
from ndtree._errors import located, spelled

POINTS, ORIGIN = room_scan(2, 0, 50)


@pytest.mark.parametrize(
    "points",
    [
        np.asfortranarray(POINTS),
        np.repeat(POINTS, 2, axis=0)[::2],
        POINTS[::-1][::-1],
        POINTS.tolist(),
        POINTS.astype(">f8"),
    ],
    ids=["fortran", "strided", "negative stride", "list", "big endian"],
)
def test_layouts_give_the_same_map(points):
    one, other = ndtree.AdaptiveMap(dim=2), ndtree.AdaptiveMap(dim=2)
    one.insert(POINTS, ORIGIN)
    other.insert(points, ORIGIN.tolist())
    assert one.to_bytes() == other.to_bytes()


def test_float32_is_taken_at_its_value():
    one, other = ndtree.AdaptiveMap(dim=2), ndtree.AdaptiveMap(dim=2)
    one.insert(POINTS.astype(np.float32), ORIGIN)
    other.insert(POINTS.astype(np.float32).astype(np.float64), ORIGIN)
    assert one.to_bytes() == other.to_bytes()


def test_empty_scans_and_questions_are_fine():
    m = ndtree.AdaptiveMap(dim=2)
    assert m.insert(np.empty((0, 2)), ORIGIN).beams == 0
    assert m.state(np.empty((0, 2))).shape == (0,)
    assert m.cast_rays(np.zeros(2), np.empty((0, 2))).shape == (0,)


WRONG = [
    (lambda m: m.insert(np.zeros((3, 3)), ORIGIN), ValueError, "points has shape (3, 3): must be (n, 2)"),
    (lambda m: m.insert(np.zeros(3), ORIGIN), ValueError, "points has shape (3,): must be (n, 2)"),
    (lambda m: m.insert(POINTS, np.zeros(3)), ValueError,
        "origin has shape (3,): must be (2,), one for all, or (50, 2), one each"),
    (lambda m: m.insert(POINTS, np.zeros((3, 2))), ValueError,
        "origin has shape (3, 2): must be (2,), one for all, or (50, 2), one each"),
    (lambda m: m.insert(POINTS, ORIGIN, returned=np.ones(3, bool)), ValueError,
        "returned has shape (3,): must be (50,), one for each point"),
    (lambda m: m.insert(POINTS, ORIGIN, returned=np.ones(50)), TypeError,
        "returned: must be an array of bool, or None"),
    (lambda m: m.insert(POINTS, ORIGIN, max_range=0), ValueError, "max_range = 0.0 m: must be > 0"),
    (lambda m: m.insert(POINTS, [0.0, np.nan]), ValueError, "origin = (0.0, nan) m: every component must be"),
    (lambda m: m.insert([[1e18, 0.0]], ORIGIN), ValueError, "beam 0 is 1e+18 m long"),
    (lambda m: m.insert([["a", "b"]], ORIGIN), TypeError,
        "points has dtype <U1: must be an array of real numbers"),
    (lambda m: m.insert(POINTS + 1j, ORIGIN), TypeError, "points has dtype complex128: must be"),
    (lambda m: m.state(np.zeros((1, 3))), ValueError, "points has shape (1, 3): must be (n, 2)"),
    (lambda m: m.cast_rays(ORIGIN, [[1, 1], [0, 0]]), ValueError, "ray 1: the direction must not be zero"),
    (lambda m: m.cast_rays(ORIGIN, [[1, 1], [1, np.nan]]), ValueError, "ray 1: origin and direction must be"),
    (lambda m: m.cast_rays(ORIGIN, np.ones((1, 2)), max_range=-1), ValueError,
        "max_range = -1.0 m: must be > 0"),
    (lambda m: m.occupied_within(POINTS, -1), ValueError, "radius = -1.0 m: must be >= 0"),
    (lambda m: m.cast_rays(ORIGIN, POINTS, unknown="no"), ValueError, "unknown = 'no'"),
    (lambda m: m.cast_rays(ORIGIN, POINTS, at="wall"), ValueError,
        "at = 'wall': must be 'cell' or 'surface'"),
    (lambda m: m.distance_field([[0, 0], [1, 1]], 0.0), ValueError, "cell_size"),
    (lambda m: m.distance_field([[0, 0], [0, 1]], 0.1), ValueError, "box: from"),
    (lambda m: m.keep_near(ORIGIN, 0.0), ValueError, "radius"),
    (lambda m: m.keep_near(ORIGIN, np.nan), ValueError, "radius = nan"),
    (lambda m: m.mark([[0, 0], [1, 1]], "free", np.zeros(3)), ValueError, "a box of two corners has none"),
    (lambda m: m.clear([[0, 0], [1, 1]], np.zeros(3)), ValueError, "a box of two corners has none"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", WRONG, ids=[w[2] for w in WRONG])
def test_wrong_arguments_are_refused_and_change_nothing(call, error, message):
    m = ndtree.AdaptiveMap(dim=2)
    m.insert(POINTS, ORIGIN)
    before = m.to_bytes()
    with pytest.raises(error) as caught:
        call(m)
    assert message in str(caught.value)
    assert m.to_bytes() == before


OPTIONS = [
    ({"min_cell_size": -0.1}, ValueError, "min_cell_size = -0.1: must be in [1e-09, 1000000] m"),
    ({"max_cell_size": 0.01}, ValueError, "max_cell_size = 0.01: must be at least min_cell_size"),
    ({"range_sigma": 0}, ValueError, "range_sigma = 0.0: must be in [1e-09, 1000000] m"),
    ({"probability_max": 0.3}, ValueError, "probability_max = 0.3: must be in [0.51, 0.999999]"),
    ({"refinement": "paper", "significance": 1.0}, ValueError,
        "significance = 1.0: must be in [1e-06, 0.999999999]"),
    ({"beam_divergence": 3}, ValueError, "beam_divergence = 3.0: must be in [0, 2] rad"),
    ({"evidence_half_life": -1}, ValueError, "evidence_half_life = -1.0: must be in [0, 1e+09] scans"),
    ({"merge_loss": 3}, TypeError, "no option merge_loss"),
    ({"constants": {"merge_loss": -1}}, ValueError, "merge_loss = -1.0: must be in [0, 1e+09] bits"),
    ({"constants": {"range_sigma": 1}}, TypeError, "range_sigma: is no constant of the maps"),
    ({"miss_given_occupied": 0.5, "hit_given_free": 0.5}, ValueError, "hit_given_free = 0.5: must be less"),
    ({"significance": 0.9}, TypeError, "the refinement 'evidence' does not read significance"),
    ({"refinement": "paper", "covered_share": 1}, TypeError,
        "the refinement 'paper' does not read covered_share"),
    ({"branching": 5}, ValueError, "branching = 5, dim = 2: must be branching 2, 3 or 4"),
    ({"dim": 4, "branching": 3}, ValueError, "branching = 3, dim = 4"),
    ({"refinement": "clever"}, ValueError, "refinement = 'clever': must be 'evidence' or 'paper'"),
    ({"cell_size": 0.1}, TypeError, "no option cell_size: did you mean min_cell_size?"),
    ({"min_cell_size": "small"}, TypeError, "min_cell_size = 'small': must be a number"),
    ({"min_cell_size": 1e-9, "max_cell_size": 1e9}, ValueError, "at most 2^36 of the smallest"),
]  # fmt: skip


@pytest.mark.parametrize("options, error, message", OPTIONS, ids=[o[2] for o in OPTIONS])
def test_wrong_options_are_refused(options, error, message):
    with pytest.raises(error) as caught:
        ndtree.AdaptiveMap(**{"dim": 2, **options})
    assert message in str(caught.value)


def test_a_fixed_map_takes_no_options_of_refinement():
    with pytest.raises(TypeError, match="no option significance"):
        ndtree.FixedMap(dim=2, significance=0.9)
    for name in ("min_cell_size", "cell_size"):  # The second is another name.
        assert ndtree.FixedMap(dim=2, **{name: 3.0}).options["min_cell_size"] == 3.0


def test_errors_carry_option_value_and_what_was_expected():
    with pytest.raises(ValueError) as caught:
        ndtree.AdaptiveMap(dim=2, max_cell_size=0.01)
    error = pickle.loads(pickle.dumps(caught.value))
    assert (error.option, error.value) == ("max_cell_size", "0.01")
    assert str(error) == "max_cell_size = 0.01: must be at least min_cell_size = 0.05 m"
    spelled_out = spelled(error, lambda name: f"<{name}>")
    assert spelled_out == "<max_cell_size> 0.01: must be at least <min_cell_size> 0.05 m"
    there = located("a.toml", error)
    assert str(there) == f"a.toml: {error}" and spelled(there, str.upper).startswith(
        "a.toml: MAX_CELL_SIZE 0.01"
    )


def test_constants_of_older_maps_are_kept():
    """They are no options, and a file that has others than today's goes on with them."""
    m = ndtree.AdaptiveMap(dim=2, constants={"merge_loss": 3.0, "evidence_memory": 100.0})
    assert m.to_bytes() != ndtree.AdaptiveMap(dim=2).to_bytes()
    assert ndtree.from_bytes(m.to_bytes()).to_bytes() == m.to_bytes()
    assert "merge_loss" not in m.options and m.options == ndtree.AdaptiveMap(dim=2).options


def test_options_default_to_those_of_the_library():
    read = set()
    for refinement in ("evidence", "paper"):
        m = ndtree.AdaptiveMap(dim=2, refinement=refinement)
        assert m.options.items() < ndtree.default_options().items()
        changed = {name: value * 0.99 for name, value in m.options.items()}
        assert ndtree.AdaptiveMap(dim=2, refinement=refinement, **changed).options == changed
        read |= set(m.options)
    assert read == set(ndtree.default_options())


def test_files_that_cannot_be_read_or_written(tmp_path):
    m = ndtree.AdaptiveMap(dim=2)
    with pytest.raises(FileNotFoundError):
        ndtree.load(tmp_path / "none.ndt")
    with pytest.raises(IsADirectoryError):
        ndtree.load(tmp_path)
    with pytest.raises(FileNotFoundError):
        m.save(tmp_path / "no folder" / "hall.ndt")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError):
        m.save(tmp_path / "folder")
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]


def test_misaligned_arrays_are_copied():
    bytes_ = b"x" + POINTS.tobytes()
    misaligned = np.frombuffer(bytes_, "f8", offset=1).reshape(POINTS.shape)
    assert not misaligned.flags.aligned
    one, other = ndtree.AdaptiveMap(dim=2), ndtree.AdaptiveMap(dim=2)
    one.insert(POINTS, ORIGIN)
    other.insert(misaligned, ORIGIN)
    assert one.to_bytes() == other.to_bytes()


def test_a_beam_too_long_to_be_sampled_is_refused_when_evaluating():
    m = ndtree.AdaptiveMap(dim=2)
    with pytest.raises(ValueError, match=r"beam 0 is .* m long: .* give a max_range"):
        m.evaluate([[1e12, 0.0]], ORIGIN)
    with pytest.raises(ValueError, match="max_range = -1"):
        m.evaluate(POINTS, ORIGIN, max_range=-1)
    assert m.evaluate([[1e12, 0.0]], ORIGIN, max_range=20).casts == 0
