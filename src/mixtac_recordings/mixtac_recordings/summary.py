# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording and its losses."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_events.codec import StreamDecoder
from mixtac_events.packets import CodecError
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
        events, notes = {}, [bag.damage] if bag.damage else []
        for topic in bag.topics(EVENTS.type_name):
            counter = SequenceCounter()
            try:
                found = _count(_packets(bag, topic, counter))
            except (CodecError, DamagedRecordingError) as error:
                notes.append(f'{topic}: {error}')
                continue
            events[topic] = EventSummary(counter.received, counter.lost, *found)
        return BagSummary(bag.duration_ns / 1e9, bag.counts, bag.types, events, '; '.join(notes))


def _packets(bag: BagFile, topic: str, counter: SequenceCounter) -> Iterable[Events]:
    decoder = StreamDecoder()
    for _, _, message in bag.messages(topic):
        counter.update(message.seq)
        yield decoder.decode(message).events


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
            if kind == 'events':
                events[name] = EventSummary(len(packets), 0, *_count(_stream(file, packets)))
        if not counts:
            raise RecordingError(
                f'{path} holds no events, frames or inertial samples'
                + (f': {file.damage}' if file.damage else '')
            )
        length_us = int(index['end_us'].max() - index['start_us'].min())
        return BagSummary(length_us / 1e6, counts, types, events, file.damage)


def _stream(file: Aedat4File, packets: NDArray[Any]) -> Iterable[Events]:
    for packet in packets:
        data = file.packet(packet)
        try:
            for events in read_events(data):
                Piece(int(events.t[0]), int(events.t[-1]), advances=True, events=events).check()
                yield events
        except DamagedRecordingError as error:
            raise file.damaged(str(error)) from error


def _count(packets: Iterable[Events]) -> tuple[int, float, int]:
    """Return the number of events, their duration [s] and the steps backwards in time."""
    count = backward = 0
    first_us = last_us = None
    for events in packets:
        if not len(events):
            continue
        count += len(events)
        backward += int(np.count_nonzero(np.diff(events.t) < 0))
        backward += last_us is not None and int(events.t[0]) < last_us
        first_us = int(events.t[0]) if first_us is None else first_us
        last_us = int(events.t[-1])
    span_us = 0 if first_us is None or last_us is None else last_us - first_us
    return count, span_us / 1e6, backward
