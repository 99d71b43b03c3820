# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishing `/diagnostics` once a second, and the rates and ages that go into it.

It replaces diagnostic_updater, which has no Python interface for lifecycle nodes.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from mixtac_core.node.process import compiling


class RateMeter:
    """Events per second over the interval between two reads.

    Attributes:
        total: Everything counted so far.
    """

    def __init__(self) -> None:
        self.total = 0
        self._last_total = 0
        self._last_s: float | None = None

    def add(self, count: int = 1) -> None:
        """Add to the count."""
        self.total += count

    def read(self, now_s: float) -> float:
        """Return the rate [1/s] since the previous read; 0 at the first one.

        Args:
            now_s: Any monotonic time [s].
        """
        last_s, self._last_s = self._last_s, now_s
        count, self._last_total = self.total - self._last_total, self.total
        if last_s is None or now_s <= last_s:
            return 0.0
        return count / (now_s - last_s)


class RecentValues:
    """A ring of the latest values (ages, durations) with their quantiles.

    Args:
        size: Number of values kept.
    """

    def __init__(self, size: int = 1024) -> None:
        self._ring = np.zeros(size)
        self._count = 0

    def add(self, value: float) -> None:
        """Append a value, dropping the oldest."""
        self._ring[self._count % len(self._ring)] = value
        self._count += 1

    def __len__(self) -> int:
        """Return the number of values held."""
        return min(self._count, len(self._ring))

    def quantile(self, q: float) -> float:
        """Return a quantile of the values held, NaN when there are none."""
        held = len(self)
        return float(np.quantile(self._ring[:held], q)) if held else float('nan')


# Levels of `diagnostic_msgs/DiagnosticStatus`.
OK = 0
WARN = 1
ERROR = 2


@dataclass(frozen=True, slots=True)
class Status:
    """Status that a node reports.

    Attributes:
        level: OK, WARN or ERROR.
        message: One line for users.
        values: Values by name; floats are written with six significant digits.
    """

    level: int
    message: str
    values: dict[str, object] = field(default_factory=dict)


PERIOD_S = 1.0
"""Time between two messages [s]."""


class DiagnosticsPublisher:
    """Publishes one DiagnosticStatus a second on the absolute topic `/diagnostics` (REP-107).

    Args:
        node: An rclpy node.
        hardware_id: Serial number or name of the device behind the node.
        source: Called once a second for the current status; runs in the node's executor.
    """

    def __init__(
        self,
        node: Any,  # noqa: ANN401
        hardware_id: str,
        source: Callable[[], Status],
    ) -> None:
        self.hardware_id = hardware_id
        self._node = node
        self._source = source
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._timer = node.create_timer(PERIOD_S, self.publish)

    @contextlib.contextmanager
    def compiling(self, kernels: str) -> Iterator[None]:
        """Load kernels, or compile them and say so in the log and, once a second, as the status.

        Args:
            kernels: Their name; see `mixtac_core.node.process.compiling`.
        """
        done = threading.Event()
        status = Status(OK, f'compiling {kernels}: once on a machine, up to a minute')

        def say() -> None:
            self._node.get_logger().info(status.message)
            # The executor waits for what is compiled.
            threading.Thread(target=report, name='compiling', daemon=True).start()

        def report() -> None:
            while not done.is_set():
                self._publish(status)
                done.wait(PERIOD_S)

        try:
            with compiling(kernels, say):
                yield
        finally:
            done.set()

    def publish(self) -> None:
        """Publish the current status now."""
        self._publish(self._source())

    def _publish(self, status: Status) -> None:
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=bytes([status.level]),
                name=self._node.get_fully_qualified_name().lstrip('/'),
                message=status.message,
                hardware_id=self.hardware_id,
                values=[KeyValue(key=k, value=_text(v)) for k, v in status.values.items()],
            )
        ]
        self._publisher.publish(message)


def _text(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)
