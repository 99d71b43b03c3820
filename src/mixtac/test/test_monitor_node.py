# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a monitor keeps, and how it waits for nodes."""

from __future__ import annotations

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from geometry_msgs.msg import WrenchStamped

from mixtac.monitor_node import Monitor, Series
from mixtac_core.node.process import GraphError


class Ended:
    """Processes, one ended."""

    def check(self):
        raise GraphError('fger has ended')


@pytest.mark.dds
def test_waiting_ends_with_the_processes(ros_domain):
    # In the root namespace, too.
    with Monitor('/', Ended()) as monitor:
        with pytest.raises(GraphError):
            monitor.trigger('fger/tare')
        monitor.listen()
        with pytest.raises(GraphError):
            monitor.wait(lambda: False, 'a force')


def test_a_full_series_counts_on():
    series = Series(2)
    message = WrenchStamped()
    message.header.stamp.sec = 7
    for normal in (1.0, 2.0, 3.0):
        message.wrench.force.x, message.wrench.force.z = 0.5, normal
        series.add(message)
    assert (series.received, series.latest_n) == (3, 3.0)
    (_, stamps_ns), force_n = series.samples()
    assert force_n.tolist() == [[1.0, 0.5, 0.0], [2.0, 0.5, 0.0]]
    assert stamps_ns.tolist() == [7_000_000_000] * 2
