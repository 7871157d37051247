# SPDX-License-Identifier: BSD-3-Clause
"""Damaged files of every kind are read, or refused by one clear line: nothing else, and soon.

NDTREE_MUTATIONS says how many of each kind, else a few; ``tools/fuzz-readers`` tries as many as there is time
for.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("typer")
pytest.importorskip("PIL")
pytest.importorskip("pypcd4")
pytest.importorskip("trimesh")
pytest.importorskip("meshio")
pytest.importorskip("laspy")
pytest.importorskip("rosbags")
pytest.importorskip("scipy")

from samples import SAMPLES, recorded_samples

HERE = Path(__file__).parent
SMALL = int(os.environ.get("NDTREE_MUTATIONS", 3))
RECORDED = int(os.environ.get("NDTREE_MUTATIONS", 2))


def check(samples: list[str], count: int, scratch: Path) -> None:
    command = [sys.executable, HERE / "outcomes.py", "0", str(count), scratch, *samples]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    wrong = [row for row in found if row["outcome"] not in ("read", "refused")]
    assert not wrong, "\n".join(
        f"{row['sample']} {row['number']}: {row['damaged']}: {row['outcome']}: {row['said']}" for row in wrong
    )
    assert len(found) == count * len(samples)
    refused = sum(row["outcome"] == "refused" for row in found)
    print(f"{len(found)} damaged files: {refused} refused, {len(found) - refused} read")
    assert refused > len(found) / 4  # The damage is some.


# In parts that may run at the same time.
@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.long) for part in (1, 2, 3))])
def test_damaged_files_are_read_or_refused(part: int, tmp_path: Path) -> None:
    check(list(SAMPLES)[part::4], SMALL, tmp_path)


@pytest.mark.long
def test_damaged_recordings_are_read_or_refused(recordings: Path, tmp_path: Path) -> None:
    os.environ["NDTREE_DATA"] = str(recordings)
    check(list(recorded_samples(recordings)), RECORDED, tmp_path)


@pytest.mark.parametrize("sample", SAMPLES)
def test_samples_are_read_as_they_are(sample: str, tmp_path: Path) -> None:
    from ndtree.logs import read
    from ndtree.maps.open import is_map, open_map

    folder = tmp_path / "whole"
    folder.mkdir()
    path = SAMPLES[sample].make(folder)
    if pack := SAMPLES[sample].pack:
        path = pack(path)
    if is_map(path):
        assert open_map(path).map.stats().observed_leaves > 0
    else:
        options = {flag[2:].replace("-", "_"): True for flag in SAMPLES[sample].options}
        assert sum(len(scan) for scan in read(path, **options)) > 0
