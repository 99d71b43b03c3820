# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The running graph on the virtual sensor: the contract of names, types and QoS, and the data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac.monitor_node import Monitor  # noqa: E402
from mixtac_core.node.graph import sensor_graph  # noqa: E402
from mixtac_core.node.topics import TOPICS  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.dds
OTHER_GRAPHS = {
    *('image_raw/compressed', 'events_rect', 'contact', 'contact_point', 'displacement'),
    *('displacement/points', 'grip', 'clock_fit', 'slip', 'reference/wrench'),
    *('force_error/mae', 'force_error/rmse'),
}


@pytest.fixture(scope='module')
def graph(module_node_under_test) -> Iterator[Monitor]:
    """Return a monitor of the sensor graph, running and active."""
    processes = module_node_under_test
    with Monitor('mixtac', processes, 120) as monitor:
        nodes = sensor_graph('virtual', virtual_sensor={'scenario': 'idle'})
        processes.start_nodes(nodes, 'mixtac')
        monitor.listen()
        processes.spin_until(lambda: monitor.estimate.received >= 500)
        yield monitor
        processes.check()


@pytest.mark.parametrize(
    'topic', [t for t in TOPICS if t.name not in OTHER_GRAPHS], ids=lambda t: t.name
)
def test_each_topic_has_its_type_and_qos(graph: Monitor, module_node_under_test, topic):
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    node = module_node_under_test.node
    infos = node.get_publishers_info_by_topic(topic.resolved('mixtac'))
    assert infos, f'nobody publishes {topic.name}'
    for info in infos:
        assert info.topic_type == topic.type_name
        qos = info.qos_profile
        assert qos.reliability == ReliabilityPolicy.RELIABLE
        assert (qos.durability == DurabilityPolicy.TRANSIENT_LOCAL) == topic.latched


def test_forces_are_two_milliseconds_apart_and_near_zero_without_contact(graph: Monitor):
    (_, stamps), force = graph.estimate.samples()
    # Time that a slow host cannot simulate is a gap.
    steps, counts = np.unique(np.diff(stamps), return_counts=True)
    assert steps[counts.argmax()] == 2_000_000
    assert not (steps % 2_000_000).any()
    assert steps[0] > 0
    assert np.isfinite(force[:, 0]).all()
    assert abs(float(force[-250:, 0].mean())) < 0.1


def test_every_node_reports_and_says_that_it_is_simulated(graph: Monitor, module_node_under_test):
    names = {'mixtac/driver', 'mixtac/virtual_sensor', 'mixtac/fger'}
    module_node_under_test.spin_until(lambda: names <= set(graph.diagnostics))
    for name in ('mixtac/driver', 'mixtac/virtual_sensor'):
        assert graph.diagnostics[name]['simulated'] == 'True'
