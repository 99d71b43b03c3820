# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The description of the graph: which nodes, in which order, with which arguments."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_core.node.graph import PATIENCE_S, config_file, node, sensor_graph, slip_control
from mixtac_core.node.process import GraphError

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


FREE = {'assume_free': True, 'autostart': True}
PATIENT = {'stream_timeout': PATIENCE_S}
FOLLOW = {'use_sim_time': True}
LEFT = {'reference_topic': '/left/ft'}


@pytest.mark.parametrize(
    ('device', 'options', 'expected'),
    [
        # Whether something touches a real sensor at the start is not known.
        ('davis346', {}, {'driver': {'device': 'davis346'}, 'fger': {'autostart': True}}),
        (
            'virtual:/a/b.sock',
            {'virtual_sensor': {'device_seed': 5}},
            {
                'virtual_sensor': {'socket': '/a/b.sock', 'device_seed': 5},
                'driver': {'device': 'virtual:/a/b.sock', **PATIENT},
                'fger': FREE,
            },
        ),
        # Errors are those against the topic that the alignment publishes.
        (
            'virtual',
            {'align': True, 'view': True, **LEFT},
            {
                'virtual_sensor': LEFT,
                'view': {},
                'alignment': LEFT,
                'force_error': {},
                'driver': {'device': 'virtual', **PATIENT},
                'fger': FREE,
            },
        ),
        # The driver, the virtual sensor or a bag player gives the simulated time.
        (
            '/some/bag',
            {'simulated_time': True},
            {'driver': {'device': '/some/bag', 'playback_clock': True}, 'fger': FREE | FOLLOW},
        ),
        (
            'virtual',
            {'simulated_time': True},
            {
                'virtual_sensor': {'publish_clock': True},
                'driver': {'device': 'virtual', **PATIENT},
                'fger': FREE | FOLLOW,
            },
        ),
        (
            'none',
            {'align': True, 'simulated_time': True},
            {'alignment': FOLLOW, 'force_error': FOLLOW, 'fger': FREE | FOLLOW},
        ),
        ('none', {}, {'fger': {'autostart': True}}),
    ],
)
def test_each_device_has_its_nodes_in_order_with_their_parameters(device, options, expected):
    nodes = sensor_graph(device, **options)
    found = {node.name: dict(node.overrides) for node in nodes}
    assert list(found.items()) == list(expected.items())
    required = {node.name for node in nodes if node.required}
    assert required == expected.keys() & {'virtual_sensor', 'driver', 'fger'}


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
    for device, options in (('virtual', {'align': True}), ('x', {'slip': {}})):
        for each in [*sensor_graph(device, **options), *more]:
            assert each.command('mixtac')
            assert config_file(f'{each.name}.yaml').is_file()
