# SPDX-License-Identifier: BSD-3-Clause
"""What Foxglove and rerun are shown of a live map is read back: by a client, and from the file."""

from __future__ import annotations

import json
import math
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ndtree
from ndtree.live import LiveMapper, ScansIntake, Way, play
from ndtree.live.outputs import cell_points, direction_of
from ndtree.maps.writers.map_server import noise_depth
from ndtree.tuning.config import Config

SETTINGS = Config.of(min_cell_size=0.1, no_return="free")
PATIENCE = 20.0
TOPICS = ("/map", "/cells", "/cell_boxes", "/frontiers", "/way")


def scans(world: str, n: int) -> list[ndtree.Scan]:
    return list(ndtree.simulate(world, scans=n))  # type: ignore[arg-type]


def drawn(m: Any, **height: Any) -> Any:
    """As live grids are: walls as thick as their noise."""
    return m.map_server_image(wall_depth=noise_depth(m), **height)


def image_of(m: Any, shape: tuple[int, int], origin: tuple[float, float], **height: Any) -> np.ndarray:
    """The map in the plane, as nav_msgs/OccupancyGrid has it, in the place of a grid."""
    pixels, (x, y), cell_size = drawn(m, **height)
    image = np.select([pixels[::-1] == 254, pixels[::-1] == 0], [0, 100], -1)
    expected = np.full(shape, -1)
    column, row = round((x - origin[0]) / cell_size), round((y - origin[1]) / cell_size)
    expected[row : row + image.shape[0], column : column + image.shape[1]] = image
    return expected


class Client:
    """Of Foxglove's WebSocket protocol: JSON about channels, and their messages after 13 bytes."""

    def __init__(self, url: str) -> None:
        client = pytest.importorskip("websockets.sync.client", reason="no websockets")
        pytest.importorskip("foxglove_schemas_protobuf", reason="no foxglove-schemas-protobuf")
        self._kept = client.connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None)
        self._socket = self._kept.__enter__()
        self.channels: dict[str, dict[str, Any]] = {}
        while len(self.channels) < len(TOPICS):
            said = json.loads(self._socket.recv(PATIENCE))
            for one in said.get("channels", ()):
                self.channels[one["topic"]] = one

    def subscribe(self, *topics: str) -> None:
        rows = [{"id": self.channels[one]["id"], "channelId": self.channels[one]["id"]} for one in topics]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": rows}))

    def take(self, timeout: float = PATIENCE) -> tuple[str, int, Any] | None:
        """Topic, time [ns] and content of the next message; None if there is none in time."""
        from importlib import import_module

        deadline = time.monotonic() + timeout
        while (left := deadline - time.monotonic()) > 0:
            try:
                data = self._socket.recv(left)
            except TimeoutError:
                break
            if isinstance(data, str) or data[0] != 1:
                continue
            number, stamp = struct.unpack_from("<IQ", data, 1)
            channel = next(one for one in self.channels.values() if one["id"] == number)
            name = channel["schemaName"].rpartition(".")[2]
            message = getattr(import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)()
            message.ParseFromString(data[13:])
            return channel["topic"], stamp, message
        return None

    def close(self) -> None:
        self._kept.__exit__(None, None, None)


def table(message: Any, stride: int) -> Any:
    """The packed fields of a message as records."""
    kinds = {1: "u1", 2: "i1", 7: "<f4"}
    names = [one.name for one in message.fields]
    layout = {
        "names": names,
        "formats": [kinds[one.type] for one in message.fields],
        "offsets": [one.offset for one in message.fields],
        "itemsize": stride,
    }
    return np.frombuffer(message.data, np.dtype(layout))  # type: ignore[call-overload]


@contextmanager
def served(**options: Any) -> Iterator[Any]:
    pytest.importorskip("foxglove", reason="no foxglove-sdk: pip install 'ndtree-mapping[foxglove]'")
    from ndtree.live import FoxgloveSink

    sink = FoxgloveSink(0, period=0.0, **options)
    try:
        yield sink
    finally:
        sink.close()


@pytest.mark.parametrize("world, n, height", [("office", 25, None), ("apartment", 3, (0.1, 1.5))])
def test_a_client_of_foxglove_has_the_map(world: str, n: int, height: Any) -> None:
    way = Way()
    with served(height=height, way=way, frame="odom") as sink:
        client, some = Client(sink.url), scans(world, n)
        dim = some[0].dim
        client.subscribe("/map", "/cells")
        with LiveMapper(ScansIntake(SETTINGS, dim), sinks=[sink], way=way) as mapper:
            play(((scan, 5.0 + 0.1 * i) for i, scan in enumerate(some)), mapper, rate=0)
        assert not mapper.failures
        client.subscribe("/cell_boxes", "/frontiers", "/way")  # It has come late, and is sent what there is.
        last: dict[str, Any] = {}
        stamp = round(some[-1].stamp * 1e9)
        while len(last) < len(TOPICS) or any(at != stamp for at, _ in last.values()):
            taken = client.take()
            assert taken is not None, list(last)
            last[taken[0]] = taken[1:]
        client.close()
    m = mapper.snapshot()
    grid = last["/map"][1]
    assert grid.frame_id == "odom" and grid.cell_size.x == grid.cell_size.y == pytest.approx(0.1)
    pixels = table(grid, grid.cell_stride).reshape(-1, grid.column_count)
    origin = grid.pose.position.x, grid.pose.position.y
    expected = image_of(m, pixels.shape, origin, **({} if height is None else {"height": height}))
    assert np.array_equal(pixels["occupancy"], expected) and np.count_nonzero(expected == 100) > 50
    assert set(pixels["alpha"][expected == -1].tolist()) == {0}
    assert grid.pose.position.z == pytest.approx(0.0 if height is None else height[0])
    points = table(last["/cells"][1], last["/cells"][1].point_stride)
    cells = cell_points(m)
    assert len(points) == len(cells) > 50
    for name in ("x", "y", "z", "size", "probability"):
        assert np.array_equal(points[name], cells[name])
    scene = last["/cell_boxes"][1]
    boxes = [(c.pose.position.x, c.size.x) for entity in scene.entities for c in entity.cubes]
    assert np.allclose(sorted(boxes), sorted(zip(cells["x"].tolist(), cells["size"].tolist())), atol=1e-6)
    assert len(scene.deletions) == 1 and scene.deletions[0].type == 1  # Boxes of before are gone.
    found = np.array([[p.position.x, p.position.y] for p in last["/frontiers"][1].poses])
    expected = np.array([one.goal[:2] for one in m.frontiers()])
    assert np.allclose(*(rows[np.lexsort(np.round(rows, 6).T)] for rows in (found, expected)), atol=1e-6)
    passed = [[p.position.x, p.position.y, p.position.z] for p in last["/way"][1].poses]
    assert passed == way.points().tolist() and len(passed) > 1


def test_who_does_not_listen_costs_nothing() -> None:
    with served() as sink:
        made = []
        sink._channels = {
            topic: (channel, lambda m, stamp, topic=topic: made.append(topic))
            for topic, (channel, _) in sink._channels.items()
        }
        client = Client(sink.url)
        client.subscribe("/way")
        with LiveMapper(ScansIntake(SETTINGS, 2), sinks=[sink]) as mapper:
            deadline = time.monotonic() + PATIENCE
            while not sink._channels["/way"][0].has_sinks():
                assert time.monotonic() < deadline
                time.sleep(0.01)
            play(((scan, 0.0) for scan in scans("office", 3)), mapper, rate=0)
        assert set(made) == {"/way"} and not mapper.failures
        client.close()


def test_wrong_numbers_and_a_port_that_is_taken_are_refused() -> None:
    with served() as sink:
        from ndtree.live import FoxgloveSink

        port = int(sink.url.rpartition(":")[2])
        with pytest.raises(OSError, match=f"port {port} of 127.0.0.1: "):
            FoxgloveSink(port)
        with pytest.raises(ValueError, match="port = 70000: must be from 0 to 65535"):
            FoxgloveSink(70000)
        with pytest.raises(ValueError, match="period = nan s: must be >= 0"):
            FoxgloveSink(0, period=math.nan)


def rows_of(path: Path) -> dict[str, list[tuple[float, dict[str, Any]]]]:
    """By entity of an .rrd, time [s] and values of all that was written."""
    reader = pytest.importorskip("rerun.chunk", reason="no rerun-sdk with a reader").RrdReader
    rows: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    for chunk in reader(path).stream():
        batch = chunk.to_record_batch()
        if "time" not in batch.schema.names:
            continue
        times = batch.column("time").to_numpy(zero_copy_only=False).astype("M8[ns]").astype(np.int64)
        values = batch.select([name for name in batch.schema.names if ":" in name]).to_pylist()
        some = rows.setdefault(chunk.entity_path, [])
        some += [(1e-9 * float(at), row) for at, row in zip(times, values)]
    return {entity: sorted(some, key=lambda one: one[0]) for entity, some in rows.items()}


def test_a_file_for_rerun_has_the_map_at_each_time(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="no rerun-sdk: pip install 'ndtree-mapping[rerun]'")
    from ndtree.live import RerunSink

    way, some = Way(), scans("office", 12)
    sink = RerunSink(tmp_path / "map.rrd", period=0.0, way=way)
    m = ndtree.AdaptiveMap(dim=2, min_cell_size=0.1)
    maps = []
    for i, scan in enumerate(some):
        scan.insert_into(m)
        way.add(scan)
        sink.update(m.snapshot(), 100.0 + i)
        maps.append(m.snapshot())
    m.clear([np.full(2, -1e3), np.full(2, 1e3)])
    sink.update(m.snapshot(), 200.0)
    sink.close()
    rows = rows_of(tmp_path / "map.rrd")
    compared = 0
    for i, snapshot in enumerate(maps):
        cells = cell_points(snapshot)
        for size in np.unique(cells["size"]):
            entity = rows[f"/map/cells/{size:g}m"]
            row = next(row for at, row in entity if abs(at - 100.0 - i) < 1e-3)
            which = cells["size"] == size
            expected = np.stack([cells[name][which] for name in "xyz"], axis=1)
            assert np.allclose(row["Boxes3D:centers"], expected, atol=1e-6)
            assert np.allclose(row["Boxes3D:half_sizes"], size / 2)
            compared += len(expected)
    assert compared > 5000
    for size in np.unique(cell_points(maps[-1])["size"]):  # What is gone is not shown for ever.
        at, row = rows[f"/map/cells/{size:g}m"][-1]
        assert at == pytest.approx(200.0) and row["Clear:is_recursive"] == [False]
    frontiers = next(row for at, row in rows["/map/frontiers"] if abs(at - 111.0) < 1e-3)
    expected = np.array([[*one.goal, 0.0] for one in maps[-1].frontiers()])
    order = [np.lexsort(np.round(rows, 4).T) for rows in (np.array(frontiers["Arrows3D:origins"]), expected)]
    assert np.allclose(np.array(frontiers["Arrows3D:origins"])[order[0]], expected[order[1]], atol=1e-5)
    assert np.allclose(np.linalg.norm(frontiers["Arrows3D:vectors"], axis=1), 0.5, atol=1e-5)
    line = rows["/map/way"][-1][1]["LineStrips3D:strips"][0]
    assert np.allclose(line, way.points(), atol=1e-6) and len(line) > 3
    image = [row for at, row in rows["/grid"] if at < 150][-1]["SegmentationImage:buffer"][0]
    pixels, *_ = drawn(maps[-1])
    for value, kind in ((0, 2), (254, 1)):
        assert np.count_nonzero(np.array(image) == kind) == np.count_nonzero(pixels == value) > 100


def test_what_is_no_target_of_rerun_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="no rerun-sdk: pip install 'ndtree-mapping[rerun]'")
    from ndtree.live import RerunSink

    with pytest.raises(ValueError, match=r"rerun = map\.txt: expected a file that ends in \.rrd"):
        RerunSink("map.txt")
    with pytest.raises(FileNotFoundError):
        RerunSink(tmp_path / "nowhere" / "map.rrd")


def test_a_direction_is_that_of_the_x_axis() -> None:
    generator = np.random.default_rng(1)
    for _ in range(20):
        q = generator.normal(size=4)
        q /= np.linalg.norm(q)
        x, y, z, w = q
        u = np.array([x, y, z])
        axis = np.array([1.0, 0, 0])
        turned = axis + 2 * w * np.cross(u, axis) + 2 * np.cross(u, np.cross(u, axis))
        assert np.allclose(direction_of(tuple(q.tolist())), turned)


def test_a_way_has_points_a_step_apart() -> None:
    way = Way()
    for x in np.arange(0, 1.0, 0.03):
        way.add(ndtree.Scan(np.zeros((1, 2)), np.array([x, 0.5])))
    way.add(ndtree.Scan(np.zeros((1, 2)), np.array([math.nan, 0.5])))
    points = way.points()
    assert (np.diff(points[:, 0]) > 0.099).all() and len(points) == 9 and (points[:, 2] == 0).all()


@pytest.mark.parametrize("command", ["live", "map"])
def test_the_command_shows_a_recording_to_both(command: str, tmp_path: Path) -> None:
    pytest.importorskip("foxglove", reason="no foxglove-sdk")
    pytest.importorskip("rerun", reason="no rerun-sdk")
    log = tmp_path / "office.npz"
    ndtree.simulate("office", scans=10).save(log)
    own = ["--rate", 0] if command == "live" else []
    words = [command, log, "-o", tmp_path / "a.ndt", *own, "--foxglove", 0, "--rerun", tmp_path / "a.rrd"]
    called = [sys.executable, "-m", "ndtree", *map(str, words)]
    process = subprocess.Popen(called, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        url = process.stderr.readline().split()[0]
        client = Client(url)
        client.subscribe("/cells")
        taken = client.take()
        assert taken is not None and taken[0] == "/cells" and len(taken[2].data) > 1000
        client.close()
        while "until Ctrl-C" not in (line := process.stderr.readline()):
            assert line, "it has ended"
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    finally:
        process.kill()
        process.wait()
    rows = rows_of(tmp_path / "a.rrd")
    assert len(rows) >= 3
    image = rows["/grid"][-1][1]["SegmentationImage:buffer"][0]  # The last one is of the map as it became.
    pixels, *_ = drawn(ndtree.load(tmp_path / "a.ndt"))
    for value, kind in ((0, 2), (254, 1)):
        assert np.count_nonzero(np.array(image) == kind) == np.count_nonzero(pixels == value) > 100


@pytest.mark.parametrize("name, extra", [("foxglove", "FoxgloveSink"), ("rerun", "RerunSink")])
def test_without_the_package_it_says_what_to_install(name: str, extra: str) -> None:
    code = f"import sys; sys.modules[{name!r}] = None; import ndtree.live; ndtree.live.{extra}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1 and f"pip install '{name}-sdk>=" in done.stderr
    code = "import sys, ndtree, ndtree.live; print({'foxglove', 'rerun'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "set()\n"
