# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A node that listens to every topic of the sensor, serialised, and can write what it hears."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from mixtac_cli.record.meter import EVEN, TopicMeter
from mixtac_cli.record.summary import RecordingSummary
from mixtac_node.base_node import DEFAULT_NAMESPACE, BaseNode
from mixtac_node.topics import REFERENCE, TOPICS, Topic, message_class
from mixtac_recordings.bag_writer import BagWriter

if TYPE_CHECKING:
    from pathlib import Path

    from rosbags.interfaces import Connection


CAMERA_CLOCK = ('image_raw', 'imu', 'force')
"""Topics whose stamps are on the camera's clock, by which it is judged."""


class Listener(BaseNode, Node):  # type: ignore[misc]
    """Meters all topics; writes them to a bag between `start` and `finish`.

    Everything but construction is for the thread of its executor.

    Args:
        name: Name of the node.
        namespace: Namespace of the sensor; one on the command line takes precedence.

    Attributes:
        meters: One per topic.
        writer: The bag that is written, or None.
        simulated: Whether a node says on `/diagnostics` that its data are simulated.
        serial: Hardware id of the driver, empty before it is known.
    """

    def __init__(self, name: str, namespace: str = DEFAULT_NAMESPACE) -> None:
        super().__init__(name, namespace=namespace)
        self.meters: list[TopicMeter] = []
        self.writer: BagWriter | None = None
        self.simulated = False
        self.serial = ''
        self._connections: dict[str, Connection] = {}
        self._began_ns = 0

    def listen(self, reference_topic: str) -> None:
        """Subscribe to all topics.

        Args:
            reference_topic: Topic of the reference force sensor.
        """
        for each in TOPICS:
            reference = each.name == REFERENCE
            chosen = replace(each, name=reference_topic) if reference else each
            meter = TopicMeter(chosen, even=reference or each.name in EVEN)
            self.meters.append(meter)
            self.create_subscription(
                message_class(each.type_name),
                chosen.name,
                partial(self._on_message, meter),
                _qos(each),
                raw=True,
            )

    def publishers(self) -> dict[str, int]:
        """Return the number of publishers by name of the topic, as in `meters`."""
        namespace = self.get_namespace()
        return {
            meter.topic.name: self.count_publishers(meter.topic.resolved(namespace))
            for meter in self.meters
        }

    def has_clock(self) -> bool:
        """Return whether somebody publishes `/clock`."""
        return bool(self.count_publishers('/clock'))

    def stamps_ns(self) -> dict[str, int]:
        """Return the latest stamp [ns] of the topics that are on the camera clock."""
        return {
            meter.topic.name: meter.stamp_ns
            for meter in self.meters
            if meter.topic.name in CAMERA_CLOCK
        }

    def start(self, output: Path) -> None:
        """Begin to write to a new bag; figures count from now.

        Raises:
            RecordingError: The folder exists already or cannot be made.
        """
        writer = BagWriter(output)
        for meter in self.meters:
            meter.restart()
            topic = meter.topic
            self._connections[topic.name] = writer.add_topic(
                topic.resolved(self.get_namespace()),
                topic.type_name,
                reliable=topic.reliable,
                latched=topic.latched,
            )
        self._began_ns = time.time_ns()
        self.writer = writer

    def finish(self) -> RecordingSummary | None:
        """Write what is queued and close the bag; return what became of it, None without one.

        Raises:
            RecordingError: The disk was full, or failed.
        """
        writer, self.writer = self.writer, None
        if writer is None:
            return None
        seconds = (time.time_ns() - self._began_ns) / 1e9
        writer.close()
        return RecordingSummary.of(
            self.meters, seconds, writer.dropped, simulated=self.simulated, serial=self.serial
        )

    def _on_message(self, meter: TopicMeter, data: bytes) -> None:
        received_ns = time.time_ns()
        meter.add(received_ns, data)
        if self.writer is not None:
            self.writer.write(self._connections[meter.topic.name], received_ns, data)
        if meter.topic.name == '/diagnostics':
            self._on_diagnostics(data)

    def _on_diagnostics(self, data: bytes) -> None:
        own = self.get_namespace().strip('/')
        for status in deserialize_message(data, DiagnosticArray).status:
            if not status.name.startswith(f'{own}/'):
                continue
            if any(v.key == 'simulated' and v.value == 'True' for v in status.values):
                self.simulated = True
            if status.name == f'{own}/driver':
                self.serial = status.hardware_id


def _qos(each: Topic) -> QoSProfile:
    return QoSProfile(
        depth=max(1000, each.depth) if not each.latched else 1,
        reliability=ReliabilityPolicy.RELIABLE if each.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if each.latched else DurabilityPolicy.VOLATILE,
    )
