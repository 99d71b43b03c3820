# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishes the running error of the estimated force against the reference."""

from __future__ import annotations

import sys

from rclpy.node import Node
from std_msgs.msg import Float64

from mixtac_alignment.force_error import ForceErrorParameters, ForcePairing
from mixtac_node import topics
from mixtac_node.base_node import BaseNode, declare, run
from mixtac_node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_node.stamps import stamp_to_ns


class ForceErrorNode(BaseNode, Node):  # type: ignore[misc]
    """Running mean absolute and root mean square error, as topics and diagnostics."""

    def __init__(self) -> None:
        super().__init__('force_error')
        p = declare(self, ForceErrorParameters)
        self._sign = p.sign or 1
        self._pairing = ForcePairing(p.window)
        self.subscribe_topic(topics.FORCE, self._on_force, name=p.force_topic)
        self.subscribe_topic(topics.ALIGNMENT_REFERENCE, self._on_reference, name=p.reference_topic)
        self._mae = self.publish_topic(topics.FORCE_ERROR_MAE, name='~/mae')
        self._rmse = self.publish_topic(topics.FORCE_ERROR_RMSE, name='~/rmse')
        self.create_timer(0.1, self._publish)
        self._diagnostics = DiagnosticsPublisher(self, 'force error', self._status)

    def _on_force(self, message: topics.ForceMessage) -> None:
        self._pairing.push_estimate(stamp_to_ns(message.header.stamp), topics.normal_force(message))

    def _on_reference(self, message: topics.ForceMessage) -> None:
        force = self._sign * topics.normal_force(message)
        self._pairing.push_reference(stamp_to_ns(message.header.stamp), force)

    def _publish(self) -> None:
        if self._pairing.pairs:
            self._mae.publish(Float64(data=self._pairing.mae))
            self._rmse.publish(Float64(data=self._pairing.rmse))

    def _status(self) -> Status:
        pairing = self._pairing
        values: dict[str, object] = {
            'pairs': pairing.pairs,
            'unpaired estimates': pairing.unpaired,
            'mae [N]': pairing.mae,
            'rmse [N]': pairing.rmse,
        }
        if not pairing.pairs:
            return Status(WARN, 'no pairs: fit the clocks first (alignment/fit)', values)
        return Status(OK, f'MAE {pairing.mae:.3f} N, RMSE {pairing.rmse:.3f} N', values)


def main(args: list[str] | None = None) -> int:
    """Run the force error node."""
    return run(ForceErrorNode, args)


if __name__ == '__main__':
    sys.exit(main())
