# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Record a sensor to an MCAP bag: a running one, or one started for the recording.

With `device:=` the sensor is started as by `sensor.launch.py`; without it the running sensor is
recorded. Once event packets arrive (`mixtac record --check`), the bag is written by `ros2 bag
record` if it is installed, otherwise by the recorder of Mixtac. Ctrl-C closes the bag.
"""

import sys
import tempfile
from pathlib import Path

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    IncludeLaunchDescription,
    OpaqueFunction,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from mixtac_core.node.graph import recorder, rosbag2_qos
from mixtac_core.node.launch_actions import (
    BOOLEAN,
    environment,
    node_actions,
    shared_arguments,
    value,
)
from mixtac_core.node.process import GraphError
from mixtac_core.node.topics import REFERENCE

FORWARDED = (
    'device',
    'serial',
    'namespace',
    'params_file',
    'reference_topic',
    'log_level',
)
WAIT_S = 180.0
"""Longest time until a sensor that is started here publishes: a first start compiles."""
ARGUMENTS = [
    DeclareLaunchArgument('output', description='Folder of the new bag'),
    DeclareLaunchArgument(
        'device',
        default_value='',
        description='Device to start first: davis346, virtual, or the path of a recording; empty '
        'records the running sensor',
    ),
    DeclareLaunchArgument('serial', default_value='', description='Serial number of the camera'),
    DeclareLaunchArgument(
        'reference_topic',
        default_value=REFERENCE,
        description='Topic of the reference force, of the recorder and of a sensor that is '
        'started, whatever params_file says',
    ),
    DeclareLaunchArgument(
        'recorder',
        default_value='auto',
        choices=['auto', 'rosbag2', 'mixtac'],
        description='Program that writes the bag; auto prefers rosbag2 if it is installed',
    ),
    DeclareLaunchArgument(
        'check',
        default_value='true',
        choices=BOOLEAN,
        description='Wait for event packets and check the disk first; record only without errors',
    ),
    DeclareLaunchArgument(
        'start_after',
        default_value='',
        description='Seconds until the checks start; empty waits for the first event packet of '
        'device',
    ),
    *shared_arguments('namespace', 'params_file', 'log_level'),
]


def _has_rosbag2():
    """Return whether `ros2 bag record` can write MCAP here."""
    try:
        get_package_prefix('ros2bag')
        get_package_prefix('rosbag2_storage_mcap')
    except PackageNotFoundError:
        return False
    return True


def _recorder(context):
    """Return the process that writes the bag."""
    output, reference = value(context, 'output'), value(context, 'reference_topic')
    chosen = value(context, 'recorder')
    if chosen == 'mixtac' or (chosen == 'auto' and not _has_rosbag2()):
        return node_actions(context, recorder(Path(output), reference))[-1]
    qos = rosbag2_qos(value(context, 'namespace'), reference)
    with tempfile.NamedTemporaryFile('w', suffix='.yaml', delete=False) as overrides:
        yaml.safe_dump(qos, overrides)
    command = ['ros2', 'bag', 'record', '-s', 'mcap', '-o', output]
    command += ['--qos-profile-overrides-path', overrides.name, '--topics', *qos]
    return ExecuteProcess(cmd=command, output='screen')


def _check(context):
    """Return the process that checks."""
    command = [sys.executable, '-m', 'mixtac', 'record', value(context, 'output')]
    command += ['--check', '--namespace', value(context, 'namespace')]
    command += ['--reference-topic', value(context, 'reference_topic')]
    if value(context, 'device') and not value(context, 'start_after'):
        command += ['--wait', f'{WAIT_S:g}']
    return ExecuteProcess(cmd=command, output='screen')


def _recording(context):
    """Return the actions that check and then record."""
    writer = _recorder(context)

    def after_writer(event, context):
        if event.returncode and not context.is_shutdown:
            # An exception, unlike the event Shutdown, gives `ros2 launch` a status other than 0.
            raise GraphError(f'the recorder has ended with status {event.returncode} (see above)')
        return [EmitEvent(event=Shutdown(reason='the recorder has ended'))]

    ended = RegisterEventHandler(OnProcessExit(target_action=writer, on_exit=after_writer))
    if value(context, 'check') == 'false':
        return [ended, writer]
    check = _check(context)

    def after_check(event, _context):
        if event.returncode:
            raise GraphError(
                'not recorded (see the error above)', remedy='check:=false records anyway'
            )
        return [writer]

    passed = RegisterEventHandler(OnProcessExit(target_action=check, on_exit=after_check))
    return [ended, passed, check]


def _sensor():
    """Return the sensor."""
    sensor = PathJoinSubstitution(
        [FindPackageShare('mixtac_bringup'), 'launch', 'sensor.launch.py']
    )
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(sensor),
        launch_arguments={name: LaunchConfiguration(name) for name in FORWARDED}.items(),
    )


def _actions(context):
    """Return the actions for the given arguments."""
    delay_s = float(value(context, 'start_after') or 0)
    recording = _recording(context)
    later = [TimerAction(period=delay_s, actions=recording)] if delay_s else recording
    return [*([_sensor()] if value(context, 'device') else []), *later]


def generate_launch_description():
    """Return the launch description of a recording."""
    return LaunchDescription([*environment(), *ARGUMENTS, OpaqueFunction(function=_actions)])
