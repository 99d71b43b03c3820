# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Running errors of the force, and their node over DDS."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip('rclpy', reason='needs ROS')
pytest.importorskip('geometry_msgs.msg', reason='needs ROS')


@pytest.mark.dds
def test_running_errors_are_published(node_under_test: Any) -> None:
    from geometry_msgs.msg import WrenchStamped
    from std_msgs.msg import Float64

    from mixtac_core.node.base_node import QOS_FORCE

    node_under_test.start('mixtac_fger.alignment.force_error_node')
    make = node_under_test.node.create_publisher
    estimate = make(WrenchStamped, '/mixtac/force', QOS_FORCE)
    reference = make(WrenchStamped, '/mixtac/reference/wrench', QOS_FORCE)
    heard = node_under_test.listen(Float64, '/mixtac/force_error/mae', QOS_FORCE)
    count, start_s, pressed = 0, 100, 1.25

    def send(*, paired: bool = True) -> None:
        nonlocal count
        count += 1
        for publisher, force in ((estimate, pressed), (reference, 1.0))[: 1 + paired]:
            message = WrenchStamped()
            message.header.stamp.sec = start_s + count // 500
            message.header.stamp.nanosec = count % 500 * 2_000_000
            message.wrench.force.z = force
            publisher.publish(message)

    node_under_test.spin_until(lambda: heard, send)
    assert heard[-1].data == pytest.approx(0.25)

    # Estimates without a reference wait; then the clock of the camera starts anew.
    for _ in range(100):
        send(paired=False)
    count, start_s, pressed = 0, 10, 2.0
    node_under_test.spin_until(lambda: heard[-1].data > 0.3, send)
