# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Count the received and the missing messages of a topic, and summarise a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mixtac_core.events.packets import CodecError, read_packet
from mixtac_core.events.sequence import SequenceCounter
from mixtac_core.node.topics import EVENTS, Topic


@dataclass
class TopicMeter:
    """Counts the messages of one topic. For one thread; others may read.

    Only event packets have numbers that show a loss. The other topics show their rate and their
    longest gap.

    Attributes:
        topic: The topic.
        messages: Messages that arrived.
        size: Their serialised size [bytes].
        missing: Event packets missing by their numbers.
        backwards: Event packets whose number is not after the previous one.
        longest_gap_ns: Longest time between two arrivals [ns].
        first_ns: Host time of the first arrival [ns], 0 before.
        last_ns: Host time of the latest arrival [ns], 0 before.
        damaged: Event packets that cannot be read; not among `messages`.
    """

    topic: Topic
    messages: int = 0
    size: int = 0
    missing: int = 0
    backwards: int = 0
    longest_gap_ns: int = 0
    first_ns: int = 0
    last_ns: int = 0
    damaged: int = 0
    _sequence: SequenceCounter = field(default_factory=SequenceCounter)

    def add(self, received_ns: int, data: bytes) -> bool:
        """Count a serialised message, arrived at a host time [ns]; return whether it is whole."""
        if self.topic.type_name == EVENTS.type_name:
            try:
                self._follow_sequence(read_packet(data).seq)
            except CodecError:
                self.damaged += 1
                return False
        self.messages += 1
        self.size += len(data)
        self.first_ns = self.first_ns or received_ns
        self.longest_gap_ns = max(self.longest_gap_ns, received_ns - (self.last_ns or received_ns))
        self.last_ns = received_ns
        return True

    def restart(self) -> None:
        """Count from zero."""
        self.messages = self.size = self.missing = self.backwards = 0
        self.longest_gap_ns = self.first_ns = self.last_ns = 0

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
            'longest_gap_s': round(1e-9 * self.longest_gap_ns, 6),
            'octets': self.size,
            'missing': self.missing,
            'backwards': self.backwards,
        }

    def _follow_sequence(self, seq: int) -> None:
        counter = self._sequence
        before = counter.restarts + counter.repeated
        self.missing += counter.update(seq)
        self.backwards += counter.restarts + counter.repeated - before


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
        """Event packets missing by their numbers."""
        return sum(int(each['missing']) for each in self.topics.values())

    def verdict(self) -> str:
        """Return one line about the losses."""
        lost = [f'{each["missing"]} of {n}' for n, each in self.topics.items() if each['missing']]
        parts = [f'packets lost: {", ".join(lost)}'] if lost else []
        if self.stopped:
            parts.append(f'ended early ({self.stopped}), complete until then')
        if self.dropped:
            why = 'failed' if self.stopped else 'was too slow'
            parts.append(f'{self.dropped} messages not written because the disk {why}')
        back = [name for name, each in self.topics.items() if each['backwards']]
        if back:
            parts.append(f'packet numbers went backwards on {", ".join(back)}')
        return '; '.join(parts) if parts else 'no event packet lost'

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
