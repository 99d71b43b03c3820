# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""AEDAT 2.0 files, read, and AEDAT4 files, read and written.

AEDAT 2.0 files of a DAVIS240 or DAVIS346, as jAER records them, hold one word of 8 bytes per event
or pixel: an address and a time [us], both big-endian. An address has row (9 bits from bit 22) and
column (10 bits from bit 12). Of an event, bits 31 and 10 are 0, bit 11 is the polarity, and columns
are counted from the right. Of a pixel of a frame, bit 31 is 1, bit 11 is 0, and bits 0 to 9 are the
converted value: before the exposure where bit 10 is 0 (reset read), and after it (signal read).
Inertial samples, which lack their scale, and edges of the external input are skipped and counted.
Rows are numbered as jAER numbers them.

AEDAT4 files of one camera are read and written with the optional package dv-processing. Times [us]
are those of the file. Another process reads the whole file first, because dv-processing never
returns from some damaged packets.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

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
WORDS: Final = 10_000
"""Words that are read at once."""
_HEADER_LINE: Final = re.compile(rb'#[^\x00-\x08\x0a-\x0c\x0e-\x1f]*\n')
PATIENCE_S: Final = 60.0
"""Longest time to read a file, apart from that for its size [s]."""
SLOWEST: Final = 2e6
"""Least speed of reading on a busy machine [bytes/s]."""
_CHECK: Final = """
import sys
from contextlib import suppress
from dv_processing.io import MonoCameraRecording
file = MonoCameraRecording(*filter(None, sys.argv[1:3]))
for name in sys.argv[3:]:
    with suppress(RuntimeError):
        while getattr(file, name)() is not None: pass
"""
"""Reads all streams of a file; errors are left to the process that reads it next."""
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
        selection: `NONE` leaves events or frames out.
        size: Width and height of the sensor; None for the size of the chip that the header names.

    Raises:
        RecordingError: It holds nothing, or the size is not known.
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
            f'{path} is of the chip {chip or "(not named)"}: only DAVIS240 and DAVIS346 are read',
            remedy='give --size 346x260 or 240x180 if it is such a camera, or open it in jAER'
            ' and export events as csv with columns t, x, y, p',
        )
    counters = ReadCounters()
    streams: Streams = {}
    if selection.events != NONE:
        streams['events'] = partial(_word_events, path, start, size, counters)
    if selection.image != NONE:
        streams['frames'] = partial(_word_frames, path, start, size, counters)
    return FileRecording(RecordingInfo(path, 'AEDAT 2 file', *size), streams, counters=counters)


def _words(path: Path, start: int) -> Iterator[tuple[NDArray[np.int64], ...]]:
    """Yield addresses, columns and rows in them, and times [us] beyond 32 bits."""
    latest_us = None
    with path.open('rb') as file:
        file.seek(start)
        while len(data := file.read(8 * WORDS)) >= 8:
            words = np.frombuffer(data, '>u4', len(data) // 8 * 2).astype(np.int64)
            address, t = words[::2], words[1::2]
            latest_us = int(t[0]) if latest_us is None else latest_us
            # Steps of 32 bits are shorter than 2^31 us.
            steps = np.diff(t, prepend=latest_us) + (1 << 31) & 0xFFFFFFFF
            t = latest_us + np.cumsum(steps - (1 << 31))
            latest_us = int(t[-1])
            yield address, address >> 12 & 0x3FF, address >> 22 & 0x1FF, t


def _word_events(
    path: Path, start: int, size: tuple[int, int], counters: ReadCounters
) -> Iterator[Rows]:
    others = 0
    for address, x, y, t in _words(path, start):
        is_event = address & (1 << 31 | 1 << 10) == 0
        others += int(np.count_nonzero(~is_event & ~_is_pixel(address)))
        if is_event.any():
            # Columns left of the first become large, outside of any sensor.
            rows: Rows = {'t': t, 'x': (size[0] - 1 - x).astype(np.uint16), 'y': y}
            rows['polarity'] = address >> 11 & 1 == 1
            yield {name: column[is_event] for name, column in rows.items()}
    counters.other_words += others


def _word_frames(
    path: Path, start: int, size: tuple[int, int], counters: ReadCounters
) -> Iterator[Rows]:
    """Yield the frames that are complete: both reads of every pixel. Any corner may come first.

    Exposures last from the last reset read to the first signal read, as with a global shutter. With
    a rolling shutter only their middle is right: it is the middle of the pixels' mean exposure.
    """
    width, height = size
    samples = np.full((2, height, width), -1, np.int16)
    times = np.zeros(samples.shape, np.int64)
    half, incomplete = np.array([[height // 2], [width // 2]]), 0
    latest = -2 * half - 1
    for address, x, y, t in _words(path, start):
        pixels = np.flatnonzero(_is_pixel(address) & (x < width) & (y < height))
        place = address[pixels] >> 10 & 1, y[pixels], x[pixels]
        resets = np.flatnonzero(place[0] == 0)
        reset = np.stack(place[1:])[:, resets]
        # Row and column both jump only from the last pixel of a frame to the first of the next.
        jumps = (np.abs(np.diff(reset, prepend=latest)) > half).all(axis=0)
        latest = reset[:, -1:] if len(resets) else latest
        for number, part in enumerate(np.split(np.arange(len(pixels)), resets[jumps])):
            if number:
                incomplete += int((samples >= 0).any())
                samples[:] = -1
            where, words = tuple(each[part] for each in place), pixels[part]
            samples[where], times[where] = address[words] & 0x3FF, t[words]
            if len(part) and (samples >= 0).all():
                begin_us, end_us = sorted((times[0].max(), times[1].min()))
                yield {
                    'exposure_start': np.array([begin_us]),
                    'exposure_end': np.array([end_us]),
                    'origin': np.zeros((1, 2), np.int64),
                    'image': (samples[0] - samples[1]).clip(0).astype(np.uint16)[None],
                }
                samples[:] = -1
    counters.frames_incomplete += incomplete + int((samples >= 0).any())


def _is_pixel(address: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(address & (1 << 31 | 1 << 11) == 1 << 31)


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
    _check(path, camera)
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


def _check(path: Path, camera: str) -> None:
    """Check that dv-processing returns from all packets of a file.

    Raises:
        DamagedRecordingError: It does not, or crashes.
    """
    following = [name for _, name, _ in _STREAMS.values()]
    command = [sys.executable, '-c', _CHECK, str(path), camera, *following]
    limit_s = PATIENCE_S + path.stat().st_size / SLOWEST
    with _refusing_damage(path):
        try:
            done = subprocess.run(command, check=False, capture_output=True, timeout=limit_s)
        except subprocess.TimeoutExpired as error:
            raise RuntimeError('dv-processing never returns') from error
        if done.returncode < 0:
            raise RuntimeError('dv-processing crashes')


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
