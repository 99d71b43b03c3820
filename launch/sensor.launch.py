# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The sensor: camera driver, force estimator, the virtual sensor, and alignment on request."""

import os

from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    GroupAction,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown, matches_action
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition

from launch import LaunchDescription
from mixtac_node.process import profile_environment

PLAYBACK = {
    'playback_rate': (float, 'speed, 0 as fast as the subscribers allow'),
    'playback_start': (float, 'where to begin [s]'),
    'playback_loop': (bool, 'begin again at the end'),
    'playback_paused': (bool, 'begin standing still'),
}
ARGUMENTS = [
    DeclareLaunchArgument(
        'device',
        default_value='davis346',
        description='What the driver opens: davis346, virtual, virtual:SOCKET (for several on one '
        'machine), or the path of a recording',
    ),
    DeclareLaunchArgument(
        'serial',
        default_value='',
        description='Serial number of the camera; empty takes the only one attached',
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
        'device_seed',
        default_value='',
        description='Virtual sensor: which one (gel, lamp, pixels, serial number); empty takes the '
        'one of the parameter files',
    ),
    DeclareLaunchArgument(
        'reference_topic',
        default_value='',
        description='Topic of the reference force: of the virtual sensor, and with align; empty '
        'takes that of the parameter files',
    ),
    DeclareLaunchArgument(
        'single_process',
        default_value='false',
        choices=['true', 'false'],
        description='Run driver and estimator in one process: less CPU than in two',
    ),
    DeclareLaunchArgument(
        'align',
        default_value='false',
        choices=['true', 'false'],
        description='Fit the clock of the reference force on request, and publish the error of '
        'the estimate against it (docs/alignment.md)',
    ),
    DeclareLaunchArgument(
        'view',
        default_value='false',
        choices=['true', 'false'],
        description='Show the sensor in the browser; needs rerun-sdk (docs/viewing.md)',
    ),
    DeclareLaunchArgument(
        'use_sim_time',
        default_value='false',
        choices=['true', 'false'],
        description='The nodes behind the driver follow /clock, which the driver publishes then; '
        'for recordings',
    ),
    *(
        DeclareLaunchArgument(
            name,
            default_value='',
            description=f'Recordings: {what}; empty takes the value of the parameter files',
        )
        for name, (_, what) in PLAYBACK.items()
    ),
    DeclareLaunchArgument(
        'autostart',
        default_value='true',
        choices=['true', 'false'],
        description='Configure and activate the force estimator',
    ),
    DeclareLaunchArgument(
        'log_level', default_value='info', description='Severity from which the nodes log'
    ),
]


def _value(context, name):
    """Return the value of a launch argument as text."""
    return LaunchConfiguration(name).perform(context)


def _settings(context, names, overrides):
    """Return the parameter sources of a process, later ones winning.

    Only what was given as a launch argument goes into `overrides`: it wins over the files.
    """
    share = FindPackageShare('mixtac_bringup')
    shipped = [PathJoinSubstitution([share, 'config', f'{name}.yaml']) for name in names]
    own = _value(context, 'params_file')
    return [*shipped, *([own] if own else []), *([overrides] if overrides else [])]


def _common(context, name, overrides, members=()):
    """Return the arguments that every process of the graph takes."""
    return {
        'name': name,
        'namespace': LaunchConfiguration('namespace'),
        'output': 'screen',
        'arguments': ['--ros-args', '--log-level', LaunchConfiguration('log_level')],
        'parameters': _settings(context, members or (name,), overrides),
    }


def _shutdown_with(node, name):
    """End the launch when a node that the graph needs has ended."""

    def shut_down(_event, context):
        if context.is_shutdown:
            return None
        return [
            LogInfo(msg=f'{name} has ended: shutting down'),
            EmitEvent(event=Shutdown(reason=f'{name} has ended')),
        ]

    return RegisterEventHandler(OnProcessExit(target_action=node, on_exit=shut_down))


def _transition(node, transition_id):
    """Return the event that asks a lifecycle node for a transition."""
    return EmitEvent(
        event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition_id)
    )


def _bring_up(node):
    """Configure the estimator, activate it once configured, end the launch if it is refused."""
    autostart = IfCondition(LaunchConfiguration('autostart'))
    activate = RegisterEventHandler(
        OnStateTransition(
            target_lifecycle_node=node,
            # Without the start state this would also fire when the user deactivates the node.
            start_state='configuring',
            goal_state='inactive',
            entities=[_transition(node, Transition.TRANSITION_ACTIVATE)],
        )
    )
    refused = RegisterEventHandler(
        OnStateTransition(
            target_lifecycle_node=node,
            start_state='configuring',
            goal_state='unconfigured',
            entities=[
                LogInfo(msg='fger could not be configured: its error line above says why'),
                EmitEvent(event=Shutdown(reason='fger could not be configured')),
            ],
        )
    )
    configure = _transition(node, Transition.TRANSITION_CONFIGURE)
    return GroupAction([activate, refused, configure], condition=autostart, scoped=False)


def _virtual_sensor(context, device):
    """Return the virtual sensor's process."""
    socket = device.partition(':')[2]
    seed, topic = _value(context, 'device_seed'), _value(context, 'reference_topic')
    overrides = {
        **({'socket': ParameterValue(socket, value_type=str)} if socket else {}),
        **({'device_seed': int(seed)} if seed else {}),
        **({'reference_topic': topic} if topic else {}),
    }
    return Node(
        package='mixtac_sim',
        executable='virtual_sensor_node',
        **_common(context, 'virtual_sensor', overrides),
    )


def _alignment(context):
    """Return the nodes that fit the clocks and compare the force with the aligned reference."""
    topic = _value(context, 'reference_topic')
    overrides = {'reference_topic': topic} if topic else {}
    return [
        Node(
            package='mixtac_alignment',
            executable='alignment_node',
            **_common(context, 'alignment', overrides),
        ),
        Node(
            package='mixtac_alignment',
            executable='force_error_node',
            **_common(context, 'force_error', {}),
        ),
    ]


def _device(context):
    """Return the overrides of the driver: its device, and whether it publishes the clock."""
    serial = _value(context, 'serial')
    playback = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, (kind, _) in PLAYBACK.items()
        if _value(context, name)
    }
    return {
        **playback,
        # Typed, as a path or serial number may look like a number.
        'device': ParameterValue(_value(context, 'device'), value_type=str),
        **({'serial': ParameterValue(serial, value_type=str)} if serial else {}),
        **({'playback_clock': True} if _value(context, 'use_sim_time') == 'true' else {}),
    }


def _estimation(context):
    """Return driver and estimator: in one process, or in two of which the graph needs both."""
    simulated_time = _value(context, 'use_sim_time') == 'true'
    followed = {'use_sim_time': True} if simulated_time else {}
    if _value(context, 'single_process') == 'true':
        if simulated_time:
            raise RuntimeError(
                'use_sim_time:=true needs processes of their own: the driver is the source of the '
                'clock and cannot follow it; leave out single_process'
            )
        together = LifecycleNode(
            package='mixtac_cli',
            executable='sensor_node',
            **_common(context, 'fger', _device(context), members=('driver', 'fger')),
        )
        return [together, _shutdown_with(together, 'the sensor'), _bring_up(together)]
    driver = Node(
        package='mixtac_driver',
        executable='driver_node',
        **_common(context, 'driver', _device(context)),
    )
    estimator = LifecycleNode(
        package='mixtac_fger', executable='fger_node', **_common(context, 'fger', followed)
    )
    return [
        driver,
        _shutdown_with(driver, 'driver'),
        estimator,
        _shutdown_with(estimator, 'fger'),
        _bring_up(estimator),
    ]


def _nodes(context):
    """Return the actions of the graph for the device that was asked for."""
    device = _value(context, 'device')
    actions = []
    if device.partition(':')[0] == 'virtual':
        virtual = _virtual_sensor(context, device)
        actions += [virtual, _shutdown_with(virtual, 'virtual_sensor')]
    if _value(context, 'view') == 'true':
        actions.append(
            Node(
                package='mixtac_cli',
                executable='view_node',
                **_common(context, 'view', {}),
            )
        )
    if _value(context, 'align') == 'true':
        actions += _alignment(context)
    return [*actions, *_estimation(context)]


def generate_launch_description():
    """Return the launch description of the sensor."""
    return LaunchDescription(
        [
            SetEnvironmentVariable('RCUTILS_LOGGING_BUFFERED_STREAM', '1'),
            *(SetEnvironmentVariable(*each) for each in profile_environment(os.environ).items()),
            *ARGUMENTS,
            OpaqueFunction(function=_nodes),
        ]
    )
