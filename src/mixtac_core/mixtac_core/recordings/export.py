# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Export recordings to AEDAT4, CSV, HDF5 or NPZ in one pass; only NPZ is held in memory."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import InertialSamples
from mixtac_core.events.windows import RESTART_US
from mixtac_core.node.files import new_folder
from mixtac_core.recordings.aedat4 import Aedat4Writer
from mixtac_core.recordings.camera_stream import open_recording
from mixtac_core.recordings.recording import (
    AEDAT4_FILE,
    Piece,
    ReadCounters,
    Recording,
    RecordingError,
    RecordingInfo,
    Selection,
)
from mixtac_core.recordings.writers import CsvWriter, Hdf5Writer, NpzWriter, TableWriter

Writer = Aedat4Writer | TableWriter
WRITERS: dict[str, Callable[[Path, RecordingInfo], Writer]] = {
    'aedat4': lambda folder, info: Aedat4Writer(folder / AEDAT4_FILE, info),
    'csv': lambda folder, _: CsvWriter(folder),
    'hdf5': lambda folder, _: Hdf5Writer(folder),
    'npz': lambda folder, _: NpzWriter(folder),
}
"""Formats of an export, by the name of `--to`: what makes the writer of a folder."""
PIECES = 500
"""Pieces that are written at once."""
LEAST_HZ = 10.0
"""Fewer events per second than the noise of any event camera [1/s]."""
MOST_HZ = 1e8
"""More events per second than any event camera sends [1/s]."""
COARSEST_US = 1000
"""Least grid of the times of events that is reported [us]: windows are of milliseconds."""


@dataclass
class Counts:
    """Numbers of exported or imported readings.

    Attributes:
        info: Description of the recording.
        lost: Events and packets that the recording lacks, or that were left out.
        events: Events.
        frames: Frames.
        samples: Inertial samples.
        edges: Edges.
        wrenches: Wrenches by topic.
        length_us: From the first to the last time [us]; known after an import.
        grid_us: Greatest common divisor of the times between events [us]; 0 if unknown.
        forces_replaced: Whether forces were left out for those of another file.
    """

    info: RecordingInfo
    lost: ReadCounters
    events: int = 0
    frames: int = 0
    samples: int = 0
    edges: int = 0
    wrenches: dict[str, int] = field(default_factory=dict)
    length_us: int = 0
    grid_us: int = 0
    forces_replaced: bool = False

    def add(self, piece: Piece) -> None:
        """Count the readings of a piece."""
        self.events += len(piece.events)
        self.samples += len(piece.imu.t)
        self.frames += len(piece.frames)
        self.edges += len(piece.edges.t)

    def add_times(self, events: Events, latest_us: int) -> None:
        """Narrow the grid of the times down by events after those until `latest_us`."""
        if self.grid_us != 1:
            steps = np.diff(events.t, prepend=events.t[0] if latest_us < 0 else latest_us)
            self.grid_us = int(np.gcd.reduce(steps, initial=self.grid_us))

    def warnings(self) -> list[str]:
        """Return missing and doubtful parts, one line for each."""
        found = [self.info.damage] if self.info.damage else []
        found += self.lost.warnings()
        if not self.info.size_known:
            found.append(
                f'the file states no size of the camera: {self.info.width} x {self.info.height} is'
                ' assumed, give it with --size'
            )
        rate_hz = self.events / (1e-6 * self.length_us) if self.length_us else 0.0
        if self.events and self.length_us and not LEAST_HZ < rate_hz < MOST_HZ:
            found.append(f'{rate_hz:.3g} events per second: check the unit of their times')
        if self.grid_us >= COARSEST_US and self.events > 1:
            found.append(
                f'times of events are on a grid of {self.grid_us} us, too coarse for 1 ms windows'
            )
        if self.forces_replaced:
            found.append('the forces of the recording are left out for those of the other file')
        return found


def export_recording(
    path: Path,
    kind: str,
    out: Path,
    progress: Callable[[float], None] = lambda _done: None,
    selection: Selection | None = None,
) -> Counts:
    """Write a recording in another format, whole or not at all.

    Args:
        path: A recording as for `open_recording`.
        kind: One of `WRITERS`.
        out: New folder.
        progress: Called with the fraction done, 0 to 1.
        selection: Which of its topics or streams; None for the only one of each kind.

    Raises:
        RecordingError: The recording cannot be read, the choice is ambiguous, or the format is
            unknown.
        FileError: The folder exists or cannot be written.
    """
    if kind not in WRITERS:
        raise RecordingError(
            f'unknown format {kind!r}', remedy=f'choose one of {", ".join(WRITERS)}'
        )
    with (
        contextlib.closing(open_recording(path, selection)) as recording,
        new_folder(out) as folder,
    ):
        info = recording.info
        counts = Counts(info, recording.counters)
        folder.mkdir()
        with contextlib.closing(WRITERS[kind](folder, info)) as writer:
            _export_camera(recording, writer, counts, progress)
            if isinstance(writer, TableWriter):
                for topic, parts in recording.wrenches().items():
                    for stamps, values in parts:
                        writer.wrenches(topic, stamps, values)
                        counts.wrenches[topic] = counts.wrenches.get(topic, 0) + len(stamps)
        counts.info = recording.info
    return counts


def _export_camera(
    recording: Recording,
    writer: Writer,
    counts: Counts,
    progress: Callable[[float], None],
) -> None:
    info, held = recording.info, list[Piece]()
    for piece in recording.pieces():
        # A clock that was reset begins a new part.
        if len(held) == PIECES or (held and piece.until_us < held[-1].until_us - RESTART_US):
            _write_pieces(held, writer, counts)
            progress(min((piece.until_us - info.start_us) / max(info.length_us, 1), 1.0))
            held = []
        held.append(piece)
    _write_pieces(held, writer, counts)
    progress(1.0)


def _write_pieces(pieces: list[Piece], writer: Writer, counts: Counts) -> None:
    if not pieces:
        return
    events = Events.concatenate([piece.events for piece in pieces])
    samples = InertialSamples.concatenate([piece.imu for piece in pieces])
    if len(events):
        writer.events(events)
    if len(samples.t):
        writer.samples(samples)
    for piece in pieces:
        counts.add(piece)
        for frame in piece.frames:
            writer.frame(frame)
        if len(piece.edges.t):
            writer.edges(piece.edges)
