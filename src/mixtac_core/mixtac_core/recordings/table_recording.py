# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files whose streams are read as rows of tables, as recordings; tables are checked.

Rows are columns as an export names them, of `events`, `frames`, `imu` and `edges`.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import Edges, Frame, InertialSamples
from mixtac_core.node.topics import REFERENCE
from mixtac_core.recordings.messages import ten_bits
from mixtac_core.recordings.recording import (
    HDF5_SUFFIXES,
    Piece,
    ReadCounters,
    RecordingError,
    RecordingInfo,
    Selection,
    Wrenches,
)
from mixtac_core.recordings.tables import (
    AXES,
    EVENT_COLUMNS,
    TIME_UNITS,
    TIMES,
    Block,
    Rows,
    TableOptions,
    find_tables,
    stated_size,
    topic_file,
)

NEEDED: Final = {
    'events': EVENT_COLUMNS,
    'frames': ('exposure_start', 'exposure_end', 'image'),
    'edges': ('t', 'kind'),
}
"""Columns that a table must have; others need `t`."""
SLICE_US: Final = 1000
"""Longest piece [us]: data of other streams are delayed by at most this much."""
MOST_GREY: Final = 1023
DAVIS346: Final = (346, 260)
Streams = dict[str, Callable[[], Iterator[Rows]]]
"""What reads each stream from its beginning, some rows at a time, by its name."""


class FileRecording:
    """A file, or a folder of files, with streams of rows.

    Args:
        info: Its description, without start and contents.
        streams: Its streams; times in microseconds, frames of 10 bits.
        counters: Losses that the streams count.
        forces: Reader of the reference force, if the recording has one.

    Attributes:
        info: Its description.
        counters: Losses found so far.

    Raises:
        RecordingError: The streams cannot be read, or hold nothing.
    """

    def __init__(
        self,
        info: RecordingInfo,
        streams: Streams,
        *,
        counters: ReadCounters | None = None,
        forces: Callable[[], Wrenches] | None = None,
    ) -> None:
        self.counters = counters or ReadCounters()
        self._streams, self._forces = streams, forces
        first = {name: next(part, None) for name, part in zip(streams, self._parts(), strict=True)}
        self._streams = {name: read for name, read in streams.items() if first[name]}
        starts = [piece.start_us for piece in first.values() if piece]
        if not starts:
            raise RecordingError(
                f'{info.path} holds nothing: no events and no frames',
                remedy='name the tables events and frames; in HDF5, choose a group with --events',
            )
        contents = tuple((name, name) for name in self._streams)
        self.info = replace(info, start_us=min(starts), contents=contents)

    def pieces(self) -> Generator[Piece, None, None]:
        """Yield what was recorded, merged by time, without events outside of the camera.

        Raises:
            RecordingError: The file is damaged.
        """
        for piece in heapq.merge(*self._parts(), key=lambda piece: piece.until_us):
            piece.check()
            events, width, height = piece.events, self.info.width, self.info.height
            inside = (events.x < width) & (events.y < height)
            self.counters.events_outside += int(np.count_nonzero(~inside))
            yield piece if inside.all() else replace(piece, events=events[inside])

    def wrenches(self) -> Mapping[str, Wrenches]:
        """Return the reference force, if it is recorded."""
        return {REFERENCE: self._forces()} if self._forces else {}

    def close(self) -> None:
        """Close nothing: a file is open while its rows are read."""

    def _parts(self) -> list[Iterator[Piece]]:
        # Frames set the pace if there are no events.
        return [
            _cut(read(), name, advances=name == 'events' or 'events' not in self._streams)
            for name, read in self._streams.items()
        ]


def _cut(stream: Iterator[Rows], name: str, *, advances: bool) -> Iterator[Piece]:
    """Yield the readings of a stream in pieces of at most `SLICE_US`, or of one frame."""
    for rows in stream:
        t = rows['exposure_end' if name == 'frames' else 't']
        steps = np.ones(len(t) - 1) if name == 'frames' else np.diff(t // SLICE_US)
        for start, end in itertools.pairwise([0, *(np.flatnonzero(steps) + 1).tolist(), len(t)]):
            part = {key: column[start:end] for key, column in rows.items()}
            yield Piece(int(t[start]), int(t[end - 1]), advances, **_readings(name, part))


def _readings(name: str, rows: Rows) -> dict[str, Any]:
    """Return the readings of rows, by the attribute of a piece; frames are one row."""
    if name == 'events':
        x, y = (rows[key].astype(np.uint16) for key in 'xy')
        return {'events': Events(rows['t'], x, y, rows['polarity'])}
    if name == 'edges':
        return {'edges': Edges(rows['t'], rows['kind'].astype(np.uint8))}
    if name == 'imu':
        acceleration, rotation = (
            _vector(rows, key, np.nan) for key in ('acceleration', 'angular_velocity')
        )
        temperature = rows.get('temperature', np.full(len(rows['t']), np.nan)).astype(np.float64)
        return {'imu': InertialSamples(rows['t'], acceleration, rotation, temperature)}
    start, end = int(rows['exposure_start'][0]), int(rows['exposure_end'][0])
    column, row = (int(value) for value in rows['origin'][0])
    image = np.ascontiguousarray(rows['image'][0])
    return {'frames': (Frame(image, column, row, start, start, end, end, end - start, True),)}


def open_table_recording(
    path: Path, selection: Selection, options: TableOptions
) -> FileRecording | None:
    """Open tables as a recording; None where a path holds none.

    Args:
        path: The file or the folder.
        selection: The group of the events in an HDF5 file.
        options: How to read them.

    Raises:
        RecordingError: They cannot be read, or there is nothing to choose.
    """
    is_hdf5 = path.suffix.lower() in HDF5_SUFFIXES
    tables = find_tables(path, group=selection.events if is_hdf5 else '')
    if not tables:
        return None
    if selection != Selection() and not is_hdf5:
        remedy = 'leave out --events, --image and --imu'
        raise RecordingError(f'{path} holds tables: there is nothing to choose', remedy=remedy)
    known, unit = options.size or stated_size(path), options.time_unit
    if known is None and 'frames' in tables:
        for rows in itertools.islice(_checked_rows(path, 'frames', tables['frames'], unit), 1):
            known = rows['image'].shape[2], rows['image'].shape[1]
    size = known or DAVIS346
    streams: Streams = {
        name: partial(_checked_rows, path, name, tables[name], unit, size=size)
        for name in ('imu', 'edges', 'events', 'frames')
        if name in tables
    }
    name, unit = topic_file(REFERENCE), options.force_unit
    forces = partial(_force_rows, path, name, tables[name], unit) if name in tables else None
    info = RecordingInfo(path, 'tables', *size, size_known=bool(known))
    return FileRecording(info, streams, forces=forces)


def table_wrenches(path: Path, options: TableOptions) -> Wrenches:
    """Return the forces of a file that holds nothing else.

    Args:
        path: A .csv or .npz file.
        options: How to read it.

    Raises:
        RecordingError: It is no table.
    """
    path = path.expanduser()
    tables = find_tables(path, 'forces')
    if len(tables) != 1:
        raise RecordingError(f'no table of forces at {path}', remedy='give a .csv or .npz file')
    return _force_rows(path, 'forces', next(iter(tables.values())), options.force_unit)


def _force_rows(path: Path, name: str, read: Callable[[], Iterator[Block]], unit: str) -> Wrenches:
    """Yield the forces of a table: stamps [ns], [n], and forces and torques [N, N m], [n, 6]."""
    for rows in _checked_rows(path, name, read, unit or 's', wanted_ns=1):
        values = np.hstack([_vector(rows, kind, 0.0) for kind in ('force', 'torque')])
        known = np.isfinite(values).all(axis=1)
        if not known.all() or not {'force', 'force_z'} & rows.keys():
            raise RecordingError(
                f'{path}: row {int(np.argmin(known)) + 1} has no finite normal force; found'
                f' columns {", ".join(rows)}',
                remedy='name the normal force force_z or fz, and remove rows without a number',
            )
        yield rows['t'], values


def _vector(rows: Rows, name: str, missing: float) -> NDArray[np.float64]:
    """Return a vector per row [n, 3] of one column or three; `missing` for columns that lack."""
    if name in rows and rows[name].ndim == 2:
        return rows[name].astype(np.float64)
    absent = np.full(len(rows['t']), missing)
    columns = [rows.get(f'{name}_{axis}', absent) for axis in AXES]
    return np.stack(columns, axis=1).astype(np.float64)


def _checked_rows(
    path: Path,
    name: str,
    read: Callable[[], Iterator[Block]],
    unit: str,
    *,
    size: tuple[int, int] = DAVIS346,
    wanted_ns: int = 1000,
) -> Iterator[Rows]:
    """Yield the columns of a table, some rows at a time; frames are of 10 bits.

    Args:
        path: As shown in errors.
        name: The table.
        read: What reads it.
        unit: Unit of its times where the file states none; empty for whole microseconds.
        size: Width and height of the camera.
        wanted_ns: Unit of the times that are returned [ns].

    Raises:
        RecordingError: It cannot be read, columns or numbers are missing, or the times have
            another unit.
    """
    first = 1
    for block in read():
        rows, given = _needed_rows(path, name, block, first), block.unit or unit
        for key in rows.keys() & set(TIMES):
            if not given:
                remedy = 'times without a unit are whole microseconds: give --time-unit s, or ms'
                _refuse(rows[key] % 1 != 0, f'{path}: {name}', key, rows[key], first, remedy)
            rows[key] = _scaled(f'{path}: {name}', rows[key], given or 'us', wanted_ns)
        for key in 'xy' if name == 'events' else '':
            remedy = 'pixels are whole numbers: give them without rectification'
            _refuse(rows[key] % 1 != 0, f'{path}: {name}', key, rows[key], first, remedy)
        if name == 'events':
            _check_events(path, rows, size)
            rows['polarity'] = rows['polarity'] > 0
        if name == 'frames':
            rows['image'] = _grey(path, rows['image'])
            rows.setdefault('origin', np.zeros((len(rows['image']), 2), np.int64))
        if count := len(rows[next(iter(rows))]):
            yield rows
        first += count


def _needed_rows(path: Path, name: str, block: Block, first: int) -> Rows:
    """Return rows whose needed columns hold finite numbers; `first` is the number of the first."""
    rows, needed = block.rows, NEEDED.get(name, ('t',))
    if name == 'frames' and 't' in rows:
        rows['exposure_start'] = rows['exposure_end'] = rows['t']
    if missing := [each for each in needed if each not in rows]:
        raise RecordingError(
            f'{path}: {name} has no column {missing[0]}; found: {block.headings}',
            remedy=f'name the columns {", ".join(needed)}',
        )
    for key in needed:
        column, dimensions = rows[key], 3 if key == 'image' else 1
        if column.ndim != dimensions or column.dtype.kind not in 'biuf':
            raise RecordingError(
                f'{path}: {key} of {name} is of type {column.dtype} and shape {column.shape}',
                remedy=f'store numbers in {dimensions} dimensions',
            )
        remedy = 'write a finite number, or remove the row'
        _refuse(~np.isfinite(column), f'{path}: {name}', key, column, first, remedy)
    return rows


def _refuse(
    bad: NDArray[np.bool_], place: str, key: str, column: NDArray[Any], first: int, remedy: str
) -> None:
    if bad.any():
        row = int(np.argmax(bad))
        raise RecordingError(
            f'{place} has {key} = {column[row]} in row {first + row}', remedy=remedy
        )


def _scaled(place: str, t: NDArray[Any], unit: str, wanted_ns: int) -> NDArray[np.int64]:
    """Return times in the wanted unit; those with fractions are rounded."""
    if unit not in TIME_UNITS:
        raise RecordingError(
            f'unknown unit of time {unit!r}', remedy=f'use one of {", ".join(TIME_UNITS)}'
        )
    unit_ns = TIME_UNITS[unit]
    if np.abs(t.astype(np.float64)).max(initial=0) >= 2.0**31 * 1e9 / unit_ns:
        raise RecordingError(
            f'{place} has times of {t.min()} to {t.max()} {unit}, which no stamp of ROS holds',
            remedy='give the unit of the times with --time-unit or --force-unit',
        )
    if t.dtype.kind == 'f':
        return np.rint(t * (unit_ns / wanted_ns)).astype(np.int64)
    return t.astype(np.int64) * unit_ns // wanted_ns


def _check_events(path: Path, rows: Rows, size: tuple[int, int]) -> None:
    x, y, values = rows['x'], rows['y'], np.unique(rows['polarity']).tolist()
    if not (set(values) <= {0, 1} or set(values) <= {-1, 1}):
        raise RecordingError(
            f'{path}: polarity has the values {", ".join(map(str, values[:5]))}',
            remedy='write 0 and 1, -1 and 1, or true and false (unnamed columns are t, x, y, p)',
        )
    if len(x) and (min(x.min(), y.min()) < 0 or x.max() >= size[0] or y.max() >= size[1]):
        raise RecordingError(
            f'events at {int(x.min())} .. {int(x.max())}, {int(y.min())} .. {int(y.max())} are'
            f' outside of {size[0]} x {size[1]} pixels',
            remedy='give the size of the camera with --size (unnamed columns are t, x, y, p)',
        )


def _grey(path: Path, image: NDArray[Any]) -> NDArray[np.uint16]:
    """Return grey values of 0 .. 1023; 8 bits become the upper ones."""
    if image.dtype == np.uint8:
        return ten_bits(image)
    darkest, brightest = image.min(initial=0), image.max(initial=0)
    if image.dtype.kind not in 'iu' or darkest < 0 or brightest > MOST_GREY:
        raise RecordingError(
            f'{path}: frames are {image.dtype} of {darkest} to {brightest}',
            remedy=f'store them as uint8, or as integers of 0 to {MOST_GREY}',
        )
    return image.astype(np.uint16)
