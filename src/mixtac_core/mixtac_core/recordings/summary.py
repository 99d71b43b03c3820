# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording, its losses, and what is doubtful in it."""

from __future__ import annotations

import contextlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from mixtac_core.node.topics import EVENTS, IMAGE_RAW
from mixtac_core.recordings.bag import BagFile, is_bag
from mixtac_core.recordings.camera_stream import (
    EVENT_ARRAYS,
    BagRecording,
    Recording,
    open_recording,
)
from mixtac_core.recordings.recording import (
    LATEST_US,
    NONE,
    DamagedRecordingError,
    Piece,
    ReadCounters,
    RecordingError,
    RecordingInfo,
    Selection,
)
from mixtac_core.recordings.tables import TableOptions

LEAST_HZ: Final = 10.0
"""Fewer events per second than the noise of any event camera [1/s]."""
MOST_HZ: Final = 1e8
"""More events per second than any event camera sends [1/s]."""
COARSEST_US: Final = 1000
"""Least grid of the times of events that is reported [us]: windows are of milliseconds."""


@dataclass
class Counts:
    """Numbers of readings of one camera.

    Attributes:
        info: Description of the recording.
        lost: Events and packets that the recording lacks, or that were left out.
        events: Events.
        frames: Frames.
        samples: Inertial samples.
        edges: Edges.
        wrenches: Wrenches by topic.
        backward_steps: Events that are older than the one before; 0 in a sound recording.
        back_us: Time of one of these [us].
        first_us: Time of the first reading [us].
        last_us: Time of the last reading [us].
        grid_us: Greatest common divisor of the times between events [us]; 0 if unknown.
    """

    info: RecordingInfo
    lost: ReadCounters
    events: int = 0
    frames: int = 0
    samples: int = 0
    edges: int = 0
    wrenches: dict[str, int] = field(default_factory=dict)
    backward_steps: int = 0
    back_us: int = 0
    first_us: int = LATEST_US
    last_us: int = 0
    grid_us: int = 0
    _latest_us: int | None = None

    def add(self, piece: Piece) -> None:
        """Count the readings of a piece."""
        self.events += len(piece.events)
        self.samples += len(piece.imu.t)
        self.frames += len(piece.frames)
        self.edges += len(piece.edges.t)
        self.first_us = min(self.first_us, piece.start_us)
        self.last_us = max(self.last_us, piece.until_us)
        if len(piece.events):
            t = piece.events.t
            steps = np.diff(t, prepend=t[0] if self._latest_us is None else self._latest_us)
            if (back := steps < 0).any():
                self.backward_steps += int(np.count_nonzero(back))
                self.back_us = int(t[back][0])
            self._latest_us = int(t[-1])
            if self.grid_us != 1:
                self.grid_us = int(np.gcd.reduce(steps, initial=self.grid_us))

    @property
    def seconds(self) -> float:
        """From the first to the last reading [s]."""
        return 1e-6 * max(self.last_us - self.first_us, 0)

    def warnings(self) -> list[str]:
        """Return losses and doubtful parts, one line for each; damage is in `info`."""
        found = self.lost.warnings()
        if not self.info.size_known:
            found.append(
                f'the file states no size of the camera: {self.info.width} x {self.info.height} is'
                ' assumed, give it with --size'
            )
        if self.backward_steps:
            found.append(
                f'{self.backward_steps} steps back in time, as at {self.back_us} us: a reset of the'
                ' clock, or disorder'
            )
        rate_hz = self.events / self.seconds if self.seconds else 0.0
        if rate_hz and not LEAST_HZ < rate_hz < MOST_HZ:
            found.append(f'{rate_hz:.3g} events per second: check the unit of their times')
        if self.grid_us >= COARSEST_US:
            found.append(
                f'times of events are on a grid of {self.grid_us} us, too coarse for 1 ms windows'
            )
        return found


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

    duration_s: float
    counts: Counter[str]
    types: dict[str, str]
    events: dict[str, Counts] = field(default_factory=dict)
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
            each, damage = _counted(recording)
        kinds = {'events': each.events, 'frames': each.frames, 'imu': each.samples}
        kinds['edges'] = each.edges
        types = {k: f'{each.info.kind} {each.info.camera}'.strip() for k, n in kinds.items() if n}
        figures = {'events': each} if each.events else {}
        return Summary(each.seconds, +Counter(kinds), types, figures, damage, each.warnings())
    with BagFile(path) as bag:
        found = Summary(bag.duration_ns / 1e9, bag.counts, bag.types)
        missing, notes, zero = bag.counts.total(), [], Counter[str]()
        try:
            # All topics: only what is read shows its damage.
            for topic, _, data in bag.messages(*bag.types, raw=bag.types):
                missing -= 1
                # The stamp is at the same place in ROS 1 and 2.
                zero[topic] += bag.types[topic] == IMAGE_RAW.type_name and not any(data[4:12])
            # Chunks without checksums may hold zeros instead of messages.
            notes += [f'{missing} messages of its index are missing'] if missing > 0 else []
        except DamagedRecordingError as error:
            notes.append(str(error))
        events = bag.topics(EVENTS.type_name, *(EVENT_ARRAYS if bag.is_ros1 else ()))
        notes.insert(0, bag.damage)
    found.warnings += [f'{topic}: {n} images with the stamp zero' for topic, n in (+zero).items()]
    for topic in events:
        try:
            with contextlib.closing(BagRecording(path, Selection(topic, NONE, NONE))) as recording:
                found.events[topic], damage = _counted(recording)
            found.warnings += [f'{topic}: {text}' for text in found.events[topic].warnings()]
            notes.append(damage)
        except RecordingError as error:
            notes.append(str(error))
    # Damage of a file shows in each of its topics.
    found.damage = '; '.join(filter(None, dict.fromkeys(notes)))
    return found


def _counted(recording: Recording) -> tuple[Counts, str]:
    """Return the numbers of all readings, and the damage that ends them."""
    counts = Counts(recording.info, recording.counters)
    try:
        for piece in recording.pieces():
            counts.add(piece)
    except DamagedRecordingError as error:
        return counts, str(error)
    return counts, ''
