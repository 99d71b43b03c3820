# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The force error node, over DDS."""

from __future__ import annotations

import subprocess
import sys
import time
from typing import Any

import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS')
pytest.importorskip('geometry_msgs.msg', reason='needs ROS')

pytestmark = pytest.mark.dds


def test_running_errors_are_published(ros_domain: dict[str, str]) -> None:
    from geometry_msgs.msg import WrenchStamped
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import Float64

    from mixtac_node.base_node import QOS_FORCE

    command = [sys.executable, '-m', 'mixtac_alignment.force_error_node']
    process = subprocess.Popen(command, env=ros_domain, text=True, stderr=subprocess.PIPE)
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(ros_domain['ROS_DOMAIN_ID']))
    node = rclpy.create_node('peer', context=context, namespace='mixtac')
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    heard: list[Any] = []
    estimate = node.create_publisher(WrenchStamped, 'force', QOS_FORCE)
    reference = node.create_publisher(WrenchStamped, 'alignment/reference', QOS_FORCE)
    node.create_subscription(Float64, 'force_error/mae', heard.append, QOS_FORCE)
    deadline = time.monotonic() + 40.0
    count = 0
    while not heard and time.monotonic() < deadline:
        count += 1
        for publisher, force in ((estimate, 1.25), (reference, 1.0)):
            message = WrenchStamped()
            message.header.stamp.sec = 100 + count // 500
            message.header.stamp.nanosec = count % 500 * 2_000_000
            message.wrench.force.z = force
            publisher.publish(message)
        executor.spin_once(timeout_sec=0.02)
    node.destroy_node()
    context.try_shutdown()
    process.terminate()
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 0, errors
    assert heard[-1].data == pytest.approx(0.25)
