# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip control for a running arm, and a running sensor or one that it starts itself."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction

from mixtac_core.node.graph import sensor_graph, slip_control
from mixtac_core.node.launch_actions import (
    environment,
    given,
    node_actions,
    shared_arguments,
    value,
)

PARAMETERS = (
    'controller',
    'joint_state_topic',
    'normal_frame',
    'normal',
    'lead',
    'limit_share',
    'grip_margin',
    'max_force',
    'max_total',
    'heartbeat_topic',
    'gripper',
)
ARGUMENTS = [
    DeclareLaunchArgument(
        'device',
        default_value='',
        description='Device of a sensor that is started as well, as by sensor.launch.py (davis346, '
        'virtual, virtual:SOCKET); empty: the sensor runs already',
    ),
    DeclareLaunchArgument(
        'arm',
        default_value='',
        description='Arm to move: none (report slip only), fr3, or the path of a URDF file; empty: '
        'that of params_file, by default none',
    ),
    DeclareLaunchArgument(
        'arm_backend',
        default_value='',
        description='Backend that drives the arm: trajectory, or a plug-in; empty: that of '
        'params_file',
    ),
    DeclareLaunchArgument(
        'law',
        default_value='',
        choices=['', 'step', 'paper'],
        description='Response to slip: a bounded step, or the law of the paper; empty: that of '
        'params_file, by default step',
    ),
    *(
        DeclareLaunchArgument(
            name,
            default_value='',
            description=f'Parameter {name} of slip control; empty: that of params_file',
        )
        for name in PARAMETERS
    ),
    *shared_arguments('namespace', 'params_file', 'autostart', 'log_level'),
]


def _nodes(context):
    """Return the actions of slip control."""
    chosen = given(context, 'arm', 'arm_backend', 'law', *PARAMETERS)
    device = value(context, 'device')
    nodes = sensor_graph(device, slip=chosen) if device else [slip_control(chosen)]
    return node_actions(context, *nodes)


def generate_launch_description():
    """Return the launch description of slip control."""
    return LaunchDescription([*environment(), *ARGUMENTS, OpaqueFunction(function=_nodes)])
