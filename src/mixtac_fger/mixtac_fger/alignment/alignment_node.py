# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fits the clock map on request, to the recent data of the topics."""

from __future__ import annotations

import math
import time
from collections import deque
from functools import partial

import numpy as np
from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import Image, TimeReference
from std_srvs.srv import Trigger

from mixtac_core.events.codec import MAX_TIME_BASE, decode_message, warm_up
from mixtac_core.events.packets import CodecError
from mixtac_core.node import topics
from mixtac_core.node.base_node import QOS_FORCE, BaseNode, answering, declare, run
from mixtac_core.node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_core.node.images import ImageConversionError
from mixtac_core.node.topics import stamp_to_ns, us_to_stamp
from mixtac_fger.alignment.align import align, arrived_together
from mixtac_fger.alignment.clock_fit import ClockFit
from mixtac_fger.alignment.histories import (
    EventHistory,
    FrameHistory,
    Recording,
    force_arrays,
    has_restarted,
)
from mixtac_fger.alignment.parameters import AlignmentParameters
from mixtac_msgs.msg import ClockFit as ClockFitMessage
from mixtac_msgs.msg import ExternalEdge, FrameExposure

Stamped = tuple[int, tuple[float, ...]]
"""Stamp [ns], and force (x, y, z) [N] or arrival of an edge by the host's steady clock [ns]."""
MOST_EDGES = 10_000
"""Edges of each clock that are kept, at most."""


class AlignmentNode(BaseNode, Node):  # type: ignore[misc]
    """Keeps events, force and frames of the last minutes; fits both clocks when `~/fit` is called.

    From then on the reference force is republished on the camera clock as `reference/wrench`.
    """

    def __init__(self) -> None:
        super().__init__('alignment')
        self._settings = p = declare(self, AlignmentParameters, self._apply)
        self._events, self._frames = EventHistory(p.history), FrameHistory(p.history)
        self._force: deque[Stamped] = deque(maxlen=round(p.history * p.reference_rate))
        self._edges: deque[Stamped] = deque(maxlen=MOST_EDGES)
        self._reference_edges: deque[Stamped] = deque(maxlen=MOST_EDGES)
        self._fit: ClockFit | None = None
        self._restarts = self._undecodable = 0
        self._diagnostics = DiagnosticsPublisher(self, 'alignment', self._status)
        with self._diagnostics.compiling('the packet codec'):
            warm_up()
        self.subscribe_topic(topics.EVENTS, self._on_events)
        self.subscribe_topic(topics.REFERENCE_WRENCH, self._on_force, name=p.reference_topic)
        # Deeper queues than those of a display: no frame or edge may be missing.
        for kind, name, callback in (
            (Image, 'image_raw', self._on_image),
            (FrameExposure, 'image_exposure', self._on_exposure),
            (ExternalEdge, 'external_edges', self._on_edge),
            (TimeReference, 'reference_edges', self._on_reference_edge),
        ):
            self.create_subscription(kind, name, callback, QOS_FORCE)
        self._aligned = self.publish_topic(topics.ALIGNMENT_REFERENCE)
        self._publisher = self.publish_topic(topics.CLOCK_FIT)
        self.create_service(Trigger, '~/fit', answering(self._on_fit))

    def _apply(self, parameters: AlignmentParameters) -> None:
        self._settings = parameters

    def _on_events(self, message: EventPacket) -> None:
        try:
            packet = decode_message(message)
        except CodecError as error:
            self._undecodable += 1
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        if self._events.add(packet, message.seq, message.width, message.height):
            # Another run of the driver has another origin of the camera clock.
            self._start_over()

    def _on_force(self, message: WrenchStamped) -> None:
        force, stamp_ns = message.wrench.force, stamp_to_ns(message.header.stamp)
        values = force.x, force.y, force.z
        if not stamp_ns or not math.isfinite(sum(values)):
            return
        self._keep(self._force, stamp_ns, values)
        if self._fit is None:
            return
        time_us = int(self._fit.to_camera(stamp_ns / 1e9))
        if 0 <= 1000 * time_us < MAX_TIME_BASE:
            message.header.stamp = us_to_stamp(time_us)
            self._aligned.publish(message)

    def _on_image(self, message: Image) -> None:
        try:
            if self._settings.use_frames:
                self._frames.add_image(message)
        except ImageConversionError as error:
            self.get_logger().warning(f'frame left out: {error}', once=True)

    def _on_exposure(self, message: FrameExposure) -> None:
        self._frames.add_exposure(message)

    def _on_edge(self, message: ExternalEdge) -> None:
        self._keep(self._edges, stamp_to_ns(message.header.stamp), (time.monotonic_ns(),))

    def _on_reference_edge(self, message: TimeReference) -> None:
        self._keep(self._reference_edges, stamp_to_ns(message.time_ref), (time.monotonic_ns(),))

    def _keep(self, kept: deque[Stamped], stamp_ns: int, values: tuple[float, ...]) -> None:
        """Keep a message as long as everything else; start over where its clock has restarted."""
        if kept and has_restarted(stamp_ns, kept[-1][0]):
            self._start_over()
        kept.append((stamp_ns, values))
        while kept[0][0] < stamp_ns - 1e9 * self._settings.history:
            kept.popleft()

    def _start_over(self) -> None:
        """Forget the fit, and everything but the events."""
        self._restarts += 1
        self._fit = None
        self._frames = FrameHistory(self._settings.history)
        for kept in (self._force, self._edges, self._reference_edges):
            kept.clear()

    def _on_fit(self, _request: Trigger.Request) -> str:
        p = self._settings
        axis = 'xyz'.index(p.reference_axis)
        camera, reference = (
            np.array([(stamp, *arrival) for stamp, arrival in each], np.int64).reshape(-1, 2)
            for each in (self._edges, self._reference_edges)
        )
        recording = Recording(
            *self._events.snapshot(),
            self._frames.snapshot() if p.use_frames else None,
            *force_arrays((stamp, force[axis]) for stamp, force in self._force),
            camera[:, 0] // 1000,
            reference[:, 0] / 1e9,
            all_edges=arrived_together(camera[:, 1], reference[:, 1]),
        )
        self._fit = align(recording, p, method='edges' if p.use_edges else 'taps')
        message = ClockFitMessage(**self._fit.to_fields())
        message.header.stamp = self.get_clock().now().to_msg()
        self._publisher.publish(message)
        return self._fit.summary()

    def _status(self) -> Status:
        values: dict[str, object] = {
            'packets': self._events.packets.received,
            'lost packets': self._events.packets.lost,
            'undecodable packets': self._undecodable,
            'external edges': len(self._edges),
            'clock restarts': self._restarts,
        }
        if self._fit is None:
            text = 'no clock fit: tap twice, then call ~/fit'
            if self._restarts:
                return Status(WARN, f'a clock has restarted; {text}', values)
            return Status(OK, text, values)
        return Status(OK, self._fit.summary(), values)


main = partial(run, AlignmentNode)
