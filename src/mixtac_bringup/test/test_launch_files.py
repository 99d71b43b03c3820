# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The launch files, and that they start the same graph as the command line."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_node.graph import in_one_process, sensor_graph

LAUNCH = Path(__file__).resolve().parents[3] / 'launch'
SENSOR = LAUNCH / 'sensor.launch.py'
FILES = ('sensor', 'replay', 'record')


def arguments_of(path: Path) -> set[str]:
    """Return the names of the launch arguments that are declared literally."""
    return {
        node.args[0].value
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == 'DeclareLaunchArgument'
        and node.args
        and isinstance(node.args[0], ast.Constant)
    }


def test_the_launch_file_names_the_nodes_of_the_graph():
    literals = {
        node.value
        for node in ast.walk(ast.parse(SENSOR.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    graph = sensor_graph('virtual')
    for spec in [*graph, *in_one_process(graph)]:
        assert {spec.package, spec.executable, spec.name} <= literals


@pytest.mark.parametrize('name', FILES)
def test_every_launch_file_takes_the_usual_arguments(name: str):
    usual = {'device', 'namespace', 'params_file', 'log_level'}
    assert usual <= arguments_of(LAUNCH / f'{name}.launch.py')


def load(path: Path):
    spec = importlib.util.spec_from_file_location('launch_file', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description()


def processes(name: str, **values: str):
    """Return package and executable of each node that a launch file starts, in order."""
    launch = pytest.importorskip('launch', reason='launch is not installed')
    pytest.importorskip('launch_ros', reason='launch_ros is not installed')
    from launch.actions import ExecuteProcess
    from launch_ros.actions import Node

    context = launch.LaunchContext()
    context.launch_configurations.update(values)
    found, queue = [], list(load(LAUNCH / f'{name}.launch.py').entities)
    while queue:
        entity = queue.pop(0)
        if isinstance(entity, ExecuteProcess):
            found.append(
                (entity.node_package, entity.node_executable) if isinstance(entity, Node) else ''
            )
            continue
        queue = [*(entity.visit(context) or []), *queue]
    return found, context


@pytest.mark.parametrize('device', ['davis346', 'virtual', 'virtual:/some/where.sock'])
@pytest.mark.parametrize('together', ['false', 'true'])
def test_the_launch_description_starts_the_graph(device: str, together: str):
    found, _ = processes('sensor', device=device, single_process=together)
    graph = sensor_graph(device)
    wanted = in_one_process(graph) if together == 'true' else graph
    assert found == [(spec.package, spec.executable) for spec in wanted]


def test_align_adds_both_nodes_of_the_alignment_on_the_same_reference():
    added = {('mixtac_alignment', 'alignment_node'), ('mixtac_alignment', 'force_error_node')}
    plain, _ = processes('sensor', device='virtual')
    aligned, _ = processes('sensor', device='virtual', align='true', reference_topic='/other')
    assert set(aligned) - set(plain) == added
    assert len(aligned) == len(plain) + len(added)


def test_a_replay_is_the_sensor_on_a_recording_in_its_own_time():
    found, context = processes('replay', device='/some/bag', rate='2.5')
    assert found == [('mixtac_driver', 'driver_node'), ('mixtac_fger', 'fger_node')]
    given = context.launch_configurations
    assert (given['use_sim_time'], given['playback_rate']) == ('true', '2.5')


def test_one_process_cannot_be_source_and_follower_of_the_clock():
    pytest.importorskip('launch', reason='launch is not installed')
    with pytest.raises(RuntimeError, match='single_process'):
        processes('sensor', device='/bag', use_sim_time='true', single_process='true')


@pytest.mark.parametrize(('device', 'sensors'), [('', 0), ('davis346', 2)])
def test_a_recording_checks_first_and_brings_its_sensor(device: str, sensors: int):
    found, _ = processes('record', output='/some/new', device=device, start_after='0')
    assert (
        found[:sensors]
        == [(spec.package, spec.executable) for spec in sensor_graph('davis346')][:sensors]
    )
    # The check only: the recorder follows when it has passed.
    assert found[sensors:] == ['']
