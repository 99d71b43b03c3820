# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fits the clock map on request, from what the topics have shown lately."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from std_srvs.srv import Trigger

from mixtac_alignment.alignment_parameters import AlignmentParameters
from mixtac_alignment.fit_message import to_fields
from mixtac_alignment.force_history import ForceHistory
from mixtac_alignment.rate_history import EventRateHistory
from mixtac_alignment.two_impulse import fit_counts
from mixtac_events.codec import decode_message, warm_up
from mixtac_events.errors import CodecError, MixtacError
from mixtac_msgs.msg import ClockFit as ClockFitMessage
from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE, QOS_LATCHED, declare, run, stamp_to_ns
from mixtac_node.diagnostics import OK, WARN, DiagnosticsPublisher, Status

if TYPE_CHECKING:
    from mixtac_alignment.clock_fit import ClockFit


class AlignmentNode(Node):  # type: ignore[misc]
    """Counts events, remembers the reference force, and fits both clocks when `~/fit` is called."""

    def __init__(self) -> None:
        super().__init__('alignment', namespace='mixtac')
        self._settings = declare(self, AlignmentParameters, self._apply)
        p = self._settings
        self._rate = EventRateHistory(p.history)
        self._force = ForceHistory(p.history, round(p.history * p.reference_rate))
        self._fit: ClockFit | None = None
        self._sequence: int | None = None
        self._packets = self._lost = self._undecodable = 0
        warm_up()
        self.create_subscription(EventPacket, 'events', self._on_events, QOS_EVENTS)
        self.create_subscription(WrenchStamped, p.reference_topic, self._on_force, QOS_FORCE)
        self._publisher = self.create_publisher(ClockFitMessage, 'clock_fit', QOS_LATCHED)
        self.create_service(Trigger, '~/fit', self._on_fit)
        self._diagnostics = DiagnosticsPublisher(self, 'alignment', self._status)

    def _apply(self, parameters: AlignmentParameters) -> None:
        self._settings = parameters

    def _on_events(self, message: EventPacket) -> None:
        try:
            packet = decode_message(message)
        except CodecError as error:
            self._undecodable += 1
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        self._packets += 1
        missing = 0 if self._sequence is None else message.seq - self._sequence - 1
        self._sequence = message.seq
        if missing > 0:
            self._lost += missing
            self._rate.mark_lost(packet.start_us)
        self._rate.push(packet.events.t, packet.complete_until)

    def _on_force(self, message: WrenchStamped) -> None:
        force = message.wrench.force
        self._force.push(stamp_to_ns(message.header.stamp), (force.x, force.y, force.z))

    def _on_fit(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        p = self._settings
        try:
            counts = self._rate.snapshot()
            t_s, force = self._force.snapshot(p.reference_axis)
            self._fit = fit_counts(counts, t_s, force, p.settings(), use_all=p.use_all)
        except MixtacError as error:
            response.success, response.message = False, str(error)
            return response
        message = ClockFitMessage(**to_fields(self._fit))
        message.header.stamp = self.get_clock().now().to_msg()
        self._publisher.publish(message)
        response.success, response.message = True, self._fit.summary()
        return response

    def _status(self) -> Status:
        values: dict[str, object] = {
            'packets': self._packets,
            'lost packets': self._lost,
            'undecodable packets': self._undecodable,
            'remembered event bins': len(self._rate.snapshot().counts),
            'reference samples out of order': self._force.out_of_order,
            'clock restarts': self._rate.restarts + self._force.restarts,
        }
        if self._fit is None:
            return Status(OK, 'no clock fit yet: tap twice, then call ~/fit', values)
        values |= {
            'drift [ppm]': self._fit.drift_ppm,
            'residual rms [s]': self._fit.residual_rms_s,
        }
        stale = self._rate.restarts + self._force.restarts > 0
        return Status(WARN if stale else OK, self._fit.summary(), values)


def main(args: list[str] | None = None) -> int:
    """Run the alignment node."""
    return run(AlignmentNode, args)


if __name__ == '__main__':
    sys.exit(main())
