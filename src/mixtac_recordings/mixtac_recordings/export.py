# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings as AEDAT4, CSV, HDF5 or NPZ, in one pass per kind of data, in constant memory."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_events.readings import InertialSamples
from mixtac_node.files import new_folder
from mixtac_node.stamps import stamp_to_ns
from mixtac_node.topics import REFERENCE_WRENCH
from mixtac_recordings.bag import BagFile
from mixtac_recordings.camera_stream import open_recording
from mixtac_recordings.recording import (
    AEDAT4_SUFFIX,
    ReadCounters,
    Recording,
    RecordingError,
    Selection,
)
from mixtac_recordings.sinks import (
    Aedat4Sink,
    CsvSink,
    Hdf5Sink,
    NpzSink,
    TableSink,
    load_h5py,
)

FORMATS = ('aedat4', 'csv', 'hdf5', 'npz')
PACKET_US = 10_000
"""Length of the packets of an AEDAT4 file, as DV writes those of events."""
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
        if self.forces_replaced:
            found.append('the forces of the recording are left out for those of the other file')
        return found


def export_recording(
    path: Path,
    kind: str,
    out: Path,
    progress: Callable[[float], None] = lambda _done: None,
    selection: Selection | None = None,
    *,
    whole: bool = False,
) -> Counts:
    """Write a recording in another format, in constant memory, whole or not at all.

    Args:
        path: Folder of a bag, or an .mcap, .db3 or .aedat4 file.
        kind: One of `FORMATS`.
        out: New folder.
        progress: Called with the fraction done, 0 to 1.
        selection: Which of its topics or streams; None for the only one of each kind.
        whole: As in `open_recording`.

    Raises:
        RecordingError: The recording cannot be read, the choice is ambiguous, or the format is
            unknown.
        FileError: The folder exists or cannot be written.
    """
    if kind not in FORMATS:
        raise RecordingError(
            f'unknown format {kind!r}', remedy=f'choose one of {", ".join(FORMATS)}'
        )
    if kind == 'hdf5':
        load_h5py()
    with (
        contextlib.closing(open_recording(path, selection, whole=whole)) as recording,
        new_folder(out) as folder,
    ):
        counts = Counts(size=(recording.info.width, recording.info.height), lost=recording.counters)
        folder.mkdir()
        sink = _sink(kind, folder, recording)
        try:
            _export_camera(recording, sink, counts, progress)
            if kind != 'aedat4' and path.suffix.lower() != AEDAT4_SUFFIX:
                _export_wrenches(path, sink, counts)
            sink.close()
        except BaseException:
            with contextlib.suppress(OSError):
                sink.discard()
            raise
        # More of it where damaged packets were left out.
        counts.damage = recording.info.damage
    return counts


def _sink(kind: str, out: Path, recording: Recording) -> Aedat4Sink | TableSink:
    if kind == 'aedat4':
        return Aedat4Sink(out, recording.info)
    sinks: dict[str, type[CsvSink | Hdf5Sink | NpzSink]]
    sinks = {'csv': CsvSink, 'hdf5': Hdf5Sink, 'npz': NpzSink}
    return sinks[kind](out)


Readings = TypeVar('Readings', Events, InertialSamples)


class _Packets(Generic[Readings]):
    """Gathers readings and passes them on in packets of `PACKET_US`."""

    def __init__(
        self,
        write: Callable[[Readings], None],
        concatenate: Callable[[list[Readings]], Readings],
    ) -> None:
        self._write: Callable[[Readings], None] = write
        self._concatenate: Callable[[list[Readings]], Readings] = concatenate
        self._parts: list[Readings] = []

    def add(self, readings: Readings) -> int:
        """Add readings, and return how many they are."""
        count = len(readings.t)
        if not count:
            return 0
        # Of a clock that goes back, a packet begins anew.
        if self._parts and not 0 <= int(readings.t[-1] - self._parts[0].t[0]) <= PACKET_US:
            self.flush()
        self._parts.append(readings)
        return count

    def flush(self) -> None:
        """Pass on what is left."""
        if self._parts:
            self._write(self._concatenate(self._parts))
            self._parts.clear()


def _export_camera(
    recording: Recording,
    sink: Aedat4Sink | TableSink,
    counts: Counts,
    progress: Callable[[float], None],
) -> None:
    info, reported = recording.info, 0.0
    events = _Packets(sink.events, Events.concatenate)
    samples = _Packets(sink.samples, InertialSamples.concatenate)
    for piece in recording.pieces(0):
        counts.events += events.add(piece.events)
        counts.samples += samples.add(piece.imu)
        for frame in piece.frames:
            sink.frame(frame)
            counts.frames += 1
        if len(piece.edges.t):
            sink.edges(piece.edges)
            counts.edges += len(piece.edges.t)
        done = (piece.until_us - info.start_us) / max(info.length_us, 1)
        if done > reported + 0.005:
            reported = done
            progress(min(done, 1.0))
    events.flush()
    samples.flush()
    progress(1.0)


def _export_wrenches(path: Path, sink: Aedat4Sink | TableSink, counts: Counts) -> None:
    with BagFile(path) as bag:
        for topic in bag.topics(REFERENCE_WRENCH.type_name):
            for stamps, values in bag_wrenches(bag, topic):
                sink.wrenches(topic, stamps, values)
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
