# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Records a sensor to an MCAP bag: one that runs, or one that is started for it.

With `device:=` the sensor is started as by `sensor.launch.py`, without it the one that runs is
recorded. After the checks of `mixtac record --check`, `ros2 bag record` writes the bag where it is
installed, and the recorder of this package elsewhere. Ctrl-C closes the bag.
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    IncludeLaunchDescription,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackagePrefix, FindPackageShare

from launch import LaunchDescription
from mixtac_node.topics import REFERENCE, TOPICS

FORWARDED = ('device', 'serial', 'namespace', 'params_file', 'single_process', 'log_level')
ARGUMENTS = [
    DeclareLaunchArgument('output', description='Folder of the new bag'),
    DeclareLaunchArgument(
        'device',
        default_value='',
        description='Start this device first: davis346, virtual, or the path of a recording; empty '
        'records the sensor that runs',
    ),
    DeclareLaunchArgument('serial', default_value='', description='Serial number of the camera'),
    DeclareLaunchArgument(
        'namespace', default_value='mixtac', description='Namespace of the sensor'
    ),
    DeclareLaunchArgument(
        'params_file',
        default_value='',
        description='Parameter file whose values win over the shipped ones',
    ),
    DeclareLaunchArgument(
        'single_process',
        default_value='false',
        choices=['true', 'false'],
        description='Run driver and estimator in one process',
    ),
    DeclareLaunchArgument(
        'reference_topic', default_value=REFERENCE, description='Topic of the reference force'
    ),
    DeclareLaunchArgument(
        'recorder',
        default_value='auto',
        choices=['auto', 'rosbag2', 'mixtac'],
        description='What writes the bag; auto takes rosbag2 where it is installed',
    ),
    DeclareLaunchArgument(
        'check',
        default_value='true',
        choices=['true', 'false'],
        description='Check disk, topics and clocks first, and do not record where they are amiss',
    ),
    DeclareLaunchArgument(
        'start_after',
        default_value='',
        description='Seconds until the checks begin; empty is 15 with a device of its own, else 0',
    ),
    DeclareLaunchArgument(
        'log_level', default_value='info', description='Severity from which the nodes log'
    ),
]


def _value(context, name):
    """Return the value of a launch argument as text."""
    return LaunchConfiguration(name).perform(context)


def _has_rosbag2():
    """Tell whether `ros2 bag record` can write MCAP here."""
    try:
        get_package_prefix('ros2bag')
        get_package_prefix('rosbag2_storage_mcap')
    except PackageNotFoundError:
        return False
    return True


def _recorder(context):
    """Return the process that writes the bag."""
    output, namespace = _value(context, 'output'), _value(context, 'namespace')
    reference = _value(context, 'reference_topic')
    chosen = _value(context, 'recorder')
    if chosen == 'rosbag2' or (chosen == 'auto' and _has_rosbag2()):
        names = [
            reference if each.name == REFERENCE else each.resolved(namespace) for each in TOPICS
        ]
        command = ['ros2', 'bag', 'record', '-s', 'mcap', '-o', output, *names]
        return ExecuteProcess(cmd=command, output='screen')
    return Node(
        package='mixtac_cli',
        executable='recorder_node',
        name='recorder',
        namespace=namespace,
        output='screen',
        parameters=[{'output': output, 'reference_topic': reference}],
    )


def _check():
    """Return the process that checks."""
    program = PathJoinSubstitution([FindPackagePrefix('mixtac_cli'), 'lib', 'mixtac_cli', 'mixtac'])
    options = [
        *('--namespace', LaunchConfiguration('namespace')),
        *('--reference-topic', LaunchConfiguration('reference_topic')),
    ]
    output = LaunchConfiguration('output')
    return ExecuteProcess(cmd=[program, 'record', output, '--check', *options], output='screen')


def _recording(context):
    """Return what checks and then records."""
    recorder = _recorder(context)
    ended = RegisterEventHandler(
        OnProcessExit(
            target_action=recorder,
            on_exit=[EmitEvent(event=Shutdown(reason='the recorder has ended'))],
        )
    )
    if _value(context, 'check') == 'false':
        return [ended, recorder]
    check = _check()

    def go_on(event, _context):
        if event.returncode == 0:
            return [recorder]
        return [
            LogInfo(msg='not recorded: the error line above says why; check:=false records anyway'),
            EmitEvent(event=Shutdown(reason='the checks found an error')),
        ]

    return [ended, RegisterEventHandler(OnProcessExit(target_action=check, on_exit=go_on)), check]


def _sensor():
    """Return the sensor, where one is to be started."""
    sensor = PathJoinSubstitution(
        [FindPackageShare('mixtac_bringup'), 'launch', 'sensor.launch.py']
    )
    arguments = {name: LaunchConfiguration(name) for name in FORWARDED}
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(sensor),
        launch_arguments={
            **arguments,
            'reference_topic': LaunchConfiguration('reference_topic'),
        }.items(),
    )


def _actions(context):
    """Return everything for the arguments that were given."""
    own = bool(_value(context, 'device'))
    delay_s = float(_value(context, 'start_after') or (15 if own else 0))
    recording = _recording(context)
    later = [TimerAction(period=delay_s, actions=recording)] if delay_s else recording
    return [*([_sensor()] if own else []), *later]


def generate_launch_description():
    """Return the launch description of a recording."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=_actions)])
