# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Subscribers of benchmarks, each run in a process of its own.

The process prints `ready`, takes a JSON object on standard input that names the probe and its
arguments, and prints the figures at SIGTERM. It offers no ROS interface that could disturb the
measurement.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np
import rclpy
from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.srv import ChangeState
from numpy.typing import NDArray
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from mixtac_events.codec import decode_message, warm_up
from mixtac_lab.bench.harness import Arrivals, quantiles, send, stop_event
from mixtac_msgs.msg import SlipState
from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE, QOS_SENSOR
from mixtac_node.lifecycle_node import LifecycleClient
from mixtac_node.process import freeze_loaded
from mixtac_node.stamps import ns_to_stamp, stamp_to_ns

MAX_FORCES = 1_000_000
CLOCK_S = 2.0
"""Time for which the events are received to measure the clock error [s]."""
WINDOW_NS = 2_000_000
STARTING_S = 100.0
"""Time to wait for the estimator [s]; on a loaded machine a start takes long."""
FORCE_N = 0.7
STIFFNESS_N_PER_M = 2000.0
FORCE_PERIOD_S = 0.01
HEARTBEAT_PERIOD_S = 0.1
SUPERVISE_PERIOD_S = 0.05
RETRY_NS = 250_000_000
REARM_NS = 250_000_000
"""Time after a slip at which slip control is disabled and enabled again [ns]."""


class Probe(Node):  # type: ignore[misc]
    """A subscriber that returns figures."""

    def __init__(self, name: str, namespace: str) -> None:
        super().__init__(name, namespace=namespace)
        self._events_executor: EventsExecutor | None = None

    def spin(self, seconds: float) -> None:
        """Run callbacks for some time [s]."""
        # Not before: `LifecycleClient` spins the node in an executor of its own and removes it.
        if self._events_executor is None:
            self._events_executor = EventsExecutor()
            self._events_executor.add_node(self)
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            self._events_executor.spin_once(timeout_sec=min(left_s, 0.1))

    def destroy_node(self) -> None:
        """Destroy the node."""
        # What an executor knows is not destroyed: messages would go on coming.
        if self._events_executor is not None:
            self._events_executor.remove_node(self)
            self._events_executor.shutdown()
        super().destroy_node()

    def prepare(self) -> None:
        """Do what comes before the measurement."""

    def figures(self) -> dict[str, Any]:
        """Return the figures of the measurement."""
        raise NotImplementedError


class EventProbe(Probe):
    """Measures the age of events of a pattern; reports `measuring` at the first packet.

    Args:
        namespace: Namespace of the sensor.
        pattern: Arguments of `Arrivals`.
    """

    def __init__(self, namespace: str, pattern: dict[str, int]) -> None:
        super().__init__('event_probe', namespace)
        self.arrivals = Arrivals(**pattern)
        self.subscription = self.create_subscription(
            EventPacket, 'events', self._on_packet, QOS_EVENTS
        )

    def _on_packet(self, message: EventPacket) -> None:
        arrival_ns = time.time_ns()
        self.arrivals.add(message.seq, decode_message(message).events, arrival_ns)

    def prepare(self) -> None:
        """Wait for the first packet."""
        while not self.arrivals.packets:
            self.spin(0.1)
        send(measuring=True)

    def figures(self) -> dict[str, Any]:
        """Return the summary of the arrivals."""
        return self.arrivals.summary()


class ForceProbe(Probe):
    """Measures the age of forces; brings the estimator up first.

    It reports `active` when the estimator runs, and then reads another JSON object with `pattern`,
    the arguments of `Arrivals` or null. With a pattern it receives the events for a while to
    measure the error of the driver's clock. It reports `measuring` when the measurement starts.

    Args:
        namespace: Namespace of the sensor.
        settle_s: Time between the subscription to the forces and the measurement [s].
    """

    def __init__(self, namespace: str, settle_s: float) -> None:
        super().__init__('force_probe', namespace)
        self._settle_s = settle_s
        self._times = np.zeros((MAX_FORCES, 2), np.int64)
        self._count = self._clock_error_us = 0

    def prepare(self) -> None:
        """Bring the estimator up, and start the measurement."""
        target = f'{self.get_namespace()}/fger'
        self.create_client(ChangeState, f'{target}/change_state').wait_for_service(STARTING_S)
        LifecycleClient(self, target, lambda: None).bring_up()
        # The camera restarts its clock when the driver starts; its origin is final by now.
        send(active=True)
        pattern = json.loads(sys.stdin.readline())['pattern']
        if pattern:
            events = EventProbe(self.get_namespace(), pattern)
            events.spin(CLOCK_S)
            self._clock_error_us = int(events.figures()['origin_error_us'])
            events.destroy_node()
        self.create_subscription(WrenchStamped, 'force', self._on_force, QOS_FORCE)
        self.spin(self._settle_s)
        self._count = 0
        send(measuring=True)

    def _on_force(self, message: WrenchStamped) -> None:
        arrival_ns = time.time_ns()
        if self._count < MAX_FORCES:
            self._times[self._count] = arrival_ns, stamp_to_ns(message.header.stamp)
            self._count += 1

    def figures(self) -> dict[str, Any]:
        """Return the figures of the forces; only `forces` (zero) without any."""
        if self._count < 2:
            return {'forces': 0}
        return force_figures(self._times[: self._count], self._clock_error_us)


def force_figures(times: NDArray[np.int64], clock_error_us: int) -> dict[str, float]:
    """Return ages [ms], rate [Hz] and losses of forces.

    Args:
        times: Arrival and stamp [ns], shape (N, 2), N > 1.
        clock_error_us: Time by which the stamps are too late [us].
    """
    ages_ms = (times[:, 0] - times[:, 1]) / 1e6 + clock_error_us / 1e3
    steps = np.diff(times[:, 1]) // WINDOW_NS
    ages = quantiles(ages_ms, (0.5, 0.99, 0.999, 1.0))
    span_s = float(times[-1, 0] - times[0, 0]) / 1e9
    return {
        **{f'force_age_{name}_ms': age for name, age in ages.items()},
        'forces': len(times),
        'force_rate_hz': (len(times) - 1) / span_s,
        'windows_missing': int(np.maximum(steps - 1, 0).sum()),
    }


class SlipProbe(Probe):
    """Records when slip control answers, and supervises it.

    It publishes the heartbeat and the force of a spring that the commanded advance compresses, and
    enables slip control again after every slip, so that each slip starts with an advance of zero.
    It reports `enabled` when slip control is first enabled. Times are on the monotonic clock.

    Args:
        namespace: Namespace of slip control.
        trajectory_topic: Topic of its trajectories.
    """

    def __init__(self, namespace: str, trajectory_topic: str) -> None:
        super().__init__('slip_probe', namespace)
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
        # Once disabled, the object is grasped again with the initial force.
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

    def figures(self) -> dict[str, Any]:
        """Return everything recorded; closes the span in which slip control is still enabled."""
        self._note_state(SlipState.DISABLED, time.monotonic_ns())
        return {
            'slips_ns': self.slips_ns,
            'trajectories_ns': self.trajectories_ns,
            'enabled_spans_ns': self.enabled_spans_ns,
            'windows': self.windows,
            'enabled_times': self.enabled,
            'stops': self.stops,
            'refused_times': self.refused,
            'last_reason': self.last_reason,
        }

    def _on_trajectory(self, _message: JointTrajectory) -> None:
        self.trajectories_ns.append(time.monotonic_ns())

    def _on_force_timer(self) -> None:
        message = WrenchStamped()
        message.header.stamp = ns_to_stamp(time.time_ns())
        message.wrench.force.z = FORCE_N + STIFFNESS_N_PER_M * self._advance_m
        self._force.publish(message)

    def _supervise(self) -> None:
        """Enable slip control if it is disabled, disable it after a slip, reset it after a stop."""
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
                send(enabled=True)
        else:
            self.refused += 1
            self.last_reason = response.message


PROBES = {'events': EventProbe, 'force': ForceProbe, 'slip': SlipProbe}


def main() -> None:
    """Measure until SIGTERM, then print the figures."""
    warm_up()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    stopping = stop_event()
    send(ready=True)
    task = json.loads(sys.stdin.readline())
    probe = PROBES[task.pop('probe')](**task)
    freeze_loaded()  # takes some 60 ms, so not within the measurement
    probe.prepare()
    while not stopping.is_set():
        probe.spin(0.1)
    send(**probe.figures())
    probe.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
