# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Record a sensor to an MCAP bag: a running one, or one started for the recording.

With `device:=` the sensor is started as by `sensor.launch.py`; without it the running sensor is
recorded. `mixtac record` waits for event packets and writes the bag. Ctrl-C closes the bag.
"""

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    IncludeLaunchDescription,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare

from mixtac_core.node.launch_actions import environment, quiet_imports, shared_arguments, value
from mixtac_core.node.process import STOP_GRACE_S, GraphError
from mixtac_core.node.topics import REFERENCE

FORWARDED = ('device', 'serial', 'namespace', 'params_file', 'reference_topic')
START_S = 180
"""Longest time until a sensor that is started here publishes: a first start compiles [s]."""
RUNNING_S = 5
"""Longest time until a running sensor is heard [s]."""
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
        'params_file',
        default_value='',
        description='Parameter file of a sensor that is started; the recorder has no parameters',
    ),
    DeclareLaunchArgument(
        'reference_topic',
        default_value=REFERENCE,
        description='Topic of the reference force, of the recorder and of a sensor that is '
        'started, whatever params_file says',
    ),
    *shared_arguments('namespace'),
]


def _recorder(context):
    """Return the actions that record."""
    # Found now: a launch that fails once nodes start leaves them running.
    program = ExecutableInPackage('mixtac', 'mixtac').perform(context)
    command = [program, 'record', value(context, 'output')]
    command += ['--namespace', value(context, 'namespace')]
    command += ['--reference-topic', value(context, 'reference_topic')]
    command += ['--wait', str(START_S if value(context, 'device') else RUNNING_S)]
    writer = ExecuteProcess(
        cmd=command,
        name='record',
        output='screen',
        prefix=quiet_imports(),
        sigterm_timeout=str(STOP_GRACE_S),
    )

    def ended(event, context):
        if event.returncode and not context.is_shutdown:
            # An exception, unlike the event Shutdown, gives `ros2 launch` a status other than 0.
            raise GraphError(f'the recorder has ended with status {event.returncode} (see above)')
        return [EmitEvent(event=Shutdown(reason='the recorder has ended'))]

    return [RegisterEventHandler(OnProcessExit(target_action=writer, on_exit=ended)), writer]


def _actions(context):
    """Return the actions for the given arguments."""
    if not value(context, 'device'):
        return _recorder(context)
    path = [FindPackageShare('mixtac_bringup'), 'launch', 'sensor.launch.py']
    sensor = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution(path)),
        launch_arguments={name: LaunchConfiguration(name) for name in FORWARDED}.items(),
    )
    return [sensor, *_recorder(context)]


def generate_launch_description():
    """Return the launch description of a recording."""
    return LaunchDescription([*environment(), *ARGUMENTS, OpaqueFunction(function=_actions)])
