# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write camera readings and forces to a bag as messages of the live graph, without rclpy.

`mixtac import` and `mixtac.Sensor` record with it: topics, types, QoS and packets are those of the
driver and of the estimator node.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.packetizer import Packetizer
from mixtac_core.events.packets import PacketWriter
from mixtac_core.events.readings import Edges, Frame, InertialSamples
from mixtac_core.node import topics
from mixtac_core.node.topics import Topic
from mixtac_core.recordings import messages
from mixtac_core.recordings.bag import blank_message, typestore


class Bag(Protocol):
    """A bag to write to: `bag_writer.McapBag`, or `bag_writer.BagWriter` from a thread."""

    def add_topic(self, topic: str, type_name: str, *, latched: bool) -> Any:  # noqa: ANN401
        """Announce a topic and return the handle to write it with."""

    def write(self, connection: Any, timestamp: int, data: bytes) -> None:  # noqa: ANN401
        """Write a serialised message, received at a host time [ns]."""


class StreamWriter:
    """Writes one camera's stream; times are on its epoch-based clock [us]. For one thread.

    Args:
        bag: Where to write; the caller closes it.
        size: Width and height of the event array.
        color_filter: Colour filter of the camera, 0 for none.
    """

    def __init__(self, bag: Bag, size: tuple[int, int], *, color_filter: int = 0) -> None:
        self._bag, self._size, self._color_filter = bag, size, color_filter
        self._packetizer, self._packets = Packetizer(), PacketWriter(topics.CAMERA_FRAME, size)
        self._sequence = self._edges = 0
        self._handles: dict[str, Any] = {}

    def announce(self, *wanted: Topic) -> None:
        """Announce topics; others are announced with their first message.

        A bag that another thread writes takes no new topics once it has messages.
        """
        for topic in wanted:
            self._handles[topic.name] = self._bag.add_topic(
                topic.resolved(topics.DEFAULT_NAMESPACE), topic.type_name, latched=topic.latched
            )

    def put(self, topic: Topic, received_ns: int, message: Any) -> None:  # noqa: ANN401
        """Write a message.

        Args:
            topic: Its topic.
            received_ns: Host time of its reception [ns since the Unix epoch].
            message: The message of `blank_message`, or its bytes.
        """
        if topic.name not in self._handles:
            self.announce(topic)
        data = message
        if not isinstance(message, bytes):
            data = bytes(typestore().serialize_cdr(message, topic.type_name))
        self._bag.write(self._handles[topic.name], received_ns, data)

    def events(self, events: Events, until_us: int, arrival_ns: int) -> None:
        """Write events, sorted and not before earlier ones.

        Args:
            events: The events; may be none.
            until_us: No later event is before this time.
            arrival_ns: Host time of their arrival [ns since the Unix epoch].
        """
        for packet in self._packetizer.push(events, until_us, arrival_ns):
            data = self._packets.write(packet.encode(), self._sequence, packet.arrival_ns)
            self.put(topics.EVENTS, arrival_ns, data)
            self._sequence += 1

    def frame(self, frame: Frame, origin_us: int, received_ns: int) -> None:
        """Write a frame, its size and its exposure.

        Args:
            frame: The frame; its times are relative to `origin_us`.
            origin_us: See above [us since the Unix epoch].
            received_ns: Host time of its reception [ns since the Unix epoch].
        """
        image = messages.image(
            frame, origin_us, self._color_filter, topics.CAMERA_FRAME, blank_message
        )
        info = messages.camera_info(frame, self._size, image, blank_message)
        exposure = messages.frame_exposure(frame, origin_us, image, blank_message)
        self.put(topics.IMAGE_RAW, received_ns, image)
        self.put(topics.CAMERA_INFO, received_ns, info)
        self.put(topics.IMAGE_EXPOSURE, received_ns, exposure)

    def samples(self, samples: InertialSamples, origin_us: int, received_ns: int) -> None:
        """Write inertial samples, each after its temperature; arguments as in `frame`."""
        for index in range(len(samples.t)):
            celsius, t_us = float(samples.temperature[index]), int(samples.t[index]) + origin_us
            if not math.isnan(celsius):
                message = messages.temperature(celsius, t_us, topics.IMU_FRAME, blank_message)
                self.put(topics.TEMPERATURE, received_ns, message)
            message = messages.imu(samples, index, origin_us, topics.IMU_FRAME, blank_message)
            self.put(topics.IMU, received_ns, message)

    def edges(self, edges: Edges, origin_us: int, received_ns: int) -> None:
        """Write edges of the synchronisation connector; arguments as in `frame`."""
        for t_us, kind in zip(edges.t.tolist(), edges.kind.tolist(), strict=True):
            message = messages.external_edge(
                kind, t_us + origin_us, self._edges, topics.CAMERA_FRAME, blank_message
            )
            self.put(topics.EXTERNAL_EDGES, received_ns, message)
            self._edges += 1

    def wrench(
        self,
        topic: Topic,
        stamp_ns: int,
        values: NDArray[np.float64],
        frame_id: str,
        received_ns: int,
    ) -> None:
        """Write a wrench.

        Args:
            topic: `FORCE` or `REFERENCE_WRENCH`.
            stamp_ns: Stamp on the clock of that topic [ns].
            values: Force [N] and torque [N m], float64 [6].
            frame_id: Frame of the force.
            received_ns: Host time of its reception [ns since the Unix epoch].
        """
        message = blank_message(topic.type_name)
        messages.set_header(message, stamp_ns, frame_id)
        force, torque = message.wrench.force, message.wrench.torque
        force.x, force.y, force.z, torque.x, torque.y, torque.z = values.tolist()
        self.put(topic, received_ns, message)
