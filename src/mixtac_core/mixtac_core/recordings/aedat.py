# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""AEDAT 2.0 files, read, and AEDAT4 files, read and written.

AEDAT 2.0 files of a DAVIS240 or DAVIS346, as jAER records them, are read for their events. A word
of 8 bytes holds an address and a time [us], both big-endian. The address of an event has row (9
bits from bit 22), column (10 bits from bit 12, counted from the right) and polarity (bit 11). Bit
31 marks pixels of frames and inertial samples, bit 10 edges of the external input: these are
skipped and counted. Rows are numbered as jAER numbers them.

AEDAT4 files of one camera are read and written with the optional package dv-processing. Times [us]
are those of the file. dv-processing does not detect all damage, and may not return from it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from mixtac_core.events.readings import STANDARD_GRAVITY, EdgeKind
from mixtac_core.recordings.messages import left_aligned, ten_bits
from mixtac_core.recordings.recording import (
    AEDAT4_FILE,
    NONE,
    DamagedRecordingError,
    ReadCounters,
    RecordingError,
    RecordingInfo,
    Selection,
)
from mixtac_core.recordings.table_recording import FileRecording, Streams
from mixtac_core.recordings.tables import Rows, optional_module

SIZES: Final = {'davis346': (346, 260), 'davis240': (240, 180), 'sbret': (240, 180)}
"""Width and height of the sensor by a part of the chip's name in lower case."""
NO_EVENT: Final = 1 << 31 | 1 << 10
"""Bits that no event has."""
PIXEL: Final = 1 << 31 | 1 << 10
"""Bits of a pixel read after its exposure; bit 11, which inertial samples have, is 0."""
WORDS: Final = 10_000
"""Words that are read at once."""
_HEADER_LINE: Final = re.compile(rb'#[^\x00-\x08\x0a-\x0c\x0e-\x1f]*\n')
_EDGES: Final = {
    1: EdgeKind.EXTERNAL_RISING,
    2: EdgeKind.EXTERNAL_FALLING,
    3: EdgeKind.EXTERNAL_PULSE,
    4: EdgeKind.GENERATOR_RISING,
    5: EdgeKind.GENERATOR_FALLING,
}
"""Kinds of edges by their number in `dv.TriggerType`; other triggers are left out."""
_TRIGGERS: Final = {int(kind): number for number, kind in _EDGES.items()}


def open_aedat2(
    path: Path, selection: Selection, size: tuple[int, int] | None = None
) -> FileRecording:
    """Open an AEDAT 2.0 file.

    Args:
        path: The file.
        selection: `NONE` for events is refused: there is nothing else to read.
        size: Width and height of the sensor; None for the size of the chip that the header names.

    Raises:
        RecordingError: It holds no events, or the size is not known.
    """
    with path.open('rb') as file:
        start, chip = 0, ''
        while line := _HEADER_LINE.fullmatch(file.readline(1 << 16)):
            start = file.tell()
            if b'AEChip:' in line[0]:
                chip = line[0].partition(b':')[2].decode(errors='replace').strip()
    size = size or next((found for name, found in SIZES.items() if name in chip.lower()), None)
    if size is None:
        raise RecordingError(
            f'{path} is of the chip {chip or "(not named)"}: only events of DAVIS240 and'
            ' DAVIS346 are read',
            remedy='give --size 346x260 or 240x180 if it is such a camera, or open it in jAER'
            ' and export events as csv with columns t, x, y, p',
        )
    counters = ReadCounters()
    streams: Streams = {}
    if selection.events != NONE:
        streams['events'] = partial(_events_of_words, path, start, size, counters)
    return FileRecording(RecordingInfo(path, 'AEDAT 2 file', *size), streams, counters=counters)


def _events_of_words(
    path: Path, start: int, size: tuple[int, int], counters: ReadCounters
) -> Iterator[Rows]:
    """Yield the events; times [us] continue where 32 bits roll over."""
    others, pixels, latest_us = 0, 0, None
    with path.open('rb') as file:
        file.seek(start)
        while len(data := file.read(8 * WORDS)) >= 8:
            words = np.frombuffer(data, '>u4', len(data) // 8 * 2).reshape(-1, 2).astype(np.int64)
            address, t = words[words[:, 0] & NO_EVENT == 0].T
            others += len(words) - len(t)
            pixels += int(np.count_nonzero(words[:, 0] & (PIXEL | 1 << 11) == PIXEL))
            if not len(t):
                continue
            latest_us = int(t[0]) if latest_us is None else latest_us
            # Steps of 32 bits are shorter than 2^31 us.
            steps = np.diff(t, prepend=latest_us) + (1 << 31) & 0xFFFFFFFF
            t = latest_us + np.cumsum(steps - (1 << 31))
            latest_us = int(t[-1])
            # Columns left of the first become large, outside of any sensor.
            x = (size[0] - 1 - (address >> 12 & 0x3FF)).astype(np.uint16)
            y, polarity = address >> 22 & 0x1FF, address >> 11 & 1 == 1
            yield {'t': t, 'x': x, 'y': y, 'polarity': polarity}
    counters.other_words += others
    counters.frames_not_read += pixels // (size[0] * size[1])


def _dv() -> Any:  # noqa: ANN401
    remedy = 'pip install dv-processing==2.0.4, or python3 tools/setup.py --with aedat4'
    return optional_module('dv_processing', remedy)


def open_aedat4(path: Path, selection: Selection) -> FileRecording:
    """Open an AEDAT4 file.

    Args:
        path: The file.
        selection: `NONE` leaves a kind of data out; another name for `events` is that of the
            camera to read, of several.

    Raises:
        RecordingError: dv-processing is missing, or there is no such camera.
        DamagedRecordingError: The file cannot be read, or holds no data of a camera.
    """
    camera = '' if selection.events == NONE else selection.events
    wanted = {'event': selection.events, 'frame': selection.image, 'imu': selection.imu}
    streams: Streams = {}
    with _refusing_damage(path):
        file = _open(path, camera)
        for kind, (table, following, convert) in _STREAMS.items():
            if wanted.get(kind) != NONE and getattr(file, f'is{kind.title()}StreamAvailable')():
                streams[table] = partial(_rows, path, camera, following, convert)
        size = file.getEventResolution() or file.getFrameResolution()
        start_us, end_us = file.getTimeRange()
    if not streams.keys() - {'edges'} or not size:
        raise DamagedRecordingError(f'{path} holds no data of a camera with its size')
    name, length_us = str(file.getCameraName()), end_us - start_us
    info = RecordingInfo(path, 'AEDAT4 file', size[0], size[1], name, length_us=length_us)
    return FileRecording(info, streams)


def _open(path: Path, camera: str) -> Any:  # noqa: ANN401
    return _dv().io.MonoCameraRecording(*filter(None, (str(path), camera)))


def _rows(
    path: Path, camera: str, following: str, convert: Callable[[Any], Rows]
) -> Iterator[Rows]:
    """Yield the packets of a stream as rows; `following` is the method that reads the next one.

    Raises:
        DamagedRecordingError: The file is damaged.
    """
    with _refusing_damage(path):
        file = _open(path, camera)
        while (packet := getattr(file, following)()) is not None:
            rows = convert(packet)
            if len(next(iter(rows.values()))):
                yield rows


@contextmanager
def _refusing_damage(path: Path) -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:
        raise DamagedRecordingError(
            f'{path} is damaged or not an AEDAT4 file ({_cause(error)})',
            remedy='copy it again, or open it in DV and save what it reads',
        ) from error


def _cause(error: Exception) -> str:
    """Return the cause in an error of dv-processing, which lies between a place and a stack."""
    return (str(error).splitlines() or [''])[:2][-1].partition(' - Error info')[0]


def _events(packet: Any) -> Rows:  # noqa: ANN401
    rows = packet.numpy()
    # Signed coordinates: negative ones become large, outside of any sensor.
    x, y = (rows[name].astype(np.uint16) for name in ('x', 'y'))
    return {
        't': rows['timestamp'].astype(np.int64),
        'x': x,
        'y': y,
        'polarity': rows['polarity'] != 0,
    }


def _frame(frame: Any) -> Rows:  # noqa: ANN401
    if frame.image.ndim != 2:
        raise RecordingError('frames are in colour', remedy='leave them out with --image none')
    end_us = frame.timestamp + round(frame.exposure.total_seconds() * 1e6)
    return {
        'exposure_start': np.array([frame.timestamp]),
        'exposure_end': np.array([end_us]),
        'origin': np.array([[frame.positionX, frame.positionY]]),
        'image': ten_bits(np.array(frame.image))[None],
    }


def _samples(packet: Any) -> Rows:  # noqa: ANN401
    names = [f'{sensor}{axis}' for sensor in ('accelerometer', 'gyroscope') for axis in 'XYZ']
    rows = [[getattr(each, name) for name in (*names, 'temperature')] for each in packet]
    table = np.array(rows, np.float64).reshape(-1, 7)
    return {
        't': np.array([each.timestamp for each in packet], np.int64),
        'acceleration': table[:, :3] * STANDARD_GRAVITY,
        'angular_velocity': np.deg2rad(table[:, 3:6]),
        'temperature': table[:, 6],
    }


def _edges(packet: Any) -> Rows:  # noqa: ANN401
    known = [
        (each.timestamp, _EDGES[int(each.type)]) for each in packet if int(each.type) in _EDGES
    ]
    t, kind = np.array(known, np.int64).reshape(-1, 2).T
    return {'t': t, 'kind': kind}


_STREAMS: Final[dict[str, tuple[str, str, Callable[[Any], Rows]]]] = {
    'event': ('events', 'getNextEventBatch', _events),
    'frame': ('frames', 'getNextFrame', _frame),
    'imu': ('imu', 'getNextImuBatch', _samples),
    'trigger': ('edges', 'getNextTriggerBatch', _edges),
}
"""Streams of a camera: the table, the method of dv-processing that reads the next packet, and what
makes rows of it."""


def write_aedat4(folder: Path, info: RecordingInfo, parts: Iterator[tuple[str, Rows]]) -> None:
    """Write a new AEDAT4 file, compressed with LZ4. The format cannot hold forces.

    Args:
        folder: Folder for it.
        info: Description of the recording: camera and size.
        parts: Rows of `events`, `frames`, `imu` and `edges`, as an export names them.

    Raises:
        RecordingError: dv-processing is missing, or cannot write the data.
    """
    dv, path = _dv(), folder / AEDAT4_FILE
    config = dv.io.MonoCameraWriter.Config(info.camera or 'camera')
    config.addEventStream((info.width, info.height))
    config.addFrameStream((info.width, info.height))
    config.addImuStream()
    config.addTriggerStream()
    try:
        file = dv.io.MonoCameraWriter(str(path), config)
        for name, columns in parts:
            _write(dv, file, name, columns)
    except (RuntimeError, IndexError) as error:
        raise RecordingError(
            f'cannot write {path}: {_cause(error)}', remedy='export with --to csv or npz'
        ) from error


def _write(dv: Any, file: Any, name: str, columns: Rows) -> None:  # noqa: ANN401
    if name == 'frames':
        start, end, (x, y), image = (column[0] for column in columns.values())
        source = dv.FrameSource.SENSOR
        file.writeFrame(dv.Frame(start, end - start, x, y, left_aligned(image), source))
        return
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    if name == 'events':
        store = dv.EventStore()
        for event in rows:
            store.push_back(*event)
        file.writeEvents(store)
    for t_us, acceleration, rotation, celsius in rows if name == 'imu' else ():
        values = (*np.divide(acceleration, STANDARD_GRAVITY), *np.rad2deg(rotation), 0.0, 0.0, 0.0)
        file.writeImu(dv.IMU(t_us, celsius, *values))
    for t_us, kind in rows if name == 'edges' else ():
        file.writeTrigger(dv.Trigger(t_us, dv.TriggerType(_TRIGGERS[kind])))
