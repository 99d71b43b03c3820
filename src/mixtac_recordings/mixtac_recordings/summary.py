# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a recording holds and what it lost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_events.codec import decode
from mixtac_recordings.bag import BagFile

if TYPE_CHECKING:
    from pathlib import Path


EVENT_TYPE = 'event_camera_msgs/msg/EventPacket'


@dataclass(frozen=True)
class EventSummary:
    """The event packets of a recording, all of them decoded.

    Attributes:
        packets: Number of packets.
        lost_packets: Packets missing by their sequence numbers.
        events: Number of events.
        duration_s: From the first to the last event, camera clock [s].
        backward_steps: Events that are older than the one before; 0 in a sound recording.
    """

    packets: int
    lost_packets: int
    events: int
    duration_s: float
    backward_steps: int


@dataclass(frozen=True)
class BagSummary:
    """A recording at a glance.

    Attributes:
        duration_s: From the first to the last message, host clock [s].
        counts: Messages by topic.
        types: Type names by topic.
        events: Event figures by topic.
    """

    duration_s: float
    counts: dict[str, int]
    types: dict[str, str]
    events: dict[str, EventSummary]


def summarise(path: Path) -> BagSummary:
    """Read a whole recording and say what it holds.

    Raises:
        BagError: It is missing or damaged.
        CodecError: A packet does not decode.
    """
    with BagFile(path) as bag:
        topics = [topic for topic, kind in bag.types.items() if kind == EVENT_TYPE]
        events = {topic: _event_summary(bag, topic) for topic in topics if bag.counts[topic]}
        return BagSummary(bag.duration_s, bag.counts, bag.types, events)


def _event_summary(bag: BagFile, topic: str) -> EventSummary:
    packets = lost = events = backward = 0
    first_us = last_us = last_seq = None
    for _, message in bag.messages(topic):
        packets += 1
        if last_seq is not None:
            lost += max(0, int(message.seq) - last_seq - 1)
        last_seq = int(message.seq)
        decoded = decode(
            message.events,
            message.encoding,
            int(message.time_base),
            width=message.width,
            height=message.height,
        ).events
        if not len(decoded):
            continue
        events += len(decoded)
        backward += int(np.count_nonzero(np.diff(decoded.t) < 0))
        backward += last_us is not None and decoded.t[0] < last_us
        first_us = decoded.t[0] if first_us is None else first_us
        last_us = decoded.t[-1]
    span_us = 0 if first_us is None or last_us is None else int(last_us - first_us)
    return EventSummary(packets, lost, events, span_us / 1e6, backward)
