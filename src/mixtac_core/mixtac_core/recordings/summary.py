# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording and its losses."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import StreamDecoder
from mixtac_core.events.packets import CodecError, read_packet
from mixtac_core.events.sequence import SequenceCounter
from mixtac_core.node.topics import EVENTS
from mixtac_core.recordings.aedat4 import KINDS, Aedat4Recording
from mixtac_core.recordings.bag import BagFile
from mixtac_core.recordings.event_arrays import EVENT_ARRAYS, read_event_array
from mixtac_core.recordings.recording import AEDAT4_SUFFIX, DamagedRecordingError


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
        counts: Messages by topic; readings by kind for AEDAT4.
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
        path: Folder of a bag, or an .mcap, .db3, .bag or .aedat4 file.

    Raises:
        RecordingError: It is missing, or nothing of it can be read.
    """
    if path.suffix.lower() == AEDAT4_SUFFIX and path.is_file():
        return _summarise_aedat4(path)
    with BagFile(path) as bag:
        counts = {
            t: _PacketCount(bag.types[t]) for t in bag.topics(EVENTS.type_name, *EVENT_ARRAYS)
        }
        missing, notes = sum(bag.counts.values()), []
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
        damage = '; '.join(filter(None, (bag.damage, *notes)))
        return BagSummary(bag.duration_ns / 1e9, bag.counts, bag.types, events, damage)


def _summarise_aedat4(path: Path) -> BagSummary:
    with contextlib.closing(Aedat4Recording(path)) as recording:
        info, count, damage = recording.info, _EventCount(), ''
        counts: dict[str, int] = {}
        try:
            for piece in recording.pieces(0):
                count.add(piece.events)
                sizes = (len(piece.events), len(piece.frames), len(piece.imu.t), len(piece.edges.t))
                for kind, size in zip(KINDS, sizes, strict=True):
                    counts[kind] = counts.get(kind, 0) + size
        except DamagedRecordingError as error:
            damage = str(error)
        counts = {kind: size for kind, size in counts.items() if size}
        types = dict.fromkeys(counts, f'AEDAT4 of {info.camera}')
        outside = recording.counters.events_outside
        figures = (count.events, count.duration_s, count.backward, outside)
        events = {KINDS[0]: EventSummary(0, 0, *figures)} if count.events else {}
        return BagSummary(info.length_us / 1e6, counts, types, events, damage)


class _EventCount:
    """Counts events and steps backwards in time."""

    def __init__(self) -> None:
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
        self.events += len(events)
        self.backward += int(np.count_nonzero(np.diff(events.t, prepend=last_us) < 0))
        self._span_us = first_us, int(events.t[-1])


class _PacketCount(_EventCount):
    """Counts serialised packets of a type and their events, until one cannot be decoded."""

    def __init__(self, type_name: str) -> None:
        super().__init__()
        self.error = ''
        self._arrays = type_name in EVENT_ARRAYS
        self._decoder = StreamDecoder()
        self._sequence = SequenceCounter()

    def add_packet(self, data: bytes) -> None:
        if self.error:
            return
        try:
            if self._arrays:
                array = read_event_array(data)
                self.outside += array.outside
                self.backward += array.unsorted
                self._sequence.update(array.seq)
                self.add(array.events)
            else:
                packet = read_packet(data)
                self._sequence.update(packet.seq)
                self.add(self._decoder.decode(packet).events)
        except (CodecError, DamagedRecordingError) as error:
            self.error = str(error)

    def summary(self) -> EventSummary:
        sequence, figures = self._sequence, (self.events, self.duration_s, self.backward)
        return EventSummary(sequence.received, sequence.lost, *figures, self.outside)
