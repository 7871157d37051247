# SPDX-License-Identifier: BSD-3-Clause
"""Receives what the node publishes until the node has ended, and writes it: receiver.py OUTPUT.npz.

Two topics have no order between them: an update counts if it is of a later scan than the grid.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

PATIENCE = 180.0


class Receiver:
    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.counts = {"map": 0, "map_updates": 0}
        self.grid: Any = None
        self.updates: list[Any] = []
        self.last: dict[str, Any] = {}
        self.has_met: set[str] = set()
        self.subscribers = {
            topic: rospy.Subscriber(topic, kind, received, queue_size=10000, buff_size=1 << 24)
            for kind, topic, received in (
                (OccupancyGrid, "map", self.whole),
                (OccupancyGridUpdate, "map_updates", self.part),
                (PointCloud2, "ndtree_map/occupied_cells", self.keep("cloud")),
                (MarkerArray, "ndtree_map/cell_markers", self.keep("markers")),
                (PoseArray, "ndtree_map/frontiers", self.keep("frontiers")),
                (DiagnosticArray, "/diagnostics", self.keep("diagnostics")),
            )
        }

    def keep(self, name: str) -> Any:
        def received(message: Any) -> None:
            with self.lock:
                self.last[name] = message

        return received

    def whole(self, message: OccupancyGrid) -> None:
        with self.lock:
            self.counts["map"] += 1
            self.info, self.frame, self.stamp = message.info, message.header.frame_id, message.header.stamp
            shape = message.info.height, message.info.width
            self.grid = np.array(message.data, dtype=np.int8).reshape(shape)
            self.updates = [one for one in self.updates if one.header.stamp > self.stamp]
            for update in self.updates:
                self.draw(update)

    def part(self, message: OccupancyGridUpdate) -> None:
        with self.lock:
            self.counts["map_updates"] += 1
            if self.grid is None or message.header.stamp > self.stamp:
                self.updates.append(message)
                if self.grid is not None:
                    self.draw(message)

    def draw(self, message: OccupancyGridUpdate) -> None:
        rows, columns = message.y + message.height, message.x + message.width
        if rows <= self.grid.shape[0] and columns <= self.grid.shape[1]:
            values = np.array(message.data, dtype=np.int8).reshape(message.height, message.width)
            self.grid[message.y : rows, message.x : columns] = values

    def is_over(self) -> bool:
        """Whether all topics had a publisher, which is gone; rospy has read then what came before."""
        for topic, one in self.subscribers.items():
            if one.get_num_connections():
                self.has_met.add(topic)
        met = self.has_met == set(self.subscribers)
        return met and not any(one.get_num_connections() for one in self.subscribers.values())

    def written(self, path: str) -> None:
        cloud, markers, frontiers = (self.last[name] for name in ("cloud", "markers", "frontiers"))
        boxes = [(p.x, p.y, p.z, one.scale.x) for one in markers.markers for p in one.points]
        position = self.info.origin.position
        said = {one.key: one.value for one in self.last["diagnostics"].status[0].values}
        text = {"counts": self.counts, "diagnostics": said, "frame": self.frame}
        with open(path, "wb") as file:
            np.savez(
                file,
                grid=self.grid,
                origin=np.array([position.x, position.y, self.info.resolution]),
                points=np.frombuffer(cloud.data, "<f4").reshape(cloud.width, -1),
                boxes=np.array(boxes),
                frontiers=np.array([(p.position.x, p.position.y) for p in frontiers.poses]),
                text=json.dumps(text),
            )


def main(output: str) -> None:
    rospy.init_node("receiver")
    receiver = Receiver()
    print("listens", flush=True)
    deadline = time.monotonic() + PATIENCE
    while not receiver.is_over():
        assert time.monotonic() < deadline, receiver.has_met
        time.sleep(0.02)
    receiver.written(output)


if __name__ == "__main__":
    main(sys.argv[1])
