# SPDX-License-Identifier: BSD-3-Clause
"""Commands make maps in tiles, and take them where they take maps."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("rich")

from calling import cli
from conftest import text_log

import ndtree
from ndtree.maps.open import is_map
from ndtree.tiles import TileMapper, storage_of

OPTIONS = ("--min-cell-size", "0.1", "--max-cell-size", "0.8", "--no-return", "free", "--range-sigma", "0.02")


def run(*arguments: object, status: int = 0) -> str:
    done = cli(*arguments)
    assert done.exit_code == status, done.output
    if status:
        assert done.output.count("ndtree: ") == 1
    return done.output


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return text_log(
        tmp_path_factory.mktemp("logs") / "office.txt", ndtree.simulate("office", seed=2, scans=12)
    )


def test_map_in_tiles_is_the_map_in_a_file(log: Path, tmp_path: Path) -> None:
    one, tiles, back = tmp_path / "a.ndt", tmp_path / "a.tiles", tmp_path / "b.ndt"
    run("map", log, "-o", one, *OPTIONS)
    figures = tmp_path / "a.json"
    said = run(
        "map", log, "-o", tiles, *OPTIONS, "--max-resident", "5MB", "--tile-size", 4, "--json", figures
    )
    assert "cells in" in said and "tiles of 6.4 m" in said
    held = json.loads(figures.read_text())
    assert held["max_resident"] == 5_000_000 and held["tiles"] > 4 and held["known_scans"] == 0
    run("convert", tiles, back)
    assert back.read_bytes() == one.read_bytes()
    assert "AdaptiveMap" in run("info", tiles)
    assert "100" in run("compare", one, tiles)


def test_map_in_tiles_goes_on(log: Path, tmp_path: Path) -> None:
    tiles, scans = tmp_path / "a.tiles", list(ndtree.read(log))
    run("map", log, "-o", tiles, *OPTIONS)
    made_from = dict(ndtree.open_tiles(tiles).manifest.made_from)
    whole = ndtree.open_tiles(tiles).to_map()
    made_from.pop("progress")
    mapper = TileMapper(storage_of(tiles), whole, made_from=made_from)
    for scan in scans[:5]:
        mapper.insert(scan)
    mapper.write()
    assert "12 scans, 5 of them known already" in run("map", log, "-o", tiles, *OPTIONS)
    assert ndtree.open_tiles(tiles).to_map() == whole


def test_a_fleet_is_mapped_as_one_machine_would(log: Path, tmp_path: Path) -> None:
    other = text_log(tmp_path / "other.txt", ndtree.simulate("office", seed=3, scans=12))
    figures = tmp_path / "a.json"
    run("fleet", log, other, "-o", tmp_path / "a.tiles", *OPTIONS, "--workers", 2, "--json", figures)
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1, max_cell_size=0.8, range_sigma=0.02)
    for path in (log, other):  # Without times: by name.
        for scan in ndtree.read(path):
            scan.insert_into(m)
    assert ndtree.open_tiles(tmp_path / "a.tiles").to_map() == m
    assert json.loads(figures.read_text())["scans"] == 24


def test_flags_for_tiles_are_refused_without_them(log: Path, tmp_path: Path) -> None:
    output = run("map", log, "-o", tmp_path / "a.ndt", *OPTIONS, "--max-resident", "1GB", status=2)
    assert "--max-resident: is for a map in tiles, -o " in " ".join(output.split())


def test_folders_that_hold_something_else_are_no_maps(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text("{}")
    output = run("convert", tmp_path, tmp_path.parent / "a.ndt", status=1)
    assert str(tmp_path) in "".join(output.split())
    assert not is_map(tmp_path)
    (tmp_path / "manifest.json").write_text('{"format": "ndtree tiles", "version": 7}')
    output = run("convert", tmp_path, tmp_path.parent / "a.ndt", status=1)
    assert "manifest.json: format version 7: this ndtree reads version 1" in " ".join(output.split())
