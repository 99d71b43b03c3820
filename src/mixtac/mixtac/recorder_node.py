# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Nodes that record: a listener that counts the messages of all topics, and the recorder node.

The recorder node is for machines without `ros2 bag record`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message
from rosbags.interfaces import Connection

from mixtac.meter import RecordingSummary, TopicMeter
from mixtac.monitor_node import CommandNode
from mixtac.parameters import RecorderParameters
from mixtac_core.events.errors import MixtacError
from mixtac_core.node.base_node import declare, run
from mixtac_core.node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_core.node.topics import DEFAULT_NAMESPACE, REFERENCE, REFERENCE_WRENCH, TOPICS
from mixtac_core.recordings.bag_writer import BagWriter
from mixtac_core.recordings.dataset import FILE_NAME, add_recording, read_recordings
from mixtac_core.recordings.recording import RecordingError

DEPTH = 1000
"""Least queue depth of a subscription: messages of about one second."""


class Listener(CommandNode):
    """Meters all topics; writes them to a bag between `start` and `finish`.

    All methods are for the thread of its executor.

    Args:
        name: Name of the node.
        namespace: Namespace of the sensor; one on the command line takes precedence.

    Attributes:
        meters: One per topic.
        writer: The bag that is written, or None.
        simulated: Whether a node reports simulated data on `/diagnostics`.
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

    def listen(self, reference_topic: str, exclude: Sequence[str] = ()) -> None:
        """Subscribe to all topics.

        Args:
            reference_topic: Topic of the reference force sensor.
            exclude: Names of topics to leave out.

        Raises:
            RecordingError: There is no topic of such a name.
        """
        names = {each.name for each in TOPICS}
        if unknown := set(exclude) - names:
            raise RecordingError(
                f'no topic {min(unknown)} to exclude',
                remedy=f'choose from {", ".join(sorted(names))}',
            )
        namespace = self.get_namespace()
        own = {each.resolved(namespace) for each in TOPICS if each.name != REFERENCE}
        if replace(REFERENCE_WRENCH, name=reference_topic).resolved(namespace) in own:
            raise RecordingError(
                f'{reference_topic} is a topic of the sensor, not of its reference',
                remedy='name the topic of the reference force sensor',
            )
        for each in TOPICS:
            if each.name in exclude:
                continue
            chosen = replace(
                each,
                name=reference_topic if each.name == REFERENCE else each.name,
                depth=1 if each.latched else max(DEPTH, each.depth),
            )
            meter = TopicMeter(chosen)
            self.meters.append(meter)
            self.subscribe_topic(chosen, partial(self._on_message, meter), raw=True)

    def start(self, output: Path) -> None:
        """Start writing to a new bag; figures count from now.

        Raises:
            RecordingError: The folder exists already or cannot be made.
        """
        writer = BagWriter(output)
        try:
            for meter in self.meters:
                meter.restart()
                topic = meter.topic
                self._connections[topic.name] = writer.add_topic(
                    topic.resolved(self.get_namespace()),
                    topic.type_name,
                    latched=topic.latched,
                )
        except Exception:
            writer.close()
            raise
        self._began_ns = time.time_ns()
        self.writer = writer

    def finish(self) -> RecordingSummary | None:
        """Write the queued messages and close the bag; return its summary, None without a bag.

        Raises:
            RecordingError: The bag could not be finished.
        """
        writer, self.writer = self.writer, None
        if writer is None:
            return None
        seconds = (time.time_ns() - self._began_ns) / 1e9
        writer.close()
        figures = {meter.topic.name: meter.figures() for meter in self.meters if meter.messages}
        return RecordingSummary(
            seconds, writer.dropped, self.simulated, self.serial, figures, writer.failure
        )

    def destroy_node(self) -> None:
        """Destroy the node; a bag that was not finished, because of an error, is now."""
        try:
            self.finish()
        finally:
            super().destroy_node()

    def _on_message(self, meter: TopicMeter, data: bytes) -> None:
        received_ns = time.time_ns()
        if not meter.add(received_ns, data):
            # Nobody could read it from the bag.
            name = meter.topic.name
            self.get_logger().warning(f'damaged message on {name}', throttle_duration_sec=5.0)
            return
        if self.writer is not None:
            self.writer.write(self._connections[meter.topic.name], received_ns, data)
        if meter.topic.name == '/diagnostics':
            self._on_diagnostics(data)

    def _on_diagnostics(self, data: bytes) -> None:
        own = self.get_namespace().strip('/')
        try:
            reports = deserialize_message(data, DiagnosticArray).status
        except rclpy_implementation.RMWError:
            return
        for status in reports:
            namespace, _, name = status.name.rpartition('/')
            if namespace != own:
                continue
            if any(v.key == 'simulated' and v.value == 'True' for v in status.values):
                self.simulated = True
            if name == 'driver':
                self.serial = status.hardware_id


class RecorderNode(Listener):
    """Records from its start to its end; `mixtac record` adds figures."""

    def __init__(self) -> None:
        super().__init__('recorder')
        self._p = declare(self, RecorderParameters)
        if not self._p.output:
            raise RecordingError(
                'parameter output is empty', remedy='name the folder of the new bag'
            )
        self._output = Path(self._p.output)
        read_recordings(self._output.absolute().parent / FILE_NAME)
        self.listen(self._p.reference_topic, self._p.exclude.split())
        self._failed = False
        self._diagnostics = DiagnosticsPublisher(self, 'recorder', self._status)
        self.start(self._output)

    def close(self) -> None:
        """Finish the bag."""
        try:
            summary = self.finish()
            if summary is None:
                return
            add_recording(
                self._output, summary.as_dict(), profile=self._p.profile, split=self._p.split
            )
        except MixtacError as error:
            self.get_logger().error(str(error))
            return
        lossy = summary.dropped or summary.stopped
        log = self.get_logger().warning if lossy else self.get_logger().info
        log(f'{self._output}: {summary.seconds:.1f} s, {summary.verdict()}')

    def _status(self) -> Status:
        writer = self.writer
        dropped = writer.dropped if writer else 0
        missing = {m.topic.name: m.missing for m in self.meters if m.missing}
        values: dict[str, object] = {
            'messages dropped': dropped,
            'messages': sum(m.messages for m in self.meters),
            'bytes': sum(m.size for m in self.meters),
            **{f'lost {name}': count for name, count in missing.items()},
        }
        if writer is not None and writer.failure:
            if not self._failed:
                self._failed = True
                self.get_logger().error(
                    f'{self._output}: recording stopped: {writer.failure}; what was recorded until'
                    ' now is complete'
                )
            return Status(WARN, f'recording stopped: {writer.failure}', values)
        if dropped:
            return Status(WARN, f'{dropped} messages dropped: disk too slow', values)
        return Status(WARN if missing else OK, 'recording', values)


main = partial(run, RecorderNode)
