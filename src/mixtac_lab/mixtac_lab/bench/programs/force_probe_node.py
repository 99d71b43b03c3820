# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A subscriber that says how old the force is when it arrives.

Where a pattern is sent, it first listens to the events for a while, which tell the error of the
driver's belief about when the camera's clock was zero; then only to the force. Run as a process;
JSON on stdin and stdout.
"""

from __future__ import annotations

import json
import signal
import sys
import time
from typing import TYPE_CHECKING

import numpy as np
import rclpy
from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.srv import ChangeState
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from mixtac_events.codec import decode_message, warm_up
from mixtac_lab.bench.harness import Arrivals
from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE
from mixtac_node.lifecycle_node import LifecycleClient
from mixtac_node.stamps import stamp_to_ns

if TYPE_CHECKING:
    from types import FrameType

    from numpy.typing import NDArray


MOST = 1_000_000
CLOCK_S = 2.0
WINDOW_NS = 2_000_000
STARTING_S = 100.0


class ForceProbe(Node):  # type: ignore[misc]
    """Keeps arrival and stamp of every force.

    Args:
        namespace: Namespace of the sensor.
    """

    def __init__(self, namespace: str) -> None:
        super().__init__('force_probe', namespace=namespace)
        self._arrivals: Arrivals | None = None
        self._times = np.zeros((MOST, 2), np.int64)
        self.count = 0

    def listen_to_events(self, arrivals: Arrivals, executor: EventsExecutor) -> None:
        """Follow the events for some time."""
        self._arrivals = arrivals
        subscription = self.create_subscription(EventPacket, 'events', self._on_packet, QOS_EVENTS)
        spin(executor, CLOCK_S)
        self.destroy_subscription(subscription)

    def listen_to_force(self) -> None:
        """Begin to keep forces."""
        self.create_subscription(WrenchStamped, 'force', self._on_force, QOS_FORCE)

    def times(self) -> NDArray[np.int64]:
        """Return arrival [ns, host] and stamp [ns, camera clock] of each force, shape (N, 2)."""
        return self._times[: self.count]

    def _on_packet(self, message: EventPacket) -> None:
        assert self._arrivals is not None  # noqa: S101  (set before subscribing)
        self._arrivals.add(message.seq, decode_message(message).events, time.time_ns())

    def _on_force(self, message: WrenchStamped) -> None:
        arrival_ns = time.time_ns()
        if self.count < MOST:
            self._times[self.count] = arrival_ns, stamp_to_ns(message.header.stamp)
            self.count += 1


def spin(executor: EventsExecutor, seconds: float) -> None:
    """Run callbacks for some time."""
    end_s = time.monotonic() + seconds
    while (left_s := end_s - time.monotonic()) > 0:
        executor.spin_once(timeout_sec=min(left_s, 0.1))


def force_figures(times: NDArray[np.int64], clock_error_us: int) -> dict[str, float]:
    """Return ages [ms], rate [Hz] and losses of forces.

    Args:
        times: Arrival and stamp [ns], shape (N, 2), N > 1.
        clock_error_us: What the stamps are too late by [us].
    """
    ages_ms = (times[:, 0] - times[:, 1]) / 1e6 + clock_error_us / 1e3
    steps = np.diff(times[:, 1]) // WINDOW_NS
    p50, p99, p999 = np.quantile(ages_ms, (0.5, 0.99, 0.999)).tolist()
    span_s = float(times[-1, 0] - times[0, 0]) / 1e9
    return {
        'force_age_p50_ms': p50,
        'force_age_p99_ms': p99,
        'force_age_p999_ms': p999,
        'force_age_max_ms': float(ages_ms.max()),
        'forces': len(times),
        'force_rate_hz': (len(times) - 1) / span_s,
        'windows_missing': int(np.maximum(steps - 1, 0).sum()),
    }


def main() -> None:
    """Bring the estimator up, measure until SIGTERM, print the figures."""
    warm_up()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    stopping = False

    def stop(_signum: int, _frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    print(json.dumps({'ready': True}), flush=True)
    task = json.loads(sys.stdin.readline())
    probe = ForceProbe(task['namespace'])
    target = f'/{task["namespace"]}/fger'
    # On a loaded machine starting takes longer than a user would wait.
    probe.create_client(ChangeState, f'{target}/change_state').wait_for_service(STARTING_S)
    LifecycleClient(probe, target, lambda: None).bring_up()
    executor = EventsExecutor()
    executor.add_node(probe)
    # The camera restarts its clock when the driver starts; by now the origin it said last counts.
    print(json.dumps({'active': True}), flush=True)
    pattern = json.loads(sys.stdin.readline())['pattern']
    arrivals = Arrivals(**pattern) if pattern else None
    if arrivals is not None:
        probe.listen_to_events(arrivals, executor)
    probe.listen_to_force()
    spin(executor, task['settle_s'])
    probe.count = 0
    print(json.dumps({'measuring': True}), flush=True)
    while not stopping:
        executor.spin_once(timeout_sec=0.1)
    error_us = int(arrivals.summary()['origin_error_us']) if arrivals is not None else 0
    figures = {} if probe.count < 2 else force_figures(probe.times(), error_us)
    print(json.dumps({'forces': 0, **figures}), flush=True)
    probe.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
