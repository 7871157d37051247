# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of the node as ROS 2 declares them."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from ndtree.base.options import MAP_OPTIONS
from ndtree.live.ros.parameters import ROWS

_TYPES = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
}


def declare(node: Node) -> None:
    """Give a node all of them; options of the map stay unset until they are given."""
    for row in ROWS:
        descriptor = ParameterDescriptor(description=row.description, read_only=False)
        if row.range is not None and row.kind is int:
            low, high = (int(value) for value in row.range)
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
        elif row.range is not None:
            low, high = row.range
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        node.declare_parameter(row.key, row.start, descriptor)
    for option in MAP_OPTIONS:
        descriptor = ParameterDescriptor(description=f"{option.help} Unset: the map's own, or measured.")
        node.declare_parameter(option.name, _TYPES[option.type], descriptor)


def map_options(node: Node) -> dict[str, Any]:
    """Options of the map that were given."""
    given = {}
    for option in MAP_OPTIONS:
        parameter = node.get_parameter_or(option.name)
        if parameter is not None and parameter.type_ != Parameter.Type.NOT_SET:
            given[option.name] = parameter.value
    return given


def value(node: Node, name: str) -> Any:
    """Of a parameter."""
    return node.get_parameter(name).value
