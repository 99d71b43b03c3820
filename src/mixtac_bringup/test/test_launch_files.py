# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The launch files: their arguments, and the processes that they start."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
import threading
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('launch_ros', reason='launch is not installed')

from geometry_msgs.msg import WrenchStamped
from launch import LaunchContext, LaunchDescription, LaunchService
from launch.actions import ExecuteProcess, IncludeLaunchDescription, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions.substitution_failure import SubstitutionFailure
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.qos import qos_profile_system_default

from mixtac_core.node.graph import config_file, sensor_graph
from mixtac_core.node.process import GraphError
from mixtac_core.node.topics import EVENTS, FORCE, IMAGE_RAW

LAUNCH = Path(__file__).resolve().parents[3] / 'launch'


def processes(name: str, **values: str):
    """Return the processes that a launch file starts, in order, and the launch context."""
    context = LaunchContext()
    context.launch_configurations.update({'frames': 'false', **values})
    description = runpy.run_path(str(LAUNCH / f'{name}.launch.py'))['generate_launch_description']()
    found, queue = [], list(description.entities)
    while queue:
        entity = queue.pop(0)
        if isinstance(entity, ExecuteProcess):
            found.append(entity)
            continue
        queue = [*(entity.visit(context) or []), *queue]
    return found, context


def names(found) -> list[tuple[str, str] | str]:
    """Return package and executable of each node, an empty text for other processes."""
    return [
        (each.node_package, each.node_executable) if hasattr(each, 'node_package') else ''
        for each in found
    ]


def graph_names(*args, **options) -> list[tuple[str, str]]:
    return [(spec.package, spec.executable) for spec in sensor_graph(*args, **options)]


def words(process) -> list[str]:
    """Return the command line, without what launch substitutes."""
    return [part[0].text for part in process.cmd if hasattr(part[0], 'text')]


@pytest.mark.parametrize('device', ['davis346', 'virtual', 'virtual:/some/where.sock'])
def test_the_launch_file_starts_the_graph(device):
    found, _ = processes('sensor', device=device)
    assert names(found) == graph_names(device)


def test_the_frames_of_the_fingertip_are_published_unless_the_robot_does():
    found, _ = processes('sensor', device='davis346', frames='true')
    assert names(found) == [*graph_names('davis346'), ('mixtac_driver', 'frames_node')]


def test_overrides_reach_the_driver():
    values = {'device': '/some/bag', 'serial': '0042', 'playback_rate': '2.5'}
    found, _ = processes('sensor', **values)
    given = words(found[0])
    assert {"device:='/some/bag'", "serial:='0042'", 'playback_rate:=2.5'} <= set(given)
    assert str(config_file('driver.yaml')) in given


def test_parameters_of_the_user_are_read_after_the_shipped_ones(tmp_path):
    own = tmp_path / 'own.yaml'
    own.write_text('{}')
    found, _ = processes('sensor', device='davis346', params_file=str(own))
    for process, name in zip(found, ('driver', 'fger'), strict=True):
        given = words(process)
        assert given.index(str(own)) > given.index(str(config_file(f'{name}.yaml')))
    with pytest.raises(GraphError):
        processes('sensor', device='davis346', params_file=str(tmp_path / 'none.yaml'))


def test_slip_control_starts_the_sensor_where_a_device_is_named():
    alone, _ = processes('slip_control')
    assert names(alone) == [('mixtac_slip_control', 'slip_control_node')]
    assert '-p' not in words(alone[0])
    found, _ = processes('slip_control', device='virtual', arm='fr3')
    assert names(found) == graph_names('virtual', slip={})
    assert "device:='virtual'" in words(found[1])
    assert "arm:='fr3'" in words(found[2])


def test_align_and_view_add_their_nodes():
    values = {'align': 'true', 'view': 'true', 'reference_topic': '/other'}
    found, _ = processes('sensor', device='virtual', **values)
    assert names(found) == graph_names('virtual', align=True, view=True)


def test_a_replay_is_the_sensor_on_a_recording_in_its_own_time():
    found, context = processes('replay', device='/some/bag', rate='2.5')
    assert names(found) == graph_names('/some/bag')
    given = context.launch_configurations
    assert (given['use_sim_time'], given['playback_rate']) == ('true', '2.5')
    assert 'playback_clock:=true' in words(found[0])
    assert 'use_sim_time:=true' in words(found[1])


@pytest.mark.parametrize('device', ['', 'davis346'])
def test_a_recording_brings_its_sensor(device):
    found, _ = processes('record', output='/some/new', device=device)
    assert names(found) == [*(graph_names(device) if device else []), '']
    assert {'mixtac', 'record', '/some/new'} <= set(words(found[-1]))


def test_without_the_recorder_nothing_starts(tmp_path, monkeypatch):
    index = tmp_path / 'share/ament_index/resource_index/packages'
    index.mkdir(parents=True)
    (index / 'mixtac').touch()
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path), prepend=os.pathsep)
    with pytest.raises(SubstitutionFailure):
        processes('record', output='/some/new', device='davis346')


def test_numbers_may_have_an_exponent():
    found, _ = processes('slip_control', max_total='2e-4', controller='/arm')
    assert {'max_total:=0.0002', "controller:='/arm'"} <= set(words(found[0]))


def launched(name: str, watch, **arguments: str) -> tuple[int, list[int]]:
    """Run a launch file while a function runs in a thread.

    Returns:
        Status of the launch, and those of its processes.
    """
    statuses: list[int] = []
    ended = OnProcessExit(on_exit=lambda event, _: statuses.append(event.returncode))
    source = PythonLaunchDescriptionSource(str(LAUNCH / f'{name}.launch.py'))
    include = IncludeLaunchDescription(source, launch_arguments=list(arguments.items()))
    service = LaunchService(argv=[])
    service.include_launch_description(LaunchDescription([RegisterEventHandler(ended), include]))

    def run() -> None:
        try:
            watch()
        finally:
            service.shutdown()

    watcher = threading.Thread(target=run)
    watcher.start()
    status = service.run()
    watcher.join()
    return status, statuses


@pytest.mark.dds
@pytest.mark.timeout(300)
def test_a_launched_virtual_sensor_gives_forces_and_ends_well(tmp_path, node_under_test):
    graph = node_under_test
    forces = graph.listen(WrenchStamped, '/mixtac/force', qos_profile_system_default)

    def watch() -> None:
        graph.spin_until(lambda: len(forces) >= 100)
        found = graph.node.get_node_names_and_namespaces()
        assert {('driver', '/mixtac'), ('fger', '/mixtac')} <= set(found)
        for topic in (EVENTS, FORCE, IMAGE_RAW):
            (end,) = graph.node.get_publishers_info_by_topic(topic.resolved('mixtac'))
            assert end.topic_type == topic.type_name
        answer = graph.call(GetState, '/mixtac/fger/get_state')
        assert answer.current_state.id == State.PRIMARY_STATE_ACTIVE

    device = f'virtual:{tmp_path}/usb.sock'
    status, statuses = launched('sensor', watch, device=device, frames='false')
    assert forces[0].header.frame_id
    assert status == 0
    assert statuses == [0] * len(graph_names(device))


PROGRAM = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

path, *arguments = sys.argv[1:]
source = PythonLaunchDescriptionSource(path)
arguments = [tuple(each.split(':=')) for each in arguments]
include = IncludeLaunchDescription(source, launch_arguments=arguments)
service = LaunchService(argv=[])
service.include_launch_description(LaunchDescription([include]))
sys.exit(service.run())
"""


def ended(name: str, env: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a launch file until it ends by itself; return its status and what it printed."""
    # In a process of its own: what launch prints first decides where it always prints.
    command = [sys.executable, '-c', PROGRAM, str(LAUNCH / f'{name}.launch.py'), *arguments]
    return subprocess.run(
        command,
        check=False,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.mark.dds
@pytest.mark.timeout(300)
def test_a_launch_that_a_node_ends_has_a_status_and_the_reason(tmp_path, ros_domain):
    own = tmp_path / 'own.yaml'
    own.write_text('/**/fger:\n  ros__parameters:\n    model: /no/such.safetensors\n')
    done = ended('sensor', ros_domain, 'device:=none', f'params_file:={own}')
    assert done.returncode == 1
    assert any(
        'fger: ' in line and '/no/such.safetensors' in line for line in done.stdout.splitlines()
    )
    assert 'Traceback' not in done.stdout


@pytest.mark.dds
def test_a_recorder_that_cannot_record_gives_the_launch_a_status(tmp_path, ros_domain):
    done = ended('record', ros_domain, f'output:={tmp_path}')
    assert done.returncode == 1
    assert 'Traceback' not in done.stdout
