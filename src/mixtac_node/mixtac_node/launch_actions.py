# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Launch actions for the nodes of a graph, and the arguments that all launch files share.

Needs `launch` and `launch_ros`, which come with a ROS installation only.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    GroupAction,
    LogInfo,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown, matches_action
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition

from mixtac_node.process import profile_environment
from mixtac_node.topics import DEFAULT_NAMESPACE

if TYPE_CHECKING:
    from launch import LaunchContext

    from mixtac_node.graph import NodeSpec

BOOLEAN = ['true', 'false']
_SHARED: dict[str, dict[str, Any]] = {
    'namespace': {
        'default_value': DEFAULT_NAMESPACE,
        'description': 'Namespace of all nodes and topics',
    },
    'params_file': {
        'default_value': '',
        'description': 'Parameter file that overrides the shipped ones',
    },
    'autostart': {
        'default_value': 'true',
        'choices': BOOLEAN,
        'description': 'Configure and activate the force estimator',
    },
    'log_level': {
        'default_value': 'info',
        'description': 'Lowest severity that the nodes log: debug, info, warn, error or fatal',
    },
}


def shared_arguments(*names: str) -> list[Any]:
    """Return the declarations of launch arguments that several launch files have.

    Args:
        names: `namespace`, `params_file`, `autostart` or `log_level`.
    """
    return [DeclareLaunchArgument(name, **_SHARED[name]) for name in names]


def environment() -> list[Any]:
    """Return the actions that set the environment of all nodes."""
    variables = {'RCUTILS_LOGGING_BUFFERED_STREAM': '1', **profile_environment(os.environ)}
    return [SetEnvironmentVariable(*each) for each in variables.items()]


def value(context: LaunchContext, name: str) -> str:
    """Return a launch argument as text, empty if it has none."""
    return str(LaunchConfiguration(name, default='').perform(context))


def given(context: LaunchContext, *names: str) -> dict[str, object]:
    """Return the launch arguments that are not empty, with the types that YAML gives them."""
    texts = {name: value(context, name) for name in names}
    return {name: yaml.safe_load(text) for name, text in texts.items() if text}


def node_actions(context: LaunchContext, spec: NodeSpec) -> list[Any]:
    """Return the actions that start a node, end the launch with it, and bring it up.

    The arguments `namespace`, `params_file`, `log_level` and `autostart` are read from the context.

    Raises:
        GraphError: The parameter file does not exist.
    """
    own = value(context, 'params_file')
    options = {
        'package': spec.package,
        'executable': spec.executable,
        'name': spec.name,
        'namespace': value(context, 'namespace'),
        'output': 'screen',
        # Not as `parameters`: launch_ros writes values for the named node only, and two nodes of
        # one process have two names.
        'arguments': spec.ros_arguments(
            Path(own) if own else None, value(context, 'log_level') or 'info'
        ),
    }
    node = LifecycleNode(**options) if spec.lifecycle else Node(**options)
    actions = [node]
    if spec.required:
        actions.append(_shut_down_with(node, spec.name))
    if spec.lifecycle:
        actions.append(_bring_up(node, spec.name))
    return actions


def _shut_down_with(node: Any, name: str) -> Any:  # noqa: ANN401
    """End the launch when a node that the graph needs has ended."""

    def shut_down(_event: object, context: LaunchContext) -> list[Any] | None:
        if context.is_shutdown:
            return None
        return _end(f'{name} has ended')

    return RegisterEventHandler(OnProcessExit(target_action=node, on_exit=shut_down))


def _end(reason: str) -> list[Any]:
    return [LogInfo(msg=f'{reason}: shutting down'), EmitEvent(event=Shutdown(reason=reason))]


def _bring_up(node: Any, name: str) -> Any:  # noqa: ANN401
    """Configure a node, activate it once configured, end the launch if it refuses."""
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
            entities=_end(f'{name} could not be configured (see its error above)'),
        )
    )
    configure = _transition(node, Transition.TRANSITION_CONFIGURE)
    autostart = IfCondition(LaunchConfiguration('autostart', default='true'))
    return GroupAction([activate, refused, configure], condition=autostart, scoped=False)


def _transition(node: Any, transition_id: int) -> Any:  # noqa: ANN401
    """Return the event that requests a transition of a lifecycle node."""
    return EmitEvent(
        event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition_id)
    )
