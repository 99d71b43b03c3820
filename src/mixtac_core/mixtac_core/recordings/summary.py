# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording and its losses."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import StreamDecoder
from mixtac_core.events.packets import CodecError, SequenceCounter, read_packet
from mixtac_core.node.topics import EVENTS, IMAGE_RAW
from mixtac_core.recordings.bag import BagFile, is_storage
from mixtac_core.recordings.camera_stream import open_recording
from mixtac_core.recordings.event_arrays import EVENT_ARRAYS, read_event_array
from mixtac_core.recordings.recording import (
    ROS1_SUFFIX,
    DamagedRecordingError,
    Recording,
)
from mixtac_core.recordings.tables import TableOptions


@dataclass
class EventSummary:
    """The events of a recording, all of them decoded.

    Attributes:
        packets: Number of packets; 0 for formats without.
        lost_packets: Packets missing by their sequence numbers; 0 for formats without numbers.
        events: Number of events.
        span_us: Times of the first and the last event [us, camera clock].
        backward_steps: Events that are older than the one before; 0 in a sound recording.
        outside: Events outside of the sensor, left out.
        error: Why packets cannot be decoded; empty if they can.
    """

    packets: int = 0
    lost_packets: int = 0
    events: int = 0
    span_us: tuple[int, int] = (0, 0)
    backward_steps: int = 0
    outside: int = 0
    error: str = ''

    @property
    def duration_s(self) -> float:
        """From the first to the last event [s]."""
        return (self.span_us[1] - self.span_us[0]) / 1e6

    def warnings(self) -> list[str]:
        """Return doubtful parts, one line for each."""
        steps = 'steps back in time, by a reset of the clock or disorder'
        texts = {steps: self.backward_steps, 'events outside of the sensor': self.outside}
        return [f'{count} {text}' for text, count in texts.items() if count]

    def add(self, events: Events) -> None:
        """Count events."""
        if len(events):
            first_us, last_us = self.span_us if self.events else (int(events.t[0]),) * 2
            self.events += len(events)
            self.backward_steps += int(np.count_nonzero(np.diff(events.t, prepend=last_us) < 0))
            self.span_us = first_us, int(events.t[-1])


@dataclass
class Summary:
    """A recording at a glance.

    Attributes:
        duration_s: From the first to the last message [s], host clock; or from the first to the
            last reading, camera clock, where the recording is no bag.
        counts: Messages by topic, or readings by kind.
        types: Type names by topic.
        events: Event figures by topic.
        damage: What is missing because the recording is incomplete, or topics whose packets cannot
            be decoded, with the reason; empty for a sound recording.
        warnings: What is doubtful, a line each.
    """

    duration_s: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)
    events: dict[str, EventSummary] = field(default_factory=dict)
    damage: str = ''
    warnings: list[str] = field(default_factory=list)


def summarise(path: Path, options: TableOptions | None = None) -> Summary:
    """Read a whole recording and count its events and losses.

    Args:
        path: A recording as for `open_recording`.
        options: As there.

    Raises:
        RecordingError: It is missing, or nothing of it can be read.
    """
    if path.is_file() and not is_storage(path) and path.suffix.lower() != ROS1_SUFFIX:
        with contextlib.closing(open_recording(path, options=options)) as recording:
            return _summarise_readings(recording)
    with BagFile(path) as bag:
        decoders = {
            topic: _Decoder(bag.types[topic])
            for topic in bag.topics(EVENTS.type_name, *EVENT_ARRAYS)
        }
        images = dict.fromkeys(bag.topics(IMAGE_RAW.type_name), 0)
        # The layout of a packet of ROS 1 is not that of CDR: the library reads it.
        raw = [t for t in bag.types if not bag.is_ros1 or bag.types[t] != EVENTS.type_name]
        missing, notes = sum(bag.counts.values()), []
        try:
            # All topics: only what is read shows its damage.
            for topic, _, data in bag.messages(*bag.types, raw=raw):
                missing -= 1
                if topic in decoders:
                    decoders[topic].add_packet(data)
                elif topic in images:
                    # The stamp lies behind the octets of the encoding, or the number of ROS 1.
                    images[topic] += not any(data[4:12])
        except DamagedRecordingError as error:
            notes.append(str(error))
        else:
            # Chunks without checksums may hold zeros instead of messages.
            notes += [f'{missing} messages of its index are missing'] if missing > 0 else []
        found = {topic: each.figures for topic, each in decoders.items()}
        warnings = [f'{t}: {n} images with the stamp zero' for t, n in images.items() if n]
        for topic, each in found.items():
            warnings += [f'{topic}: {text}' for text in each.warnings()]
        notes += [f'{topic}: {each.error}' for topic, each in found.items() if each.error]
        return Summary(
            bag.duration_ns / 1e9,
            bag.counts,
            bag.types,
            {topic: each for topic, each in found.items() if not each.error},
            '; '.join(filter(None, (bag.damage, *notes))),
            warnings,
        )


def _summarise_readings(recording: Recording) -> Summary:
    events, counts, damage = EventSummary(), dict.fromkeys(KINDS, 0), ''
    first_us = last_us = -1
    try:
        for piece in recording.pieces():
            first_us = piece.start_us if first_us < 0 else min(first_us, piece.start_us)
            last_us = max(last_us, piece.until_us)
            events.add(piece.events)
            sizes = (len(piece.events), len(piece.frames), len(piece.imu.t), len(piece.edges.t))
            for kind, size in zip(KINDS, sizes, strict=True):
                counts[kind] += size
    except DamagedRecordingError as error:
        damage = str(error)
    info, counters = recording.info, recording.counters
    warnings, events.outside = events.warnings() + counters.warnings(), counters.events_outside
    counts = {kind: size for kind, size in counts.items() if size}
    types = dict.fromkeys(counts, f'{info.kind} {info.camera}'.strip())
    found = {KINDS[0]: events} if events.events else {}
    return Summary((last_us - first_us) / 1e6, counts, types, found, damage, warnings)


KINDS = ('events', 'frames', 'imu', 'edges')
"""Kinds of readings."""


class _Decoder:
    """Decodes the serialised packets of a topic, until one cannot be decoded."""

    def __init__(self, type_name: str) -> None:
        self.figures = EventSummary()
        self._arrays = type_name in EVENT_ARRAYS
        self._decoder = StreamDecoder()
        self._sequence = SequenceCounter()

    def add_packet(self, data: Any) -> None:  # noqa: ANN401  (serialised, or a message of ROS 1)
        figures = self.figures
        if figures.error:
            return
        try:
            if self._arrays:
                array = read_event_array(data)
                figures.outside += array.outside
                figures.backward_steps += array.unsorted
                self._sequence.update(array.seq)
                figures.add(array.events)
            else:
                packet = data if hasattr(data, 'encoding') else read_packet(data)
                self._sequence.update(packet.seq)
                figures.add(self._decoder.decode(packet).events)
        except (CodecError, DamagedRecordingError) as error:
            figures.error = str(error)
        figures.packets, figures.lost_packets = self._sequence.received, self._sequence.lost
