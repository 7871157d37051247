# SPDX-License-Identifier: BSD-3-Clause
"""Coordinates in feet become metres, degrees are refused, whichever way a LAS says it."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calling import cli

import ndtree
from ndtree.logs.folders.coordinate_system import Units, units_of_keys, units_of_wkt

laspy = pytest.importorskip("laspy", reason="no laspy: no LAS can be written")

SURVEY, FOOT = 1200 / 3937, 0.3048
DEGREES = 'GEOGCS["WGS 84",DATUM["W",SPHEROID["W",6378137,298.2]],UNIT["degree",0.0174532925199433]]'
AXES = 'CS[Cartesian,2],AXIS["(E)",east,ORDER[1]{0}],AXIS["(N)",north,ORDER[2]{0}]{1}'
FEET = ',LENGTHUNIT["foot",0.3048]'
BASE = 'BASEGEOGCRS["N",DATUM["D",ELLIPSOID["G",6378,298,LENGTHUNIT["km",1000]]]],CONVERSION["C",METHOD["T"]]'


def projected(unit: str, size: float) -> str:
    own = f'PARAMETER["x",0],UNIT["{unit}",{size!r}],AXIS["X",EAST]'
    return f'PROJCS["some ""plane""",{DEGREES},PROJECTION["T"],{own}]'


def heights(unit: str, size: float, word: str = "VERT_CS") -> str:
    return f'{word}["h",VERT_DATUM["d",2005],UNIT["{unit}",{size!r}],AXIS["Up",UP]]'


METRE = projected("metre", 1.0)
WKT = {
    "metres": (METRE, Units()),
    "feet": (projected("foot", FOOT), Units(FOOT, FOOT)),
    "survey feet": (projected("Foot_US", 0.30480060960121924), Units(SURVEY, SURVEY)),
    "heights alone": (f'COMPD_CS["c",{METRE},{heights("foot", FOOT)}]', Units(1.0, FOOT)),
    "metric heights": (f'COMPD_CS["c",{projected("f", SURVEY)},{heights("m", 1.0)}]', Units(SURVEY, 1.0)),
    "beside": (f"{METRE},{heights('Foot_US', SURVEY, 'VERTCS')}", Units(1.0, SURVEY)),
    "degrees": (DEGREES, Units(are_degrees=True)),
    "degrees and feet": (f'COMPD_CS["c",{DEGREES},{heights("foot", FOOT)}]', Units(are_degrees=True)),
    "WKT2": (f'PROJCRS["p",{BASE},{AXES.format("", FEET)}]', Units(FOOT, FOOT)),
    "WKT2 by axes": (f'PROJCRS["p",{BASE},{AXES.format(FEET, "")}]', Units(FOOT, FOOT)),
    "Web Mercator": (METRE.replace('some ""plane""', "WGS 84 / Pseudo-Mercator"), Units(are_stretched=True)),
    "ESRI's": (METRE.replace('some ""plane""', "WGS_1984_Web_Mercator"), Units(are_stretched=True)),
    "Mercator along a meridian": (METRE.replace('["T"]', '["Transverse_Mercator"]'), Units()),
    "WKT2 degrees": ('GEOGCRS["g",CS[ellipsoidal,2],ANGLEUNIT["d",0.0174]]', Units(are_degrees=True)),
    "geocentric": ('GEODCRS["g",CS[Cartesian,3],AXIS["X",geocentricX],LENGTHUNIT["metre",1]]', Units()),
    "local": ('LOCAL_CS["site",LOCAL_DATUM["l",0],UNIT["metre",1],AXIS["X",EAST]]', Units()),
}  # fmt: skip
KEYS = {
    "metres": ({1024: 1, 3072: 32633, 3076: 9001}, Units()),
    "UTM": ({1024: 1, 3072: 26915}, Units()),
    "Web Mercator": ({1024: 1, 3072: 3857, 3076: 9001}, Units(are_stretched=True)),
    "survey feet": ({1024: 1, 3072: 2263, 3076: 9003, 4099: 9003}, Units(SURVEY, SURVEY)),
    "heights alone": ({1024: 1, 3072: 26915, 4099: 9002}, Units(1.0, FOOT)),
    "of its own": ({1024: 1, 3072: 32767, 3076: 32767, 3077: 0.3048}, Units(FOOT, FOOT)),
    "heights in feet by their system": ({1024: 1, 3072: 26918, 4096: 6360}, Units(1.0, SURVEY)),
    "heights in metres by theirs": ({1024: 1, 3076: 9003, 4096: 5703}, Units(SURVEY, 1.0)),
    "heights by their unit": ({1024: 1, 3072: 26918, 4096: 6360, 4099: 9002}, Units(1.0, FOOT)),
    "heights by a datum": ({1024: 1, 3076: 9003, 4096: 5103}, Units(SURVEY, SURVEY)),
    "heights of no known system": (
        {1024: 1, 3072: 26918, 4096: 9999},
        Units(unknown="system of heights EPSG:9999"),
    ),
    "degrees": ({1024: 2, 2048: 4326}, Units(are_degrees=True)),
    "degrees without a kind": ({2048: 4326}, Units(are_degrees=True)),
    "in the plane without a kind": ({2048: 4269, 3072: 26918}, Units()),
    "nothing": ({}, Units()),
}


@pytest.mark.parametrize("case", WKT)
def test_units_of_wkt(case: str) -> None:
    text, right = WKT[case]
    found = units_of_wkt(text)
    assert replace(found, across=1, height=1) == replace(right, across=1, height=1)
    assert (found.across, found.height) == pytest.approx((right.across, right.height), rel=1e-9)


@pytest.mark.parametrize("text", ["", "[", "NAD83", 'PROJCS["a"', "PROJCS[" * 100, '"', "\x80[1]"])
def test_what_is_no_wkt_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected a coordinate system as WKT"):
        units_of_wkt(text)


@pytest.mark.parametrize("case", KEYS)
def test_units_of_keys(case: str) -> None:
    keys, right = KEYS[case]
    found = units_of_keys(keys)
    assert replace(found, across=1, height=1) == replace(right, across=1, height=1)
    assert (found.across, found.height) == pytest.approx((right.across, right.height), rel=1e-9)


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
def test_feet_are_metres_in_the_map_and_that_is_said(ending: str, tmp_path: Path) -> None:
    path = las(
        tmp_path / f"a.{ending}", POINTS, wkt=f'COMPD_CS["c",{projected("f", FOOT)},{heights("m", 1.0)}]'
    )
    log = ndtree.read(path, points_only=True)
    (scan,) = log
    np.testing.assert_allclose(scan.endpoints, POINTS * [FOOT, FOOT, 1], rtol=0, atol=1e-3)
    assert [note for note in log.notes if "coordinates are in feet, heights in metres" in note]
    (scan,) = log = ndtree.read(las(path, POINTS, wkt=METRE), points_only=True)
    np.testing.assert_allclose(scan.endpoints, POINTS, rtol=0, atol=1e-3)


def test_keys_of_a_las_say_it_as_well(tmp_path: Path) -> None:
    keys = np.array([1, 1, 0, 2, 1024, 0, 1, 1, 3076, 0, 1, 9003], "<u2").tobytes()
    (scan,) = ndtree.read(las(tmp_path / "a.las", POINTS, keys=keys), points_only=True)
    np.testing.assert_allclose(scan.endpoints, POINTS * SURVEY, rtol=0, atol=1e-3)


def test_degrees_are_refused_and_what_cannot_be_degrees_is_doubted(tmp_path: Path) -> None:
    points = np.array([[-89.7, 30.35, 10], [-89.69, 30.36, 12]])
    with pytest.raises(ValueError, match=r"a\.las: coordinates are degrees .* expected metres, as of UTM"):
        list(ndtree.read(las(tmp_path / "a.las", points, wkt=DEGREES), points_only=True))
    web = METRE.replace('some ""plane""', "WGS 84 / Pseudo-Mercator")
    with pytest.raises(ValueError, match=r"a\.las: coordinates are stretched, .* expected metres"):
        list(ndtree.read(las(tmp_path / "a.las", POINTS, wkt=web), points_only=True))
    log = ndtree.read(las(tmp_path / "a.las", POINTS, wkt=DEGREES), points_only=True)
    assert len(list(log)) == 1 and any("are taken as metres" in note for note in log.notes)


@pytest.mark.parametrize(
    "steps, doubted", [((1e-7, 1e-7, 0.01), True), ((1e-7, 1e-7, 1e-7), False), ((1e-3, 1e-3, 0.01), False)]
)
def test_steps_as_of_degrees_are_doubted(steps: tuple[float, ...], doubted: bool, tmp_path: Path) -> None:
    points = np.array([[-89.7, 30.35, 10], [-89.69, 30.36, 12]])
    log = ndtree.read(las(tmp_path / "a.las", points, steps=steps), points_only=True)
    assert len(list(log)) == 1
    assert [note for note in log.notes if "as of degrees" in note and "taken as metres" in note] == (
        log.notes if doubted else []
    )
    far = ndtree.read(las(tmp_path / "b.las", points + 1000, steps=steps), points_only=True)
    assert len(list(far)) == 1 and not far.notes


def test_a_system_that_is_not_known_is_named(tmp_path: Path) -> None:
    keys = np.array([1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 2263], "<u2").tobytes()
    log = ndtree.read(las(tmp_path / "a.las", POINTS, keys=keys), points_only=True)
    assert log.notes == [
        "coordinate system EPSG:2263 does not say the unit of its coordinates: they are taken as metres"
    ]


@pytest.mark.parametrize("axis, step", [(0, 0.0), (1, float("nan")), (2, float("inf")), (2, -0.001)])
def test_steps_that_are_no_lengths_are_refused(axis: int, step: float, tmp_path: Path) -> None:
    path = las(tmp_path / "a.las", POINTS)
    content = bytearray(path.read_bytes())
    struct.pack_into("<d", content, 131 + 8 * axis, step)
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.las: steps of x, y and z: found .*, expected numbers > 0"):
        list(ndtree.read(path, points_only=True))
    info = cli("info", path)
    assert info.exit_code == 1 and "expected numbers > 0" in info.output and "try" not in info.output
