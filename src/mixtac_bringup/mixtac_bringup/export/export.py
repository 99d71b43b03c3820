# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From a recording to the files of another format, in one pass per kind of data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_bringup.bag_reader import BagFile
from mixtac_bringup.errors import BagError
from mixtac_bringup.export.sinks import FORMATS, Aedat4Sink, CsvSink, NpzSink, Sink
from mixtac_driver.recordings.opening import open_recording
from mixtac_driver.recordings.playback_parameters import PlaybackParameters
from mixtac_events.arrays import Events

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mixtac_driver.recordings.pieces import Piece, Recording

WRENCH = 'geometry_msgs/msg/WrenchStamped'
PACKET_US = 10_000
"""Time that events of one AEDAT4 packet span, as DV writes them."""
WRENCHES = 1000


@dataclass
class Counts:
    """What was exported.

    Attributes:
        events: Events.
        frames: Frames.
        samples: Inertial samples.
        edges: Edges.
        wrenches: Wrenches by topic.
    """

    events: int = 0
    frames: int = 0
    samples: int = 0
    edges: int = 0
    wrenches: dict[str, int] = field(default_factory=dict)


def export_recording(
    path: Path, kind: str, out: Path, progress: Callable[[float], None] = lambda _done: None
) -> Counts:
    """Write a recording in another format, in flat memory.

    Args:
        path: Folder of a bag, or an .mcap, .db3 or .aedat4 file.
        kind: One of `FORMATS`.
        out: New folder.
        progress: Called with the share done, 0 to 1.

    Raises:
        BagError: The folder is there already or cannot be made, or the format is unknown.
        RecordingError: The recording cannot be read.
    """
    if kind not in FORMATS:
        raise BagError(f'format {kind!r}: choose one of {", ".join(FORMATS)}')
    recording = open_recording(str(path), PlaybackParameters())
    try:
        try:
            out.mkdir(parents=True)
        except OSError as error:
            raise BagError(f'cannot export to {out}: {error}; choose a new folder') from error
        sink = _sink(kind, out, recording)
        counts = Counts()
        _export_camera(recording, sink, counts, progress)
    finally:
        recording.close()
    if kind != 'aedat4' and path.suffix != '.aedat4' and path.is_dir():
        _export_wrenches(path, sink, counts)
    sink.close()
    return counts


def _sink(kind: str, out: Path, recording: Recording) -> Sink:
    if kind == 'aedat4':
        return Aedat4Sink(out, recording.info)
    return CsvSink(out) if kind == 'csv' else NpzSink(out)


class _EventPackets:
    """Gathers events into packets of PACKET_US."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._held: list[Events] = []

    def add(self, events: Events) -> None:
        if self._held and int(events.t[-1]) - int(self._held[0].t[0]) > PACKET_US:
            self.flush()
        self._held.append(events)

    def flush(self) -> None:
        if self._held:
            names = ('t', 'x', 'y', 'polarity')
            columns = [np.concatenate([getattr(e, name) for e in self._held]) for name in names]
            self._sink.events(Events(*columns))
            self._held.clear()


def _export_camera(
    recording: Recording, sink: Sink, counts: Counts, progress: Callable[[float], None]
) -> None:
    info, packets, told = recording.info, _EventPackets(sink), 0.0
    for piece in recording.pieces(info.start_us):
        _export_piece(piece, packets, sink, counts)
        done = (piece.until_us - info.start_us) / max(info.length_us, 1)
        if done > told + 0.005:
            told = done
            progress(min(done, 1.0))
    packets.flush()
    progress(1.0)


def _export_piece(piece: Piece, packets: _EventPackets, sink: Sink, counts: Counts) -> None:
    if len(piece.events):
        packets.add(piece.events)
        counts.events += len(piece.events)
    for frame in piece.frames:
        sink.frame(frame)
        counts.frames += 1
    if len(piece.imu.t):
        sink.samples(piece.imu)
        counts.samples += len(piece.imu.t)
    if len(piece.edges.t):
        sink.edges(piece.edges)
        counts.edges += len(piece.edges.t)


def _export_wrenches(path: Path, sink: Sink, counts: Counts) -> None:
    with BagFile(path) as bag:
        for topic, kind in bag.types.items():
            if kind != WRENCH or not bag.counts[topic]:
                continue
            rows: list[tuple[int, list[float]]] = []
            for _, message in bag.messages(topic):
                rows.append(_wrench(message))
                if len(rows) == WRENCHES:
                    _flush(sink, topic, rows)
            _flush(sink, topic, rows)
            counts.wrenches[topic] = bag.counts[topic]


def _wrench(message: Any) -> tuple[int, list[float]]:  # noqa: ANN401
    stamp, force, torque = message.header.stamp, message.wrench.force, message.wrench.torque
    return stamp.sec * 1_000_000_000 + stamp.nanosec, [
        *(force.x, force.y, force.z),
        *(torque.x, torque.y, torque.z),
    ]


def _flush(sink: Sink, topic: str, rows: list[tuple[int, list[float]]]) -> None:
    if rows:
        stamps = np.array([stamp for stamp, _ in rows], np.int64)
        sink.wrenches(topic, stamps, np.array([values for _, values in rows]))
        rows.clear()
