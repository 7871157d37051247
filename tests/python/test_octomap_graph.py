# SPDX-License-Identifier: BSD-3-Clause
"""Scan graphs that OctoMap itself wrote have the points that OctoMap finds in them."""

from __future__ import annotations

import gzip
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

import ndtree
from ndtree.logs import read

#: Writes a graph of N nodes, node i of sizes[i] points, and prints what the library says of each.
PROGRAM = r"""
#include <octomap/ScanGraph.h>
#include <cstdio>
#include <cstdlib>
#include <random>

int main(int argc, char** argv) {
  std::mt19937 random(5);
  std::normal_distribution<float> normal;
  octomap::ScanGraph graph;
  for (int i = 2; i < argc; ++i) {
    auto* cloud = new octomap::Pointcloud;
    for (int k = 0; k < std::atoi(argv[i]); ++k)
      cloud->push_back(normal(random), normal(random), normal(random));
    graph.addNode(cloud, octomap::pose6d(normal(random), normal(random), normal(random), normal(random),
                                         normal(random), normal(random)));
  }
  graph.connectPrevious();
  graph.writeBinary(std::string(argv[1]));
  for (auto* node : graph) {
    auto origin = node->pose.trans();
    std::printf("node %.9g %.9g %.9g\n", origin.x(), origin.y(), origin.z());
    for (const auto& point : *node->scan) {
      auto end = node->pose.transform(point);
      std::printf("%.9g %.9g %.9g\n", end.x(), end.y(), end.z());
    }
  }
}
"""


@pytest.fixture(scope="session")
def octomap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A program that writes graphs with liboctomap."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler: no graph can be written by liboctomap")
    folder = tmp_path_factory.mktemp("octomap")
    (folder / "write.cpp").write_text(PROGRAM)
    command = [compiler, "-O0", "write.cpp", "-o", "write", "-loctomap", "-loctomath"]
    if subprocess.run(command, cwd=folder, capture_output=True, check=False).returncode != 0:
        pytest.skip("liboctomap cannot be compiled against: no graph can be written by it")
    return folder / "write"


def written_by(octomap: Path, path: Path, sizes: list[int]) -> list[np.ndarray]:
    """What the library says of each node: rows of the origin and of the end points in the map."""
    command = [str(octomap), str(path), *map(str, sizes)]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    nodes: list[list[list[float]]] = []
    for line in output.splitlines():
        fields = line.split()
        if fields[0] == "node":
            nodes.append([])
        nodes[-1].append([float(field) for field in fields[-3:]])
    return [np.array(rows) for rows in nodes]


@pytest.mark.parametrize("sizes", [[1], [2], [3, 0, 1, 200], [0, 4], [0]], ids=str)
@pytest.mark.parametrize("packed", [False, True])
def test_graphs_of_liboctomap_are_read(octomap: Path, tmp_path: Path, sizes: list[int], packed: bool) -> None:
    path = tmp_path / "scans.graph"
    expected = written_by(octomap, path, sizes)
    if packed:
        path.write_bytes(gzip.compress(path.read_bytes()))
    log = read(path)
    assert (log.format, log.dim, len(log)) == ("octomap_graph", 3, len(sizes))
    scans = list(log)
    assert [len(scan) for scan in scans] == sizes
    for scan, rows in zip(scans, expected):
        np.testing.assert_allclose(scan.origin, rows[0], atol=1e-6)
        np.testing.assert_allclose(scan.endpoints, rows[1:], atol=2e-6)
    assert len(list(log)) == len(sizes), "a log can be read again"


def test_graphs_of_the_octomap_tools_are_read(tmp_path: Path) -> None:
    tool = shutil.which("log2graph")
    if tool is None:
        pytest.skip("no log2graph: octomap-tools are not installed")
    text = tmp_path / "scans.log"
    text.write_text("NODE 1 2 3 0 0 1.5707963267948966\n1 0 0\n0 1 0.5\nNODE -1 0 0 0 0 0\n4 5 6\n")
    graph = tmp_path / "scans.graph"
    subprocess.run([tool, str(text), str(graph)], capture_output=True, check=True)
    one, other = read(graph)
    np.testing.assert_allclose(one.origin, [1, 2, 3])
    np.testing.assert_allclose(one.endpoints, [[1, 3, 3], [0, 2, 3.5]], atol=1e-6)
    np.testing.assert_allclose(other.endpoints, [[3, 5, 6]])
    m = ndtree.AdaptiveMap(dim=3)
    assert one.insert_into(m).returned == 2


# --- What is refused --------------------------------------------------------------------------------


def node(points: np.ndarray, pose: tuple[float, ...] = (0, 0, 0, 1, 0, 0, 0), size: int = 3) -> bytes:
    """By the description of the format; the quaternion is w x y z."""
    content = struct.pack("<I", len(points)) + b"".join(struct.pack("<I3d", size, *point) for point in points)
    return content + struct.pack("<I3dI4dI", 3, *pose[:3], 4, *pose[3:], 0)


def graph(*nodes: bytes) -> bytes:
    return struct.pack("<I", len(nodes)) + b"".join(nodes) + struct.pack("<I", 0)


POINTS = np.arange(12.0).reshape(4, 3) + 1
WHOLE = graph(node(POINTS), node(POINTS), node(POINTS))
NOISE = np.random.default_rng(1).normal(size=(500, 3))
BROKEN = {
    "cut in points": (WHOLE[:250], "node 2 of 3: the file is cut off, expected"),
    "cut in a pose": (WHOLE[:345], "node 2 of 3: the file is cut off, expected 27 bytes more"),
    "cut between nodes": (WHOLE[:372], "node 3 of 3: the file is cut off, expected"),
    "no rotation": (graph(node(POINTS), node(POINTS, (0, 0, 0, 2, 0, 0, 0))),
        "node 2 of 2: quaternion .* has len"),
    "no position": (graph(node(POINTS, (np.nan, 0, 0, 1, 0, 0, 0))), "node 1 of 1: expected a position of 3"),
    "points of 7 numbers": (graph(node(POINTS), node(POINTS, size=7)),
        "node 2 of 2: found a point of 7 numbers"),
    "too many points": (graph(node(POINTS), b"\xff" * 4 + node(POINTS)[4:]),
        "node 2 of 2: the file is cut off"),
    "cut gzip": (gzip.compress(graph(*[node(NOISE)] * 3))[:-900], "gzip stream is cut off"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_damaged_graphs_say_where(case: str, tmp_path: Path) -> None:
    content, message = BROKEN[case]
    path = tmp_path / "a.graph"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        list(read(path))
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_what_was_read_before_the_damage_can_be_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.graph"
    path.write_bytes(BROKEN["cut between nodes"][0])
    log = read(path, keep_going=True)
    assert len(list(log)) == 2 and log.skipped["damaged files"].count == 1
    assert len(list(log)) == 2 and log.skipped["damaged files"].count == 1, "counts are the last loop's"


def test_other_files_are_no_graph(tmp_path: Path) -> None:
    path = tmp_path / "a.graph"
    for content in (b"\x01\0\0\0\x01\0\0\0", bytes(range(256)) * 3, b"\x05" * 90):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"binary data, expected|found .*, expected"):
            read(path)
        with pytest.raises(ValueError, match="expected a scan graph of OctoMap"):
            read(path, format="octomap_graph")
    path.write_bytes(WHOLE)
    with pytest.raises(ValueError, match="a scan graph of OctoMap is 3-D"):
        read(path, dim=2)
