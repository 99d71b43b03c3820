# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Supervises slip control on the simulated grasp: heartbeat, enabling, impacts.

All times are on the node's clock, which is that of the simulation if `use_sim_time` is set.
"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

from geometry_msgs.msg import PointStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger

from mixtac_cli.impacts import ImpactLog, draw_impacts
from mixtac_cli.parameters import SupervisorParameters
from mixtac_msgs.msg import SlipState
from mixtac_node import topics
from mixtac_node.base_node import QOS_SENSOR, BaseNode, declare, run
from mixtac_node.files import FileError

HEARTBEAT_PERIOD_S = 0.1
REQUEST_PERIOD_S = 0.3
GRIP_S = 1.6
"""Time after the object was put back in which it is gripped anew [s]."""
STEADY_S = 1.0
"""Slip control is enabled for this time before an impact, so that it has settled [s]."""
REARM_S = 2.0
"""Time after an impact at which slip control is enabled again, with an advance of zero [s]."""
WORD_PERIOD_S = 5.0
"""Host time between two words on what is waited for [s]."""


class Supervisor(BaseNode, Node):  # type: ignore[misc]
    """Keeps slip control of a simulation enabled, strikes the object and logs each result.

    For simulations only: with a real arm, a person or a cell controller enables slip control.
    """

    def __init__(self) -> None:
        super().__init__('supervisor')
        self._settings = declare(self, SupervisorParameters, self._apply)
        self._state, self._reason = SlipState.DISABLED, ''
        self._log = ImpactLog()
        self._requested_s = self._enabled_s = 0.0
        self._struck_s = -1e9
        self._started_s, self._heard, self._told = time.monotonic(), False, ''
        self._heartbeat = self.create_publisher(Empty, 'slip_control/heartbeat', QOS_SENSOR)
        self._enable = self.create_client(SetBool, 'slip_control/enable')
        self._reset = self.create_client(Trigger, 'slip_control/reset')
        self._knock = self.create_client(Trigger, 'virtual_grasp/knock')
        self._put_back = self.create_client(Trigger, 'virtual_grasp/put_back')
        self.subscribe_topic(topics.SLIP, self._on_slip)
        self.subscribe_topic(topics.TRUTH_OBJECT, self._on_place)
        self.create_timer(HEARTBEAT_PERIOD_S, self._beat)
        # Simulated time does not go on before the simulation has started.
        host = Clock(clock_type=ClockType.STEADY_TIME)
        self._tell()
        self.create_timer(WORD_PERIOD_S, self._tell, clock=host)

    def close(self) -> None:
        """Say how it went, and draw it."""
        self.get_logger().info(self._log.summary())
        if not self._settings.figure or not self._log.impacts:
            return
        try:
            draw_impacts(self._log.impacts, Path(self._settings.figure))
        except FileError as error:
            self.get_logger().error(str(error))
            return
        self.get_logger().info(f'picture of the impacts: {self._settings.figure}')

    def _apply(self, settings: SupervisorParameters) -> None:
        self._settings = settings

    def _now_s(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _tell(self) -> None:
        """Say what is waited for, once a period."""
        text = self._reason and f'slip control is not enabled yet: {self._reason}'
        if not self._heard:
            seconds = time.monotonic() - self._started_s
            text = (
                f'sensor, arm and slip control start ({seconds:.0f} s); the first time they '
                'compile, for a minute or more'
            )
        if self._heard and (self._state == SlipState.ENABLED or text == self._told):
            return
        self._told = text
        if text:
            self.get_logger().info(text)

    def _on_place(self, message: PointStamped) -> None:
        self._log.on_place(self._now_s(), -1e3 * message.point.z)

    def _on_slip(self, message: SlipState) -> None:
        if message.state != self._state and message.state == SlipState.ENABLED:
            self._enabled_s = self._now_s()
            if not self._log.impacts:
                self.get_logger().info('slip control is enabled; the first impact is near')
        self._state, self._reason, self._heard = message.state, message.reason, True
        stopped = message.reason if message.state == SlipState.STOPPED else ''
        advance_mm = 1e3 * message.total_advance
        self._log.on_slip(self._now_s(), advance_mm, stopped, slipping=message.slipping)

    def _beat(self) -> None:
        self._heartbeat.publish(Empty())
        now_s, every = self._now_s(), self._settings.knock_every
        if self._log.open is not None:
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
            elif not self._reason:
                self._enable.call_async(SetBool.Request(data=True))

    def _strike(self, now_s: float) -> None:
        """Request an impact; it counts once the simulation has confirmed it."""
        if now_s - self._requested_s < REQUEST_PERIOD_S:
            return
        self._requested_s = now_s
        self._knock.call_async(Trigger.Request()).add_done_callback(self._on_struck)

    def _on_struck(self, _response: object) -> None:
        self._struck_s = self._now_s()
        self._log.struck(self._struck_s)

    def _report(self) -> None:
        """Log the result of the last impact and start over."""
        self.get_logger().info(self._log.close())
        # Until it answers, the received state is outdated; the grasp comes back first.
        self._state, self._requested_s = SlipState.DISABLED, self._now_s() + GRIP_S
        self._reason = 'the object is put back'
        disabled = self._enable.call_async(SetBool.Request(data=False))
        # Start each impact with the same force, so that they can be compared.
        disabled.add_done_callback(lambda _: self._put_back.call_async(Trigger.Request()))


main = partial(run, Supervisor)
