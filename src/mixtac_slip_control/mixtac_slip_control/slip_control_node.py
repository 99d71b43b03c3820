# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counts events per millisecond and publishes slip and the advance against it.

This node moves no arm: it publishes the advance it would ask for in `slip`, and nothing subscribes
to it on an arm's behalf. It starts disabled; `~/enable` starts and stops the advance,
`~/calibrate` learns the background anew.
"""

from __future__ import annotations

import dataclasses
import sys
from typing import TYPE_CHECKING

from event_camera_msgs.msg import EventPacket
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from mixtac_events.codec import decode_message, warm_up
from mixtac_events.errors import CodecError, MixtacError
from mixtac_events.windows import WindowSlicer
from mixtac_msgs.msg import SlipState
from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE, declare, run, us_to_stamp
from mixtac_node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_slip_control.controller import SlipController
from mixtac_slip_control.slip_control_parameters import SlipControlParameters

if TYPE_CHECKING:
    from mixtac_events.packets import DecodedPacket
    from mixtac_slip_control.controller import SlipStep

MAX_EMPTY_RUN = 20
"""After a gap in the stream only this many empty windows are published: old news helps nobody."""


class SlipControlNode(Node):  # type: ignore[misc]
    """Wires the slip controller to the event stream."""

    def __init__(self) -> None:
        super().__init__('slip_control', namespace='mixtac')
        self._parameters = declare(self, SlipControlParameters, self._apply)
        self._controller = SlipController(self._parameters.settings())
        self._slicer = WindowSlicer(self._parameters.window_us, max_empty_run=MAX_EMPTY_RUN)
        self._sequence: int | None = None
        self._lost_until_us = 0
        self._latest: SlipStep | None = None
        self._packets = self._lost = self._undecodable = self._windows = 0
        warm_up()
        self._publisher = self.create_publisher(SlipState, 'slip', QOS_FORCE)
        self.create_service(SetBool, '~/enable', self._on_enable)
        self.create_service(Trigger, '~/calibrate', self._on_calibrate)
        self.create_subscription(EventPacket, 'events', self._on_events, QOS_EVENTS)
        self._diagnostics = DiagnosticsPublisher(self, 'slip_control', self._status)

    def _apply(self, parameters: SlipControlParameters) -> None:
        self._controller.configure(parameters.settings())
        self._parameters = parameters

    def _on_events(self, message: EventPacket) -> None:
        try:
            packet = decode_message(message)
        except CodecError as error:
            self._undecodable += 1
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        self._note_sequence(message.seq, packet)
        for end_us, events in self._slicer.push(packet.events, packet.complete_until):
            start_us = end_us - self._slicer.width_us
            self._latest = self._controller.step(
                len(events), complete=start_us >= self._lost_until_us
            )
            self._publish(end_us, self._latest)

    def _note_sequence(self, sequence: int, packet: DecodedPacket) -> None:
        missing = 0 if self._sequence is None else sequence - self._sequence - 1
        self._sequence = sequence
        self._packets += 1
        if missing > 0:
            self._lost += missing
            self._lost_until_us = packet.start_us
        elif missing < 0:
            self._lost_until_us = 0

    def _publish(self, end_us: int, step: SlipStep) -> None:
        self._windows += 1
        message = SlipState(**{f.name: getattr(step, f.name) for f in dataclasses.fields(step)})
        message.header.stamp = us_to_stamp(end_us)
        self._publisher.publish(message)

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                self._controller.enable()
            else:
                self._controller.disable()
        except MixtacError as error:
            response.success, response.message = False, str(error)
            return response
        state = 'enabled; no arm is connected' if request.data else 'disabled'
        response.success, response.message = True, f'slip control {state}'
        return response

    def _on_calibrate(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        try:
            self._controller.recalibrate()
        except MixtacError as error:
            response.success, response.message = False, str(error)
            return response
        learning = self._parameters.learning_time
        response.success = True
        response.message = f'learning the background: keep the contact still for {learning:g} s'
        return response

    def _status(self) -> Status:
        values: dict[str, object] = {
            'packets': self._packets,
            'lost packets': self._lost,
            'undecodable packets': self._undecodable,
            'windows': self._windows,
            'skipped windows': self._slicer.skipped_windows,
            'late events': self._slicer.late_events,
            'clock restarts': self._slicer.restarts,
            'enabled': self._controller.enabled,
        }
        if self._latest is None:
            return Status(WARN, 'no events yet: check that the driver runs', values)
        values |= {
            'background [events]': self._latest.background,
            'threshold [events]': self._latest.threshold,
            'total advance [m]': self._latest.total_advance,
        }
        message = 'watching' if self._controller.calibrated else 'learning the background'
        return Status(OK, f'{message}; no arm is connected', values)


def main(args: list[str] | None = None) -> int:
    """Run the slip control node."""
    return run(SlipControlNode, args)


if __name__ == '__main__':
    sys.exit(main())
