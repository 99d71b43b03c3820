# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Supervises slip control on the simulated grasp: grip, heartbeat, enabling, impacts.

All times are on the node's clock, which is that of the simulation if `use_sim_time` is set.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Final

from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger

from mixtac.parameters import SupervisorParameters
from mixtac_core.node import topics
from mixtac_core.node.base_node import QOS_SENSOR, BaseNode, declare, run
from mixtac_msgs.msg import ForceQuality, SlipState

HEARTBEAT_PERIOD_S: Final = 0.1
REQUEST_PERIOD_S: Final = 0.3
"""Time between two requests to slip control or to the simulation [s]."""
GRIP_S: Final = 1.6
"""Time in which the object is gripped anew after it was put back [s]."""
STEADY_S: Final = 1.0
"""Slip control is enabled for this time before an impact, so that it has settled [s]."""
REARM_S: Final = 2.0
"""Time from an impact until its result is reported [s]."""


FALLEN_MM: Final = 5.0
"""An object that moves farther is lost [mm]: the contact of the fingertip is 12 mm wide."""


class Phase(Enum):
    """What the supervisor waits for, in this order; the value is what it logs."""

    ZERO = 'the estimator learns the picture of the untouched skin'
    GRIP = 'the object is gripped'
    ENABLE = 'slip control learns the background of the grasp and is enabled'
    HOLD = 'slip control is enabled; the object is struck soon'
    IMPACT = 'the object was struck'


@dataclass
class Impact:
    """One impact and its result.

    Attributes:
        start_mm: How far down the object was before [mm].
        moved_mm: Largest downward displacement of the object since then [mm].
        advance_mm: Largest advance of the arm that slip control asked for [mm].
        detected: Whether slip was detected.
        stopped: Why slip control stopped; empty if it did not.
    """

    start_mm: float
    moved_mm: float = 0.0
    advance_mm: float = 0.0
    detected: bool = False
    stopped: str = ''

    @property
    def held(self) -> bool:
        """Whether the object was held."""
        return self.moved_mm <= FALLEN_MM

    def __str__(self) -> str:
        """Return the result as text."""
        seen = 'detected' if self.detected else 'not detected'
        end = f'the object moved {self.moved_mm:.2f} mm and is held'
        if not self.held:
            end = f'THE OBJECT FELL (more than {FALLEN_MM:g} mm down)'
        stop = f', slip control stopped: {self.stopped}' if self.stopped else ''
        advance = f'the arm advanced {self.advance_mm:.2f} mm'
        return f'impact {seen}: {end}, {advance}{stop} (simulated)'


class Supervisor(BaseNode, Node):  # type: ignore[misc]
    """Keeps slip control of a simulation enabled, strikes the object and logs each result.

    For simulations only: with a real arm, a person or a cell controller enables slip control.
    """

    def __init__(self) -> None:
        super().__init__('supervisor')
        self._settings = declare(self, SupervisorParameters)
        self._slip = SlipState(state=SlipState.DISABLED)
        self._impacts: list[Impact] = []
        self._place_mm = 0.0
        self._since_s = self._requested_s = self._struck_s = 0.0
        self._heartbeat = self.create_publisher(Empty, 'slip_control/heartbeat', QOS_SENSOR)
        self._enable = self.create_client(SetBool, 'slip_control/enable')
        self._reset = self.create_client(Trigger, 'slip_control/reset')
        self._tare = self.create_client(Trigger, 'slip_control/tare')
        self._knock = self.create_client(Trigger, 'virtual_grasp/knock')
        self._put_back = self.create_client(Trigger, 'virtual_grasp/put_back')
        self._enter(Phase.ZERO)
        self.subscribe_topic(topics.FORCE_QUALITY, self._on_quality)
        self.subscribe_topic(topics.SLIP, self._on_slip)
        self.subscribe_topic(topics.TRUTH_OBJECT, self._on_place)
        self.create_timer(HEARTBEAT_PERIOD_S, self._beat)

    def close(self) -> None:
        """Disable slip control, and log how many impacts were held."""
        # Without a heartbeat it would stop with an error.
        self._enable.call_async(SetBool.Request(data=False))
        held = sum(each.held for each in self._impacts)
        self.get_logger().info(f'{held} of {len(self._impacts)} impacts held (simulated)')

    def _now_s(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _enter(self, phase: Phase) -> None:
        self._phase, self._since_s = phase, self._now_s()
        self.get_logger().info(phase.value)

    def _on_place(self, message: PointStamped) -> None:
        self._place_mm = -1e3 * message.point.y
        if self._phase is Phase.IMPACT:
            impact = self._impacts[-1]
            impact.moved_mm = max(impact.moved_mm, self._place_mm - impact.start_mm)

    def _on_quality(self, message: ForceQuality) -> None:
        if self._phase is Phase.ZERO and message.valid:
            self._grip()

    def _on_slip(self, message: SlipState) -> None:
        self._slip = message
        if self._phase is Phase.IMPACT:
            impact = self._impacts[-1]
            impact.advance_mm = max(impact.advance_mm, 1e3 * message.total_advance)
            impact.detected |= message.slipping
            if message.state == SlipState.STOPPED:
                impact.stopped = impact.stopped or message.reason
        if self._phase is Phase.ENABLE and message.state == SlipState.ENABLED:
            self._enter(Phase.HOLD)

    def _beat(self) -> None:
        """Publish the heartbeat, and do what the phase asks for."""
        self._heartbeat.publish(Empty())
        now_s, every_s = self._now_s(), self._settings.knock_every
        elapsed_s = now_s - self._since_s
        may_request = now_s - self._requested_s > REQUEST_PERIOD_S
        if self._phase is Phase.GRIP and elapsed_s > GRIP_S:
            self._tare.call_async(Trigger.Request())
            self._enter(Phase.ENABLE)
        elif self._phase is Phase.ENABLE and may_request:
            self._requested_s = now_s
            if self._slip.state == SlipState.STOPPED:
                self._reset.call_async(Trigger.Request())
            elif not self._slip.reason:
                self._enable.call_async(SetBool.Request(data=True))
        elif self._phase is Phase.HOLD and self._slip.state != SlipState.ENABLED:
            self._enter(Phase.ENABLE)
        elif self._phase is Phase.HOLD and may_request and elapsed_s > STEADY_S:
            if now_s - self._struck_s > every_s > 0.0:
                self._requested_s = now_s
                self._knock.call_async(Trigger.Request()).add_done_callback(self._on_struck)
        elif self._phase is Phase.IMPACT and elapsed_s > REARM_S:
            self.get_logger().info(str(self._impacts[-1]))
            # Start each impact with the same force, so that they can be compared.
            disabled = self._enable.call_async(SetBool.Request(data=False))
            self._phase, self._since_s = Phase.GRIP, now_s
            disabled.add_done_callback(lambda _: self._grip())

    def _grip(self) -> None:
        self._put_back.call_async(Trigger.Request())
        self._enter(Phase.GRIP)

    def _on_struck(self, _response: object) -> None:
        """Begin an impact once the simulation has confirmed it."""
        self._struck_s = self._now_s()
        self._impacts.append(Impact(self._place_mm))
        self._enter(Phase.IMPACT)


main = partial(run, Supervisor)
