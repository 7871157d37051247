# SPDX-License-Identifier: BSD-3-Clause
"""Calibration finds the noise and the error rates that a log was made with, and those known of real ones."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import arrays_of

import ndtree
from ndtree.tuning.calibration import range_noise
from ndtree.tuning.calibration.noise import _fitted


def sigma_at(found: ndtree.Calibration, r: float) -> float:
    assert found.range_sigma is not None and found.range_sigma_quadratic is not None
    return found.range_sigma.value + found.range_sigma_quadratic.value * r**2


def kept(world: str, **options: Any) -> list[ndtree.Scan]:
    return list(ndtree.simulate(world, **options))


@pytest.fixture(scope="module")
def office() -> list[ndtree.Scan]:
    return kept("office", seed=3, scans=160)


@pytest.fixture(scope="module")
def found_office(office: list[ndtree.Scan]) -> ndtree.Calibration:
    return ndtree.calibrate(office)


# --- Noise ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [2.0])
def test_constant_noise_is_recovered(scale: float) -> None:
    found = ndtree.calibrate(kept("office", seed=2, scans=160, noise_scale=scale))
    for r in (0.5, 2.0, 5.0):
        assert sigma_at(found, r) == pytest.approx(0.02 * scale, rel=0.2)
    assert found.range_sigma.low <= found.range_sigma.value <= found.range_sigma.high
    assert found.range_sigma.high - found.range_sigma.low < 0.4 * found.range_sigma.value
    assert found.range_sigma.count > 10_000 and found.surfaces > 300


def test_noise_that_grows_with_the_range_is_recovered() -> None:
    found = ndtree.calibrate(kept("apartment", seed=2, scans=28))
    for r in (0.8, 1.5, 3.0, 5.0):
        assert sigma_at(found, r) == pytest.approx(0.002 + 0.0015 * r**2, rel=0.2)
    assert found.range_sigma_quadratic.low > 0
    rising = [sigma for _, sigma, _ in found.sigma_by_range]
    assert rising[-1] > 5 * rising[0]


def test_a_log_without_noise_has_almost_none() -> None:
    found = ndtree.calibrate(kept("office", seed=2, scans=80, noise_scale=0))
    assert found.range_sigma.value < 1e-6
    assert found.range_sigma_quadratic.value < 1e-6
    assert found.options()["range_sigma"] == 1e-4
    ndtree.AdaptiveMap(dim=2, **found.options())


def test_errors_of_poses_are_in_the_noise(found_office: ndtree.Calibration) -> None:
    blurred = ndtree.calibrate(kept("office", seed=3, scans=100, position_sigma=0.03))
    assert sigma_at(blurred, 2.0) > 1.3 * sigma_at(found_office, 2.0)


def test_without_flat_surfaces_there_is_no_noise_to_give() -> None:
    random = np.random.default_rng(5)
    print("seed 5")
    cloud = [ndtree.Scan(random.uniform(-9, 9, (400, 3)), np.zeros(3)) for _ in range(20)]
    found = ndtree.calibrate(cloud)
    assert found.range_sigma is None and found.range_sigma_quadratic is None
    assert found.surfaces == 0 and found.sigma_by_range == ()
    assert not {"range_sigma", "range_sigma_quadratic"} & set(found.options())
    assert "no flat surfaces" in str(found)
    assert json.loads(found.to_json())["range_sigma"] is None
    assert ndtree.calibrate(cloud, max_range=1e-3).range_sigma is None, "no beam is that short"


def test_a_body_that_walks_is_no_surface() -> None:
    random = np.random.default_rng(0)
    bearing, height = np.meshgrid(np.linspace(-0.3, 0.3, 40), np.linspace(-0.3, 0.3, 40))
    beam = np.stack([np.cos(bearing), np.sin(bearing), height], axis=-1).reshape(-1, 3)
    beam /= np.linalg.norm(beam, axis=1)[:, None]

    def seen(step: int) -> ndtree.Scan:
        """A post of 20 cm, 1.6 m away, with noise of 3 mm."""
        middle = np.array([1.6 + 0.15 * math.sin(step), 0.06 * step])
        square, half = (beam[:, :2] ** 2).sum(axis=1), beam[:, :2] @ middle
        root = half**2 - square * (middle @ middle - 0.2**2)
        meets = root > 0
        length = (half[meets] - np.sqrt(root[meets])) / square[meets]
        return ndtree.Scan(
            beam[meets] * (length + random.normal(0, 0.003, len(length)))[:, None], np.zeros(3)
        )

    assert range_noise([seen(step) for step in range(12)]) is None


@pytest.mark.parametrize("walls", [1, 2, 3])
def test_what_one_or_two_places_show_may_be_no_surface(walls: int) -> None:
    generator = np.random.default_rng(8)

    def seen(step: int) -> ndtree.Scan:
        near = [
            generator.uniform((6.0 * wall + 0.3, 2.0), (6.0 * wall + 1.7, 2.0), (150, 2))
            for wall in range(walls)
        ]
        points = np.concatenate(near) + generator.normal(0.0, 0.02, (150 * walls, 2)) * (0, 1)
        return ndtree.Scan(points, (9.0 + 0.01 * step, 0.0))

    found = range_noise([seen(step) for step in range(20)])
    assert (found is not None) == (walls == 3)


def test_growth_is_not_told_from_ranges_that_are_alike() -> None:
    random = np.random.default_rng(1)
    angle = np.radians(np.arange(-20, 20, 0.25))
    beam = np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def seen(step: int) -> ndtree.Scan:
        """A wall 1 m ahead, whose noise happens to grow fast to one side of the little that is seen."""
        length = 1 / beam[:, 0]
        noise = random.normal(0, 0.005 + 0.1 * (length - 1), len(length))
        origin = np.array([0.0, 6.0 * (step % 3)])
        return ndtree.Scan(origin + beam * (length + noise)[:, None], origin)

    found = range_noise([seen(step) for step in range(40)])
    assert found is not None and found[1].value == 0 and found[0].value < 0.03


@pytest.mark.parametrize(
    "where, sigma, expected",
    [
        ([1.0, 2.0, 3.0], [0.03, 0.06, 0.11], (0.02, 0.01)),
        ([1.0, 2.0, 3.0], [0.02, 0.02, 0.02], (0.02, 0.0)),
        ([1.0, 2.0, 3.0], [0.01, 0.04, 0.09], (0.0, 0.01)),
        ([2.0], [0.02], (0.02, 0.0)),
        ([1.0, 2.0, 3.0], [0.03, math.nan, 0.11], (0.02, 0.01)),
    ],
)
def test_fit_is_exact_where_the_noise_is(where: Any, sigma: Any, expected: Any) -> None:
    found = _fitted(np.array(where), np.array(sigma), np.ones(len(where)))
    assert found == pytest.approx(expected, abs=1e-4)


def test_fit_has_no_negative_parts() -> None:
    where, pieces = np.array([1.0, 2.0, 3.0]), np.ones(3)
    for sigma in ([0.09, 0.04, 0.01], [0.001, 0.08, 0.3]):
        assert min(_fitted(where, np.array(sigma), pieces)) == 0


# --- Error rates and facts --------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    "cause, name", [("no_return_rate", "miss_given_occupied"), ("outlier_rate", "hit_given_free")]
)
def test_error_rates_are_recovered(cause: str, name: str) -> None:
    """Of 8 % more beams that miss, or hit on their way, nearly all are found, and no others."""
    both = {"outlier_rate": 0.0, "no_return_rate": 0.0}
    few, many = (
        getattr(ndtree.calibrate(kept("office", seed=4, scans=180, **one)), name)
        for one in (both, {**both, cause: 0.08})
    )
    assert few.value < 0.02
    assert many.value - few.value == pytest.approx(0.08, rel=0.35)
    assert many.low < many.value < many.high
    assert many.count > 300


def test_beams_without_return_can_be_ignored() -> None:
    scans = kept("office", seed=4, scans=120, outlier_rate=0, no_return_rate=0.08)
    free, ignored = (ndtree.calibrate(scans, no_return=kind) for kind in ("free", "ignore"))
    assert free.no_return_share == ignored.no_return_share == pytest.approx(0.08, abs=0.01)
    assert ignored.miss_given_occupied.value < 0.4 * free.miss_given_occupied.value


def test_facts_are_those_of_the_log(office: list[ndtree.Scan]) -> None:
    found = ndtree.calibrate(office, max_range=6.0)
    ranges = np.concatenate([np.linalg.norm(scan.endpoints - scan.origin, axis=1) for scan in office])
    returned = np.concatenate([scan.returned for scan in office])
    known = np.isfinite(ranges)
    assert (found.dim, found.scans, found.beams) == (2, 160, known.sum())
    assert found.returned == (known & returned).sum()
    assert found.no_return_share == pytest.approx(1 - found.returned / found.beams)
    assert found.longest_range == pytest.approx(ranges[known & returned].max())
    assert found.median_range == pytest.approx(np.median(ranges[known & returned]))
    assert max(r for r, _, _ in found.sigma_by_range) <= 6.0
    assert ndtree.calibrate(office, limit=20).scans == 20


def test_the_same_log_gives_the_same_and_its_options_make_a_map(found_office: ndtree.Calibration) -> None:
    one, other = found_office, ndtree.calibrate(ndtree.simulate("office", seed=3, scans=160))
    assert one.to_json() == other.to_json().replace('"world office"', '"scans"')
    names = {"range_sigma", "range_sigma_quadratic", "miss_given_occupied", "hit_given_free"}
    assert set(one.options()) == names
    m = ndtree.AdaptiveMap(dim=2, **one.options())
    assert m.options["range_sigma"] == one.range_sigma.value
    for name in names:
        assert name in str(one)


def test_a_long_log_is_thinned(
    monkeypatch: pytest.MonkeyPatch, office: list[ndtree.Scan], found_office: ndtree.Calibration
) -> None:
    whole = found_office
    monkeypatch.setattr("ndtree.tuning.calibration.beams.MOST_POINTS", 20_000)
    monkeypatch.setattr("ndtree.tuning.calibration.rates.UPDATES", 1.5e6)
    thin = ndtree.calibrate(office)
    assert sigma_at(thin, 2.0) == pytest.approx(sigma_at(whole, 2.0), rel=0.2)
    assert 0 < thin.miss_given_occupied.count < whole.miss_given_occupied.count
    assert (thin.beams, thin.longest_range) == (whole.beams, whole.longest_range)


# --- What is refused --------------------------------------------------------------------------------


def scans_2d(beams: int) -> Iterator[ndtree.Scan]:
    yield ndtree.Scan(np.ones((beams, 2)), np.zeros(2))


@pytest.mark.parametrize(
    "log, options, expected",
    [
        ([], {}, "scans: no scans, expected at least one"),
        (scans_2d(99), {}, "scans: 99 beams returned, expected at least 100"),
        (scans_2d(200), {"max_range": 0}, "max_range = 0 m: must be > 0"),
        (scans_2d(200), {"max_range": math.nan}, "max_range = nan m: must be > 0"),
        (scans_2d(200), {"no_return": "maybe"}, "no_return = 'maybe': must be one of free, ignore"),
        (scans_2d(200), {"limit": 0}, "limit = 0: must be >= 1"),
        (scans_2d(200), {"min_cell_size": -1}, "min_cell_size = -1 m: must be > 0 and finite"),
        ([*scans_2d(9), ndtree.Scan(np.ones((9, 3)), np.zeros(3))], {}, "scans: scan 1 is 3-D: must be 2-D"),
        ([ndtree.Scan(np.ones((9, 4)), np.zeros(4))], {}, "scans: scan 0 is 4-D: must be 2-D or 3-D"),
        ([ndtree.Scan(np.full((9, 2), 1e13), np.zeros(2))], {}, "scans: scan 0: beam 0 reaches"),
        ([ndtree.Scan(np.full((200, 2), np.nan), np.zeros(2))], {}, "0 beams returned"),
    ],
)
def test_bad_input_is_named(log: Any, options: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValueError) as error:
        ndtree.calibrate(log, **options)
    assert expected in str(error.value)


# --- The command line -------------------------------------------------------------------------------


def run(*arguments: object) -> Any:
    pytest.importorskip("typer")
    pytest.importorskip("rich")
    from calling import cli

    return cli("calibrate", *arguments)


@pytest.fixture(scope="module")
def log(office: list[ndtree.Scan], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "office.npz"
    points = np.concatenate([scan.endpoints for scan in office])
    np.savez(path, **{**arrays_of(office), "points": points})
    return path


def test_the_command_does_what_the_library_does(log: Path, tmp_path: Path) -> None:
    target = tmp_path / "a.json"
    options = ("--max-range", 9, "--no-return", "ignore", "--limit", 60, "--dim", 2)
    done = run(log, *options, "--json", target)
    assert done.exit_code == 0, done.output
    found = ndtree.calibrate(ndtree.read(log), max_range=9, no_return="ignore", limit=60)
    assert target.read_text() == found.to_json()
    assert str(found) in done.output
    assert f"--range-sigma {found.range_sigma.value:.3g} " in done.output
    written = json.loads(target.read_text())
    assert (written["log"], written["scans"], written["dim"]) == (str(log), 60, 2)
    assert set(written["range_sigma"]) == {"value", "low", "high", "count"}
    assert set(written["sigma_by_range"][0]) == {"range", "sigma", "count"}
    assert written["options"]["range_sigma"] == written["range_sigma"]["value"]
    assert json.loads(run(log, "--limit", 3, "--json", "-").stdout)["scans"] == 3


# --- Real recordings --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "log, limit, max_range, expected",
    [
        ("laser2d_intel", 500, 20, {2.0: 0.017}),
        pytest.param("laser2d_freiburg_079", 600, 20, {1.9: 0.020}, marks=pytest.mark.long),
        pytest.param("laser2d_mrpt_sena", None, 50, {8.6: 0.014}, marks=pytest.mark.long),
        ("kinect_7scenes", 40, 10, {r: 0.005 + 0.0015 * r**2 for r in (1.0, 2.0, 3.0)}),
        ("lidar_avia_hku_mb", 120, 100, {10.0: 0.016}),
    ],
)
def test_known_thickness_of_walls(
    monkeypatch: pytest.MonkeyPatch,
    recordings: Path,
    log: str,
    limit: int | None,
    max_range: float,
    expected: dict[float, float],
) -> None:
    monkeypatch.setattr("ndtree.tuning.calibration.rates.UPDATES", 5e6)  # Sooner done.
    scans = ndtree.read(recordings / log / f"{log}.npz")
    found = ndtree.calibrate(scans, limit=limit, max_range=max_range, no_return="ignore")
    for r, sigma in expected.items():
        assert sigma / 1.6 < sigma_at(found, r) < 1.6 * sigma, (r, sigma_at(found, r))
    for rate in (found.miss_given_occupied, found.hit_given_free):
        assert rate is None or 0.001 <= rate.value < 0.15
    assert found.hit_given_free is not None or found.dim == 3


def test_of_a_laser_that_turns_in_its_plane_the_noise_in_space_is_not_known() -> None:
    """Its points lie on lines, and no flat piece of surface is seen by several scans."""
    generator = np.random.default_rng(3)
    angles = np.radians(np.arange(0, 360, 2.0))
    scans = []
    for i in range(20):
        place = np.array([0.05 * i, 0, 0])
        ways = np.stack([np.cos(angles + 0.1 * i), np.sin(angles + 0.1 * i), np.zeros(len(angles))], axis=1)
        with np.errstate(divide="ignore"):
            walls = [(side - place[axis]) / ways[:, axis] for axis in (0, 1) for side in (-3, 3)]
        ranges = np.where(np.array(walls) > 0, walls, np.inf).min(axis=0)
        ranges += generator.normal(0, 0.01, len(ranges))
        scans.append(ndtree.Scan(place + ways * ranges[:, None], place))
    assert range_noise(scans) is None
    flat = [ndtree.Scan(scan.endpoints[:, :2], scan.origin[:2]) for scan in scans]
    found = range_noise(flat)
    assert found is not None and found[0].value == pytest.approx(0.01, rel=0.3)
