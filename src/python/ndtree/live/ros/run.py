# SPDX-License-Identifier: BSD-3-Clause
"""The command ``ndtree_map``: the node of the ROS that there is, until it is asked to end."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec

from ndtree._lazy import install_of

_NEEDED = {
    "ros1": "ndtree_map needs rospy and messages of ROS 1 ({}): source the setup file of an installed ROS, "
    "or with Debian: apt install python3-rospy python3-nav-msgs python3-map-msgs python3-tf2-msgs, "
    "for the Python of the system",
    "ros2": "ndtree_map needs rclpy and messages of ROS 2 ({}): source the setup file of an installed ROS, "
    "or for CPython 3.11 {}",
}
#: For how long one thread may run while others wait for the interpreter [s].
SWITCH_INTERVAL = 5e-4


def is_ros1() -> bool:
    """Whether the setup file of ROS 1 was sourced, or nothing but its rospy is installed."""
    version = os.environ.get("ROS_VERSION")
    if version in ("1", "2"):
        return version == "1"
    return find_spec("rclpy") is None and find_spec("rospy") is not None


def main(ros: str = "", arguments: Sequence[str] | None = None) -> int:
    """Run the node; its exit status.

    `ros` ({"ros1", "ros2"}): Which; left out, the one that there is.
    `arguments`: As on the command line: of ROS 1 ``_PARAMETER:=VALUE``, of ROS 2 behind ``--ros-args``.
    """
    # Products of small matrices gain nothing by threads, which wait for each other on a robot's busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    ros = ros or ("ros1" if is_ros1() else "ros2")
    try:
        from ndtree._errors import WrongOption
        from ndtree.live.ros.parameters import in_parameters

        of_ros = import_module(f"ndtree.live.{ros}.node")
    except ImportError as error:
        print(f"ndtree_map: {_NEEDED[ros].format(error, install_of('ros2'))}", file=sys.stderr)
        return 2
    # The thread that receives messages gets its turn sooner; by Python's default each takes up to 5 ms.
    sys.setswitchinterval(SWITCH_INTERVAL)
    ended = threading.Event()
    before = {one: signal.signal(one, lambda *_: ended.set()) for one in (signal.SIGINT, signal.SIGTERM)}
    node = None
    try:
        of_ros.begin(arguments)
        node = of_ros.MapNode()
        node.run(ended)
    except (ValueError, OSError, ImportError, WrongOption, *of_ros.ERRORS) as error:
        print(f"ndtree_map: {in_parameters(error)}", file=sys.stderr)
        return 1
    finally:
        if node is not None:
            node.end()
        of_ros.finish()
        for one, handler in before.items():
            signal.signal(one, handler)
    return 0
