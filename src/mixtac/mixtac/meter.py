# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Count the received and the missing messages of a topic, and summarise a recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from mixtac_core.events.packets import CodecError, SequenceCounter, header_stamp_ns, read_packet
from mixtac_core.node import topics
from mixtac_core.node.topics import Topic

EVEN = {each.name for each in (topics.IMAGE_RAW, topics.FORCE, topics.IMU, topics.TRUTH_WRENCH)}
"""Topics whose stamps are evenly spaced; the reference force is another one."""
GAP = 1.5
"""A message is missing if two stamps are this many usual intervals apart."""
LEARNING = 16
"""Number of latest intervals whose median is the usual one."""


@dataclass
class TopicMeter:
    """Counts the messages of one topic. For one thread; others may read.

    Attributes:
        topic: The topic.
        even: Whether its stamps are evenly spaced.
        messages: Messages that arrived.
        size: Their serialised size [bytes].
        missing: Messages lost: by the numbers of event packets, by gaps in the stamps of evenly
            spaced topics.
        backwards: Stamps or numbers that are not after the previous one.
        first_ns: Host time of the first arrival [ns], 0 before.
        last_ns: Host time of the latest arrival [ns], 0 before.
        stamp_ns: Latest stamp [ns, clock of the topic].
        damaged: Messages that were cut off or otherwise not readable; not among `messages`.
    """

    topic: Topic
    even: bool
    messages: int = 0
    size: int = 0
    missing: int = 0
    backwards: int = 0
    first_ns: int = 0
    last_ns: int = 0
    stamp_ns: int = 0
    damaged: int = 0
    _sequence: SequenceCounter = field(default_factory=SequenceCounter)
    _intervals_ns: deque[int] = field(default_factory=lambda: deque(maxlen=LEARNING))

    def add(self, received_ns: int, data: bytes) -> bool:
        """Count a serialised message, arrived at a host time [ns]; return whether it is whole."""
        is_events = self.topic.type_name == topics.EVENTS.type_name
        try:
            seq = read_packet(data).seq if is_events else 0
            stamp_ns = header_stamp_ns(data) if self.topic.has_header else 0
        except CodecError:
            self.damaged += 1
            return False
        self.messages += 1
        self.size += len(data)
        self.first_ns = self.first_ns or received_ns
        self.last_ns = received_ns
        if is_events:
            self._follow_sequence(seq)
        if self.topic.has_header:
            self._follow_stamp(stamp_ns)
        return True

    def restart(self) -> None:
        """Count from zero; the usual interval stays known."""
        self.messages = self.size = self.missing = self.backwards = 0
        self.first_ns = self.last_ns = 0

    @property
    def rate_hz(self) -> float:
        """Messages per second between first and latest arrival."""
        span_ns = self.last_ns - self.first_ns
        return (self.messages - 1) * 1e9 / span_ns if span_ns > 0 else 0.0

    def figures(self) -> dict[str, float]:
        """Return the figures of the topic for YAML and JSON."""
        return {
            'messages': self.messages,
            'rate_hz': round(self.rate_hz, 3),
            'octets': self.size,
            'missing': self.missing,
            'backwards': self.backwards,
        }

    def _follow_sequence(self, seq: int) -> None:
        counter = self._sequence
        before = counter.restarts + counter.repeated
        self.missing += counter.update(seq)
        self.backwards += counter.restarts + counter.repeated - before

    def _follow_stamp(self, stamp_ns: int) -> None:
        last_ns, self.stamp_ns = self.stamp_ns, stamp_ns
        if not self.even or not last_ns:
            return
        interval_ns = stamp_ns - last_ns
        if interval_ns <= 0:
            self.backwards += 1
            return
        if len(self._intervals_ns) == LEARNING:
            # The median of the latest ones follows a change of the exposure interval.
            usual_ns = median(self._intervals_ns)
            if interval_ns > GAP * usual_ns:
                self.missing += round(interval_ns / usual_ns) - 1
        self._intervals_ns.append(interval_ns)


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """A finished recording.

    Attributes:
        seconds: Its length on the host clock [s].
        dropped: Messages that arrived but were not written: the disk was too slow, or failed.
        simulated: Whether the diagnostics report simulated data.
        serial: Hardware id of the driver.
        topics: Figures of the topics with messages, by name; see `TopicMeter.figures`.
        stopped: Error of the disk that ended the recording early; empty for none.
    """

    seconds: float
    dropped: int
    simulated: bool
    serial: str
    topics: Mapping[str, Mapping[str, float]]
    stopped: str = ''

    @property
    def missing(self) -> int:
        """Lost messages of all topics."""
        return sum(int(each['missing']) for each in self.topics.values())

    def verdict(self) -> str:
        """Return one line about the losses."""
        lost = [f'{each["missing"]} of {n}' for n, each in self.topics.items() if each['missing']]
        parts = [f'messages lost: {", ".join(lost)}'] if lost else []
        if self.stopped:
            parts.append(f'ended early ({self.stopped}), complete until then')
        if self.dropped:
            why = 'failed' if self.stopped else 'was too slow'
            parts.append(f'{self.dropped} messages not written because the disk {why}')
        back = [name for name, each in self.topics.items() if each['backwards']]
        if back:
            parts.append(f'stamps or numbers went backwards on {", ".join(back)}')
        return '; '.join(parts) if parts else 'no losses'

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for YAML and JSON."""
        return {
            'seconds': round(self.seconds, 3),
            'simulated': self.simulated,
            'serial': self.serial,
            'stopped': self.stopped,
            'not_written': self.dropped,
            'not_arrived': self.missing,
            'topics': {name: dict(each) for name, each in self.topics.items()},
        }
