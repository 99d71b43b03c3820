# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Nodes that record: a listener that counts the messages of all topics, and the recorder node.

The recorder node is for machines without `ros2 bag record`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rosbags.interfaces import Connection

from mixtac.monitor_node import CommandNode
from mixtac.parameters import RecorderParameters
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.packets import CodecError, SequenceCounter, read_packet
from mixtac_core.node import topics
from mixtac_core.node.base_node import declare, run
from mixtac_core.node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_core.node.topics import Topic
from mixtac_core.recordings.bag_writer import BagWriter
from mixtac_core.recordings.dataset import FILE_NAME, add_recording, read_recordings
from mixtac_core.recordings.recording import RecordingError

DEPTH: Final = 1000
"""Least queue depth of a subscription: messages of about one second."""


class TopicMeter:
    """Counts the messages of one topic.

    Only event packets have numbers that show a loss. The other topics show their rate and their
    longest gap.

    Args:
        topic: The topic.

    Attributes:
        topic: As given.
        messages: Messages that arrived whole.
        size: Their serialised size [bytes].
        missing: Event packets lost by their numbers; damaged messages.
        longest_gap_ns: Longest time between two arrivals [ns].
    """

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self._sequence = SequenceCounter()
        self.restart()

    def restart(self) -> None:
        """Count from zero."""
        self.messages = self.size = self.missing = self.longest_gap_ns = 0
        self._first_ns = self._last_ns = 0

    def add(self, received_ns: int, data: bytes) -> bool:
        """Count a serialised message, arrived at a host time [ns]; return whether it is whole."""
        try:
            if self.topic.type_name == topics.EVENTS.type_name:
                self.missing += self._sequence.update(read_packet(data).seq)
        except CodecError:
            self.missing += 1
            return False
        self.messages += 1
        self.size += len(data)
        self._first_ns = self._first_ns or received_ns
        self.longest_gap_ns = max(self.longest_gap_ns, received_ns - (self._last_ns or received_ns))
        self._last_ns = received_ns
        return True

    @property
    def rate_hz(self) -> float:
        """Messages per second between first and latest arrival."""
        span_ns = self._last_ns - self._first_ns
        return (self.messages - 1) * 1e9 / span_ns if span_ns > 0 else 0.0

    def figures(self) -> dict[str, float]:
        """Return the figures of the topic for dataset.yaml."""
        return {
            'messages': self.messages,
            'rate_hz': round(self.rate_hz, 3),
            'longest_gap_s': round(1e-9 * self.longest_gap_ns, 6),
            'octets': self.size,
            'missing': self.missing,
        }


class Listener(CommandNode):
    """Meters all topics; writes them to a bag between `start` and `finish`.

    All methods are for the thread of its executor.

    Args:
        name: Name of the node.
        namespace: Namespace of the sensor; one on the command line takes precedence.

    Attributes:
        meters: One per topic.
        writer: The bag that is written, or None.
    """

    def __init__(self, name: str, namespace: str = topics.DEFAULT_NAMESPACE) -> None:
        super().__init__(name, namespace=namespace)
        self.meters: list[TopicMeter] = []
        self.writer: BagWriter | None = None
        self._simulated, self._serial = False, ''
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
        names = {each.name for each in topics.TOPICS}
        if unknown := set(exclude) - names:
            raise RecordingError(
                f'no topic {min(unknown)} to exclude',
                remedy=f'choose from {", ".join(sorted(names))}',
            )
        reference = replace(topics.REFERENCE_WRENCH, name=reference_topic)
        namespace = self.get_namespace()
        own = {each.resolved(namespace) for each in topics.TOPICS if each.name != topics.REFERENCE}
        if reference.resolved(namespace) in own:
            raise RecordingError(
                f'{reference_topic} is a topic of the sensor, not of its reference',
                remedy='name the topic of the reference force sensor',
            )
        for each in topics.TOPICS:
            if each.name in exclude:
                continue
            topic = reference if each.name == topics.REFERENCE else each
            topic = replace(topic, depth=1 if topic.latched else max(DEPTH, topic.depth))
            meter = TopicMeter(topic)
            self.meters.append(meter)
            self.subscribe_topic(topic, partial(self._on_message, meter), raw=True)
        self.subscribe_topic(topics.DIAGNOSTICS, self._on_diagnostics)

    def start(self, output: Path) -> None:
        """Start writing to a new bag; figures count from now.

        Raises:
            RecordingError: The folder exists already or cannot be made.
        """
        self.writer = BagWriter(output)
        for meter in self.meters:
            meter.restart()
            name, kind = meter.topic.resolved(self.get_namespace()), meter.topic.type_name
            self._connections[meter.topic.name] = self.writer.add_topic(
                name, kind, latched=meter.topic.latched
            )
        self._began_ns = time.time_ns()

    def finish(self) -> dict[str, Any] | None:
        """Write the queued messages and close the bag.

        Returns:
            Length [s] and losses for dataset.yaml; None without a bag.

        Raises:
            RecordingError: The bag could not be finished.
        """
        writer, self.writer = self.writer, None
        if writer is None:
            return None
        seconds = (time.time_ns() - self._began_ns) / 1e9
        writer.close()
        figures = {meter.topic.name: meter.figures() for meter in self.meters if meter.messages}
        return {
            'seconds': round(seconds, 3),
            'simulated': self._simulated,
            'serial': self._serial,
            'stopped': writer.failure,
            'not_written': writer.dropped,
            'not_arrived': sum(int(each['missing']) for each in figures.values()),
            'topics': figures,
        }

    def destroy_node(self) -> None:
        """Destroy the node; a bag that was not finished, because of an error, is now."""
        try:
            self.finish()
        finally:
            super().destroy_node()

    def _on_message(self, meter: TopicMeter, data: bytes) -> None:
        received_ns, name = time.time_ns(), meter.topic.name
        if not meter.add(received_ns, data):
            # Nobody could read it from the bag.
            self.get_logger().warning(f'damaged message on {name}', throttle_duration_sec=5.0)
        elif self.writer is not None:
            self.writer.write(self._connections[name], received_ns, data)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        own = self.get_namespace().strip('/')
        for status in message.status:
            namespace, _, name = status.name.rpartition('/')
            if namespace == own:
                self._simulated |= any(
                    v.key == 'simulated' and v.value == 'True' for v in status.values
                )
                self._serial = status.hardware_id if name == 'driver' else self._serial


def verdict(figures: Mapping[str, Any]) -> str:
    """Return one line about length and losses of a recording, from its figures."""
    lost = [f'{each["missing"]} of {n}' for n, each in figures['topics'].items() if each['missing']]
    parts = [f'messages lost: {", ".join(lost)}'] if lost else []
    if figures['not_written']:
        parts.append(f'{figures["not_written"]} messages not written: the disk failed or is slow')
    if figures['stopped']:
        parts.append(f'ended early ({figures["stopped"]}), complete until then')
    return f'{figures["seconds"]:.1f} s, {"; ".join(parts) or "no losses"}'


class RecorderNode(Listener):
    """Records from its start to its end; `mixtac record` adds progress."""

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
        self._diagnostics = DiagnosticsPublisher(self, 'recorder', self._status)
        self.start(self._output)

    def close(self) -> None:
        """Finish the bag."""
        try:
            if (figures := self.finish()) is None:
                return
            add_recording(self._output, figures, profile=self._p.profile, split=self._p.split)
        except MixtacError as error:
            self.get_logger().error(str(error))
            return
        lossy = figures['not_written'] or figures['stopped']
        log = self.get_logger().warning if lossy else self.get_logger().info
        log(f'{self._output}: {verdict(figures)}')

    def _status(self) -> Status:
        dropped = self.writer.dropped if self.writer else 0
        missing = {m.topic.name: m.missing for m in self.meters if m.missing}
        values: dict[str, object] = {
            'messages dropped': dropped,
            'messages': sum(m.messages for m in self.meters),
            'bytes': sum(m.size for m in self.meters),
            **{f'lost {name}': count for name, count in missing.items()},
        }
        text = 'recording'
        if self.writer and self.writer.failure:
            text = f'recording stopped: {self.writer.failure}; complete until then'
            self.get_logger().error(f'{self._output}: {text}', once=True)
        elif dropped:
            text = f'{dropped} messages dropped: disk too slow'
        return Status(WARN if dropped or missing else OK, text, values)


main = partial(run, RecorderNode)
