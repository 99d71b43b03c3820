# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The launch files, and that they start the same graph as the command line."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_bringup.graph import sensor_graph

LAUNCH = Path(__file__).resolve().parents[3] / 'launch'
SENSOR = LAUNCH / 'sensor.launch.py'


def test_the_launch_file_names_the_nodes_of_the_graph():
    literals = {
        node.value
        for node in ast.walk(ast.parse(SENSOR.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    for spec in sensor_graph('virtual'):
        assert {spec.package, spec.executable, spec.name} <= literals


def load(path: Path):
    spec = importlib.util.spec_from_file_location('sensor_launch', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description()


@pytest.mark.parametrize('device', ['davis346', 'virtual'])
def test_the_launch_description_starts_the_graph(device: str):
    launch = pytest.importorskip('launch', reason='launch is not installed')
    pytest.importorskip('launch_ros', reason='launch_ros is not installed')
    from launch.actions import DeclareLaunchArgument, OpaqueFunction
    from launch_ros.actions import Node

    description = load(SENSOR)
    context = launch.LaunchContext()
    arguments = [a for a in description.entities if isinstance(a, DeclareLaunchArgument)]
    assert {a.name for a in arguments} == {
        'device',
        'namespace',
        'params_file',
        'autostart',
        'log_level',
    }
    for argument in arguments:
        argument.visit(context)
    context.launch_configurations['device'] = device
    started = []
    for entity in description.entities:
        if isinstance(entity, OpaqueFunction):
            started += [a for a in entity.execute(context) if isinstance(a, Node)]
    found = {(node.node_package, node.node_executable) for node in started}
    assert found == {(spec.package, spec.executable) for spec in sensor_graph(device)}
