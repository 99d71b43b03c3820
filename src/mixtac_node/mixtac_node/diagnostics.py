# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishing `/diagnostics` once a second, as diagnostic_updater would."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

if TYPE_CHECKING:
    from collections.abc import Callable

OK, WARN, ERROR, STALE = range(4)


@dataclass(frozen=True, slots=True)
class Status:
    """What a node says of itself.

    Attributes:
        level: OK, WARN, ERROR or STALE.
        message: One line for people.
        values: Figures by name; floats are written with six significant digits.
    """

    level: int
    message: str
    values: dict[str, object] = field(default_factory=dict)


class DiagnosticsPublisher:
    """Publishes one DiagnosticStatus a second on the absolute topic `/diagnostics` (REP-107).

    Args:
        node: An rclpy node.
        hardware_id: Serial number or name of the device behind the node.
        source: Called once a second for the current status; runs in the node's executor.
        period_s: Publishing period.
    """

    def __init__(
        self,
        node: Any,  # noqa: ANN401
        hardware_id: str,
        source: Callable[[], Status],
        period_s: float = 1.0,
    ) -> None:
        self.hardware_id = hardware_id
        self._node = node
        self._source = source
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._timer = node.create_timer(period_s, self.publish)

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
