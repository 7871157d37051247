# SPDX-License-Identifier: BSD-3-Clause
"""What a sensor sees of its own robot is no obstacle, in recordings and live."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import START, Messages, write_bag
from calling import cli
from drives import Drive

import ndtree
from ndtree.logs.ros.placement.body import Body

#: Shapes in the frame of the base, and an oracle of each: is a point in it?
SHAPES = {
    "box:1.2,0.8,2": lambda p: abs(p[0]) <= 0.6 and abs(p[1]) <= 0.4 and abs(p[2]) <= 1,
    "box:1,1,1,0.5,-0.2,0.5": lambda p: abs(p[0] - 0.5) <= 0.5 and abs(p[1] + 0.2) <= 0.5 and 0 <= p[2] <= 1,
    "sphere:0.9": lambda p: sum(v * v for v in p) <= 0.81,
    "sphere:0.5,1,0,0.5": lambda p: (p[0] - 1) ** 2 + p[1] ** 2 + (p[2] - 0.5) ** 2 <= 0.25,
    "capsule:0.4,0,0,0.5,2,0,0.5": lambda p: (
        min((p[0] - x) ** 2 + p[1] ** 2 + (p[2] - 0.5) ** 2 for x in np.linspace(0, 2, 400)) <= 0.16
    ),
}


#: Seen from above: an L, which is two boxes, at all heights and at some.
SHAPES["footprint:-1,-1,1,-1,1,0,0,0,0,1.5,-1,1.5"] = lambda p: (
    (-1 <= p[0] <= 1 and -1 <= p[1] <= 0) or (-1 <= p[0] <= 0 and -1 <= p[1] <= 1.5)
)
SHAPES["footprint:[[0.8, 0.5], [-0.8, 0.5], [-0.8, -0.5], [0.8, -0.5]]/-0.2,0.9"] = lambda p: (
    abs(p[0]) <= 0.8 and abs(p[1]) <= 0.5 and -0.2 <= p[2] <= 0.9
)


def test_corners_and_edges_of_a_footprint_are_in_it() -> None:
    is_in = Body.of("footprint:-1,-1,1,-1,1,0,0,0,0,1.5,-1,1.5").parts[0]
    points = np.array(
        [[-1, -1, 0], [1, 0, 0], [0, 1.5, 0], [0, 0.7, 5], [0.5, 0, -3], [0.3, -1, 0], [-0.5, 0, 0],
         [0.01, 0.01, 0], [1.01, -0.5, 0], [-1.01, 0, 0], [np.nan, 0, 0], [0.5, 1.5, 0], [-2, 0, 0],
         [-2, -1, 0]]
    )  # fmt: skip
    assert is_in(points).tolist() == [True] * 7 + [False] * 7


@pytest.mark.parametrize("shape", [*SHAPES, "sphere:0.9+sphere:0.5,1,0,0.5"])
@pytest.mark.parametrize("planar", [True, False])
def test_beams_that_end_in_the_body_are_left_out(shape: str, planar: bool, tmp_path: Path) -> None:
    make, drive = Messages("mcap"), Drive(planar=planar)
    generator = np.random.default_rng(4)
    content, expected, inside = drive.transforms(make), [], 0
    for stamp in START + 0.1 * np.arange(1, 20):
        points = generator.uniform(-2, 2, (250, 3)).astype(np.float32)
        content.append(("/points", stamp, make.cloud(stamp, "sensor", points)))
        in_base = drive.mount.apply(points.astype(np.float64)) + drive.mount_position
        own = [any(SHAPES[one](p) for one in shape.split("+")) for p in in_base]
        inside += sum(own)
        expected.append((drive.in_map(stamp, points), np.array(own)))
    log = ndtree.read(write_bag(tmp_path / "drive", make, content), body=f"{shape}@base")
    scans = list(log)
    assert len(scans) == 19 and inside > 20
    for scan, (ends, own) in zip(scans, expected):
        assert np.isnan(scan.endpoints[own]).all()
        assert np.allclose(scan.endpoints[~own], ends[~own], atol=1e-5)
        # Where the sensor is in the body, beams are free from it on.
        assert np.allclose(scan.origin, drive.in_map(scan.stamp, np.zeros((1, 3)))[0], atol=1e-5)
    assert f"{inside:,} beams ended in the robot's own body: left out" in log.notes


def test_what_is_no_body_is_refused(tmp_path: Path) -> None:
    for text, said in {
        "box:1,2": "expected box:LX,LY,LZ",
        "cone:1": "'cone:1': expected box:LX",
        "sphere:": "expected box:LX",
        "sphere:nan": "expected box:LX",
        "sphere:-1": "lengths must be > 0 m",
        "sphere:1+box:0,1,1": "'box:0,1,1': lengths must be > 0 m",
        "footprint:0,0,1,0": "or footprint:X,Y,X,Y,X,Y,...[/LOW,HIGH] in metres",
        "footprint:0,0,1,0,1,1,2": "or footprint:X,Y",
        "footprint:0,0,1,0,1,1/2": "or footprint:X,Y",
        "footprint:0,0,1,0,1,x": "or footprint:X,Y",
        "footprint:0,0,1,1,2,2": "its corners lie on a line",
        "footprint:0,0,1,0,1,1/1,0": "heights must be from low to high",
    }.items():
        with pytest.raises(ValueError, match=said.replace("[", r"\[")):
            Body.of(text)
    make, drive = Messages("mcap"), Drive(planar=True)
    content = drive.transforms(make)
    content += [
        ("/scan", START + 0.1 * i, make.laser(START + 0.1 * i, "sensor", [2.0] * 9)) for i in range(9)
    ]
    bag = write_bag(tmp_path / "drive", make, content)
    with pytest.raises(ValueError, match="no transform between sensor and arm, expected one of base, map"):
        ndtree.read(bag, body="sphere:1@arm")
    with pytest.raises(TypeError, match="body = 'sphere:x'"):
        ndtree.read(bag, body="sphere:x")


def test_live_leaves_out_the_same(tmp_path: Path) -> None:
    make, drive = Messages("mcap"), Drive(planar=True, n=60)
    ranges = np.linspace(0.2, 4, 50)
    stamps = START + 0.05 * np.arange(110)
    content = drive.transforms(make)
    content += [("/scan", stamp, make.laser(stamp, "sensor", ranges)) for stamp in stamps]
    bag = write_bag(tmp_path / "drive", make, sorted(content, key=lambda row: row[1]))
    maps = []
    for command in (["map"], ["live", "--rate", "0"]):
        target = tmp_path / f"{command[0]}.ndt"
        options = ["--body", "sphere:1.5@base", "--range-sigma", "0.02", "--no-return", "free"]
        done = cli(*command, bag, "-o", target, *options)
        assert done.exit_code == 0, done.stderr
        assert "beams ended in the robot's own body" in done.output
        maps.append(target.read_bytes())
    assert maps[0] == maps[1]
    for words, said in (
        (["--body", "cone:1"], "'cone:1'"),
        (["--sweep", "never"], "--sweep never: must be one of"),
    ):
        done = cli("live", bag, "--rate", "0", *words)
        assert done.exit_code == 2 and said in done.stderr
