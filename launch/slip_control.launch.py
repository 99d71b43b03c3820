# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip control for a running sensor (`sensor.launch.py`) and a running arm."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction

from mixtac_node.graph import slip_control
from mixtac_node.launch_actions import environment, node_actions, shared_arguments, value

ARGUMENTS = [
    DeclareLaunchArgument(
        'arm',
        default_value='none',
        description='Arm to move: none (report slip only), fr3, or the path of a URDF file',
    ),
    DeclareLaunchArgument(
        'arm_backend',
        default_value='',
        description='Backend that drives the arm: trajectory, libfranka, or a plug-in; empty: '
        'that of params_file',
    ),
    DeclareLaunchArgument(
        'detector',
        default_value='flow',
        choices=['flow', 'count'],
        description="Slip detector: motion of the skin, or the paper's event count",
    ),
    *shared_arguments('namespace', 'params_file', 'log_level'),
]


def _nodes(context):
    """Return the actions of slip control."""
    chosen = {name: value(context, name) for name in ('arm', 'detector')}
    if backend := value(context, 'arm_backend'):
        chosen['arm_backend'] = backend
    return node_actions(context, slip_control(chosen))


def generate_launch_description():
    """Return the launch description of slip control."""
    return LaunchDescription([*environment(), *ARGUMENTS, OpaqueFunction(function=_nodes)])
