# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fits the clock map on request, to the recent data of the topics."""

from __future__ import annotations

import time
from collections import deque
from functools import partial

import numpy as np
from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from message_filters import Subscriber, TimeSynchronizer
from rclpy.node import Node
from sensor_msgs.msg import Image, TimeReference
from std_srvs.srv import Trigger

from mixtac_core.events.codec import MAX_TIME_BASE, decode_message, warm_up
from mixtac_core.events.packets import CodecError
from mixtac_core.node import topics
from mixtac_core.node.base_node import QOS_FORCE, BaseNode, answering, declare, run
from mixtac_core.node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_core.node.images import ImageConversionError, grey
from mixtac_core.node.topics import stamp_to_ns, stamp_to_us, us_to_stamp
from mixtac_fger.alignment import signals
from mixtac_fger.alignment.align import Method, align, arrived_together
from mixtac_fger.alignment.clock_fit import ClockFit
from mixtac_fger.alignment.histories import (
    EventHistory,
    ForceHistory,
    FrameHistory,
    Recording,
    follow_stamps,
    has_restarted,
    reduce_frame,
)
from mixtac_fger.alignment.parameters import AlignmentParameters
from mixtac_msgs.msg import ClockFit as ClockFitMessage
from mixtac_msgs.msg import ExternalEdge, FrameExposure

Edges = deque[tuple[int, int]]
"""Stamps, and when they arrived by the host's steady clock [ns]."""
MOST_EDGES = 10_000
"""Edges of each clock that are kept, at most."""
WAITING = 32
"""Frames, or exposures, that wait for each other."""


class AlignmentNode(BaseNode, Node):  # type: ignore[misc]
    """Keeps events, force and frames of the last minutes; fits both clocks when `~/fit` is called.

    From then on the reference force is republished on the camera clock as `reference/wrench`.
    """

    def __init__(self) -> None:
        super().__init__('alignment')
        self._settings = declare(self, AlignmentParameters, self._apply)
        p = self._settings
        self._events = EventHistory(p.history)
        self._force = ForceHistory(p.history, round(p.history * p.reference_rate))
        self._frames = FrameHistory(p.history)
        self._camera_edges: Edges = deque()
        self._reference_edges: Edges = deque()
        self._fit: ClockFit | None = None
        self._restarts = 0
        self._newest_ns = self._undecodable = 0
        self._diagnostics = DiagnosticsPublisher(self, 'alignment', self._status)
        with self._diagnostics.compiling('the packet codec'):
            warm_up()
        signals.warm_up()
        self.subscribe_topic(topics.EVENTS, self._on_events)
        self.subscribe_topic(topics.REFERENCE_WRENCH, self._on_force, name=p.reference_topic)
        # Deeper queues than those of a display: no frame or edge may be missing.
        halves = [
            Subscriber(self, Image, 'image_raw', qos_profile=QOS_FORCE),
            Subscriber(self, FrameExposure, 'image_exposure', qos_profile=QOS_FORCE),
        ]
        for half in halves:
            half.registerCallback(self._on_half)
        self._pairs = TimeSynchronizer(halves, WAITING)
        self._pairs.registerCallback(self._on_frame)
        self.create_subscription(ExternalEdge, 'external_edges', self._on_edge, QOS_FORCE)
        self.create_subscription(
            TimeReference, 'reference_edges', self._on_reference_edge, QOS_FORCE
        )
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
            self._frames = FrameHistory(self._settings.history)
            self._camera_edges.clear()
            self._reference_edges.clear()

    def _on_force(self, message: WrenchStamped) -> None:
        force = message.wrench.force
        kept = self._force.push(stamp_to_ns(message.header.stamp), (force.x, force.y, force.z))
        if not kept or self._fit is None or self._stale:
            return
        time_us = int(self._fit.to_camera(stamp_to_ns(message.header.stamp) / 1e9))
        if 0 <= 1000 * time_us < MAX_TIME_BASE:
            message.header.stamp = us_to_stamp(time_us)
            self._aligned.publish(message)

    def _on_half(self, message: Image | FrameExposure) -> None:
        stamp_ns = stamp_to_ns(message.header.stamp)
        self._newest_ns = follow_stamps(self._pairs.queues, stamp_ns, self._newest_ns)

    def _on_frame(self, image: Image, exposure: FrameExposure) -> None:
        if not self._settings.use_frames:
            return
        try:
            pixels = grey(image)
        except ImageConversionError as error:
            self.get_logger().warning(f'frame left out: {error}', once=True)
            return
        values = reduce_frame(pixels, float(np.iinfo(pixels.dtype).max))
        start_us, end_us = map(stamp_to_us, (exposure.exposure_start, exposure.exposure_end))
        self._frames.push(start_us, end_us, values)

    def _on_edge(self, message: ExternalEdge) -> None:
        self._keep_edge(self._camera_edges, stamp_to_ns(message.header.stamp))

    def _on_reference_edge(self, message: TimeReference) -> None:
        self._keep_edge(self._reference_edges, stamp_to_ns(message.time_ref))

    def _keep_edge(self, edges: Edges, stamp_ns: int) -> None:
        """Keep an edge as long as everything else; forget all where its clock has restarted."""
        if edges and has_restarted(stamp_ns, edges[-1][0]):
            self._camera_edges.clear()
            self._reference_edges.clear()
        edges.append((stamp_ns, time.monotonic_ns()))
        while len(edges) > MOST_EDGES or edges[0][0] < stamp_ns - 1e9 * self._settings.history:
            edges.popleft()

    def _on_fit(self, _request: Trigger.Request) -> str:
        p = self._settings
        t_s, force = self._force.snapshot(p.reference_axis)
        edges = self._camera_edges, self._reference_edges
        camera, reference = (np.array(each, np.int64).reshape(-1, 2) for each in edges)
        recording = Recording(
            counts=self._events.counts(),
            events=self._events.events(),
            frames=self._frames.snapshot() if p.use_frames else None,
            force_t_s=t_s,
            force=force,
            edges_us=camera[:, 0] // 1000,
            reference_edges_s=reference[:, 0] / 1e9,
            all_edges=arrived_together(camera[:, 1], reference[:, 1]),
        )
        method: Method = 'edges' if p.use_edges else 'taps'
        self._fit = align(recording, p, method=method)
        self._restarts = self._clock_restarts
        message = ClockFitMessage(**self._fit.to_fields())
        message.header.stamp = self.get_clock().now().to_msg()
        self._publisher.publish(message)
        return self._fit.summary()

    @property
    def _clock_restarts(self) -> int:
        return self._events.restarts + self._force.restarts

    @property
    def _stale(self) -> bool:
        """Whether a clock has restarted since the fit."""
        return self._clock_restarts > self._restarts

    def _status(self) -> Status:
        values: dict[str, object] = {
            'packets': self._events.packets.received,
            'lost packets': self._events.packets.lost,
            'undecodable packets': self._undecodable,
            'reference samples out of order': self._force.refused,
            'events dropped: history buffer full': self._events.dropped,
            'external edges': len(self._camera_edges),
            'clock restarts': self._clock_restarts,
        }
        if self._fit is None:
            return Status(OK, 'no clock fit yet: tap twice, then call ~/fit', values)
        values |= {
            'drift [ppm]': self._fit.drift_ppm,
            'residual rms [s]': self._fit.residual_rms_s,
        }
        if self._stale:
            text = 'a clock has restarted since the clock fit: tap twice, then call ~/fit'
            return Status(WARN, text, values)
        return Status(OK, self._fit.summary(), values)


main = partial(run, AlignmentNode)
