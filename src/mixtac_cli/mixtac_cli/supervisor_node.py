# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Supervises slip control on the simulated grasp: closing it, heartbeat, enabling, impacts.

Where an estimator tells the force, the grasp closes once its zero is known, and while a hand still
holds the object the known force of the grasp calibrates the estimator.

All times are on the node's clock, which is that of the simulation if `use_sim_time` is set.
"""

from __future__ import annotations

import math
import time
from functools import partial
from pathlib import Path

from geometry_msgs.msg import PointStamped
from rcl_interfaces.srv import SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger

from mixtac_cli.impacts import ImpactLog, draw_impacts
from mixtac_cli.parameters import SupervisorParameters
from mixtac_msgs.msg import ForceQuality, SlipState
from mixtac_node import topics
from mixtac_node.base_node import QOS_SENSOR, BaseNode, declare, run
from mixtac_node.files import FileError

HEARTBEAT_PERIOD_S = 0.1
REQUEST_PERIOD_S = 0.3
GRIP_S = 1.6
"""Time after the object was put back in which it is gripped anew [s]."""
PRESSED_S = 0.5
"""Time after closing from which on the force of the grasp is steady [s]."""
LEAST_FORCES = 200
"""Forces by which the estimator is calibrated: 0.4 s."""
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
        self._ready, self._zero_known = not self._settings.grip, False
        self._closed_s = math.inf
        self._known = (0.0, 0.0)
        self._known_sum = self._told_sum = (0.0, 0.0)
        self._forces = 0
        self._struck_s = -1e9
        self._started_s, self._heard, self._told = time.monotonic(), False, ''
        self._heartbeat = self.create_publisher(Empty, 'slip_control/heartbeat', QOS_SENSOR)
        self._enable = self.create_client(SetBool, 'slip_control/enable')
        self._reset = self.create_client(Trigger, 'slip_control/reset')
        self._knock = self.create_client(Trigger, 'virtual_grasp/knock')
        self._put_back = self.create_client(Trigger, 'virtual_grasp/put_back')
        self.subscribe_topic(topics.SLIP, self._on_slip)
        self.subscribe_topic(topics.TRUTH_OBJECT, self._on_place)
        if self._settings.grip:
            self._calibrate = self.create_client(SetParameters, 'fger/set_parameters')
            self._tare = self.create_client(Trigger, 'slip_control/tare')
            self._weighing = [
                self.subscribe_topic(topics.FORCE_QUALITY, self._on_quality),
                self.subscribe_topic(topics.FORCE, self._on_force),
                self.subscribe_topic(topics.TRUTH_WRENCH, self._on_truth),
            ]
        self.create_timer(HEARTBEAT_PERIOD_S, self._beat)
        # Simulated time does not go on before the simulation has started.
        host = Clock(clock_type=ClockType.STEADY_TIME)
        self._tell()
        self.create_timer(WORD_PERIOD_S, self._tell, clock=host)

    def close(self) -> None:
        """Disable slip control, say how it went, and draw it."""
        # Without a heartbeat it would stop with an error while the picture is drawn.
        self._enable.call_async(SetBool.Request(data=False))
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
        elif not self._ready and not self._zero_known:
            text = 'the estimator learns the picture of the untouched skin'
        if self._heard and (self._state == SlipState.ENABLED or text == self._told):
            return
        self._told = text
        if text:
            self.get_logger().info(text)

    def _on_place(self, message: PointStamped) -> None:
        self._log.on_place(self._now_s(), -1e3 * message.point.y)

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
        if not self._ready:
            self._grip(now_s)
        elif self._log.open is not None:
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

    def _on_quality(self, message: ForceQuality) -> None:
        self._zero_known |= message.valid

    def _on_truth(self, message: topics.ForceMessage) -> None:
        force = message.wrench.force
        self._known = force.z, math.hypot(force.x, force.y)

    def _on_force(self, message: topics.ForceMessage) -> None:
        """Add up forces while a hand holds the object; only trusted ones are published."""
        if self._ready or self._now_s() < self._closed_s + PRESSED_S:
            return
        force = message.wrench.force
        told = force.z, math.hypot(force.x, force.y)
        self._known_sum = self._known_sum[0] + self._known[0], self._known_sum[1] + self._known[1]
        self._told_sum = self._told_sum[0] + told[0], self._told_sum[1] + told[1]
        self._forces += 1

    def _grip(self, now_s: float) -> None:
        """Close the grasp, calibrate the estimator, and let slip control learn the new rest."""
        if self._forces >= LEAST_FORCES and min(self._told_sum) > 0.0:
            self._ready, self._requested_s = True, now_s
            normal, across = (k / t for k, t in zip(self._known_sum, self._told_sum, strict=True))
            gains = {'force_scale': normal, 'sideways_scale': across / normal}
            self._calibrate.call_async(
                SetParameters.Request(
                    parameters=[
                        Parameter(name, value=value).to_parameter_msg()
                        for name, value in gains.items()
                    ]
                )
            ).add_done_callback(self._on_calibrated)
            self._tare.call_async(Trigger.Request())
            for each in self._weighing:
                self.destroy_subscription(each)
            self._reason = 'it learns the background of the grasp'
            said = f'the grasp has closed; true over estimated force: {normal:.2f}'
            self.get_logger().info(f'{said}, sideways {across:.2f} (simulated)')
        elif self._zero_known and now_s - self._requested_s > max(REQUEST_PERIOD_S, GRIP_S):
            self._requested_s = now_s
            self._put_back.call_async(Trigger.Request()).add_done_callback(self._on_closing)

    def _on_closing(self, _response: object) -> None:
        self._closed_s = self._now_s()
        self._known_sum = self._told_sum = (0.0, 0.0)
        self._forces = 0

    def _on_calibrated(self, future: Future) -> None:
        for result in future.result().results:
            if not result.successful:
                self.get_logger().error(f'not calibrated: {result.reason}')

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
