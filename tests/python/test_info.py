# SPDX-License-Identifier: BSD-3-Clause
"""`ndtree info` says at once what is in a file; with --look, what mapping will choose."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags")

import numpy as np
from bags import KINDS, Messages, write_bag
from calling import cli

import ndtree
from ndtree.cli.commands import info
from ndtree.logs.ros.files.bag import Bag, open_bag
from ndtree.logs.ros.rosbag import outline

LEVEL = (0, 0, 0, 1)


@pytest.fixture(scope="module", params=KINDS)
def bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 200 scans, with a fixed frame that is told once, and a topic that begins late."""
    make = Messages(request.param)
    content: list[Any] = [make.fixed(100.0, "base", "laser", (0, 0, 1))]
    for i in range(200):
        t = 100 + 0.1 * i
        for k in range(5):
            content.append(make.moved(t + 0.02 * k, "odom", "base", (0.02 * i, 0, 0)))
        content.append(("/scan", t, make.laser(t, "laser", [2.0, 3.0, 4.0])))
        if i > 150:
            content.append(("/late", t, make.cloud(t, "laser", np.ones((5, 3)))))
    return write_bag(tmp_path_factory.mktemp(request.param) / "bag", make, content)


def test_at_once_the_same_is_said_as_of_all_of_it(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = 0
    messages = Bag.messages

    def counted(self: Bag, *arguments: Any, **keywords: Any) -> Any:
        nonlocal read
        for raw in messages(self, *arguments, **keywords):
            read += 1
            yield raw

    monkeypatch.setattr(Bag, "messages", counted)
    with open_bag(str(bag)) as opened:
        quick, few = outline(opened, whole=False), read
        whole, read = outline(opened), 0
        outline(opened)
    assert few < 450 < 1200 < read
    rates = [{topic["topic"]: topic.pop("rate") for topic in one["topics"]} for one in (quick, whole)]
    assert set(rates[0].values()) == {None} and rates[1]["/scan"] == pytest.approx(10, rel=0.02)
    assert quick == whole
    frames = {topic["topic"]: topic["frame"] for topic in quick["topics"]}
    assert (frames["/scan"], frames["/late"]) == ("laser", "laser")


def test_info_of_a_bag_has_topics_and_what_to_type(bag: Path) -> None:
    done = cli("info", bag)
    assert done.exit_code == 0 and done.stderr == ""
    lines = done.stdout.splitlines()
    assert any(line.split()[:3] == ["/scan", "sensor_msgs/msg/LaserScan", "200"] for line in lines)
    assert lines[-1] == f"  ndtree info {bag} --look"
    assert "chosen:" not in done.stdout and "beams" not in done.stdout
    figures = json.loads(cli("info", bag, "--json").stdout)
    assert {topic["topic"] for topic in figures["contents"]["topics"]} > {"/scan", "/tf"}
    looked = cli("info", bag, "--look")
    assert "chosen: --dim" in looked.stdout and "mapping will take about" in looked.stdout
    assert "--look" not in looked.stdout


def test_of_long_logs_the_beginning_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "office.npz"
    ndtree.simulate("office", scans=10).save(log)
    whole = cli("info", log).stdout
    assert "2-D, 10 scans" in whole
    monkeypatch.setattr(info, "FIRST_BEAMS", 1000)
    begun = cli("info", log).stdout
    assert "2-D, the first 3 scans" in begun
    figures, _, hint = whole.rpartition("to see what mapping will choose, and how long it takes:\n")
    assert hint == f"  ndtree info {log} --look\n"
    looked = cli("info", log, "--look").stdout
    assert looked.startswith(figures) and "mapping will take about" in looked and "no_return = " in looked
    assert json.loads(cli("info", log, "--json").stdout)["is_whole"] is False
