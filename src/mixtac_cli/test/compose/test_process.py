# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command of the process that holds driver and estimator, and the graph that it makes."""

from __future__ import annotations

import time

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_node.graph import in_one_process, sensor_graph
from mixtac_node.process import GraphError


def test_the_virtual_sensor_stays_a_process_of_its_own():
    nodes = in_one_process(sensor_graph('virtual:/a/b.sock', estimator={'force_scale': 2.0}))
    assert [node.name for node in nodes] == ['virtual_sensor', 'fger']
    command = nodes[1].command('left')
    assert "device:='virtual:/a/b.sock'" in command
    assert 'force_scale:=2.0' in command
    assert sum(part.endswith(('driver.yaml', 'fger.yaml')) for part in command) == 2


def test_an_override_of_both_nodes_is_refused():
    nodes = sensor_graph('davis346', driver={'frame_id': 'a'}, estimator={'frame_id': 'b'})
    with pytest.raises(GraphError, match='frame_id'):
        in_one_process(nodes)[-1].command('mixtac')


@pytest.mark.dds
def test_one_process_has_the_nodes_topics_and_force_of_two(ros_domain, tmp_path):
    from mixtac_cli.monitor_node import Monitor
    from mixtac_node.process import ProcessGroup

    graph = sensor_graph(f'virtual:{tmp_path}/usb.sock', virtual_sensor={'scenario': 'idle'})
    with ProcessGroup(tmp_path / 'log') as processes, Monitor('one', 60) as monitor:
        for node in in_one_process(graph):
            processes.start(node.name, node.command('one'))
        monitor.bring_up('fger', processes)
        monitor.listen()
        deadline = time.monotonic() + 60
        while monitor.force_count < 250 and time.monotonic() < deadline:
            time.sleep(0.05)
            processes.check()
        assert monitor.force_count >= 250
        _, stamps, _ = monitor.force()
        steps = stamps[1:] - stamps[:-1]
        assert (steps > 0).all()
        assert (steps % 2_000_000 == 0).all()
        monitor.trigger('fger/tare', processes.check)
        assert monitor.publishers('/one/events')
        assert monitor.publishers('/one/image_raw')
        while {'one/driver', 'one/fger'} - set(monitor.diagnostics):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert monitor.diagnostics['one/fger']['lost_packets'] == '0'
