# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What became of a recording: how much was written, and what was lost."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_bringup.record.meter import TopicMeter


@dataclass(frozen=True, slots=True)
class TopicFigures:
    """One topic of a recording.

    Attributes:
        messages: Messages that arrived.
        rate_hz: Their rate.
        octets: Their size [bytes].
        missing: See `TopicMeter`.
        backwards: See `TopicMeter`.
    """

    messages: int
    rate_hz: float
    octets: int
    missing: int
    backwards: int


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """A recording that has ended.

    Attributes:
        seconds: Its length on the host clock [s].
        dropped: Messages that arrived and were not written, as the disk was too slow.
        simulated: Whether the data say that they are.
        serial: Hardware id of the driver.
        topics: Figures of the topics on which anything arrived, by name.
    """

    seconds: float
    dropped: int
    simulated: bool
    serial: str
    topics: dict[str, TopicFigures]

    @staticmethod
    def of(
        meters: Sequence[TopicMeter], seconds: float, dropped: int, *, simulated: bool, serial: str
    ) -> RecordingSummary:
        """Return the summary of what was metered."""
        topics = {
            m.topic.name: TopicFigures(m.messages, m.rate_hz, m.octets, m.missing, m.backwards)
            for m in meters
            if m.messages
        }
        return RecordingSummary(seconds, dropped, simulated, serial, topics)

    @property
    def missing(self) -> int:
        """Messages that did not arrive, of all topics."""
        return sum(each.missing for each in self.topics.values())

    def verdict(self) -> str:
        """Return one line that says what was lost."""
        lost = [f'{t.missing} of {name}' for name, t in self.topics.items() if t.missing]
        parts = [f'did not arrive: {", ".join(lost)}'] if lost else []
        if self.dropped:
            parts.append(f'{self.dropped} messages not written: the disk was too slow')
        back = [name for name, t in self.topics.items() if t.backwards]
        if back:
            parts.append(f'stamps or numbers went back on {", ".join(back)}')
        return '; '.join(parts) if parts else 'nothing was lost'

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for YAML and JSON."""
        return {
            'seconds': round(self.seconds, 3),
            'simulated': self.simulated,
            'serial': self.serial,
            'not_written': self.dropped,
            'not_arrived': self.missing,
            'topics': {
                name: {**asdict(each), 'rate_hz': round(each.rate_hz, 3)}
                for name, each in self.topics.items()
            },
        }
