# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`/clock` from the camera clock of a recording that is played."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rosgraph_msgs.msg import Clock

from mixtac_node.base_node import us_to_stamp

if TYPE_CHECKING:
    from mixtac_driver.stream import CameraBatch

PERIOD_US = 1000


class ClockPublisher:
    """Publishes the time that a recording has reached. For one thread.

    Args:
        node: An rclpy node.
    """

    def __init__(self, node: Any) -> None:  # noqa: ANN401
        # Default QoS: subscribers with use_sim_time are best effort, others may want all.
        self._publisher = node.create_publisher(Clock, '/clock', 10)
        self._due_us = 0

    def publish(self, batch: CameraBatch) -> None:
        """Publish the time of a batch [epoch-based camera clock], once per millisecond at most."""
        time_us = batch.time_us
        # A seek back moves published time on, so that it never runs backwards.
        if time_us >= self._due_us:
            self._due_us = time_us + PERIOD_US
            self._publisher.publish(Clock(clock=us_to_stamp(time_us)))
