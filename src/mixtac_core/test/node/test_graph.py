# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The description of the graph: which nodes, in which order, with which arguments."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_core.node.graph import (
    PATIENCE_S,
    config_file,
    node,
    sensor_graph,
    slip_control,
)
from mixtac_core.node.process import GraphError


def names(nodes) -> list[str]:
    return [node.name for node in nodes]


def overrides(nodes) -> dict[str, dict[str, object]]:
    return {node.name: dict(node.overrides) for node in nodes}


FROM_PIP = ('numba', 'numpy', 'scipy', 'cv2', 'rosbags', 'mcap', 'safetensors', 'usb')
"""Modules that pip installs, but YAML."""


def test_the_graph_is_read_with_what_ros_brings(tmp_path):
    # `ros2 launch` runs in the system's interpreter, the nodes in that of the environment.
    own = tmp_path / 'own.yaml'
    own.write_text('/**/driver:\n  ros__parameters:\n    serial: "0042"\n')
    code = f"""
import sys
sys.modules.update(dict.fromkeys({FROM_PIP}))
from pathlib import Path
from mixtac_core.node.graph import sensor_graph
for node in sensor_graph('virtual', align=True):
    print(node.command('mixtac', Path({str(own)!r})))
"""
    subprocess.run([sys.executable, '-c', code], check=True, stdout=subprocess.DEVNULL)


def test_a_camera_needs_driver_and_estimator():
    nodes = sensor_graph('davis346')
    assert names(nodes) == ['driver', 'fger']
    assert all(node.required for node in nodes)
    # Whether something touches a real sensor at the start is not known.
    assert overrides(nodes)['fger'] == {'autostart': True}


def test_the_virtual_sensor_comes_first_and_shares_its_socket():
    nodes = sensor_graph('virtual:/a/b.sock', virtual_sensor={'device_seed': 5})
    assert names(nodes) == ['virtual_sensor', 'driver', 'fger']
    assert overrides(nodes)['virtual_sensor'] == {'socket': '/a/b.sock', 'device_seed': 5}
    driver = {'device': 'virtual:/a/b.sock', 'stream_timeout': PATIENCE_S}
    assert overrides(nodes)['driver'] == driver
    assert overrides(nodes)['fger'] == {'assume_free': True, 'autostart': True}


def test_additions_stand_between_sensor_and_driver():
    nodes = sensor_graph('virtual', align=True, view=True, reference_topic='/left/ft')
    assert names(nodes) == ['virtual_sensor', 'view', 'alignment', 'force_error', 'driver', 'fger']
    reference = {'reference_topic': '/left/ft'}
    assert overrides(nodes)['virtual_sensor'] == overrides(nodes)['alignment'] == reference
    # It compares with the topic that the alignment publishes.
    assert overrides(nodes)['force_error'] == {}


def test_simulated_time_comes_from_the_driver_or_the_virtual_sensor():
    found = overrides(sensor_graph('/some/bag', simulated_time=True))
    assert found == {
        'driver': {'device': '/some/bag', 'playback_clock': True},
        'fger': {'assume_free': True, 'autostart': True, 'use_sim_time': True},
    }
    found = overrides(sensor_graph('virtual', align=True, simulated_time=True))
    assert found['virtual_sensor'] == {'publish_clock': True}
    assert 'playback_clock' not in found['driver']
    assert all(found[name]['use_sim_time'] for name in ('alignment', 'force_error', 'fger'))


def test_without_a_driver_all_nodes_follow_the_clock_of_the_bag_player():
    nodes = sensor_graph('none', align=True, simulated_time=True)
    assert names(nodes) == ['alignment', 'force_error', 'fger']
    assert all(node.overrides['use_sim_time'] for node in nodes)
    assert 'assume_free' not in overrides(sensor_graph('none'))['fger']


def test_overrides_come_after_the_files_and_reach_every_node_of_a_process(tmp_path):
    own = tmp_path / 'own.yaml'
    own.write_text('{}')
    (driver, _) = sensor_graph('davis346', driver={'serial': "00'1", 'playback_loop': True})
    arguments = driver.ros_arguments(own, 'debug')
    files = [value for key, value in pairwise(arguments) if key == '--params-file']
    assert files == [str(config_file('driver.yaml')), str(own)]
    values = [value for key, value in pairwise(arguments) if key == '-p']
    # Neither a node's name nor a namespace before them: `-p` is for all nodes of the process.
    assert values == ["device:='davis346'", "serial:='00''1'", 'playback_loop:=true']
    assert arguments.index('-p') > arguments.index(str(own))
    command = driver.command('left/', own)
    assert command[1:4] == ['-m', 'mixtac_core.node.graph', 'mixtac_driver.node.driver_node']
    assert {'__ns:=/left', '__node:=driver'} <= set(command)
    with pytest.raises(GraphError):
        driver.command('left', tmp_path / 'none.yaml')


def test_every_node_is_installed_and_has_a_parameter_file():
    more = [slip_control({'arm': 'none'}), node('mixtac', 'view')]
    for device, options in (
        ('virtual', {'align': True}),
        ('x', {'slip': {}}),
    ):
        for each in [*sensor_graph(device, **options), *more]:
            assert each.command('mixtac')
            assert config_file(f'{each.name}.yaml').is_file()
