# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of events, frames, inertial samples and forces as a recording."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import Edges, Frame, InertialSamples
from mixtac_core.node.topics import REFERENCE
from mixtac_core.recordings.recording import (
    HDF5_SUFFIXES,
    Piece,
    ReadCounters,
    RecordingError,
    RecordingInfo,
    Selection,
    Wrenches,
)
from mixtac_core.recordings.tables import Rows, TableOptions, Tables, open_tables
from mixtac_core.recordings.writers import AXES, TABLES, topic_file

PACKET_US = 10_000
"""Longest stretch of a table in one piece [us]."""
DAVIS346: Final = (346, 260)


class TableRecording:
    """Tables of a file or a folder as a recording.

    Args:
        path: The file or the folder.
        tables: Its tables.
        options: How to read them.

    Attributes:
        counters: Losses; there are none.

    Raises:
        RecordingError: There are no tables of events or frames, or they cannot be read.
    """

    def __init__(self, path: Path, tables: Tables, options: TableOptions) -> None:
        self.counters = ReadCounters()
        self._path, self._tables, self._options = path, tables, options
        if not tables.names & {'events', 'frames'}:
            raise RecordingError(
                f'{path} holds neither events nor frames, but'
                f' {", ".join(sorted(tables.names)) or "nothing"}',
                remedy='name the tables events and frames; in HDF5, choose a group with --events',
            )
        self._frame_size: tuple[int, int] | None = None
        first = next(self.pieces(), None)
        if first is None:
            raise RecordingError(f'{path} holds nothing: no events and no frames')
        self._start_us = first.start_us

    @property
    def info(self) -> RecordingInfo:
        """Description; the length is not known."""
        width, height = self._size() or DAVIS346
        return RecordingInfo(
            path=self._path,
            kind='tables',
            camera='',
            width=width,
            height=height,
            color_filter=0,
            start_us=self._start_us,
            length_us=0,
            contents=tuple((name, name) for name in TABLES if name in self._tables.names),
            size_known=self._size() is not None,
        )

    def pieces(self) -> Generator[Piece, None, None]:
        """Yield the rows of all tables, merged by time.

        Raises:
            RecordingError: A table cannot be read, or events lie outside of the camera.
        """
        unit, names = self._options.time_unit, self._tables.names
        parts = [
            _cut(self._tables.rows(name, unit), 't', make)
            for name, make in (('imu', _samples), ('edges', _edges), ('events', self._events))
            if name in names
        ]
        if 'frames' in names:
            for rows in itertools.islice(self._tables.rows('frames', unit), 1):
                self._frame_size = rows['image'].shape[:0:-1]
            parts.append(_cut(self._tables.rows('frames', unit), 'exposure_end', _frames, one=True))
        yield from heapq.merge(*parts, key=lambda piece: piece.until_us)

    def wrenches(self) -> Mapping[str, Wrenches]:
        """Return the reference force, if there is such a table."""
        name = topic_file(REFERENCE)
        if name not in self._tables.names:
            return {}
        return {REFERENCE: _force_rows(self._tables, name, self._options)}

    def close(self) -> None:
        """Close the files."""
        self._tables.close()

    def _size(self) -> tuple[int, int] | None:
        """Return width and height: as given, those of the first frame, or as a table states."""
        return self._options.size or self._frame_size or self._tables.size

    def _events(self, rows: Rows) -> dict[str, Any]:
        x, y, size = rows['x'], rows['y'], self._size() or DAVIS346
        if min(x.min(), y.min()) < 0 or x.max() >= size[0] or y.max() >= size[1]:
            raise RecordingError(
                f'events at {int(x.min())} .. {int(x.max())}, {int(y.min())} .. {int(y.max())} are'
                f' outside of {size[0]} x {size[1]} pixels',
                remedy='give the size of the camera with --size',
            )
        columns = (x.astype(np.uint16), y.astype(np.uint16), rows['polarity'])
        return {'events': Events(rows['t'], *columns)}


def open_table_recording(
    path: Path, selection: Selection, options: TableOptions
) -> TableRecording | None:
    """Open tables as a recording; None where a path holds none.

    Args:
        path: The file or the folder.
        selection: The group of the events in an HDF5 file.
        options: How to read them.

    Raises:
        RecordingError: They cannot be read, or there is nothing to choose.
    """
    is_hdf5 = path.suffix.lower() in HDF5_SUFFIXES
    tables = open_tables(path, group=selection.events if is_hdf5 else '')
    if tables is None:
        return None
    if selection != Selection() and not is_hdf5:
        raise RecordingError(
            f'{path} holds tables: there is nothing to choose',
            remedy='leave out --events, --image and --imu',
        )
    try:
        return TableRecording(path, tables, options)
    except RecordingError:
        tables.close()
        raise


def _cut(
    tables: Iterator[Rows], key: str, make: Callable[[Rows], dict[str, Any]], *, one: bool = False
) -> Iterator[Piece]:
    """Yield pieces of at most `PACKET_US`, or of one row, that `make` fills."""
    for rows in tables:
        t = rows[key]
        changes = np.arange(1, len(t)) if one else np.flatnonzero(np.diff(t // PACKET_US)) + 1
        for start, end in itertools.pairwise([0, *changes.tolist(), len(t)]):
            part = {name: column[start:end] for name, column in rows.items()}
            first, last = int(part[key][0]), int(part[key][-1])
            yield Piece(first, last, advances='polarity' in part, **make(part))


def _samples(rows: Rows) -> dict[str, Any]:
    count = len(rows['t'])
    temperature = rows.get('temperature', np.full(count, np.nan))
    acceleration, rotation = (
        _vector(rows, name, count) for name in ('acceleration', 'angular_velocity')
    )
    samples = InertialSamples(rows['t'], acceleration, rotation, temperature.astype(np.float64))
    return {'imu': samples}


def _edges(rows: Rows) -> dict[str, Any]:
    return {'edges': Edges(rows['t'], rows['kind'].astype(np.uint8))}


def _frames(rows: Rows) -> dict[str, Any]:
    start, end = int(rows['exposure_start'][0]), int(rows['exposure_end'][0])
    x, y = (int(value) for value in rows['origin'][0])
    image = np.ascontiguousarray(rows['image'][0])
    return {'frames': (Frame(image, x, y, start, start, end, end, end - start, True),)}


def table_wrenches(path: Path, options: TableOptions) -> Wrenches:
    """Return the forces of a file that holds nothing else.

    Args:
        path: A .csv or .npz file.
        options: How to read it.

    Raises:
        RecordingError: It cannot be read, or holds no forces.
    """
    path, remedy = path.expanduser(), 'give a .csv or .npz file'
    if not path.exists():
        raise RecordingError(f'no table of forces at {path}', remedy=remedy)
    tables = open_tables(path, 'forces')
    if tables is None or len(tables.names) != 1:
        raise RecordingError(f'{path} is no table of forces', remedy=remedy)
    rows = _force_rows(tables, next(iter(tables.names)), options)
    first = next(rows, None)
    if first is None:
        raise RecordingError(f'{path} holds no forces', remedy='give a table with rows')
    return itertools.chain([first], rows)


def _force_rows(tables: Tables, name: str, options: TableOptions) -> Wrenches:
    """Yield the forces of a table: stamps [ns], [n], and forces and torques [N, N m], [n, 6]."""
    for rows in tables.rows(name, options.force_unit, 's', wanted_ns=1):
        count = len(rows['t'])
        values = np.hstack([_vector(rows, kind, count) for kind in ('force', 'torque')])
        known = np.isfinite(values).all(axis=1)
        if not known.all():
            raise RecordingError(
                f'{tables.path}: row {int(np.argmin(known)) + 1} has no finite normal force; found'
                f' columns {", ".join(rows)}',
                remedy='name the normal force force_z or fz, and remove rows without a number',
            )
        yield rows['t'], values


def _vector(rows: Rows, name: str, count: int) -> NDArray[np.float64]:
    """Return a vector per row [n, 3]; components of a force that are missing are 0, its z NaN."""
    if name in rows and rows[name].ndim == 2:
        return rows[name].astype(np.float64)
    absent = np.zeros(count) if name in {'force', 'torque'} else np.full(count, np.nan)
    columns = [rows.get(f'{name}_{axis}', absent) for axis in AXES]
    if name == 'force' and 'force_z' not in rows:
        columns[2] = np.full(count, np.nan)
    return np.stack(columns, axis=1).astype(np.float64)
