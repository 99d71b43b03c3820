# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording and its losses."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_events.codec import StreamDecoder
from mixtac_events.packets import CodecError, read_packet
from mixtac_events.sequence import SequenceCounter
from mixtac_node.topics import EVENTS
from mixtac_recordings.aedat4 import read_events
from mixtac_recordings.aedat4_file import STREAMS, Aedat4File
from mixtac_recordings.bag import BagFile
from mixtac_recordings.recording import (
    AEDAT4_SUFFIX,
    DamagedRecordingError,
    Piece,
    RecordingError,
)


@dataclass(frozen=True)
class EventSummary:
    """The event packets of a recording, all of them decoded.

    Attributes:
        packets: Number of packets.
        lost_packets: Packets missing by their sequence numbers; 0 for formats without numbers.
        events: Number of events.
        duration_s: From the first to the last event, camera clock [s].
        backward_steps: Events that are older than the one before; 0 in a sound recording.
        outside: Events outside of the sensor, left out.
    """

    packets: int
    lost_packets: int
    events: int
    duration_s: float
    backward_steps: int
    outside: int = 0


@dataclass(frozen=True)
class BagSummary:
    """A recording at a glance.

    Attributes:
        duration_s: From the first to the last message [s]: host clock; camera clock for AEDAT4.
        counts: Messages by topic; packets by stream for AEDAT4.
        types: Type names by topic.
        events: Event figures by topic.
        damage: What is missing because the recording is incomplete, or topics whose packets cannot
            be decoded, with the reason; empty for a sound recording.
    """

    duration_s: float
    counts: dict[str, int]
    types: dict[str, str]
    events: dict[str, EventSummary]
    damage: str = ''


def summarise(path: Path) -> BagSummary:
    """Read a whole recording and count its events and losses.

    Args:
        path: Folder of a bag, or an .mcap, .db3 or .aedat4 file.

    Raises:
        RecordingError: It is missing, or nothing of it can be read.
    """
    if path.suffix.lower() == AEDAT4_SUFFIX:
        return _summarise_aedat4(path)
    with BagFile(path) as bag:
        notes = [bag.damage] if bag.damage else []
        counts = {topic: _PacketCount() for topic in bag.topics(EVENTS.type_name)}
        missing = sum(bag.counts.values())
        try:
            # All topics: only what is read shows its damage.
            for topic, _, data in bag.messages(*bag.types, raw=bag.types):
                missing -= 1
                if topic in counts:
                    counts[topic].add_packet(data)
        except DamagedRecordingError as error:
            notes.append(str(error))
        else:
            # Chunks without checksums may hold zeros instead of messages.
            notes += [f'{missing} messages of its index are missing'] if missing > 0 else []
        notes += [f'{topic}: {each.error}' for topic, each in counts.items() if each.error]
        events = {topic: each.summary() for topic, each in counts.items() if not each.error}
        return BagSummary(bag.duration_ns / 1e9, bag.counts, bag.types, events, '; '.join(notes))


def _summarise_aedat4(path: Path) -> BagSummary:
    with contextlib.closing(Aedat4File(path)) as file:
        index = file.index()
        streams = [s for s in file.streams if s.identifier in STREAMS]
        kinds = Counter(s.identifier for s in streams)
        counts, types, events = {}, {}, {}
        for stream in streams:
            packets = index[index['stream'] == stream.number]
            if not len(packets):
                continue
            kind = STREAMS[stream.identifier]
            name = f'{kind} {stream.number}' if kinds[stream.identifier] > 1 else kind
            counts[name] = len(packets)
            types[name] = f'AEDAT4 stream {stream.name!r} of {stream.source}'
            count = _EventCount(stream.width, stream.height)
            for part in _events(file, packets, kind):
                count.add(part)
            if kind == 'events':
                figures = (count.events, count.duration_s, count.backward, count.outside)
                events[name] = EventSummary(len(packets), 0, *figures)
        if not counts:
            raise RecordingError(
                f'{path} holds no events, frames or inertial samples'
                + (f': {file.damage}' if file.damage else '')
            )
        length_us = int(index['end_us'].max() - index['start_us'].min())
        return BagSummary(length_us / 1e6, counts, types, events, file.damage)


def _events(file: Aedat4File, packets: NDArray[Any], kind: str) -> Iterator[Events]:
    """Read all packets of a stream, and yield their events."""
    for packet in packets:
        try:
            data = file.packet(packet)
            parts = list(read_events(data)) if kind == 'events' else []
            for part in parts:
                Piece(int(part.t[0]), int(part.t[-1]), advances=True, events=part).check()
        except DamagedRecordingError as error:
            file.leave_out(int(packet['offset']), error)
        else:
            yield from parts


class _EventCount:
    """Counts events, steps backwards in time, and events outside of a sensor of a known size."""

    def __init__(self, width: int = 0, height: int = 0) -> None:
        self._size = (width, height)
        self.events = self.backward = self.outside = 0
        self._span_us: tuple[int, int] | None = None

    @property
    def duration_s(self) -> float:
        first_us, last_us = self._span_us or (0, 0)
        return (last_us - first_us) / 1e6

    def add(self, events: Events) -> None:
        if not len(events):
            return
        first_us, last_us = self._span_us or (int(events.t[0]), int(events.t[0]))
        width, height = self._size
        outside = 0
        if width and height:
            outside = int(np.count_nonzero((events.x >= width) | (events.y >= height)))
        self.outside += outside
        self.events += len(events) - outside
        self.backward += int(np.count_nonzero(np.diff(events.t, prepend=last_us) < 0))
        self._span_us = first_us, int(events.t[-1])


class _PacketCount(_EventCount):
    """Counts serialised packets and their events, until one cannot be decoded."""

    def __init__(self) -> None:
        super().__init__()
        self.error = ''
        self._decoder = StreamDecoder()
        self._sequence = SequenceCounter()

    def add_packet(self, data: bytes) -> None:
        if self.error:
            return
        try:
            packet = read_packet(data)
            self._sequence.update(packet.seq)
            self.add(self._decoder.decode(packet).events)
        except CodecError as error:
            self.error = str(error)

    def summary(self) -> EventSummary:
        sequence = self._sequence
        return EventSummary(
            sequence.received, sequence.lost, self.events, self.duration_s, self.backward
        )
