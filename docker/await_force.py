#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Exit with 0 as soon as a force arrives, with 1 after eight seconds without one."""

from __future__ import annotations

import os
import sys
import time

import rclpy

from mixtac_core.node.base_node import qos
from mixtac_core.node.topics import DEFAULT_NAMESPACE, FORCE, message_class

WAIT_S = 8.0


def main() -> int:
    """Wait for the force of the namespace in the environment, `mixtac` by default."""
    rclpy.init()
    node = rclpy.create_node('healthcheck')
    found: list[object] = []
    topic = FORCE.resolved(os.environ.get('MIXTAC_NAMESPACE', DEFAULT_NAMESPACE))
    node.create_subscription(message_class(FORCE.type_name), topic, found.append, qos(FORCE))
    deadline = time.monotonic() + WAIT_S
    while not found and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.2)
    node.destroy_node()
    rclpy.shutdown()
    return 0 if found else 1


if __name__ == '__main__':
    sys.exit(main())
