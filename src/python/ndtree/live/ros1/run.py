# SPDX-License-Identifier: BSD-3-Clause
"""The command ``ndtree_map`` with ROS 1: the node, until it is asked to end."""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import Any

_NEEDED = (
    "ndtree_map needs rospy and messages of ROS 1 ({}): source the setup file of an installed ROS, "
    "or with Debian: apt install python3-rospy python3-nav-msgs python3-map-msgs python3-tf2-msgs, "
    "for the Python of the system"
)
#: For how long one thread may run while others wait for the interpreter [s].
SWITCH_INTERVAL = 5e-4


def main(arguments: list[str] | None = None) -> int:
    """Run the node; its exit status.

    `arguments`: As on the command line: ``_PARAMETER:=VALUE``, ``TOPIC:=OTHER``.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        import rospy

        from ndtree.live.ros.parameters import in_parameters
        from ndtree.live.ros1.node import MapNode
        from ndtree.logs.core.failures import WrongOption
    except ImportError as error:
        print(f"ndtree_map: {_NEEDED.format(error)}", file=sys.stderr)
        return 2
    sys.setswitchinterval(SWITCH_INTERVAL)
    ended = threading.Event()

    def end(number: int, frame: Any) -> None:
        ended.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    node = None
    try:
        rospy.init_node("ndtree_map", argv=sys.argv if arguments is None else arguments, disable_signals=True)
        node = MapNode()
        node.run(ended)
    except (ValueError, OSError, ImportError, WrongOption, rospy.ROSException) as error:
        print(f"ndtree_map: {in_parameters(error)}", file=sys.stderr)
        return 1
    finally:
        if node is not None:
            node.end()
        rospy.signal_shutdown("the node was asked to end")
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0
