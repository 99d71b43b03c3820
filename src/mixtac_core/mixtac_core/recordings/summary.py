# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording and its losses."""

from __future__ import annotations

import contextlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mixtac_core.node.topics import EVENTS
from mixtac_core.recordings.bag import BagFile, is_bag
from mixtac_core.recordings.camera_stream import BagRecording, open_recording
from mixtac_core.recordings.event_arrays import EVENT_ARRAYS
from mixtac_core.recordings.recording import (
    NONE,
    DamagedRecordingError,
    Recording,
    RecordingError,
    Selection,
)
from mixtac_core.recordings.tables import TableOptions


@dataclass
class EventSummary:
    """The events of a recording, all of them decoded.

    Attributes:
        events: Number of events.
        lost_packets: Packets missing by their sequence numbers; 0 for formats without numbers.
        backward_steps: Events that are older than the one before; 0 in a sound recording.
        outside: Events outside of the sensor, left out.
    """

    events: int = 0
    lost_packets: int = 0
    backward_steps: int = 0
    outside: int = 0


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
    counts: Counter[str] = field(default_factory=Counter)
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
    if not is_bag(path):
        with contextlib.closing(open_recording(path, options=options)) as recording:
            return _summarise_readings(recording)
    with BagFile(path) as bag:
        found = Summary(bag.duration_ns / 1e9, bag.counts, bag.types)
        missing, notes = bag.counts.total(), []
        try:
            # All topics: only what is read shows its damage.
            for _ in bag.messages(*bag.types, raw=bag.types):
                missing -= 1
            # Chunks without checksums may hold zeros instead of messages.
            notes += [f'{missing} messages of its index are missing'] if missing > 0 else []
        except DamagedRecordingError as error:
            notes.append(str(error))
        events = bag.topics(EVENTS.type_name, *(EVENT_ARRAYS if bag.is_ros1 else ()))
        notes.insert(0, bag.damage)
    for topic in events:
        try:
            with contextlib.closing(BagRecording(path, Selection(topic, NONE, NONE))) as each:
                part = _summarise_readings(each)
            found.events[topic] = part.events.get('events', EventSummary())
            found.warnings += [f'{topic}: {text}' for text in part.warnings]
            notes.append(part.damage)
        except RecordingError as error:
            notes.append(str(error))
    # Damage of a file shows in each of its topics.
    found.damage = '; '.join(filter(None, dict.fromkeys(notes)))
    return found


def _summarise_readings(recording: Recording) -> Summary:
    found, steps = Summary(), 0
    first_us, last_us, latest_us = None, 0, 0
    try:
        for piece in recording.pieces():
            first_us = piece.start_us if first_us is None else min(first_us, piece.start_us)
            last_us = max(last_us, piece.until_us)
            found.counts.update(events=len(piece.events), frames=len(piece.frames))
            found.counts.update(imu=len(piece.imu.t), edges=len(piece.edges.t))
            if len(piece.events):
                steps += int(np.count_nonzero(np.diff(piece.events.t, prepend=latest_us) < 0))
                latest_us = int(piece.events.t[-1])
    except DamagedRecordingError as error:
        found.damage = str(error)
    info, counters = recording.info, recording.counters
    found.duration_s = 1e-6 * (last_us - (first_us or 0))
    found.counts = +found.counts  # without zeros
    found.types = dict.fromkeys(found.counts, f'{info.kind} {info.camera}'.strip())
    found.warnings = counters.warnings()
    if steps:
        found.warnings.append(f'{steps} steps back in time, by a reset of the clock or disorder')
    if 'events' in found.counts:
        found.events['events'] = EventSummary(
            found.counts['events'],
            counters.packets_missing,
            steps + counters.events_unsorted,
            counters.events_outside,
        )
    return found
