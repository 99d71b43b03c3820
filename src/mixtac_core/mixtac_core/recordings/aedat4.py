# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""AEDAT4 files of one camera, read and written with the optional package dv-processing.

Packets of the streams differ in length: often half a second of inertial samples and 10 ms of
events. They are cut into short pieces and merged by time. Times [us] are those of the file. A
separate process reads the file, because dv-processing never returns from some damaged packets.
"""

from __future__ import annotations

import heapq
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import STANDARD_GRAVITY, EdgeKind, Edges, Frame, InertialSamples
from mixtac_core.recordings.messages import left_aligned, ten_bits
from mixtac_core.recordings.recording import (
    AEDAT4_SUFFIX,
    NONE,
    DamagedRecordingError,
    Piece,
    ReadCounters,
    RecordingError,
    RecordingInfo,
    Selection,
    Wrenches,
)

Readings = TypeVar('Readings', Events, InertialSamples, Edges)
SLICE_US = 1000
"""Longest piece [us]: data of other streams are delayed by at most this much."""
PACKAGE = 'dv-processing==2.0.4'
PIECES = 100
"""Pieces that are passed on at once."""
START_S = 180.0
"""Longest time in which a process starts and opens a file [s]."""
PATIENCE_S = 30.0
"""Longest time without progress, after which a file counts as damaged [s]."""
KINDS = ('events', 'image', 'imu', 'triggers')
"""Kinds of data that are read."""
_EDGES = {
    1: EdgeKind.EXTERNAL_RISING,
    2: EdgeKind.EXTERNAL_FALLING,
    3: EdgeKind.EXTERNAL_PULSE,
    4: EdgeKind.GENERATOR_RISING,
    5: EdgeKind.GENERATOR_FALLING,
}
"""Kinds of edges by their number in `dv.TriggerType`; other triggers are left out."""
_TRIGGERS = {kind: number for number, kind in _EDGES.items()}


def load_dv() -> Any:  # noqa: ANN401
    """Return the module dv_processing.

    Raises:
        RecordingError: It is not installed.
    """
    try:
        import dv_processing
    except ImportError as error:
        raise RecordingError(
            f'AEDAT4 files need dv-processing, which is not installed ({error})',
            remedy=f'pip install {PACKAGE}, or python3 tools/setup.py --with aedat4',
        ) from error
    return dv_processing


class Aedat4Recording:
    """An AEDAT4 file.

    Args:
        path: The file.
        selection: `NONE` leaves a kind of data out; another name for `events` is that of the
            camera to read, of several.

    Attributes:
        info: Its description.
        counters: Losses found so far.

    Raises:
        RecordingError: dv-processing is missing, or there is no such camera.
        DamagedRecordingError: The file cannot be read, or holds no data of a camera.
    """

    def __init__(self, path: Path, selection: Selection | None = None) -> None:
        if path.suffix != AEDAT4_SUFFIX:
            raise RecordingError(
                f'dv-processing does not read {path}', remedy=f'name it {path.stem}{AEDAT4_SUFFIX}'
            )
        load_dv()
        self.counters = ReadCounters()
        self._path, self._selection = path, selection or Selection()
        self._child: subprocess.Popen[bytes] | None = None
        self.info = self._open()
        self._fresh = True

    def close(self) -> None:
        """End the process that reads the file."""
        if self._child is not None:
            self._child.kill()
            self._child.wait()
            self._wire.close()
            self._child = None

    def wrenches(self) -> Mapping[str, Wrenches]:
        """Return none: the format holds no forces."""
        return {}

    def pieces(self) -> Generator[Piece, None, None]:
        """Yield what was recorded, merged by time.

        Raises:
            DamagedRecordingError: The file is damaged.
        """
        if not self._fresh:
            self._open()
        self._fresh = False
        width, height = self.info.width, self.info.height
        while pieces := self._received():
            for piece in pieces:
                piece.check()
                inside = (piece.events.x < width) & (piece.events.y < height)
                self.counters.events_outside += int(np.count_nonzero(~inside))
                yield piece if inside.all() else replace(piece, events=piece.events[inside])

    def _open(self) -> RecordingInfo:
        """Start the process that reads the file, and return its description."""
        self.close()
        self._wire, theirs = Pipe()
        code = f'from {__name__} import serve; serve({theirs.fileno()})'
        self._child = subprocess.Popen(
            [sys.executable, '-c', code],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
        )
        theirs.close()
        self._wire.send((self._path, self._selection))
        info: RecordingInfo = self._received(START_S)
        return info

    def _received(self, patience_s: float = PATIENCE_S) -> Any:  # noqa: ANN401
        """Return the next message of the process.

        Raises:
            RecordingError: What the process found, or it stands still or has crashed.
        """
        try:
            found = self._wire.recv() if self._wire.poll(patience_s) else None
        except EOFError:
            found = None
        if found is None:
            self.close()
            raise _damaged(self._path, 'dv-processing stands still or has crashed')
        if isinstance(found, RecordingError):
            self.close()
            raise found
        return found


def serve(number: int) -> None:
    """Read a file for another process, and send its description, its pieces, and an empty list.

    Args:
        number: File descriptor of the connection, on which the path and the selection arrive.
    """
    wire = Connection(number)
    path, selection = wire.recv()
    part: list[Piece] = []
    try:
        file = _File(path, selection)
        wire.send(file.info)
        for piece in file.merged():
            part.append(piece)
            if len(part) == PIECES:
                wire.send(part)
                part = []
        wire.send(part) if part else None
        wire.send([])
    except RecordingError as error:
        wire.send(part) if part else None
        wire.send(error)


class _File:
    """A file, read in this process."""

    def __init__(self, path: Path, selection: Selection) -> None:
        dv, camera = load_dv(), '' if selection.events == NONE else selection.events
        self._path = path
        try:
            arguments = (str(path), camera) if camera else (str(path),)
            self._file = dv.io.MonoCameraRecording(*arguments)
            wanted = (selection.events, selection.image, selection.imu, '')
            there = (
                self._file.isEventStreamAvailable(),
                self._file.isFrameStreamAvailable(),
                self._file.isImuStreamAvailable(),
                self._file.isTriggerStreamAvailable(),
            )
            found = zip(KINDS, wanted, there, strict=True)
            self._kinds = [kind for kind, name, has in found if has and name != NONE]
            sized = self._file.getEventResolution() or self._file.getFrameResolution()
            start_us, end_us = self._file.getTimeRange()
        except RuntimeError as error:
            raise _damaged(path, _cause(error)) from error
        if not set(self._kinds) - {'triggers'} or not sized:
            raise DamagedRecordingError(f'{path} holds no data of a camera with its size')
        if start_us >= end_us:
            # A table of packets without times: the length stays unknown.
            start_us = end_us = next((piece.start_us for piece in self.merged()), 0)
        self.info = RecordingInfo(
            path=path,
            kind='AEDAT4 file',
            camera=self._file.getCameraName(),
            width=int(sized[0]),
            height=int(sized[1]),
            color_filter=0,
            start_us=int(start_us),
            length_us=int(end_us - start_us),
            contents=tuple((kind, kind) for kind in self._kinds),
        )

    def merged(self) -> Iterator[Piece]:
        self._file.resetSequentialRead()
        chosen = [self._stream(*_READERS[kind]) for kind in self._kinds]
        yield from heapq.merge(*chosen, key=lambda piece: piece.start_us)

    def _stream(self, name: str, pieces: Callable[[Any, bool], Iterator[Piece]]) -> Iterator[Piece]:
        """Yield the pieces of a stream; `name` is the method that reads its next packet."""
        following, alone = getattr(self._file, name), 'events' not in self._kinds
        while True:
            try:
                packet = following()
            except RuntimeError as error:
                raise _damaged(self._path, _cause(error)) from error
            if packet is None:
                return
            yield from pieces(packet, alone)


def _damaged(path: Path, cause: str) -> DamagedRecordingError:
    return DamagedRecordingError(
        f'{path} is damaged or not an AEDAT4 file ({cause})',
        remedy='copy it again, or open it in DV and save what it reads',
    )


def _cause(error: Exception) -> str:
    """Return the cause in an error of dv-processing, which lies between a place and a stack."""
    return (str(error).splitlines() or [''])[:2][-1].partition(' - Error info')[0]


def _span(readings: Readings) -> tuple[int, int]:
    return int(readings.t[0]), int(readings.t[-1])


def _slices(readings: Readings) -> Iterator[Readings]:
    """Yield readings in stretches of at most SLICE_US."""
    if len(readings.t):
        cuts: list[int] = (np.flatnonzero(np.diff(readings.t // SLICE_US)) + 1).tolist()
        for start, stop in pairwise([0, *cuts, len(readings.t)]):
            yield readings[start:stop]


def _events(packet: Any, _alone: bool) -> Iterator[Piece]:  # noqa: ANN401
    rows = packet.numpy()
    # Signed coordinates: negative ones become large, outside of any sensor.
    x, y = (rows[name].astype(np.uint16) for name in ('x', 'y'))
    for each in _slices(Events(rows['timestamp'].astype(np.int64), x, y, rows['polarity'] != 0)):
        yield Piece(*_span(each), True, events=each)


def _frames(frame: Any, alone: bool) -> Iterator[Piece]:  # noqa: ANN401
    if frame.image.ndim != 2:
        raise RecordingError('frames are in colour', remedy='leave them out with --image none')
    start_us = int(frame.timestamp)
    length_us = round(frame.exposure.total_seconds() * 1e6)
    end_us = start_us + length_us
    image, x, y = ten_bits(np.array(frame.image)), frame.positionX, frame.positionY
    found = Frame(image, x, y, start_us, start_us, end_us, end_us, length_us, global_shutter=True)
    yield Piece(end_us, end_us, alone, frames=(found,))


def _samples(packet: Any, alone: bool) -> Iterator[Piece]:  # noqa: ANN401
    names = [f'{sensor}{axis}' for sensor in ('accelerometer', 'gyroscope') for axis in 'XYZ']
    rows = [[getattr(each, name) for name in (*names, 'temperature')] for each in packet]
    table = np.array(rows, np.float64).reshape(-1, 7)
    samples = InertialSamples(
        np.array([each.timestamp for each in packet], np.int64),
        table[:, :3] * STANDARD_GRAVITY,
        np.deg2rad(table[:, 3:6]),
        table[:, 6],
    )
    for each in _slices(samples):
        yield Piece(*_span(each), alone, imu=each)


def _edges(packet: Any, alone: bool) -> Iterator[Piece]:  # noqa: ANN401
    pairs = [(each.timestamp, _EDGES.get(int(each.type))) for each in packet]
    known = [(t, kind) for t, kind in pairs if kind is not None]
    times, kinds = (np.array([each[n] for each in known]) for n in (0, 1))
    for each in _slices(Edges(times.astype(np.int64), kinds.astype(np.uint8))):
        yield Piece(*_span(each), alone, edges=each)


_READERS: dict[str, tuple[str, Callable[[Any, bool], Iterator[Piece]]]] = {
    'events': ('getNextEventBatch', _events),
    'image': ('getNextFrame', _frames),
    'imu': ('getNextImuBatch', _samples),
    'triggers': ('getNextTriggerBatch', _edges),
}
"""Method of dv-processing that reads the next packet of a stream, and what makes pieces of it."""


class Aedat4Writer:
    """A new AEDAT4 file, compressed with LZ4. The format cannot hold forces.

    Args:
        path: The new file.
        info: Description of the recording: camera and size.

    Raises:
        RecordingError: dv-processing is missing, or the file cannot be made.
    """

    def __init__(self, path: Path, info: RecordingInfo) -> None:
        self._dv = load_dv()
        size = (info.width, info.height)
        config = self._dv.io.MonoCameraWriter.Config(info.camera or 'camera')
        config.addEventStream(size)
        config.addFrameStream(size)
        config.addImuStream()
        config.addTriggerStream()
        try:
            self._file = self._dv.io.MonoCameraWriter(str(path), config)
        except RuntimeError as error:
            raise RecordingError(f'cannot write {path}: {_cause(error)}') from error

    def events(self, events: Events) -> None:
        """Write events, sorted by time."""
        store = self._dv.EventStore()
        columns = (events.t, events.x, events.y, events.polarity)
        for event in zip(*(each.tolist() for each in columns), strict=True):
            store.push_back(*event)
        self._file.writeEvents(store)

    def frame(self, frame: Frame) -> None:
        """Write a frame: 10 bits left-aligned in 16, as on `image_raw`."""
        start_us, image = frame.exposure_start_us, left_aligned(frame.image)
        exposure_us = frame.exposure_end_us - start_us
        source = self._dv.FrameSource.SENSOR
        self._file.writeFrame(
            self._dv.Frame(start_us, exposure_us, frame.x, frame.y, image, source)
        )

    def samples(self, samples: InertialSamples) -> None:
        """Write inertial samples, in g, degrees per second and degrees Celsius."""
        table = np.column_stack(
            [
                samples.temperature,
                samples.acceleration / STANDARD_GRAVITY,
                np.rad2deg(samples.angular_velocity),
                np.zeros((len(samples.t), 3)),
            ]
        )
        for t_us, row in zip(samples.t.tolist(), table.tolist(), strict=True):
            self._file.writeImu(self._dv.IMU(t_us, *row))

    def edges(self, edges: Edges) -> None:
        """Write edges at the synchronisation connector."""
        for t_us, kind in zip(edges.t.tolist(), edges.kind.tolist(), strict=True):
            trigger = self._dv.TriggerType(_TRIGGERS[EdgeKind(kind)])
            self._file.writeTrigger(self._dv.Trigger(t_us, trigger))

    def close(self) -> None:
        """Finish the file."""
        del self._file
