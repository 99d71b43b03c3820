# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""AEDAT4 files, as DV and dv-processing write them: packets read and written, files as recordings.

A file is read while it is played. Packets of the streams differ in length, often half a second
of inertial samples and 10 ms of events: they are cut into short pieces and merged by time. Times
[us] are those of the file. Field numbers are those of the published schemas of EventPacket, Frame,
IMUPacket and TriggerPacket.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_events.readings import STANDARD_GRAVITY, EdgeKind, Edges, Frame, InertialSamples
from mixtac_recordings import flatbuffer
from mixtac_recordings.aedat4_file import EVENT, Aedat4File, StreamInfo
from mixtac_recordings.flatbuffer import FlatBufferWriter, Octets
from mixtac_recordings.messages import BIT_SHIFT, left_aligned
from mixtac_recordings.recording import (
    DamagedRecordingError,
    Piece,
    ReadCounters,
    RecordingError,
    RecordingInfo,
    Selection,
    choose,
)

Readings = TypeVar('Readings', Events, InertialSamples, Edges)

SLICE_US = 1000
"""Longest piece [us]: data of other streams are delayed by at most this much."""
_MONO16 = 2
_FORMATS: dict[int, np.dtype[Any]] = {0: np.dtype(np.uint8), _MONO16: np.dtype('<u2')}
"""The two monochrome formats by their OpenCV numbers."""
_TRIGGERS = {
    EdgeKind.EXTERNAL_RISING: 1,
    EdgeKind.EXTERNAL_FALLING: 2,
    EdgeKind.EXTERNAL_PULSE: 3,
    EdgeKind.GENERATOR_RISING: 4,
    EdgeKind.GENERATOR_FALLING: 5,
}
_EDGES = {number: kind for kind, number in _TRIGGERS.items()}


def read_events(data: Octets) -> Iterator[Events]:
    """Return the events of a packet in stretches of at most SLICE_US.

    Raises:
        DamagedRecordingError: The packet is damaged.
    """
    flatbuffer.check(data, 'EVTS')
    packed = flatbuffer.structs(data, flatbuffer.root(data), 0, EVENT)
    return _slices(Events(*(packed[name].copy() for name in ('t', 'x', 'y', 'polarity'))))


def read_frame(data: Octets) -> Frame:
    """Return the frame of a packet; 8-bit pixels become the upper bits of 10.

    Raises:
        DamagedRecordingError: The packet is damaged.
        RecordingError: Its frame is in colour.
    """
    flatbuffer.check(data, 'FRME')
    table = flatbuffer.root(data)

    def number(index: int, dtype: str = '<i8', default: int = 0) -> int:
        return int(flatbuffer.column(data, table, index, dtype, default)[0])

    image = _pixels(data, number(5, 'i1'), number(6, '<i2'), number(7, '<i2'))
    stamp_us = number(0)
    start_us = number(3) or stamp_us
    end_us = number(4) or start_us + number(11)
    return Frame(
        image=image,
        x=number(8, '<i2'),
        y=number(9, '<i2'),
        frame_start_us=number(1) or start_us,
        exposure_start_us=start_us,
        exposure_end_us=end_us,
        frame_end_us=number(2) or end_us,
        exposure_cycles=end_us - start_us,
        global_shutter=True,
    )


def read_samples(data: Octets) -> Iterator[InertialSamples]:
    """Return the inertial samples of a packet in stretches of at most SLICE_US, in SI units.

    Raises:
        DamagedRecordingError: The packet is damaged.
    """
    flatbuffer.check(data, 'IMUS')
    rows = flatbuffer.tables(data, flatbuffer.root(data), 0)
    t = flatbuffer.column(data, rows, 0, '<i8', 0).astype(np.int64)
    columns = [flatbuffer.column(data, rows, index, '<f4', 0.0) for index in range(1, 8)]
    # Converting signalling NaNs sets a floating-point flag.
    with np.errstate(invalid='ignore'):
        temperature, ax, ay, az, wx, wy, wz = np.array(columns).astype(np.float64)
    acceleration = np.stack((ax, ay, az), 1) * STANDARD_GRAVITY
    rotation = np.deg2rad(np.stack((wx, wy, wz), 1))
    return _slices(InertialSamples(t, acceleration, rotation, temperature))


def read_edges(data: Octets) -> Iterator[Edges]:
    """Return the edges of a packet in stretches of at most SLICE_US; other triggers are left out.

    Raises:
        DamagedRecordingError: The packet is damaged.
    """
    flatbuffer.check(data, 'TRIG')
    rows = flatbuffer.tables(data, flatbuffer.root(data), 0)
    t = flatbuffer.column(data, rows, 0, '<i8', 0).astype(np.int64)
    recorded = flatbuffer.column(data, rows, 1, 'i1', 0)
    known = np.isin(recorded, list(_EDGES))
    kinds = np.array([_EDGES[int(each)] for each in recorded[known]], np.uint8)
    return _slices(Edges(t[known], kinds))


def _pixels(data: Octets, number: int, width: int, height: int) -> NDArray[np.uint16]:
    if number not in _FORMATS:
        raise RecordingError(
            f'frames have OpenCV format {number}, not 8 or 16 bits of one channel',
            remedy='set playback_image_topic to none',
        )
    dtype = _FORMATS[number]
    octets = flatbuffer.structs(data, flatbuffer.root(data), 10, np.dtype(np.uint8))
    if width <= 0 or height <= 0 or len(octets) < width * height * dtype.itemsize:
        raise DamagedRecordingError(f'{len(octets)} bytes in a frame of {width} x {height}')
    image = octets[: width * height * dtype.itemsize].view(dtype).reshape(height, width)
    wide: NDArray[np.uint16] = image.astype(np.uint16)
    return wide << np.uint16(2) if dtype.itemsize == 1 else wide >> np.uint16(BIT_SHIFT)


def _slices(readings: Readings) -> Iterator[Readings]:
    """Yield readings in stretches of at most SLICE_US."""
    if len(readings.t):
        cuts: list[int] = (np.flatnonzero(np.diff(readings.t // SLICE_US)) + 1).tolist()
        for start, stop in pairwise([0, *cuts, len(readings.t)]):
            yield readings[start:stop]


_FROM_SENSOR = 1


def events_packet(events: Events) -> bytes:
    """Return the buffer of events."""
    rows = np.zeros(len(events), EVENT)
    for name in EVENT.names or ():
        rows[name] = getattr(events, name)
    buffer = FlatBufferWriter('EVTS')
    table, fields = buffer.table({0: ('O', 0)})
    buffer.refer(fields[0], buffer.vector(len(rows), rows.tobytes()))
    return buffer.finish(table)


def frame_packet(frame: Frame) -> bytes:
    """Return the buffer of a frame: 10 bits left-aligned in 16, as on `image_raw`.

    Its time is the start of the exposure, as in dv-processing.
    """
    buffer = FlatBufferWriter('FRME')
    height, width = frame.image.shape
    table, fields = buffer.table(
        {
            0: ('q', frame.exposure_start_us),
            1: ('q', frame.frame_start_us),
            2: ('q', frame.frame_end_us),
            3: ('q', frame.exposure_start_us),
            4: ('q', frame.exposure_end_us),
            5: ('b', _MONO16),
            6: ('h', width),
            7: ('h', height),
            8: ('h', frame.x),
            9: ('h', frame.y),
            10: ('O', 0),
            11: ('q', frame.exposure_end_us - frame.exposure_start_us),
            12: ('b', _FROM_SENSOR),
        }
    )
    pixels = left_aligned(frame.image).astype('<u2').tobytes()
    buffer.refer(fields[10], buffer.vector(len(pixels), pixels))
    return buffer.finish(table)


def samples_packet(samples: InertialSamples) -> bytes:
    """Return the buffer of inertial samples, in g, degrees per second and degrees Celsius."""
    acceleration = (samples.acceleration / STANDARD_GRAVITY).tolist()
    rotation = np.rad2deg(samples.angular_velocity).tolist()
    rows: list[dict[int, tuple[str, float]]] = []
    for index, t_us in enumerate(samples.t.tolist()):
        values = (float(samples.temperature[index]), *acceleration[index], *rotation[index])
        row: dict[int, tuple[str, float]] = {0: ('q', t_us)}
        row |= {1 + number: ('f', value) for number, value in enumerate(values)}
        rows.append(row)
    return flatbuffer.tables_buffer('IMUS', rows, len(rows))


def edges_packet(edges: Edges) -> bytes:
    """Return the buffer of edges at the synchronisation connector."""
    kinds = [_TRIGGERS[EdgeKind(int(kind))] for kind in edges.kind]
    rows = zip(edges.t.tolist(), kinds, strict=True)
    return flatbuffer.tables_buffer(
        'TRIG', ({0: ('q', t_us), 1: ('b', kind)} for t_us, kind in rows), len(kinds)
    )


_KINDS = {'EVTS': 'events', 'FRME': 'image', 'IMUS': 'imu', 'TRIG': 'triggers'}


class Aedat4Recording:
    """An AEDAT4 file.

    Args:
        path: The file.
        selection: Which of its streams to read; None for the only one of each kind. Triggers of the
            camera that the events are from are always read.
        whole: Leave out packets that are damaged, instead of failing.

    Attributes:
        info: Its description; its damage grows with each packet that is left out.
        counters: Losses found so far.

    Raises:
        RecordingError: It cannot be read, is empty, or the choice is ambiguous.
    """

    def __init__(
        self, path: Path, selection: Selection | None = None, *, whole: bool = False
    ) -> None:
        self.counters = ReadCounters()
        self._path, self._whole = path, whole
        self._file = Aedat4File(path)
        try:
            self._chosen = self._choose(selection or Selection())
            index = self._file.index()
            self._packets = {
                s.identifier: index[index['stream'] == s.number] for s in self._chosen.values()
            }
            self._packets = {name: each for name, each in self._packets.items() if len(each)}
            self.info = self._info()
        except RecordingError:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def pieces(self, from_us: int) -> Generator[Piece, None, None]:
        """Yield what was recorded, merged by time.

        Args:
            from_us: Time to begin at [us]; earlier pieces may come first.

        Raises:
            RecordingError: The file is damaged, and `whole` was not asked for.
        """
        readers: dict[str, Callable[[Octets], Iterator[Piece]]] = {
            'EVTS': self._events,
            'FRME': self._frames,
            'IMUS': self._samples,
            'TRIG': self._edges,
        }
        streams = [
            self._stream(packets[packets['end_us'] >= from_us], readers[identifier])
            for identifier, packets in self._packets.items()
        ]
        yield from heapq.merge(*streams, key=lambda piece: piece.start_us)

    def _stream(
        self, packets: NDArray[Any], reader: Callable[[Octets], Iterator[Piece]]
    ) -> Iterator[Piece]:
        for packet in packets:
            try:
                pieces = list(reader(self._file.packet(packet)))
                for piece in pieces:
                    piece.check()
            except DamagedRecordingError as error:
                if not self._whole:
                    raise self._file.damaged(str(error)) from error
                self._file.leave_out(int(packet['offset']), error)
                self.info = replace(self.info, damage=self._file.damage)
            except RecordingError as error:
                raise RecordingError(f'{self._path}: {error}') from error
            else:
                yield from pieces

    def _events(self, data: Octets) -> Iterator[Piece]:
        for events in read_events(data):
            inside = (events.x < self.info.width) & (events.y < self.info.height)
            self.counters.events_outside += int(np.count_nonzero(~inside))
            start_us, until_us = int(events.t[0]), int(events.t[-1])
            kept = events if inside.all() else events[inside]
            yield Piece(start_us, until_us, advances=True, events=kept)

    def _frames(self, data: Octets) -> Iterator[Piece]:
        frame = read_frame(data)
        t_us = frame.exposure_end_us
        yield Piece(t_us, t_us, advances=self._alone, frames=(frame,))

    def _samples(self, data: Octets) -> Iterator[Piece]:
        for imu in read_samples(data):
            yield Piece(int(imu.t[0]), int(imu.t[-1]), advances=self._alone, imu=imu)

    def _edges(self, data: Octets) -> Iterator[Piece]:
        for edges in read_edges(data):
            yield Piece(int(edges.t[0]), int(edges.t[-1]), advances=self._alone, edges=edges)

    @property
    def _alone(self) -> bool:
        return 'EVTS' not in self._packets

    def _choose(self, selection: Selection) -> dict[str, StreamInfo]:
        wanted = {
            'EVTS': selection.events,
            'FRME': selection.image,
            'IMUS': selection.imu,
        }
        chosen: dict[str, StreamInfo] = {}
        for identifier, name in wanted.items():
            streams = [s for s in self._file.streams if s.identifier == identifier]
            if not name and 'EVTS' in chosen:
                source = chosen['EVTS'].source
                streams = [s for s in streams if s.source == source] or streams
            kind, found = _KINDS[identifier], {s.name: s for s in streams}
            if len(found) < len(streams):
                # Of several cameras, as they usually call their streams.
                found = {f'{s.name} of {s.source}': s for s in streams}
            taken = choose(list(found), name, kind=kind, path=self._path)
            if taken is not None:
                chosen[identifier] = found[taken]
        if 'EVTS' in chosen:
            for stream in self._file.streams:
                if (stream.identifier, stream.source) == ('TRIG', chosen['EVTS'].source):
                    chosen['TRIG'] = stream
        return chosen

    def _info(self) -> RecordingInfo:
        if not self._packets:
            raise RecordingError(
                f'{self._path} holds no events, frames or inertial samples'
                + (f': {self._file.damage}' if self._file.damage else '')
            )
        every = list(self._packets.values())
        first = self._packets.get('EVTS')
        starts = [int(each['start_us'].min()) for each in every]
        start_us = int(first['start_us'][0]) if first is not None else min(starts)
        camera = next(iter(self._chosen.values()))
        sized = [s for s in self._chosen.values() if s.width and s.height]
        if not sized:
            raise RecordingError(f'{self._path} does not give the size of its camera')
        return RecordingInfo(
            path=self._path,
            kind='AEDAT4 file',
            camera=camera.source,
            width=sized[0].width,
            height=sized[0].height,
            color_filter=0,
            start_us=start_us,
            length_us=max(int(each['end_us'].max()) for each in every) - start_us,
            contents=tuple((_KINDS[key], self._chosen[key].name) for key in self._packets),
            damage=self._file.damage,
        )
