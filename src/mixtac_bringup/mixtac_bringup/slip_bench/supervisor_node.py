# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Supervises slip control on the simulated grasp: heartbeat, enabling, and a line per slip."""

from __future__ import annotations

import sys
import time

from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger

from mixtac_msgs.msg import SlipState
from mixtac_node.base_node import QOS_FORCE, QOS_SENSOR, run

HEARTBEAT_PERIOD_S = 0.1
ASK_EVERY_S = 1.0
REARM_S = 3.0
"""So long after a slip it is enabled anew, with an advance of zero [s]."""


class Supervisor(Node):  # type: ignore[misc]
    """Keeps slip control of a simulation enabled and says what happens.

    For simulations only: on a real arm a person or a cell controller decides what is enabled.
    """

    def __init__(self) -> None:
        super().__init__('supervisor', namespace='mixtac')
        self._state, self._slipping = SlipState.DISABLED, False
        self._place_mm = self._start_mm = 0.0
        self._onset_s, self._asked_s = 0.0, 0.0
        self._reported = True
        self._heartbeat = self.create_publisher(Empty, 'slip_control/heartbeat', QOS_SENSOR)
        self._enable = self.create_client(SetBool, 'slip_control/enable')
        self._reset = self.create_client(Trigger, 'slip_control/reset')
        self.create_subscription(SlipState, 'slip', self._on_slip, QOS_FORCE)
        self.create_subscription(PointStamped, 'truth/object', self._on_place, QOS_FORCE)
        self.create_timer(HEARTBEAT_PERIOD_S, self._beat)

    def _on_place(self, message: PointStamped) -> None:
        self._place_mm = -1e3 * message.point.z

    def _on_slip(self, message: SlipState) -> None:
        self._state = message.state
        if message.slipping and not self._slipping and self._reported:
            self._onset_s, self._reported = time.monotonic(), False
            self._start_mm = self._place_mm
        self._slipping = message.slipping

    def _beat(self) -> None:
        self._heartbeat.publish(Empty())
        now_s = time.monotonic()
        if not self._reported and now_s - self._onset_s > REARM_S:
            self._reported = True
            moved = self._place_mm - self._start_mm
            self.get_logger().info(f'slip seen; the object moved {moved:.2f} mm (simulated)')
            self._enable.call_async(SetBool.Request(data=False))
        elif now_s - self._asked_s > ASK_EVERY_S:
            self._asked_s = now_s
            if self._state == SlipState.STOPPED:
                self._reset.call_async(Trigger.Request())
            elif self._state == SlipState.DISABLED:
                self._enable.call_async(SetBool.Request(data=True))


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(Supervisor, args)


if __name__ == '__main__':
    sys.exit(main())
