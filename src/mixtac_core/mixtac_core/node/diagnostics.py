# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishing `/diagnostics` once a second, and the rates and ages that go into it.

It replaces diagnostic_updater, which has no Python interface for lifecycle nodes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
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
    """The latest values (ages, durations) with their quantiles.

    Args:
        size: Number of values kept.
    """

    def __init__(self, size: int = 1024) -> None:
        self._kept: deque[float] = deque(maxlen=size)

    def add(self, value: float) -> None:
        """Append a value, dropping the oldest."""
        self._kept.append(value)

    def quantile(self, q: float) -> float:
        """Return a quantile of the values kept, NaN when there are none."""
        return float(np.quantile(tuple(self._kept), q)) if self._kept else float('nan')


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

    def compiling(self, kernels: str) -> AbstractContextManager[None]:
        """Return the context `mixtac_core.node.process.compiling`; the log reports a compilation.

        Args:
            kernels: Their name.
        """
        text = f'compiling {kernels}: once on a machine, up to a minute'
        return compiling(kernels, lambda: self._node.get_logger().info(text))

    def publish(self) -> None:
        """Publish the current status now."""
        status = self._source()
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
