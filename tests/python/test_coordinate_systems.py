# SPDX-License-Identifier: BSD-3-Clause
"""Coordinates that are no metres are refused, whichever way a LAS says it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ndtree
from ndtree.logs.folders.las_files import DEGREES, METRES, unit_of_keys, unit_of_wkt

laspy = pytest.importorskip("laspy", reason="no laspy: no LAS can be written")

SURVEY, FOOT = 1200 / 3937, 0.3048
GEOGRAPHIC = 'GEOGCS["WGS 84",DATUM["W",SPHEROID["W",6378137,298.2]],UNIT["degree",0.0174532925199433]]'
AXES = 'CS[Cartesian,2],AXIS["(E)",east,ORDER[1]{0}],AXIS["(N)",north,ORDER[2]{0}]{1}'
FEET = ',LENGTHUNIT["foot",0.3048]'
BASE = 'BASEGEOGCRS["N",DATUM["D",ELLIPSOID["G",6378,298,LENGTHUNIT["m",1]]]],CONVERSION["C",METHOD["T"]]'


def projected(unit: str, size: float) -> str:
    own = f'PARAMETER["x",0],UNIT["{unit}",{size!r}],AXIS["X",EAST]'
    return f'PROJCS["some ""plane""",{GEOGRAPHIC},PROJECTION["T"],{own}]'


def heights(unit: str, size: float, word: str = "VERT_CS") -> str:
    return f'{word}["h",VERT_DATUM["d",2005],UNIT["{unit}",{size!r}],AXIS["Up",UP]]'


METRE, IN_FEET = projected("metre", 1.0), "in units of 0.3048 m"
WKT = {
    "metres": (METRE, METRES),
    "feet": (projected("foot", FOOT), IN_FEET),
    "survey feet": (projected("Foot_US", 0.30480060960121924), "in units of 0.30480061 m"),
    "heights alone": (f'COMPD_CS["c",{METRE},{heights("foot", FOOT)}]', IN_FEET),
    "metric heights": (f'COMPD_CS["c",{projected("f", FOOT)},{heights("m", 1.0)}]', IN_FEET),
    "beside": (f"{METRE},{heights('Foot', FOOT, 'VERTCS')}", IN_FEET),
    "degrees": (GEOGRAPHIC, DEGREES),
    "degrees and feet": (f'COMPD_CS["c",{GEOGRAPHIC},{heights("foot", FOOT)}]', DEGREES),
    "WKT2": (f'PROJCRS["p",{BASE},{AXES.format("", FEET)}]', IN_FEET),
    "WKT2 by axes": (f'PROJCRS["p",{BASE},{AXES.format(FEET, "")}]', IN_FEET),
    "WKT2 metres": (f'PROJCRS["p",{BASE},{AXES.format("", ",LENGTHUNIT[")}"metre",1]]', METRES),
    "WKT2 degrees": ('GEOGCRS["g",CS[ellipsoidal,2],ANGLEUNIT["d",0.0174]]', DEGREES),
    "geocentric": ('GEODCRS["g",CS[Cartesian,3],AXIS["X",geocentricX],LENGTHUNIT["metre",1]]', METRES),
    "local": ('LOCAL_CS["site",LOCAL_DATUM["l",0],UNIT["metre",1],AXIS["X",EAST]]', METRES),
    "without a unit": ('PROJCS["p"]', ""),
    **{text: (text, "") for text in ("NAD83", '"', "\x80[1]", "[" * 1000)},
}  # fmt: skip
KEYS = {
    "metres": ({1024: 1, 3072: 32633, 3076: 9001}, METRES),
    "UTM": ({1024: 1, 3072: 26915}, METRES),
    "survey feet": ({1024: 1, 3072: 2263, 3076: 9003, 4099: 9003}, "in the unit EPSG:9003"),
    "heights alone": ({1024: 1, 3072: 26915, 4099: 9002}, "in the unit EPSG:9002"),
    "of its own": ({1024: 1, 3072: 32767, 3076: 32767, 3077: 0.3048}, IN_FEET),
    "heights in feet by their system": ({1024: 1, 3072: 26918, 4096: 6360}, "in feet along z"),
    "heights in metres by theirs": ({1024: 1, 3076: 9001, 4096: 5703}, METRES),
    "heights by a datum": ({1024: 1, 3076: 9001, 4096: 5103}, METRES),
    "heights of no known system": ({1024: 1, 3072: 26918, 4096: 9999}, ""),
    "no known system": ({1024: 1, 3072: 2263}, ""),
    "degrees": ({1024: 2, 2048: 4326}, DEGREES),
    "degrees without a kind": ({2048: 4326}, DEGREES),
    "in the plane without a kind": ({2048: 4269, 3072: 26918}, METRES),
    "nothing": ({}, METRES),
}


@pytest.mark.parametrize("case", WKT)
def test_units_of_wkt(case: str) -> None:
    text, right = WKT[case]
    assert unit_of_wkt(text) == right


@pytest.mark.parametrize("case", KEYS)
def test_units_of_keys(case: str) -> None:
    keys, right = KEYS[case]
    assert unit_of_keys(keys) == right


def las(
    path: Path, points: np.ndarray, wkt: str = "", keys: bytes = b"", steps: tuple[float, ...] = (1e-4,) * 3
) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.array(steps), points.min(axis=0)
    if wkt:
        header.global_encoding.wkt = True
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    if keys:
        header.vlrs.append(laspy.VLR("LASF_Projection", 34735, record_data=keys))
    made = laspy.LasData(header)
    made.x, made.y, made.z = points.T
    made.write(path)
    return path


POINTS = np.array([[2445000.0, 604000, 1350], [2445100, 604100, 1360.5], [2445050, 604000, 1351]])


@pytest.mark.parametrize("ending", ["las", "laz", "copc.laz"])
def test_feet_are_refused_with_what_to_do(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{ending}"
    with pytest.raises(ValueError, match=r"coordinates are in units of 0\.3048 m, expected metres.*: pdal"):
        list(ndtree.read(las(path, POINTS, wkt=projected("f", FOOT)), points_only=True))
    keys = np.array([1, 1, 0, 2, 1024, 0, 1, 1, 3076, 0, 1, 9003], "<u2").tobytes()
    with pytest.raises(ValueError, match="coordinates are in the unit EPSG:9003, expected metres"):
        list(ndtree.read(las(path, POINTS, keys=keys), points_only=True))
    (scan,) = log = ndtree.read(las(path, POINTS, wkt=METRE), points_only=True)
    np.testing.assert_allclose(scan.endpoints, POINTS, rtol=0, atol=1e-3)
    assert not log.notes


def test_degrees_are_refused_and_what_cannot_be_degrees_is_doubted(tmp_path: Path) -> None:
    points = np.array([[-89.7, 30.35, 10], [-89.69, 30.36, 12]])
    with pytest.raises(ValueError, match=r"a\.las: coordinates are degrees .* expected metres, as of UTM"):
        list(ndtree.read(las(tmp_path / "a.las", points, wkt=GEOGRAPHIC), points_only=True))
    log = ndtree.read(las(tmp_path / "a.las", POINTS, wkt=GEOGRAPHIC), points_only=True)
    assert len(list(log)) == 1 and any("are taken for metres" in note for note in log.notes)


@pytest.mark.parametrize(
    "steps, doubted", [((1e-7, 1e-7, 0.01), True), ((1e-7, 1e-7, 1e-7), False), ((1e-3, 1e-3, 0.01), False)]
)
def test_steps_as_of_degrees_are_doubted(steps: tuple[float, ...], doubted: bool, tmp_path: Path) -> None:
    points = np.array([[-89.7, 30.35, 10], [-89.69, 30.36, 12]])
    log = ndtree.read(las(tmp_path / "a.las", points, steps=steps), points_only=True)
    assert len(list(log)) == 1
    assert [note for note in log.notes if "as of degrees" in note and "taken for metres" in note] == (
        log.notes if doubted else []
    )
    far = ndtree.read(las(tmp_path / "b.las", points + 1000, steps=steps), points_only=True)
    assert len(list(far)) == 1 and not far.notes


def test_a_system_that_is_not_known_is_doubted(tmp_path: Path) -> None:
    keys = np.array([1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 2263], "<u2").tobytes()
    log = ndtree.read(las(tmp_path / "a.las", POINTS, keys=keys), points_only=True)
    said = "its coordinate system does not say the unit of its coordinates: they are taken for metres"
    assert log.notes == [said]
