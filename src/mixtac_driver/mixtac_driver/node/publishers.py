# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishers of the driver: events, frames, inertial samples, edges."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import CameraInfo

from mixtac_core.events.arrays import Events
from mixtac_core.events.packets import PacketWriter
from mixtac_core.events.readings import Edges, Frame, InertialSamples
from mixtac_core.events.windows import Packetizer
from mixtac_core.node import topics
from mixtac_core.node.topics import Topic
from mixtac_core.recordings import messages
from mixtac_driver.camera import CameraBatch
from mixtac_driver.davis346.model import Identity
from mixtac_driver.node.status import DriverMeters
from mixtac_driver.parameters import DeviceParameters


class EventPublisher:
    """Cuts events into packets and publishes them on a topic. For one thread.

    Packets are encoded only while the topic has subscribers.

    Args:
        node: An rclpy node.
        p: Encoding, size and frame of the packets.
        topic: The topic.
        meters: Counts the packets, or None.
        move: Applied to events before they are published, or None.
    """

    def __init__(
        self,
        node: Any,  # noqa: ANN401
        p: DeviceParameters,
        topic: Topic,
        meters: DriverMeters | None = None,
        move: Callable[[Events], Events] | None = None,
    ) -> None:
        self._p, self._meters, self._move = p, meters, move
        self._publisher = node.publish_topic(topic)
        self._sequence = 0
        self._packetizer: Packetizer | None = None
        self._writer: PacketWriter

    def restart(self) -> None:
        """Discard unpublished events: another stream starts."""
        self._packetizer = None

    def publish(self, events: Events, batch: CameraBatch, size: tuple[int, int]) -> None:
        """Add events and publish the packets that they complete, if there are subscribers.

        Args:
            events: Events of the batch.
            batch: The batch.
            size: Width and height of the event array.
        """
        if not self._publisher.get_subscription_count():
            # Who subscribes gets whole packets from the next batch on.
            self.restart()
            return
        if self._packetizer is None:
            period_us = round(self._p.event_message_time_threshold * 1e6)
            most_bytes = self._p.event_message_size_threshold
            self._packetizer = Packetizer(period_us, most_bytes)
            self._writer = PacketWriter(self._p.camera_frame_id, size)
        if self._move is not None:
            events = self._move(events)
        origin_us, arrival_ns = batch.origin.us, batch.arrival_ns
        for packet in self._packetizer.push(events, batch.time_us, arrival_ns, origin_us):
            message = self._writer.write(packet.encode(), self._sequence, packet.arrival_ns)
            self._publisher.publish(message)
            self._sequence += 1
            if self._meters is not None:
                self._meters.packets.add()
                self._meters.ages_s.add((time.time_ns() - packet.arrival_ns) / 1e9)


TEMPERATURE_PERIOD_US = 100_000
MOST_EDGES = 500
"""Edges that are published per period; more would delay events."""
EDGES_PERIOD_S = 0.25
"""Period in which the published edges are counted [s]."""


class ReadingPublisher:
    """Publishes frames, inertial samples and edges, each on the topics that have subscribers.

    For one thread.

    Args:
        node: An rclpy node.
        p: Frames of camera and inertial unit.
        meters: Counts what is published.
        complete: Adds the calibration to camera information.
    """

    def __init__(
        self,
        node: Any,  # noqa: ANN401
        p: DeviceParameters,
        meters: DriverMeters,
        complete: Callable[[CameraInfo], CameraInfo],
    ) -> None:
        self._camera_frame, self._imu_frame = p.camera_frame_id, p.imu_frame_id
        self._meters, self._complete = meters, complete
        self._image = node.publish_topic(topics.IMAGE_RAW)
        self._info = node.publish_topic(topics.CAMERA_INFO)
        self._exposure = node.publish_topic(topics.IMAGE_EXPOSURE)
        self._imu = node.publish_topic(topics.IMU)
        self._temperature = node.publish_topic(topics.TEMPERATURE)
        self._edges = node.publish_topic(topics.EXTERNAL_EDGES)
        self._temperature_due_us = self._edge_sequence = 0
        self._edges_allowed, self._period_ends_s = MOST_EDGES, 0.0

    def frame(self, frame: Frame, origin_us: int, identity: Identity) -> None:
        """Publish a frame on `image_raw`, `camera_info` and `image_exposure`.

        Args:
            frame: The frame.
            origin_us: Origin of the camera's clock [us since the Unix epoch].
            identity: The camera.
        """
        if self._image.get_subscription_count():
            color_filter = identity.color_filter
            image = messages.image(frame, origin_us, color_filter, self._camera_frame)
            self._image.publish(image)
        else:
            image = messages.image_header(frame, origin_us, self._camera_frame)
        if self._info.get_subscription_count():
            size = (identity.geometry.width, identity.geometry.height)
            self._info.publish(self._complete(messages.camera_info(frame, size, image)))
        if self._exposure.get_subscription_count():
            self._exposure.publish(messages.frame_exposure(frame, origin_us, image))

    def samples(self, samples: InertialSamples, origin_us: int) -> None:
        """Publish samples on `imu/data_raw` and, ten times a second, on `temperature`.

        Args:
            samples: At least one sample.
            origin_us: Origin of the camera's clock [us since the Unix epoch].
        """
        if self._imu.get_subscription_count():
            for index in range(len(samples.t)):
                self._imu.publish(messages.imu(samples, index, origin_us, self._imu_frame))
        celsius, time_us = float(samples.temperature[-1]), int(samples.t[-1]) + origin_us
        if time_us < self._temperature_due_us or math.isnan(celsius):
            return
        self._temperature_due_us = time_us + TEMPERATURE_PERIOD_US
        if self._temperature.get_subscription_count():
            self._temperature.publish(messages.temperature(celsius, time_us, self._imu_frame))

    def edges(self, edges: Edges, origin_us: int) -> None:
        """Publish edges on `external_edges`, up to MOST_EDGES per period; count those dropped.

        Args:
            edges: The edges.
            origin_us: Origin of the camera's clock [us since the Unix epoch].
        """
        count, first = len(edges.t), self._edge_sequence
        self._edge_sequence += count
        self._meters.edges += count
        if not count or not self._edges.get_subscription_count():
            return
        now_s = time.monotonic()
        if now_s >= self._period_ends_s:
            self._period_ends_s, self._edges_allowed = now_s + EDGES_PERIOD_S, MOST_EDGES
        published = min(count, self._edges_allowed)
        self._edges_allowed -= published
        self._meters.edges_dropped += count - published
        for index in range(published):
            time_us, kind = int(edges.t[index]) + origin_us, int(edges.kind[index])
            message = messages.external_edge(kind, time_us, first + index, self._camera_frame)
            self._edges.publish(message)
