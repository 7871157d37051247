# SPDX-License-Identifier: BSD-3-Clause
"""``python -m ndtree.live.ros2 --ros-args ...`` runs the node ``ndtree_map``."""

import sys

from ndtree.live.ros.run import main

if __name__ == "__main__":
    sys.exit(main("ros2"))
