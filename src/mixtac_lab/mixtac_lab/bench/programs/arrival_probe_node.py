# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A subscriber that says how old events of a pattern are when they arrive, and counts them.

Run as a process; takes JSON on stdin and prints JSON on stdout, so that no ROS interface of its own
disturbs what it measures.
"""

from __future__ import annotations

import json
import signal
import sys
import time
from typing import TYPE_CHECKING

import rclpy
from event_camera_msgs.msg import EventPacket
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from mixtac_events.codec import decode_message, warm_up
from mixtac_lab.bench.harness import Arrivals
from mixtac_node.base_node import QOS_EVENTS

if TYPE_CHECKING:
    from types import FrameType


class ArrivalProbe(Node):  # type: ignore[misc]
    """Hands every packet to `Arrivals`."""

    def __init__(self, arrivals: Arrivals, topic: str) -> None:
        super().__init__('arrival_probe')
        self._arrivals = arrivals
        self.create_subscription(EventPacket, topic, self._on_packet, QOS_EVENTS)

    def _on_packet(self, message: EventPacket) -> None:
        arrival_ns = time.time_ns()
        events = decode_message(message).events
        self._arrivals.add(message.seq, events, arrival_ns)


def main() -> None:
    """Measure from the first line on stdin until SIGTERM, then print the figures."""
    warm_up()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    stopping = False

    def stop(_signum: int, _frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    print(json.dumps({'ready': True}), flush=True)
    task = json.loads(sys.stdin.readline())
    arrivals = Arrivals(**task['pattern'])
    probe = ArrivalProbe(arrivals, task['topic'])
    executor = EventsExecutor()
    executor.add_node(probe)
    while not stopping:
        executor.spin_once(timeout_sec=0.1)
    print(json.dumps(arrivals.summary()), flush=True)
    probe.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
