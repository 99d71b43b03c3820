# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counts what arrived on a topic, and what is missing in between."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mixtac_events.packets import header_stamp_ns, read_packet

if TYPE_CHECKING:
    from mixtac_node.topics import Topic


EVENT_TYPE = 'event_camera_msgs/msg/EventPacket'
EVEN = {'image_raw', 'force', 'imu', 'truth/wrench'}
"""Topics whose messages are evenly spaced in stamps; with `reference_topic`."""
GAP = 1.5
"""A message is missing where the stamps are this many usual intervals apart."""
LEARNING = 16
"""Intervals from which the usual one is known."""


@dataclass
class TopicMeter:
    """Counts the messages of one topic. For one thread; others may read.

    Attributes:
        topic: The topic.
        even: Whether its stamps are evenly spaced.
        messages: Messages that arrived.
        octets: Their serialised size [bytes].
        missing: Messages that did not arrive: by sequence numbers of packets, by gaps in the stamps
            of topics that are evenly spaced.
        backwards: Stamps or numbers that are not after the one before.
        first_ns: Host time of the first arrival [ns], 0 before.
        last_ns: Host time of the latest arrival [ns], 0 before.
        stamp_ns: Latest stamp [ns, clock of the topic].
    """

    topic: Topic
    even: bool
    messages: int = 0
    octets: int = 0
    missing: int = 0
    backwards: int = 0
    first_ns: int = 0
    last_ns: int = 0
    stamp_ns: int = 0
    _sequence: int | None = None
    _intervals: list[int] = field(default_factory=list)
    _usual_ns: int = 0

    def add(self, received_ns: int, data: bytes) -> None:
        """Count a serialised message that arrived at a host time [ns]."""
        self.messages += 1
        self.octets += len(data)
        self.first_ns = self.first_ns or received_ns
        self.last_ns = received_ns
        if self.topic.type_name == EVENT_TYPE:
            self._follow_sequence(read_packet(data).seq)
        if self.topic.has_header:
            self._follow_stamp(header_stamp_ns(data))

    def restart(self) -> None:
        """Count from zero; what is known of the usual interval stays."""
        self.messages = self.octets = self.missing = self.backwards = 0
        self.first_ns = self.last_ns = 0

    @property
    def rate_hz(self) -> float:
        """Messages per second between first and latest arrival."""
        span_ns = self.last_ns - self.first_ns
        return (self.messages - 1) * 1e9 / span_ns if span_ns > 0 else 0.0

    def _follow_sequence(self, sequence: int) -> None:
        if self._sequence is not None:
            # The driver counts from zero again when it is restarted.
            self.missing += max(0, sequence - self._sequence - 1)
            self.backwards += sequence <= self._sequence
        self._sequence = sequence

    def _follow_stamp(self, stamp_ns: int) -> None:
        last_ns, self.stamp_ns = self.stamp_ns, stamp_ns
        if not self.even or not last_ns:
            return
        interval_ns = stamp_ns - last_ns
        self.backwards += interval_ns <= 0
        if interval_ns <= 0:
            return
        if self._usual_ns and interval_ns > GAP * self._usual_ns:
            self.missing += round(interval_ns / self._usual_ns) - 1
        self._learn(interval_ns)

    def _learn(self, interval_ns: int) -> None:
        # A median of the latest ones, so that a new exposure interval is followed.
        self._intervals.append(interval_ns)
        if len(self._intervals) == LEARNING:
            self._usual_ns = sorted(self._intervals)[LEARNING // 2]
            self._intervals.clear()
