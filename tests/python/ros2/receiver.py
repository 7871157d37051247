# SPDX-License-Identifier: BSD-3-Clause
"""Receives what the node publishes until a file appears, and writes it: receiver.py OUTPUT.npz STOP.

Two topics have no order between them: an update counts if it was sent after the grid.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Receiver:
    def __init__(self) -> None:
        self.node = rclpy.create_node("receiver")
        self.grid = None
        self.counts = {"map": 0, "map_updates": 0}
        self.received = 0
        self.updates = []
        self.last = {}
        for kind, topic, qos, received in (
            (OccupancyGrid, "map", LATCHED, self.whole),
            (OccupancyGridUpdate, "map_updates", QoSProfile(depth=10000), self.part),
            (PointCloud2, "ndtree_map/occupied_cells", LATCHED, self.keep("cloud")),
            (MarkerArray, "ndtree_map/cell_markers", LATCHED, self.keep("markers")),
            (PoseArray, "ndtree_map/frontiers", LATCHED, self.keep("frontiers")),
            (DiagnosticArray, "/diagnostics", QoSProfile(depth=10), self.keep("diagnostics")),
        ):
            self.node.create_subscription(kind, topic, self.counted(received), qos)
        try:
            from octomap_msgs.msg import Octomap
        except ImportError:
            return
        for name in ("full", "binary"):
            topic = f"ndtree_map/octomap_{name}"
            received = self.counted(self.keep(f"octomap_{name}"))
            self.node.create_subscription(Octomap, topic, received, LATCHED)

    def counted(self, received):
        def call(message, info) -> None:
            self.received += 1
            received(message, info["source_timestamp"])

        return call

    def drain(self) -> None:
        """Take what has arrived."""
        before = -1
        while self.received > before:
            before = self.received
            rclpy.spin_once(self.node, timeout_sec=0.2)

    def keep(self, name):
        def received(message, sent) -> None:
            self.last[name] = message

        return received

    def whole(self, message, sent) -> None:
        self.counts["map"] += 1
        self.info, self.frame = message.info, message.header.frame_id
        self.grid = np.array(message.data, dtype=np.int8).reshape(message.info.height, message.info.width)
        self.sent = sent
        self.updates = [one for one in self.updates if one[1] > sent]
        for update, _ in self.updates:
            self.draw(update)

    def part(self, message, sent) -> None:
        self.counts["map_updates"] += 1
        if self.grid is None or sent > self.sent:
            self.updates.append((message, sent))  # It may belong to a grid that comes later.
        if self.grid is not None and sent > self.sent:
            self.draw(message)

    def draw(self, message) -> None:
        size = message.y + message.height, message.x + message.width
        if any(end > edge for end, edge in zip(size, self.grid.shape)):
            return
        values = np.array(message.data, dtype=np.int8).reshape(message.height, message.width)
        self.grid[message.y : message.y + message.height, message.x : message.x + message.width] = values

    def written(self, path: Path) -> None:
        cloud, markers = self.last.get("cloud"), self.last.get("markers")
        points = np.zeros(0, dtype="<f4")
        if cloud is not None:
            points = np.frombuffer(bytes(cloud.data), "<f4").reshape(cloud.width, -1)
        boxes = [
            (point.x, point.y, point.z, one.scale.x)
            for one in (markers.markers if markers is not None else ())
            for point in one.points
        ]
        colors = [
            (color.r, color.g, color.b)
            for one in (markers.markers if markers is not None else ())
            for color in one.colors
        ]
        diagnostics = self.last.get("diagnostics")
        said = {one.key: one.value for one in diagnostics.status[0].values} if diagnostics else {}
        frontiers = self.last.get("frontiers")
        poses = [(p.position.x, p.position.y) for p in frontiers.poses] if frontiers else []
        octomaps = {
            name: np.frombuffer(bytes(bytearray(np.array(self.last[name].data, dtype=np.int8))), np.uint8)
            for name in ("octomap_full", "octomap_binary")
            if name in self.last
        }
        origin = self.info.origin.position if self.grid is not None else None
        text = {"counts": self.counts, "diagnostics": said, "frame": getattr(self, "frame", "")}
        with open(path, "wb") as file:
            np.savez(
                file, grid=self.grid if self.grid is not None else np.zeros((0, 0), np.int8),
                origin=np.array([origin.x, origin.y, self.info.resolution]) if origin else np.zeros(0),
                points=points, boxes=np.array(boxes), colors=np.array(colors), frontiers=np.array(poses),
                text=json.dumps(text), **octomaps,
            )  # fmt: skip


def main(output: Path, stop: Path) -> None:
    rclpy.init()
    receiver = Receiver()
    print("listens", flush=True)
    while not stop.exists():
        rclpy.spin_once(receiver.node, timeout_sec=0.1)
    receiver.drain()
    receiver.written(output)
    rclpy.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
