# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A monitor without the nodes that it would measure."""

from __future__ import annotations

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_cli.monitor_node import Monitor
from mixtac_node.process import GraphError

pytestmark = pytest.mark.dds


def test_a_sensor_may_be_in_the_root_namespace(ros_domain):
    class Ended:
        def check(self):
            raise GraphError('fger has ended')

    with Monitor('/', 1.0) as monitor, pytest.raises(GraphError):
        monitor.bring_up('fger', Ended())
