# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The force error node, over DDS."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip('rclpy', reason='needs ROS')
pytest.importorskip('geometry_msgs.msg', reason='needs ROS')

pytestmark = pytest.mark.dds


def test_running_errors_are_published(node_under_test: Any) -> None:
    from geometry_msgs.msg import WrenchStamped
    from std_msgs.msg import Float64

    from mixtac_node.base_node import QOS_FORCE

    node_under_test.start('mixtac_alignment.force_error_node')
    make = node_under_test.node.create_publisher
    estimate = make(WrenchStamped, '/mixtac/force', QOS_FORCE)
    reference = make(WrenchStamped, '/mixtac/reference/wrench', QOS_FORCE)
    heard = node_under_test.listen(Float64, '/mixtac/force_error/mae', QOS_FORCE)
    count = 0

    def send() -> None:
        nonlocal count
        count += 1
        for publisher, force in ((estimate, 1.25), (reference, 1.0)):
            message = WrenchStamped()
            message.header.stamp.sec = 100 + count // 500
            message.header.stamp.nanosec = count % 500 * 2_000_000
            message.wrench.force.z = force
            publisher.publish(message)

    node_under_test.spin_until(lambda: heard, send)
    assert heard[-1].data == pytest.approx(0.25)
