# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip control beside a running sensor (`sensor.launch.py`) and a running arm."""

import os

from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription
from mixtac_node.process import profile_environment

ARGUMENTS = [
    DeclareLaunchArgument(
        'arm',
        default_value='none',
        description='What moves: none only reports slip, fr3, or the path of a URDF file',
    ),
    DeclareLaunchArgument(
        'detector',
        default_value='flow',
        choices=['flow', 'count'],
        description='Whose word counts: motion of the skin, or the count law of the paper',
    ),
    DeclareLaunchArgument(
        'namespace', default_value='mixtac', description='Namespace of all nodes and topics'
    ),
    DeclareLaunchArgument(
        'params_file',
        default_value='',
        description='Parameter file whose values win over the shipped ones',
    ),
    DeclareLaunchArgument(
        'log_level', default_value='info', description='Severity from which the nodes log'
    ),
]


def _nodes(context):
    """Return the actions of slip control."""
    package = FindPackageShare('mixtac_bringup')
    own = LaunchConfiguration('params_file').perform(context)
    chosen = {name: LaunchConfiguration(name).perform(context) for name in ('arm', 'detector')}
    shipped = PathJoinSubstitution([package, 'config', 'slip_control.yaml'])
    node = Node(
        package='mixtac_slip_control',
        executable='slip_control_node',
        name='slip_control',
        namespace=LaunchConfiguration('namespace'),
        output='screen',
        arguments=['--ros-args', '--log-level', LaunchConfiguration('log_level')],
        parameters=[shipped, chosen, *([own] if own else [])],
    )

    def shut_down(_event, exiting):
        if exiting.is_shutdown:
            return None
        return [
            LogInfo(msg='slip_control has ended: shutting down'),
            EmitEvent(event=Shutdown(reason='slip_control has ended')),
        ]

    return [node, RegisterEventHandler(OnProcessExit(target_action=node, on_exit=shut_down))]


def generate_launch_description():
    """Return the launch description of slip control."""
    return LaunchDescription(
        [
            SetEnvironmentVariable('RCUTILS_LOGGING_BUFFERED_STREAM', '1'),
            *(SetEnvironmentVariable(*each) for each in profile_environment(os.environ).items()),
            *ARGUMENTS,
            OpaqueFunction(function=_nodes),
        ]
    )
