# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Supervises slip control on the simulated grasp: heartbeat, enabling, impacts.

All times are on the node's clock, which is that of the simulation if `use_sim_time` is set.
"""

from __future__ import annotations

import sys

from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger

from mixtac_cli.parameters import SupervisorParameters
from mixtac_msgs.msg import SlipState
from mixtac_node import topics
from mixtac_node.base_node import QOS_SENSOR, BaseNode, declare, run

HEARTBEAT_PERIOD_S = 0.1
REQUEST_PERIOD_S = 1.0
STEADY_S = 1.5
"""Slip control is enabled for this time before an impact, so that it has settled [s]."""
REARM_S = 3.0
"""Time after an impact at which slip control is enabled again, with an advance of zero [s]."""


class Supervisor(BaseNode, Node):  # type: ignore[misc]
    """Keeps slip control of a simulation enabled, strikes the object and logs each result.

    For simulations only: with a real arm, a person or a cell controller enables slip control.
    """

    def __init__(self) -> None:
        super().__init__('supervisor')
        self._settings = declare(self, SupervisorParameters, self._apply)
        self._state, self._seen, self._stopped = SlipState.DISABLED, False, False
        self._place_mm = self._start_mm = self._advance_mm = 0.0
        self._requested_s = self._enabled_s = self._struck_s = 0.0
        self._open = False
        self._heartbeat = self.create_publisher(Empty, 'slip_control/heartbeat', QOS_SENSOR)
        self._enable = self.create_client(SetBool, 'slip_control/enable')
        self._reset = self.create_client(Trigger, 'slip_control/reset')
        self._knock = self.create_client(Trigger, 'virtual_grasp/knock')
        self._put_back = self.create_client(Trigger, 'virtual_grasp/put_back')
        self.subscribe_topic(topics.SLIP, self._on_slip)
        self.subscribe_topic(topics.TRUTH_OBJECT, self._on_place)
        self.create_timer(HEARTBEAT_PERIOD_S, self._beat)

    def _apply(self, settings: SupervisorParameters) -> None:
        self._settings = settings

    def _now_s(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _on_place(self, message: PointStamped) -> None:
        self._place_mm = -1e3 * message.point.z

    def _on_slip(self, message: SlipState) -> None:
        if message.state == SlipState.ENABLED != self._state:
            self._enabled_s = self._now_s()
        self._state = message.state
        self._seen |= message.slipping
        self._stopped |= message.state == SlipState.STOPPED
        self._advance_mm = max(self._advance_mm, 1e3 * message.total_advance)

    def _beat(self) -> None:
        self._heartbeat.publish(Empty())
        now_s, every = self._now_s(), self._settings.knock_every
        if self._open:
            if now_s - self._struck_s > REARM_S:
                self._report()
        elif self._state == SlipState.ENABLED:
            steady = now_s - self._enabled_s > STEADY_S
            if every > 0.0 and steady and now_s - self._struck_s > every:
                self._strike(now_s)
        elif now_s - self._requested_s > REQUEST_PERIOD_S:
            self._requested_s = now_s
            if self._state == SlipState.STOPPED:
                self._reset.call_async(Trigger.Request())
            elif self._state == SlipState.DISABLED:
                self._enable.call_async(SetBool.Request(data=True))

    def _strike(self, now_s: float) -> None:
        """Request an impact; it counts once the simulation has confirmed it."""
        if now_s - self._requested_s < REQUEST_PERIOD_S:
            return
        self._requested_s, self._start_mm = now_s, self._place_mm
        self._seen, self._stopped, self._advance_mm = False, False, 0.0
        self._knock.call_async(Trigger.Request()).add_done_callback(self._on_struck)

    def _on_struck(self, _response: object) -> None:
        self._struck_s, self._open = self._now_s(), True

    def _report(self) -> None:
        """Log the result of the last impact and start over."""
        self._open = False
        moved = self._place_mm - self._start_mm
        found = 'detected' if self._seen else 'not detected'
        text = f'impact {found}: the object moved {moved:.2f} mm'
        if self._stopped:
            text += ', slip control stopped'
        self.get_logger().info(f'{text}, the arm {self._advance_mm:.2f} mm (simulated)')
        # Until it answers, the received state is outdated.
        self._state, self._requested_s = SlipState.DISABLED, self._now_s()
        disabled = self._enable.call_async(SetBool.Request(data=False))
        # Start each impact with the same force, so that they can be compared.
        disabled.add_done_callback(lambda _: self._put_back.call_async(Trigger.Request()))


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(Supervisor, args)


if __name__ == '__main__':
    sys.exit(main())
