# SPDX-License-Identifier: BSD-3-Clause
"""The command ``ndtree_map``: the node, until it is asked to end."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

from ndtree._lazy import install_of

_NEEDED = (
    "ndtree_map needs rclpy and messages of ROS 2 ({}): source the setup file of an installed ROS, "
    "or for CPython 3.11 {}"
)
#: For how long one thread may run while others wait for the interpreter [s].
SWITCH_INTERVAL = 5e-4
#: So often it is looked whether the node is to end [s].
_LOOKS = 0.2


def main(arguments: list[str] | None = None) -> int:
    """Run the node; its exit status.

    `arguments`: As on the command line; ROS's own stand behind ``--ros-args``.
    """
    # Products of small matrices gain nothing by threads, which wait for each other on a robot's busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        from ndtree.live.ros.parameters import in_parameters
        from ndtree.live.ros2.node import MapNode
        from ndtree.logs.core.failures import WrongOption
    except ImportError as error:
        print(f"ndtree_map: {_NEEDED.format(error, install_of('ros2'))}", file=sys.stderr)
        return 2
    # The thread that receives messages gets its turn sooner; by Python's default each takes up to 5 ms.
    sys.setswitchinterval(SWITCH_INTERVAL)
    ended = False

    def end(number: int, frame: Any) -> None:
        nonlocal ended
        ended = True

    # ROS's own handlers would take the context away before the last map is published.
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    node = None
    try:
        node = MapNode()
        node.start()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not ended and rclpy.ok():
            executor.spin_once(timeout_sec=_LOOKS)
    except (ValueError, OSError, ImportError, WrongOption) as error:
        print(f"ndtree_map: {in_parameters(error)}", file=sys.stderr)
        return 1
    finally:
        if node is not None:
            node.end()
        rclpy.try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0
