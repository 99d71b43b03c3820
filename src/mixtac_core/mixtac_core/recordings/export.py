# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Export recordings to AEDAT4, CSV, HDF5 or NPZ in one pass; only NPZ is held in memory.

All but AEDAT4 are tables with a row per reading, and units.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import InertialSamples
from mixtac_core.node.files import new_folder
from mixtac_core.recordings.aedat import write_aedat4
from mixtac_core.recordings.camera_stream import Recording, open_recording
from mixtac_core.recordings.messages import left_aligned
from mixtac_core.recordings.recording import (
    RecordingError,
    RecordingInfo,
    Selection,
)
from mixtac_core.recordings.summary import Counts
from mixtac_core.recordings.tables import (
    AXES,
    HDF5_FILE,
    TABLES,
    TOPIC_TIME,
    UNITS,
    Rows,
    open_hdf5,
    topic_file,
)

PIECES: Final = 500
"""Pieces that are written at once."""
HDF5_ROWS: Final = 1 << 14
"""Rows of a chunk, which fits into the library's cache."""
TableParts = Iterator[tuple[str, Rows]]
"""Rows of tables in recorded order: the name of a table, and its columns of equal length."""


def export_recording(
    path: Path, kind: str, out: Path, selection: Selection | None = None
) -> Counts:
    """Write a recording in another format, whole or not at all.

    Args:
        path: A recording as for `open_recording`.
        kind: One of `WRITERS`.
        out: New folder.
        selection: Which of its topics or streams; None for the only one of each kind.

    Raises:
        RecordingError: The recording cannot be read, the choice is ambiguous, or the format is
            unknown or cannot hold its data.
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
        folder.mkdir()
        counts = Counts(recording.info, recording.counters)
        parts = _camera(recording, counts)
        if kind != 'aedat4':
            parts = itertools.chain(parts, _forces(recording, counts))
        WRITERS[kind](folder, recording.info, parts)
        counts.info = recording.info
    return counts


def _camera(recording: Recording, counts: Counts) -> TableParts:
    stream = recording.pieces()
    while pieces := list(itertools.islice(stream, PIECES)):
        events = Events.concatenate([piece.events for piece in pieces])
        samples = InertialSamples.concatenate([piece.imu for piece in pieces])
        if len(events):
            yield 'events', {name: getattr(events, name) for name in ('t', 'x', 'y', 'polarity')}
        if len(samples.t):
            names = ('t', 'acceleration', 'angular_velocity', 'temperature')
            yield 'imu', {name: getattr(samples, name) for name in names}
        for piece in pieces:
            counts.add(piece)
            for frame in piece.frames:
                columns = {
                    'exposure_start': np.array([frame.exposure_start_us]),
                    'exposure_end': np.array([frame.exposure_end_us]),
                    'origin': np.array([[frame.x, frame.y]]),
                    'image': frame.image[None],
                }
                yield 'frames', columns
            if len(piece.edges.t):
                yield 'edges', {'t': piece.edges.t, 'kind': piece.edges.kind}


def _forces(recording: Recording, counts: Counts) -> TableParts:
    for topic, parts in recording.wrenches().items():
        for stamps, values in parts:
            counts.wrenches[topic] = counts.wrenches.get(topic, 0) + len(stamps)
            yield topic_file(topic), {'t': stamps, 'force': values[:, :3], 'torque': values[:, 3:]}


def _headings(name: str, columns: Rows) -> list[str]:
    """Return the columns of a table with their units: `t [us, camera clock]`."""
    units = UNITS if name in TABLES else UNITS | {'t': TOPIC_TIME}
    return [f'{key} [{units[key]}]' for key in columns]


def _write_csv(folder: Path, _info: RecordingInfo, parts: TableParts) -> None:
    """Write CSV tables with units in their headings; frames as PNG files, 10 of 16 bits aligned."""
    files: dict[str, IO[str]] = {}
    pictures = itertools.count()
    with contextlib.ExitStack() as stack:
        for name, columns in parts:
            single: Rows = {}
            if name == 'frames':
                origin, image = columns.pop('origin'), columns.pop('image')[0]
                single['file'] = np.array([_write_picture(folder, next(pictures), image)])
                columns |= {'x': origin[:, 0], 'y': origin[:, 1]}
            for heading, column in zip(_headings(name, columns), columns.values(), strict=True):
                key, space, unit = heading.partition(' ')
                keys = [key] if column.ndim == 1 else [f'{key}_{axis}' for axis in AXES]
                headings = [each + space + unit for each in keys]
                single.update(zip(headings, np.atleast_2d(column.T), strict=True))
            if name not in files:
                path = folder / f'{name}.csv'
                files[name] = stack.enter_context(path.open('x', encoding='utf8'))
                files[name].write(','.join(f'"{each}"' for each in single) + '\n')
            formats = {'f': '%.9g' if name == 'imu' else '%.17g', 'U': '%s'}
            form = ','.join(formats.get(each.dtype.kind, '%d') for each in single.values()) + '\n'
            # A minus before a zero goes.
            plain = (each + 0.0 if each.dtype.kind == 'f' else each for each in single.values())
            rows = zip(*(each.tolist() for each in plain), strict=True)
            files[name].writelines(form % row for row in rows)


def _write_picture(folder: Path, number: int, image: NDArray[np.uint16]) -> str:
    name = f'frames/{number:06d}.png'
    (folder / name).parent.mkdir(exist_ok=True)
    if not cv2.imwrite(str(folder / name), left_aligned(image)):
        raise RecordingError(f'cannot write {folder / name}', remedy='free some space')
    return name


def _write_npz(folder: Path, _info: RecordingInfo, parts: TableParts) -> None:
    """Write a .npz file per table, with its units in the array `units`."""
    held: dict[str, list[Rows]] = {}
    for name, columns in parts:
        held.setdefault(name, []).append(columns)
        for key, rows in columns.items():
            _check_shape(name, held[name][0][key], rows)
    for name, tables in held.items():
        columns = {key: np.concatenate([table[key] for table in tables]) for key in tables[0]}
        units = np.array(', '.join(_headings(name, columns)))
        np.savez_compressed(folder / f'{name}.npz', allow_pickle=False, **columns, units=units)


def _write_hdf5(folder: Path, _info: RecordingInfo, parts: TableParts) -> None:
    """Write one HDF5 file: events in the layout of the DSEC data set, other tables as groups.

    `events/p, x, y, t` with `t` in microseconds after `t_offset`, and `ms_to_idx`: the first event
    at or after each millisecond (https://dsec.ifi.uzh.ch/data-format/).
    """
    starts: list[NDArray[np.int64]] = []
    milliseconds = count = 0
    with open_hdf5(folder / HDF5_FILE, 'x') as file:
        for name, columns in parts:
            if name == 'events':
                offset_us = file.require_dataset('t_offset', (), np.int64)
                if not count:
                    offset_us[()] = columns['t'][0]
                t = columns['t'] - offset_us[()]
                if t.min() < 0 or t.max() > np.iinfo(np.uint32).max:
                    raise RecordingError(
                        f'events at {t.min()} .. {t.max()} us after the first: the layout holds 71'
                        ' minutes',
                        remedy='export with --to npz',
                    )
                limits = np.arange(milliseconds, int(t[-1]) // 1000 + 1)
                starts.append(count + np.searchsorted(t, 1000 * limits))
                milliseconds, count = milliseconds + len(limits), count + len(t)
                p = columns.pop('polarity').astype(np.uint8)
                columns |= {'p': p, 't': t.astype(np.uint32)}
            group = file.require_group(name)
            group.attrs['units'] = ', '.join(_headings(name, columns))
            for key, rows in columns.items():
                _append(group, key, rows)
        if count:
            file['ms_to_idx'] = np.concatenate(starts).astype(np.uint64)


def _append(group: Any, key: str, rows: NDArray[Any]) -> None:  # noqa: ANN401
    """Append rows to a data set of a group."""
    if key not in group:
        chunk = (1 if rows.ndim > 2 else HDF5_ROWS, *rows.shape[1:])
        options = {'maxshape': (None, *rows.shape[1:]), 'compression': 'gzip'}
        group.create_dataset(key, (0, *rows.shape[1:]), rows.dtype, chunks=chunk, **options)
    held = group[key]
    _check_shape(group.name, held, rows)
    held.resize(len(held) + len(rows), axis=0)
    held[-len(rows) :] = rows


def _check_shape(name: str, held: Any, rows: NDArray[Any]) -> None:  # noqa: ANN401
    if held.shape[1:] != rows.shape[1:]:
        raise RecordingError(
            f'{name} of {rows.shape[1:]} after {held.shape[1:]}: one array holds one size',
            remedy='export with --to csv or aedat4',
        )


WRITERS: Final[dict[str, Callable[[Path, RecordingInfo, TableParts], None]]] = {
    'aedat4': write_aedat4,
    'csv': _write_csv,
    'hdf5': _write_hdf5,
    'npz': _write_npz,
}
"""What writes a recording into a folder, by the name of `--to`."""
