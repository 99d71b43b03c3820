# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""QoS of topics set by parameters, on a real lifecycle node."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

SCRIPT = """
import json, rclpy
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger
from builtin_interfaces.msg import Time
from mixtac_node.base_node import QOS_EVENTS, BaseNode

class Probe(BaseNode, LifecycleNode):
    pass

overrides = {
    '/ns/plain.publisher.depth': 7,
    '/ns/managed.publisher.reliability': 'reliable',
    '/ns/heard.subscription.depth': 3,
}
arguments = [part for k, v in overrides.items() for part in ('-p', f'qos_overrides.{k}:={v}')]
rclpy.init(args=['--ros-args', *arguments])
node = Probe('probe', namespace='ns')
plain = node.create_publisher(Time, 'plain', QOS_EVENTS)
managed = node.create_lifecycle_publisher(Time, 'managed', QOS_EVENTS)
heard = node.create_subscription(Time, 'heard', lambda _message: None, QOS_EVENTS)
node.destroy_subscription(heard)
again = node.create_subscription(Time, 'heard', lambda _message: None, QOS_EVENTS)
other = node.create_publisher(Time, 'other', QOS_EVENTS)
print(json.dumps({
    'plain': plain.qos_profile.depth,
    'managed': managed.qos_profile.reliability.name,
    'heard': again.qos_profile.depth,
    'other': [other.qos_profile.depth, other.qos_profile.reliability.name],
}))
"""


def test_depth_and_reliability_follow_the_parameters(ros_domain):
    done = subprocess.run(
        [sys.executable, '-c', SCRIPT],
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
        env=ros_domain,
    )
    assert json.loads(done.stdout.splitlines()[-1]) == {
        'plain': 7,
        'managed': 'RELIABLE',
        'heard': 3,
        'other': [1000, 'BEST_EFFORT'],
    }
