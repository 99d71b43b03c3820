# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishing events, for as long as somebody listens."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from event_camera_msgs.msg import EventPacket

from mixtac_driver import messages
from mixtac_driver.packetizer import Packetizer
from mixtac_node.base_node import QOS_EVENTS

if TYPE_CHECKING:
    from mixtac_driver.device_parameters import DeviceParameters
    from mixtac_driver.driver_meters import DriverMeters
    from mixtac_events.arrays import Events


class EventPublisher:
    """Cuts events into packets and publishes them on a topic. For one thread.

    Args:
        node: An rclpy node.
        p: Encoding, size and frame of the packets.
        meters: Where packets are counted.
        topic: Where they go.
    """

    def __init__(
        self,
        node: Any,  # noqa: ANN401
        p: DeviceParameters,
        meters: DriverMeters,
        topic: str = 'events',
    ) -> None:
        self._p, self._meters = p, meters
        self._publisher = node.create_publisher(EventPacket, topic, QOS_EVENTS)
        self._sequence = 0
        self._packetizer: Packetizer | None = None

    @property
    def wanted(self) -> bool:
        """True while somebody listens."""
        return bool(self._publisher.get_subscription_count())

    def restart(self) -> None:
        """Forget what was not published: another stream begins."""
        self._packetizer = None

    def publish(
        self, events: Events, time_us: int, arrival_ns: int, shift_us: int, size: tuple[int, int]
    ) -> None:
        """Take events and publish the packets that they complete.

        Args:
            events: Events [us on the camera clock since its reset].
            time_us: Time that the stream has reached [us, epoch-based camera clock].
            arrival_ns: Host time of their arrival [ns since the Unix epoch].
            shift_us: What leads from the clock of the events to the epoch-based one [us].
            size: Width and height of the event array.
        """
        if self._packetizer is None:
            period_us = round(self._p.event_message_time_threshold * 1e6)
            most_bytes = self._p.event_message_size_threshold
            self._packetizer = Packetizer(self._p.encoding, period_us, most_bytes)
        for packet in self._packetizer.push(events, time_us, arrival_ns, shift_us):
            self._publisher.publish(
                messages.event_packet(packet, self._sequence, size, self._p.camera_frame_id)
            )
            self._sequence += 1
            self._meters.packets.add()
            self._meters.ages_s.add((time.time_ns() - packet.arrival_ns) / 1e9)
