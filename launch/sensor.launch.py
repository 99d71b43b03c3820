# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The sensor: camera driver and force estimator; virtual sensor, alignment and view on request."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from mixtac_core.node.graph import sensor_graph
from mixtac_core.node.launch_actions import (
    BOOLEAN,
    environment,
    given,
    node_actions,
    quiet_imports,
    shared_arguments,
    value,
)

PLAYBACK = {
    'playback_rate': 'speed; 0 plays as fast as the subscribers allow',
    'playback_start': 'where to start [s]',
    'playback_loop': 'start again at the end',
    'playback_paused': 'start paused',
}
ARGUMENTS = [
    DeclareLaunchArgument(
        'device',
        default_value='davis346',
        description='Device that the driver opens: davis346, virtual, virtual:SOCKET (for several '
        'on one machine), or the path of a recording; none starts no driver, for `ros2 bag play` '
        'or a driver on another machine',
    ),
    DeclareLaunchArgument(
        'serial',
        default_value='',
        description='Serial number of the camera; empty: the only one attached',
    ),
    DeclareLaunchArgument(
        'device_seed',
        default_value='',
        description='Virtual sensor: random seed that selects the sensor (gel, lamp, pixels, '
        'serial number); empty keeps the value of the parameter files',
    ),
    DeclareLaunchArgument(
        'reference_topic',
        default_value='',
        description='Topic of the reference force, for the virtual sensor and the alignment; empty '
        'keeps the value of the parameter files',
    ),
    DeclareLaunchArgument(
        'align',
        default_value='false',
        choices=BOOLEAN,
        description='Align the clock of the reference force on request, and publish the error of '
        'the estimate against it (docs/alignment.md)',
    ),
    DeclareLaunchArgument(
        'view',
        default_value='false',
        choices=BOOLEAN,
        description='Show the sensor in the browser; needs rerun-sdk (docs/viewing.md)',
    ),
    DeclareLaunchArgument(
        'frames',
        default_value='true',
        choices=BOOLEAN,
        description='Publish the frames of the fingertip and its URDF; false where the URDF of the '
        'robot contains it',
    ),
    DeclareLaunchArgument(
        'use_sim_time',
        default_value='false',
        choices=BOOLEAN,
        description='All nodes but the driver follow /clock: of a recording, which the driver '
        'plays, of the virtual sensor, or with device:=none of a bag player',
    ),
    *(
        DeclareLaunchArgument(
            name,
            default_value='',
            description=f'Recordings: {what}; empty keeps the value of the parameter files',
        )
        for name, what in PLAYBACK.items()
    ),
    *shared_arguments('namespace', 'params_file', 'autostart', 'log_level'),
]


def _nodes(context):
    """Return the actions of the graph."""
    serial = value(context, 'serial')
    graph = sensor_graph(
        value(context, 'device'),
        driver={**given(context, *PLAYBACK), **({'serial': serial} if serial else {})},
        virtual_sensor=given(context, 'device_seed'),
        align=value(context, 'align') == 'true',
        view=value(context, 'view') == 'true',
        simulated_time=value(context, 'use_sim_time') == 'true',
        reference_topic=value(context, 'reference_topic'),
    )
    frames = Node(
        package='mixtac_driver',
        executable='frames_node',
        exec_name='frames_node',
        namespace=value(context, 'namespace'),
        prefix=quiet_imports(),
    )
    published = value(context, 'frames') == 'true'
    return [*node_actions(context, *graph), *([frames] if published else [])]


def generate_launch_description():
    """Return the launch description of the sensor."""
    return LaunchDescription([*environment(), *ARGUMENTS, OpaqueFunction(function=_nodes)])
