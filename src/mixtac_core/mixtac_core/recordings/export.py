# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings as AEDAT4, CSV, HDF5 or NPZ, in one pass; only NPZ is held in memory."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import InertialSamples
from mixtac_core.node.files import new_folder
from mixtac_core.node.stamps import stamp_to_ns
from mixtac_core.node.topics import REFERENCE_WRENCH
from mixtac_core.recordings.aedat4 import Aedat4Writer
from mixtac_core.recordings.bag import BagFile
from mixtac_core.recordings.camera_stream import BagRecording, open_recording
from mixtac_core.recordings.recording import (
    ReadCounters,
    Recording,
    RecordingError,
    RecordingInfo,
    Selection,
)
from mixtac_core.recordings.writers import CsvWriter, Hdf5Writer, NpzWriter, TableWriter

AEDAT4_FILE = 'recording.aedat4'
Writer = Aedat4Writer | TableWriter
WRITERS: dict[str, Callable[[Path, RecordingInfo], Writer]] = {
    'aedat4': lambda folder, info: Aedat4Writer(folder / AEDAT4_FILE, info),
    'csv': lambda folder, _: CsvWriter(folder),
    'hdf5': lambda folder, _: Hdf5Writer(folder),
    'npz': lambda folder, _: NpzWriter(folder),
}
"""Formats of an export, by the name of `--to`: what makes the writer of a folder."""
ROWS = 1 << 14
"""Readings that are written at once."""
LEAST_HZ = 10.0
"""Fewer events per second than the noise of any event camera [1/s]."""
MOST_HZ = 1e8
"""More events per second than any event camera sends [1/s]."""
WRENCHES = 1000
"""Wrenches that are read at once."""


@dataclass
class Counts:
    """Numbers of exported or imported readings.

    Attributes:
        events: Events.
        frames: Frames.
        samples: Inertial samples.
        edges: Edges.
        wrenches: Wrenches by topic.
        size: Width and height of the camera.
        damage: What of the recording is missing; empty for a sound one.
        lost: Events and packets that the recording lacks, or that were left out.
        length_us: From the first to the last time [us]; known after an import.
        forces_replaced: Whether forces were left out for those of another file.
    """

    events: int = 0
    frames: int = 0
    samples: int = 0
    edges: int = 0
    wrenches: dict[str, int] = field(default_factory=dict)
    size: tuple[int, int] = (0, 0)
    damage: str = ''
    lost: ReadCounters = field(default_factory=ReadCounters)
    length_us: int = 0
    forces_replaced: bool = False

    def warnings(self) -> list[str]:
        """Return what is missing, a line each."""
        found = [self.damage] if self.damage else []
        if self.lost.packets_missing:
            found.append(f'{self.lost.packets_missing} packets missing')
        if self.lost.events_outside:
            width, height = self.size
            found.append(
                f'{self.lost.events_outside} events outside of {width} x {height} pixels left out'
            )
        if self.lost.events_unsorted:
            found.append(
                f'{self.lost.events_unsorted} events out of order in their message, sorted'
            )
        rate_hz = self.events / (1e-6 * self.length_us) if self.length_us else 0.0
        if self.events and self.length_us and not LEAST_HZ < rate_hz < MOST_HZ:
            found.append(f'{rate_hz:.3g} events per second: check the unit of their times')
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
        path: Folder of a bag, or an .mcap, .db3, .bag or .aedat4 file.
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
        counts = Counts(size=(info.width, info.height), lost=recording.counters)
        folder.mkdir()
        with contextlib.closing(WRITERS[kind](folder, info)) as writer:
            _export_camera(recording, writer, counts, progress)
            if isinstance(writer, TableWriter) and isinstance(recording, BagRecording):
                _export_wrenches(path, writer, counts)
        counts.damage = recording.info.damage
    return counts


Readings = TypeVar('Readings', Events, InertialSamples)


class _Gathered(Generic[Readings]):
    """Gathers readings and passes them on, `ROWS` or more at once, in order of time."""

    def __init__(
        self,
        write: Callable[[Readings], None],
        concatenate: Callable[[list[Readings]], Readings],
    ) -> None:
        self._write: Callable[[Readings], None] = write
        self._concatenate: Callable[[list[Readings]], Readings] = concatenate
        self._parts: list[Readings] = []
        self._count = 0

    def add(self, readings: Readings) -> int:
        """Add readings, and return how many they are."""
        count = len(readings.t)
        if not count:
            return 0
        if self._count >= ROWS or (self._parts and readings.t[0] < self._parts[-1].t[-1]):
            self.flush()
        self._parts.append(readings)
        self._count += count
        return count

    def flush(self) -> None:
        """Pass on what is left."""
        if self._parts:
            self._write(self._concatenate(self._parts))
            self._parts, self._count = [], 0


def _export_camera(
    recording: Recording,
    writer: Writer,
    counts: Counts,
    progress: Callable[[float], None],
) -> None:
    info, reported = recording.info, 0.0
    events = _Gathered(writer.events, Events.concatenate)
    samples = _Gathered(writer.samples, InertialSamples.concatenate)
    for piece in recording.pieces(0):
        counts.events += events.add(piece.events)
        counts.samples += samples.add(piece.imu)
        for frame in piece.frames:
            writer.frame(frame)
            counts.frames += 1
        if len(piece.edges.t):
            writer.edges(piece.edges)
            counts.edges += len(piece.edges.t)
        done = (piece.until_us - info.start_us) / max(info.length_us, 1)
        if done > reported + 0.005:
            reported = done
            progress(min(done, 1.0))
    events.flush()
    samples.flush()
    progress(1.0)


def _export_wrenches(path: Path, writer: TableWriter, counts: Counts) -> None:
    with BagFile(path) as bag:
        for topic in bag.topics(REFERENCE_WRENCH.type_name):
            for stamps, values in bag_wrenches(bag, topic):
                writer.wrenches(topic, stamps, values)
            counts.wrenches[topic] = bag.counts[topic]


def bag_wrenches(
    bag: BagFile, topic: str
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Yield stamps [ns, clock of the topic], [n], and wrenches [N, N m], [n, 6], of a topic."""
    messages = (message for _, _, message in bag.messages(topic))
    while found := list(itertools.islice(messages, WRENCHES)):
        stamps = np.array([stamp_to_ns(each.header.stamp) for each in found], np.int64)
        yield stamps, np.array([_six(each.wrench) for each in found])


def _six(wrench: Any) -> tuple[float, ...]:  # noqa: ANN401
    force, torque = wrench.force, wrench.torque
    return force.x, force.y, force.z, torque.x, torque.y, torque.z
