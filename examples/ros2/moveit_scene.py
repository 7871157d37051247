# SPDX-License-Identifier: BSD-3-Clause
"""Shows MoveIt the map: each octomap of ndtree_map becomes that of the planning scene.

Start it beside ndtree_map and move_group, with octomap_msgs and moveit_msgs of the same ROS 2:

    python3 moveit_scene.py --ros-args -r octomap_binary:=/ndtree_map/octomap_binary
"""

import rclpy
from moveit_msgs.msg import PlanningScene
from octomap_msgs.msg import Octomap
from rclpy.qos import DurabilityPolicy, QoSProfile


def scene_of(octomap: Octomap) -> PlanningScene:
    """A difference to the planning scene, in the frame of the octomap."""
    scene = PlanningScene(is_diff=True)
    placed = scene.world.octomap
    placed.header = octomap.header
    placed.origin.orientation.w = 1.0
    placed.octomap = octomap
    return scene


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("moveit_scene")
    scenes = node.create_publisher(PlanningScene, "planning_scene", 1)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(
        Octomap, "octomap_binary", lambda octomap: scenes.publish(scene_of(octomap)), latched
    )
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass


if __name__ == "__main__":
    main()
