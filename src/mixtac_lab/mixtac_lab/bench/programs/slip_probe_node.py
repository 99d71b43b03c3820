# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Supervises a slip control node and notes when it answers, in a process of its own.

Takes one line of JSON on stdin ({"namespace": ..., "trajectory_topic": ...}), prints `enabled` once
slip control runs, and at SIGTERM everything it noted, on the host's monotonic clock. It publishes
the heartbeat and the force of a spring that the wanted advance presses, and enables anew after
every slip, so that each starts with an advance of zero.
"""

from __future__ import annotations

import json
import signal
import sys
import time
from typing import TYPE_CHECKING

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from mixtac_msgs.msg import SlipState
from mixtac_node.base_node import QOS_FORCE, QOS_SENSOR
from mixtac_node.stamps import ns_to_stamp

if TYPE_CHECKING:
    from types import FrameType


FORCE_N = 0.7
STIFFNESS_N_PER_M = 2000.0
FORCE_PERIOD_S = 0.01
HEARTBEAT_PERIOD_S = 0.1
SUPERVISE_PERIOD_S = 0.05
RETRY_NS = 250_000_000
REARM_NS = 250_000_000
"""After a slip the controller is disabled and enabled again so much later."""


class SlipProbe(Node):  # type: ignore[misc]
    """Notes arrivals and keeps slip control enabled.

    Args:
        namespace: Of slip control.
        trajectory_topic: Where its trajectories go.
    """

    def __init__(self, namespace: str, trajectory_topic: str) -> None:
        super().__init__('slip_probe', namespace=namespace)
        self.slips_ns: list[int] = []
        self.trajectories_ns: list[int] = []
        self.windows = 0
        self.enabled = self.refused = self.stops = 0
        self.last_reason = ''
        self.enabled_spans_ns: list[tuple[int, int]] = []
        self._slipping, self._state = False, SlipState.DISABLED
        self._enabled_ns, self._advance_m = 0, 0.0
        self._rearm_ns = 0
        self._asked_ns = 0
        self.create_subscription(SlipState, 'slip', self._on_slip, QOS_FORCE)
        self.create_subscription(JointTrajectory, trajectory_topic, self._on_trajectory, 10)
        self._force = self.create_publisher(WrenchStamped, 'force', QOS_FORCE)
        self._heartbeat = self.create_publisher(Empty, 'slip_control/heartbeat', QOS_SENSOR)
        self._enable = self.create_client(SetBool, 'slip_control/enable')
        self._reset = self.create_client(Trigger, 'slip_control/reset')
        self.create_timer(FORCE_PERIOD_S, self._on_force_timer)
        self.create_timer(HEARTBEAT_PERIOD_S, lambda: self._heartbeat.publish(Empty()))
        self.create_timer(SUPERVISE_PERIOD_S, self._supervise)

    def _on_slip(self, message: SlipState) -> None:
        now_ns = time.monotonic_ns()
        self.windows += 1
        if message.state != self._state:
            self._note_state(message.state, now_ns)
        # Once disabled, the object is grasped anew with the force of before.
        enabled = message.state == SlipState.ENABLED
        self._advance_m = message.total_advance if enabled else 0.0
        if message.slipping and not self._slipping:
            self.slips_ns.append(now_ns)
            self._rearm_ns = now_ns + REARM_NS
        self._slipping = message.slipping

    def _note_state(self, state: int, now_ns: int) -> None:
        if self._state == SlipState.ENABLED:
            self.enabled_spans_ns.append((self._enabled_ns, now_ns))
        self.stops += state == SlipState.STOPPED
        self._state, self._enabled_ns = state, now_ns

    def end(self) -> None:
        """Close the span in which slip control is still enabled."""
        self._note_state(SlipState.DISABLED, time.monotonic_ns())

    def _on_trajectory(self, _message: JointTrajectory) -> None:
        self.trajectories_ns.append(time.monotonic_ns())

    def _on_force_timer(self) -> None:
        message = WrenchStamped()
        message.header.stamp = ns_to_stamp(time.time_ns())
        message.wrench.force.z = FORCE_N + STIFFNESS_N_PER_M * self._advance_m
        self._force.publish(message)

    def _supervise(self) -> None:
        """Enable what is disabled, disable what has slipped, reset what has stopped."""
        now_ns = time.monotonic_ns()
        if self._state == SlipState.STOPPED:
            self._reset.call_async(Trigger.Request())
        elif self._state == SlipState.ENABLED:
            if self._rearm_ns and now_ns >= self._rearm_ns:
                self._rearm_ns = 0
                self._enable.call_async(SetBool.Request(data=False))
        elif min(now_ns - self._asked_ns, now_ns - self._enabled_ns) > RETRY_NS:
            self._asked_ns = now_ns
            future = self._enable.call_async(SetBool.Request(data=True))
            future.add_done_callback(lambda f: self._on_enabled(f.result()))

    def _on_enabled(self, response: SetBool.Response) -> None:
        if response.success:
            self.enabled += 1
            if self.enabled == 1:
                print(json.dumps({'enabled': True}), flush=True)
        else:
            self.refused += 1
            self.last_reason = response.message


def main() -> None:
    """Note until SIGTERM, then print."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    stopping = False

    def stop(_signum: int, _frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    print(json.dumps({'ready': True}), flush=True)
    task = json.loads(sys.stdin.readline())
    probe = SlipProbe(task['namespace'], task['trajectory_topic'])
    executor = EventsExecutor()
    executor.add_node(probe)
    while not stopping:
        executor.spin_once(timeout_sec=0.1)
    probe.end()
    noted = {
        'slips_ns': probe.slips_ns,
        'trajectories_ns': probe.trajectories_ns,
        'enabled_spans_ns': probe.enabled_spans_ns,
        'windows': probe.windows,
        'enabled_times': probe.enabled,
        'stops': probe.stops,
        'refused_times': probe.refused,
        'last_reason': probe.last_reason,
    }
    print(json.dumps(noted), flush=True)
    probe.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
