# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Supervises slip control on the simulated grasp: grip, heartbeat, enabling, impacts.

All times are on the node's clock, which is that of the simulation if `use_sim_time` is set.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from geometry_msgs.msg import PointStamped, WrenchStamped
from rclpy.node import Node
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger

from mixtac.figures import FORCE, REFERENCE, new_axes, save_figure
from mixtac.parameters import SupervisorParameters
from mixtac_core.node import topics
from mixtac_core.node.base_node import QOS_SENSOR, BaseNode, declare, run
from mixtac_core.node.process import GraphError
from mixtac_msgs.msg import ForceQuality, SlipState

HEARTBEAT_PERIOD_S: Final = 0.1
GRIP_S: Final = 0.7
"""Time in which the object is gripped anew after it was put back [s]."""
PATIENCE_S: Final = 10.0
"""Time after which slip control that cannot be enabled is an error [s]."""
STEADY_S: Final = 0.5
"""Slip control is enabled for this time before an impact, so that it has pressed [s]."""
REARM_S: Final = 0.5
"""Time from an impact until its result is reported [s]."""
MOVED_MM: Final = 5e-3
"""An object that moved less is at rest [mm]."""
RISE_N: Final = 0.02
"""Least rise of the force by an answer [N]."""
SHOWN_MS: Final = (-50.0, 200.0)
"""Range of the figure [ms]."""
FALLEN_MM: Final = 5.0
"""An object that moves farther is lost [mm]: the contact of the fingertip is 12 mm wide."""


class Phase(Enum):
    """What the supervisor waits for, in this order; the value is what it logs."""

    ZERO = 'the estimator learns the picture of the untouched skin'
    GRIP = 'the object is gripped'
    ENABLE = 'slip control becomes ready and is enabled'
    HOLD = 'slip control is enabled; the object is struck soon'
    IMPACT = 'the object was struck'


@dataclass
class Impact:
    """One impact and its result, by stamps of the simulation.

    Attributes:
        grasp_n: True normal force before the press [N].
        places: Times and places of the object, downwards, from before the impact on [s, mm].
        forces: Times and true normal forces, from before the impact on [s, N].
        detected: Whether slip was detected.
        stopped: Why slip control stopped; empty if it did not.
    """

    grasp_n: float
    places: list[tuple[float, float]]
    forces: list[tuple[float, float]] = field(default_factory=list)
    detected: bool = False
    stopped: str = ''

    @property
    def held(self) -> bool:
        """Whether the object was held."""
        return max(mm for _, mm in self.places) <= self.places[0][1] + FALLEN_MM

    @property
    def start_s(self) -> float:
        """Time of the last sample before the object moved [s]."""
        t, mm = np.transpose(self.places)
        return float(t[max(np.argmax(mm > mm[0] + MOVED_MM) - 1, 0)])

    def __str__(self) -> str:
        """Return the result as text."""
        t, mm = np.transpose(self.places)
        force_t, force = np.transpose([*self.forces, (np.inf, np.inf)])
        before = force[np.searchsorted(force_t, self.start_s)] + RISE_N
        rises = force_t[(force_t > self.start_s) & (force > before)]
        rise_s = np.min(rises, initial=np.inf) - self.start_s
        rest_s = t[np.argmax(mm > mm.max() - MOVED_MM)] - self.start_s
        how = ', before the force rose: held by the force at the impact'
        if rise_s < rest_s:
            how = f'; the force rose from {1e3 * rise_s:.0f} ms on: held by the answer'
        end = f'the object moved {mm.max() - mm[0]:.2f} mm, at rest after {1e3 * rest_s:.0f} ms'
        end = end + how if self.held else f'THE OBJECT FELL (more than {FALLEN_MM:g} mm down)'
        seen = 'detected' if self.detected else 'not detected'
        stop = f', slip control stopped: {self.stopped}' if self.stopped else ''
        return f'impact {seen}: {end}{stop} (simulated)'

    def draw(self, path: Path) -> None:
        """Draw force, margin and place of the object around the impact."""
        figure, (top, bottom) = new_axes(1, 2, height=5.0)
        for axis, course, colour in ((top, self.forces, FORCE), (bottom, self.places, REFERENCE)):
            t, y = np.transpose(course)
            axis.plot(1e3 * (t - self.start_s), y, color=colour)
            axis.set_xlim(*SHOWN_MS)
        ratio = top.twinx()
        ratio.set_ylim(*(n / self.grasp_n for n in top.get_ylim()))
        ratio.set_ylabel('over the force of the grasp')
        top.set_title(str(self), fontsize=8)
        top.set_ylabel('true normal force [N]')
        bottom.set(xlabel='time from the first motion [ms]', ylabel='object, downwards [mm]')
        save_figure(figure, path)


class Supervisor(BaseNode, Node):  # type: ignore[misc]
    """Keeps slip control of a simulation enabled, strikes the object and logs each result.

    For simulations only: with a real arm, a person or a cell controller enables slip control.
    """

    def __init__(self) -> None:
        super().__init__('supervisor')
        self._settings = declare(self, SupervisorParameters)
        self._slip = SlipState(state=SlipState.DISABLED)
        self._impact: Impact
        self._held: list[bool] = []
        self._forces: deque[tuple[float, float]] = deque(maxlen=1000)
        self._place = (0.0, 0.0)
        self._grasp_n = math.nan
        self._since_s = self._struck_s = 0.0
        self._heartbeat = self.create_publisher(Empty, 'slip_control/heartbeat', QOS_SENSOR)
        self._enable = self.create_client(SetBool, 'slip_control/enable')
        self._reset = self.create_client(Trigger, 'slip_control/reset')
        self._knock = self.create_client(Trigger, 'virtual_grasp/knock')
        self._put_back = self.create_client(Trigger, 'virtual_grasp/put_back')
        self._enter(Phase.ZERO)
        self.subscribe_topic(topics.FORCE_QUALITY, self._on_quality)
        self.subscribe_topic(topics.SLIP, self._on_slip)
        self.subscribe_topic(topics.TRUTH_OBJECT, self._on_place)
        self.subscribe_topic(topics.TRUTH_WRENCH, self._on_force)
        self.create_timer(HEARTBEAT_PERIOD_S, self._beat)

    def check(self) -> None:
        """Check that slip control can be enabled.

        Raises:
            GraphError: It cannot; the message names the reason.
        """
        if self._phase is Phase.ENABLE and self._now_s() - self._since_s > PATIENCE_S:
            raise GraphError(f'slip control stays off: {self._slip.reason}', remedy='start again')

    def close(self) -> None:
        """Disable slip control, and log how many impacts were held."""
        # Without a heartbeat it would stop with an error.
        self._enable.call_async(SetBool.Request(data=False))
        held = sum(self._held)
        self.get_logger().info(f'{held} of {len(self._held)} impacts held (simulated)')

    def _now_s(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _enter(self, phase: Phase) -> None:
        self._phase, self._since_s = phase, self._now_s()
        self.get_logger().info(phase.value)

    def _on_place(self, message: PointStamped) -> None:
        self._place = 1e-9 * topics.stamp_to_ns(message.header.stamp), -1e3 * message.point.y
        if self._phase is Phase.IMPACT:
            self._impact.places.append(self._place)

    def _on_force(self, message: WrenchStamped) -> None:
        stamp_s = 1e-9 * topics.stamp_to_ns(message.header.stamp)
        self._forces.append((stamp_s, topics.normal_force(message)))

    def _on_quality(self, message: ForceQuality) -> None:
        if self._phase is Phase.ZERO and message.valid:
            self._grip()

    def _on_slip(self, message: SlipState) -> None:
        self._slip = message
        if self._phase is Phase.IMPACT:
            self._impact.detected |= message.slipping
            self._impact.stopped = self._impact.stopped or message.reason
        if self._phase is Phase.ENABLE and message.state == SlipState.ENABLED:
            self._grasp_n = self._forces[-1][1] if self._forces else math.nan
            self._enter(Phase.HOLD)

    def _beat(self) -> None:
        """Publish the heartbeat, and do what the phase asks for."""
        self._heartbeat.publish(Empty())
        now_s, every_s = self._now_s(), self._settings.knock_every
        elapsed_s = now_s - self._since_s
        if self._phase is Phase.GRIP and elapsed_s > GRIP_S:
            self._enter(Phase.ENABLE)
        elif self._phase is Phase.ENABLE:
            if self._slip.state == SlipState.STOPPED:
                self._reset.call_async(Trigger.Request())
            elif not self._slip.reason:
                self._enable.call_async(SetBool.Request(data=True))
        elif self._phase is Phase.HOLD and self._slip.state != SlipState.ENABLED:
            self._enter(Phase.ENABLE)
        elif self._phase is Phase.HOLD and elapsed_s > STEADY_S:
            if now_s - self._struck_s > every_s > 0.0:
                self._struck_s = now_s
                self._impact = Impact(self._grasp_n, [self._place])
                self._knock.call_async(Trigger.Request())
                self._enter(Phase.IMPACT)
        elif self._phase is Phase.IMPACT and elapsed_s > REARM_S:
            self._phase, self._since_s = Phase.GRIP, now_s
            self._end_impact()

    def _end_impact(self) -> None:
        """Log the result of an impact, and have the object gripped anew."""
        impact = self._impact
        impact.forces = list(self._forces)
        self._held.append(impact.held)
        self.get_logger().info(str(impact))
        # Start each impact with the same force, so that they can be compared.
        disabled = self._enable.call_async(SetBool.Request(data=False))
        disabled.add_done_callback(lambda _: self._grip())
        if self._settings.figure:
            impact.draw(Path(self._settings.figure))

    def _grip(self) -> None:
        self._put_back.call_async(Trigger.Request())
        self._enter(Phase.GRIP)


main = partial(run, Supervisor)
