# SPDX-License-Identifier: BSD-3-Clause
"""The command ``ndtree_map``: the node, until Ctrl-C."""

from __future__ import annotations

import sys

_NEEDED = (
    "ndtree_map needs rclpy and messages of ROS 2 ({}): source the setup file of an installed ROS, "
    "or pip install 'ndtree-mapping[ros2]' for CPython 3.11"
)


def main(arguments: list[str] | None = None) -> int:
    """Run the node; its exit status.

    Parameters
    ----------
    arguments : list of str, optional
        As on the command line; ROS's own stand behind ``--ros-args``.
    """
    try:
        import rclpy
        from rclpy.executors import ExternalShutdownException
        from rclpy.signals import SignalHandlerOptions

        from ndtree.live.ros2.node import MapNode
    except ImportError as error:
        print(f"ndtree_map: {_NEEDED.format(error)}", file=sys.stderr)
        return 2
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.ALL)
    node = None
    try:
        node = MapNode()
        node.start()
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (ValueError, OSError, ImportError) as error:
        print(f"ndtree_map: {error}", file=sys.stderr)
        return 1
    finally:
        if node is not None:
            node.end()
        rclpy.try_shutdown()
    return 0
