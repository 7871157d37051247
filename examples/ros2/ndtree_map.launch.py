# SPDX-License-Identifier: BSD-3-Clause
"""Starts ndtree_map: ros2 launch ndtree_map.launch.py [use_sim_time:=true] [params:=FILE]."""

import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration


def generate_launch_description() -> LaunchDescription:
    here = os.path.dirname(os.path.abspath(__file__))
    return LaunchDescription(
        [
            DeclareLaunchArgument("params", default_value=os.path.join(here, "ndtree_map.yaml")),
            DeclareLaunchArgument("use_sim_time", default_value="false"),
            ExecuteProcess(
                cmd=[
                    "ndtree_map", "--ros-args",
                    "--params-file", LaunchConfiguration("params"),
                    "-p", ["use_sim_time:=", LaunchConfiguration("use_sim_time")],
                ],
                output="screen",
                sigterm_timeout="30",
            ),
        ]
    )  # fmt: skip
