# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings as AEDAT4, CSV or NPZ, in one pass per kind of data and in constant memory."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol

import cv2
import numpy as np
from numpy.lib import format as npy

from mixtac_events.arrays import Events
from mixtac_recordings import aedat4 as packets
from mixtac_recordings.aedat4_file import Aedat4Writer
from mixtac_recordings.bag import BagFile
from mixtac_recordings.camera_stream import open_recording
from mixtac_recordings.recording import BagError, PlaybackParameters

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from mixtac_events.readings import Edges, Frame, InertialSamples
    from mixtac_recordings.recording import Piece, Recording, RecordingInfo


class GrowingNpz:
    """Keeps each array in a file of its own until the end, then puts them into one .npz.

    Args:
        path: The new file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._folder = Path(tempfile.mkdtemp(prefix='.npz-', dir=path.parent))
        self._files: dict[str, IO[bytes]] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._types: dict[str, np.dtype[Any]] = {}

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Append rows to an array; all have the type and row shape of the first."""
        if name not in self._files:
            self._files[name] = (self._folder / name).open('w+b')
            self._shapes[name], self._types[name] = (0, *rows.shape[1:]), rows.dtype
        shape = self._shapes[name]
        if rows.shape[1:] != shape[1:]:
            raise ValueError(f'{name}: rows of {rows.shape[1:]} after rows of {shape[1:]}')
        self._files[name].write(np.ascontiguousarray(rows, self._types[name]).tobytes())
        self._shapes[name] = (shape[0] + len(rows), *shape[1:])

    def close(self) -> None:
        """Write the file."""
        with zipfile.ZipFile(self._path, 'x', zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, file in self._files.items():
                header = {
                    'descr': npy.dtype_to_descr(self._types[name]),
                    'fortran_order': False,
                    'shape': self._shapes[name],
                }
                file.seek(0)
                with archive.open(f'{name}.npy', 'w', force_zip64=True) as member:
                    npy.write_array_header_1_0(member, header)
                    shutil.copyfileobj(file, member, 1 << 20)
        self.discard()

    def discard(self) -> None:
        """Remove what was kept."""
        for file in self._files.values():
            file.close()
        shutil.rmtree(self._folder, ignore_errors=True)


FORMATS = ('aedat4', 'csv', 'npz')


class Sink(Protocol):
    """Takes recorded data, each kind in order of time."""

    def events(self, events: Events) -> None:
        """Take events, at least one."""

    def frame(self, frame: Frame) -> None:
        """Take a frame."""

    def samples(self, samples: InertialSamples) -> None:
        """Take inertial samples, at least one."""

    def edges(self, edges: Edges) -> None:
        """Take edges, at least one."""

    def wrenches(self, topic: str, rows: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Take stamps [ns, clock of the topic], shape (N,), and wrenches [N, N m], (N, 6)."""

    def close(self) -> None:
        """Finish the files."""


class Aedat4Sink:
    """One AEDAT4 file; wrenches have no place in it and are left out.

    Args:
        folder: Where to put it.
        info: What is known of the recording.
    """

    def __init__(self, folder: Path, info: RecordingInfo) -> None:
        size = (info.width, info.height)
        self._file = Aedat4Writer(folder / 'recording.aedat4', size, info.camera or 'DAVIS346')

    def events(self, events: Events) -> None:
        """Take events."""
        span = (int(events.t[0]), int(events.t[-1]))
        self._file.write('EVTS', packets.events_packet(events), len(events), *span)

    def frame(self, frame: Frame) -> None:
        """Take a frame."""
        t_us = frame.exposure_start_us
        self._file.write('FRME', packets.frame_packet(frame), 1, t_us, t_us)

    def samples(self, samples: InertialSamples) -> None:
        """Take inertial samples."""
        span = (int(samples.t[0]), int(samples.t[-1]))
        self._file.write('IMUS', packets.samples_packet(samples), len(samples.t), *span)

    def edges(self, edges: Edges) -> None:
        """Take edges."""
        span = (int(edges.t[0]), int(edges.t[-1]))
        self._file.write('TRIG', packets.edges_packet(edges), len(edges.t), *span)

    def wrenches(self, topic: str, rows: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Leave wrenches out."""

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


CAMERA = 'us, camera clock'
IMU_COLUMNS = (
    f't [{CAMERA}]',
    *(f'acceleration_{axis} [m/s^2]' for axis in 'xyz'),
    *(f'angular_velocity_{axis} [rad/s]' for axis in 'xyz'),
    'temperature [degC]',
)
FRAME_COLUMNS = (
    'file',
    f'exposure_start [{CAMERA}]',
    f'exposure_end [{CAMERA}]',
    'x [px]',
    'y [px]',
)
WRENCH_COLUMNS = (
    't [ns, clock of the topic]',
    *(f'force_{axis} [N]' for axis in 'xyz'),
    *(f'torque_{axis} [N m]' for axis in 'xyz'),
)
HEADINGS = {
    'events': (f't [{CAMERA}]', 'x [px]', 'y [px]', 'polarity [1 = brighter]'),
    'frames': FRAME_COLUMNS,
    'imu': IMU_COLUMNS,
    'edges': (f't [{CAMERA}]', 'kind [2 falling, 3 rising, 4 pulse, 16 and 17 generator]'),
}


def topic_file(topic: str) -> str:
    """Return the name under which a topic is exported."""
    return topic.strip('/').replace('/', '_')


class CsvSink:
    """Tables with units in their headings; frames as PNG files of 16 bits, 10 left-aligned.

    Args:
        folder: Where to put them.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, IO[str]] = {}
        self._frames = 0

    def events(self, events: Events) -> None:
        """Take events."""
        columns = (events.t, events.x, events.y, events.polarity.astype(np.uint8))
        rows = zip(*(column.tolist() for column in columns), strict=True)
        self._write('events', HEADINGS['events'], '%d,%d,%d,%d\n', rows)

    def frame(self, frame: Frame) -> None:
        """Take a frame."""
        name = f'frames/{self._frames:06d}.png'
        self._frames += 1
        path = self._folder / name
        path.parent.mkdir(exist_ok=True)
        if not cv2.imwrite(str(path), np.left_shift(frame.image, packets.LEFT_ALIGNED)):
            raise BagError(f'cannot write {path}: free some space')
        row = (name, frame.exposure_start_us, frame.exposure_end_us, frame.x, frame.y)
        self._write('frames', HEADINGS['frames'], '%s,%d,%d,%d,%d\n', [row])

    def samples(self, samples: InertialSamples) -> None:
        """Take inertial samples."""
        table = np.column_stack(
            (samples.acceleration, samples.angular_velocity, samples.temperature)
        )
        rows = [(t, *row) for t, row in zip(samples.t.tolist(), table.tolist(), strict=True)]
        self._write('imu', HEADINGS['imu'], '%d' + ',%.9g' * 7 + '\n', rows)

    def edges(self, edges: Edges) -> None:
        """Take edges."""
        rows = zip(edges.t.tolist(), edges.kind.tolist(), strict=True)
        self._write('edges', HEADINGS['edges'], '%d,%d\n', rows)

    def wrenches(self, topic: str, rows: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Take wrenches."""
        table = [(t, *row) for t, row in zip(rows.tolist(), values.tolist(), strict=True)]
        self._write(topic_file(topic), WRENCH_COLUMNS, '%d' + ',%.17g' * 6 + '\n', table)

    def close(self) -> None:
        """Finish the files."""
        for file in self._files.values():
            file.close()

    def _write(self, name: str, headings: tuple[str, ...], form: str, rows: Any) -> None:  # noqa: ANN401
        if name not in self._files:
            self._files[name] = (self._folder / f'{name}.csv').open('x', encoding='utf8')
            self._files[name].write(','.join(f'"{each}"' for each in headings) + '\n')
        self._files[name].write(''.join([form % row for row in rows]))


class NpzSink:
    """One .npz per kind of data; `units.txt` says what the arrays are.

    Args:
        folder: Where to put them.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, GrowingNpz] = {}

    def events(self, events: Events) -> None:
        """Take events."""
        self._append('events', t=events.t, x=events.x, y=events.y, polarity=events.polarity)

    def frame(self, frame: Frame) -> None:
        """Take a frame."""
        self._append(
            'frames',
            exposure_start=np.array([frame.exposure_start_us]),
            exposure_end=np.array([frame.exposure_end_us]),
            origin=np.array([[frame.x, frame.y]]),
            image=frame.image[None],
        )

    def samples(self, samples: InertialSamples) -> None:
        """Take inertial samples."""
        self._append(
            'imu',
            t=samples.t,
            acceleration=samples.acceleration,
            angular_velocity=samples.angular_velocity,
            temperature=samples.temperature,
        )

    def edges(self, edges: Edges) -> None:
        """Take edges."""
        self._append('edges', t=edges.t, kind=edges.kind)

    def wrenches(self, topic: str, rows: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Take wrenches."""
        self._append(topic_file(topic), t=rows, force=values[:, :3], torque=values[:, 3:])

    def close(self) -> None:
        """Finish the files."""
        for file in self._files.values():
            file.close()
        (self._folder / 'units.txt').write_text(UNITS, encoding='utf8')

    def _append(self, name: str, **arrays: NDArray[Any]) -> None:
        file = self._files.get(name)
        if file is None:
            file = self._files[name] = GrowingNpz(self._folder / f'{name}.npz')
        for key, rows in arrays.items():
            file.append(key, rows)


UNITS = """\
events.npz  t [us, camera clock], x, y [px], polarity (true: brighter)
frames.npz  exposure_start, exposure_end [us, camera clock], origin (x, y of the first pixel),
            image [n, height, width], 0 .. 1023
imu.npz     t [us, camera clock], acceleration [m/s^2], angular_velocity [rad/s], temperature [degC]
edges.npz   t [us, camera clock], kind (2 falling, 3 rising, 4 pulse, 16 and 17 generator)
others      named after their topic: t [ns, clock of the topic], force [N], torque [N m]
"""
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
