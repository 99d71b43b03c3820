# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The sensor: camera driver, force estimator, and the virtual sensor where that is the device."""

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
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition

from launch import LaunchDescription

ARGUMENTS = [
    DeclareLaunchArgument(
        'device',
        default_value='davis346',
        description='What the driver opens: davis346, virtual, or the path of a recording',
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
        'autostart',
        default_value='true',
        choices=['true', 'false'],
        description='Configure and activate the force estimator',
    ),
    DeclareLaunchArgument(
        'log_level', default_value='info', description='Severity from which the nodes log'
    ),
]


def _settings(context, name):
    """Return the parameter sources of a node, later ones winning."""
    shipped = PathJoinSubstitution([FindPackageShare('mixtac_bringup'), 'config', f'{name}.yaml'])
    own = LaunchConfiguration('params_file').perform(context)
    return [shipped, own] if own else [shipped]


def _common(context, name):
    """Return the arguments that every node of the graph takes."""
    return {
        'name': name,
        'namespace': LaunchConfiguration('namespace'),
        'output': 'screen',
        'arguments': ['--ros-args', '--log-level', LaunchConfiguration('log_level')],
        'parameters': _settings(context, name),
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


def _nodes(context):
    """Return the actions of the graph for the device that was asked for."""
    device = LaunchConfiguration('device').perform(context)
    actions = []
    if device.partition(':')[0] == 'virtual':
        virtual = Node(
            package='mixtac_sim',
            executable='virtual_sensor_node',
            **_common(context, 'virtual_sensor'),
        )
        actions += [virtual, _shutdown_with(virtual, 'virtual_sensor')]
    settings = _common(context, 'driver')
    settings['parameters'] = [*settings['parameters'], {'device': device}]
    driver = Node(package='mixtac_driver', executable='driver_node', **settings)
    estimator = LifecycleNode(
        package='mixtac_fger', executable='fger_node', **_common(context, 'fger')
    )
    return [*actions, driver, _shutdown_with(driver, 'driver'), estimator, _bring_up(estimator)]


def generate_launch_description():
    """Return the launch description of the sensor."""
    return LaunchDescription(
        [
            SetEnvironmentVariable('RCUTILS_LOGGING_BUFFERED_STREAM', '1'),
            *ARGUMENTS,
            OpaqueFunction(function=_nodes),
        ]
    )
