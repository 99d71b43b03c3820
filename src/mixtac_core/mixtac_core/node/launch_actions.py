# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Launch actions for the nodes of a graph, and the arguments that all launch files share.

Needs `launch` and `launch_ros`, which come with a ROS installation only.
"""

from __future__ import annotations

import contextlib
import functools
import os
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from launch import LaunchContext
from launch.actions import DeclareLaunchArgument, RegisterEventHandler, SetEnvironmentVariable
from launch.event_handlers import OnProcessExit, OnProcessIO
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from mixtac_core.node.graph import NodeSpec
from mixtac_core.node.process import GraphError, fatal_text, profile_environment
from mixtac_core.node.topics import DEFAULT_NAMESPACE

BOOLEAN = ['true', 'false']
_SHARED = {
    'namespace': (DEFAULT_NAMESPACE, 'Namespace of all nodes and topics', None),
    'params_file': ('', 'Parameter file that overrides the shipped ones', None),
    'autostart': ('true', 'Configure and activate the force estimator', BOOLEAN),
    'log_level': (
        'info',
        'Lowest severity that the nodes log: debug, info, warn, error, fatal',
        None,
    ),
}
"""Default, description and choices of arguments."""


def shared_arguments(*names: str) -> list[Any]:
    """Return the declarations of launch arguments that several launch files have.

    Args:
        names: `namespace`, `params_file`, `autostart` or `log_level`.
    """
    found = []
    for name in names:
        default, text, choices = _SHARED[name]
        found += [
            DeclareLaunchArgument(name, default_value=default, description=text, choices=choices)
        ]
    return found


def environment() -> list[Any]:
    """Return the actions that set the environment of all nodes."""
    variables = {'RCUTILS_LOGGING_BUFFERED_STREAM': '1', **profile_environment(os.environ)}
    return [SetEnvironmentVariable(*each) for each in variables.items()]


def value(context: LaunchContext, name: str) -> str:
    """Return a launch argument as text, empty if it has none."""
    return str(LaunchConfiguration(name, default='').perform(context))


def given(context: LaunchContext, *names: str) -> dict[str, object]:
    """Return the launch arguments that are not empty, with the types that ROS gives them."""
    texts = {name: value(context, name) for name in names}
    return {name: _typed(text) for name, text in texts.items() if text}


def _typed(text: str) -> object:
    typed = yaml.safe_load(text)
    # YAML 1.1 takes 2e-4 for a text.
    with contextlib.suppress(ValueError):
        return float(typed) if isinstance(typed, str) else typed
    return typed


def node_actions(context: LaunchContext, *specs: NodeSpec) -> list[Any]:
    """Return the actions that start nodes, and end the launch with a node that it needs.

    A launch that a node ends reports the node's reason and has a status other than 0. The arguments
    `namespace`, `params_file`, `log_level` and `autostart` are read from the context.

    Args:
        context: Of the launch.
        specs: The nodes.

    Raises:
        GraphError: The parameter file does not exist.
    """
    actions: list[Any] = []
    for spec in specs:
        node = _node(context, spec)
        actions += [*(_ends(spec.name, node) if spec.required else ()), node]
    return actions


def _ends(name: str, node: Node) -> list[Any]:
    """Return the handlers that end the launch with a node."""
    reason = f'{name} has ended'

    def read(event: Any) -> None:  # noqa: ANN401
        nonlocal reason
        for line in event.text.decode(errors='replace').splitlines():
            if text := fatal_text(line):
                reason = f'{name}: {text}'

    def ended(_event: object, context: LaunchContext) -> None:
        if not context.is_shutdown:
            # Unlike the event Shutdown, an exception gives the launch a status other than 0.
            raise GraphError(reason)

    return [
        RegisterEventHandler(OnProcessIO(target_action=node, on_stderr=read)),
        RegisterEventHandler(OnProcessExit(target_action=node, on_exit=ended)),
    ]


def _node(context: LaunchContext, spec: NodeSpec) -> Node:
    """Return the action that starts a node."""
    own = value(context, 'params_file')
    if 'autostart' in spec.overrides:
        autostart = value(context, 'autostart') != 'false'
        spec = replace(spec, overrides={**spec.overrides, 'autostart': autostart})
    return Node(
        package=spec.package,
        executable=spec.executable,
        exec_name=spec.executable,
        name=spec.name,
        namespace=value(context, 'namespace'),
        output='screen',
        prefix=quiet_imports(),
        # Not as `parameters`: launch_ros writes values for the named node only, and two nodes of
        # one process have two names.
        arguments=spec.ros_arguments(
            Path(own) if own else None, value(context, 'log_level') or 'info'
        ),
    )


@functools.cache
def quiet_imports() -> str:
    """Return the prefix with which SIGINT waits for the end of the imports; empty without one."""
    prefix = ['env', '--block-signal=INT']
    supported = subprocess.run([*prefix, 'true'], capture_output=True, check=False).returncode == 0
    return ' '.join(prefix) if supported else ''
