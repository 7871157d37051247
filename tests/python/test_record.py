# SPDX-License-Identifier: BSD-3-Clause
"""Films of growing maps: a picture when it is due, in files that others play, whole or not at all."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("rich")

from calling import cli
from conftest import room_log, room_scan
from PIL import Image, ImageSequence

import ndtree
from ndtree.plot import record


def recorded(
    path: Path, dim: int, scans: int, kind: Any = ndtree.AdaptiveMap, **options: Any
) -> record.Recorder:
    larger = {"max_cell_size": 0.8} if kind is ndtree.AdaptiveMap else {}
    m = kind(dim=dim, min_cell_size=0.1, **larger)
    recorder = record.Recorder(path, **options)
    for seed in range(scans):
        points, origin = room_scan(dim, seed)
        m.insert(points, origin)
        recorder.update(m, ndtree.Scan(points, origin))
    return recorder


def gif_frames(path: Path) -> list[np.ndarray]:
    with Image.open(path) as film:
        return [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(film)]


@pytest.mark.parametrize("dim", [2, 3])
def test_a_gif_has_a_picture_every_few_scans_and_the_last(dim: int, tmp_path: Path) -> None:
    recorder = recorded(tmp_path / "film.gif", dim, 7, every=3)
    assert not (tmp_path / "film.gif").exists(), "a film is there before it is whole"
    recorder.close()
    assert [path.name for path in tmp_path.iterdir()] == ["film.gif"]
    frames = gif_frames(tmp_path / "film.gif")
    assert len(frames) == recorder.frames == 3  # After 3, 6 and 7 scans.
    assert {frame.shape for frame in frames} == {(record.SIZE[1], record.SIZE[0], 3)}
    assert all(frame.std() > 10 for frame in frames)
    assert np.abs(frames[0].astype(int) - frames[2]).mean() > 0.5, "nothing grows"


@pytest.mark.parametrize(("kind", "drawn"), [(ndtree.AdaptiveMap, True), (ndtree.FixedMap, False)])
def test_a_film_of_a_plane_shows_the_borders_of_adaptive_cells(
    kind: Any, drawn: bool, tmp_path: Path
) -> None:
    recorded(tmp_path / "film.gif", 2, 5, kind, every=5).close()
    red, _, blue = np.moveaxis(gif_frames(tmp_path / "film.gif")[-1].astype(int), -1, 0)
    assert ((blue - red > 20).sum() > 1000) == drawn


def test_a_long_gif_keeps_a_bounded_number_of_pictures(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(record, "MAX_GIF_FRAMES", 4)
    recorded(tmp_path / "film.gif", 2, 20, every=1).close()
    assert 2 <= len(gif_frames(tmp_path / "film.gif")) <= 5


def test_an_mp4_is_played_by_others(tmp_path: Path) -> None:
    if shutil.which("ffmpeg") is None or shutil.which("ffprobe") is None:
        pytest.skip("no ffmpeg on PATH")
    recorder = recorded(tmp_path / "film.mp4", 2, 6, every=2)
    recorder.close()
    asked = ("-count_frames", "-select_streams", "v", "-show_streams", "-of", "json")
    done = subprocess.run(
        ["ffprobe", "-v", "error", *asked, str(tmp_path / "film.mp4")], capture_output=True, check=True
    )
    (stream,) = json.loads(done.stdout)["streams"]
    assert (stream["width"], stream["height"]) == record.SIZE
    assert int(stream["nb_read_frames"]) == recorder.frames == 3
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def test_what_is_abandoned_leaves_nothing(tmp_path: Path) -> None:
    for name in ("film.gif", "film.mp4") if shutil.which("ffmpeg") else ("film.gif",):
        recorder = recorded(tmp_path / name, 2, 2, every=1)
        recorder.abandon()
        assert not list(tmp_path.iterdir())
    recorder = record.Recorder(tmp_path / "film.gif")
    with pytest.raises(ValueError, match="the map has no occupied cell, so that there is no film"):
        recorder.close()
    assert not list(tmp_path.iterdir())


def test_wrong_films_are_refused(tmp_path: Path, monkeypatch: Any) -> None:
    with pytest.raises(ValueError, match=r"film\.avi: the name of a film must end in \.gif or \.mp4"):
        record.Recorder(tmp_path / "film.avi")
    with pytest.raises(ValueError, match="every = 0: must be >= 1"):
        record.Recorder(tmp_path / "film.gif", every=0)
    with pytest.raises(ValueError, match="color = 'red': must be one of"):
        record.Recorder(tmp_path / "film.gif", color="red")
    monkeypatch.setattr(record.FFMpegWriter, "isAvailable", lambda: False)
    with pytest.raises(RuntimeError, match=r"film\.mp4: \.mp4 needs the program ffmpeg on PATH"):
        record.Recorder(tmp_path / "film.mp4")
    assert not list(tmp_path.iterdir())


def test_map_records_and_the_map_is_the_same(tmp_path: Path) -> None:
    log = room_log(tmp_path / "log.txt", 8)
    film, one, two = tmp_path / "film.gif", tmp_path / "one.ndt", tmp_path / "two.ndt"
    done = cli("map", log, "-o", one, "--record", film, "--record-every", "4")
    assert done.exit_code == 0, done.output
    assert f"wrote {one} and {film}" in done.output
    assert len(gif_frames(film)) == 2
    assert cli("map", log, "-o", two).exit_code == 0
    assert one.read_bytes() == two.read_bytes()
    there = sorted(tmp_path.iterdir())
    for arguments, status, message in (
        (("--record-every", "4"), 2, "--record-every: is for --record"),
        (("--record", str(tmp_path / "film.avi")), 2, "must end in .gif or .mp4"),
        (("--record", str(tmp_path / "none" / "film.gif")), 1, "cannot be written"),
    ):
        done = cli("map", log, "-o", tmp_path / "three.ndt", *arguments)
        assert done.exit_code == status
        assert message in done.stderr and done.stderr.count("\n") == 1
    with open(log, "a") as file:
        file.write("what?\n")
    done = cli("map", log, "-o", tmp_path / "three.ndt", "--record", film)
    assert done.exit_code == 1
    assert sorted(tmp_path.iterdir()) == there, "a refused call left something"
