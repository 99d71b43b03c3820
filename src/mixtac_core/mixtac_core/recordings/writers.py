# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write exported data as tables in CSV, NPZ or HDF5: one row per reading, with units."""

from __future__ import annotations

import contextlib
import itertools
from abc import ABC, abstractmethod
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import Edges, Frame, InertialSamples
from mixtac_core.node.topics import REFERENCE
from mixtac_core.recordings.messages import left_aligned
from mixtac_core.recordings.recording import RecordingError

HDF5_FILE = 'recording.h5'
AXES = 'xyz'
"""Names of the columns of a vector in CSV, after the name of the vector and `_`."""
CAMERA_TIME = 'us, camera clock'
TOPIC_TIME = 'ns, clock of the topic'
UNITS = {
    't': CAMERA_TIME,
    'exposure_start': CAMERA_TIME,
    'exposure_end': CAMERA_TIME,
    'x': 'px',
    'y': 'px',
    'polarity': '1 = brighter',
    'p': '1 = brighter',
    'image': '0 .. 1023',
    'origin': 'px',
    'acceleration': 'm/s^2',
    'angular_velocity': 'rad/s',
    'temperature': 'degC',
    'kind': '2 falling, 3 rising, 4 pulse, 16 and 17 generator',
    'force': 'N',
    'torque': 'N m',
}
"""Units of the columns; the times of force topics are in `TOPIC_TIME`."""
TABLES = ('events', 'frames', 'imu', 'edges')


def open_hdf5(path: Path, mode: str) -> Any:  # noqa: ANN401
    """Return an HDF5 file, an `h5py.File`, opened to read (`r`) or newly made (`x`).

    Raises:
        RecordingError: h5py is not installed, or the file cannot be opened.
    """
    try:
        import h5py
    except ImportError as error:
        raise RecordingError(
            f'HDF5 files need h5py, which is not installed ({error})',
            remedy='python3 tools/setup.py --with hdf5, or pip install h5py',
        ) from error
    with contextlib.suppress(ImportError):
        # Registers the compression of DSEC where it is installed.
        import hdf5plugin  # noqa: F401
    try:
        return h5py.File(path, mode)
    except OSError as error:
        raise RecordingError(f'{path} cannot be opened as HDF5: {error}') from error


def topic_file(topic: str) -> str:
    """Return the name under which a topic is exported."""
    return topic.strip('/').replace('/', '_')


class TableWriter(ABC):
    """Writes recorded data, each kind in order of time, as tables with a row per reading."""

    def __init__(self) -> None:
        self._topics = {REFERENCE: topic_file(REFERENCE)}

    @abstractmethod
    def table(self, name: str, units: dict[str, str], **columns: NDArray[Any]) -> None:
        """Append rows to a table.

        Args:
            name: The table.
            units: Units of its columns.
            columns: Arrays of one length; those of vectors have the shape (N, 3).
        """

    @abstractmethod
    def close(self) -> None:
        """Finish the files."""

    def events(self, events: Events) -> None:
        """Write events."""
        self.table('events', UNITS, t=events.t, x=events.x, y=events.y, polarity=events.polarity)

    def frame(self, frame: Frame) -> None:
        """Write a frame."""
        self.table(
            'frames',
            UNITS,
            exposure_start=np.array([frame.exposure_start_us]),
            exposure_end=np.array([frame.exposure_end_us]),
            origin=np.array([[frame.x, frame.y]]),
            image=frame.image[None],
        )

    def samples(self, samples: InertialSamples) -> None:
        """Write inertial samples."""
        self.table(
            'imu',
            UNITS,
            t=samples.t,
            acceleration=samples.acceleration,
            angular_velocity=samples.angular_velocity,
            temperature=samples.temperature,
        )

    def edges(self, edges: Edges) -> None:
        """Write edges."""
        self.table('edges', UNITS, t=edges.t, kind=edges.kind)

    def wrenches(self, topic: str, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Write stamps [ns, clock of the topic], shape (N,), and wrenches [N, N m], (N, 6)."""
        if topic not in self._topics:
            taken, name = {*TABLES, *self._topics.values()}, topic_file(topic)
            names = itertools.chain([name], (f'{name}_{n}' for n in itertools.count(2)))
            self._topics[topic] = next(each for each in names if each not in taken)
        units = UNITS | {'t': TOPIC_TIME}
        self.table(self._topics[topic], units, t=stamps, force=values[:, :3], torque=values[:, 3:])


class CsvWriter(TableWriter):
    """CSV tables with units in their headings; frames as PNG files of 16 bits, 10 left-aligned.

    Args:
        folder: Folder for them.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._files: dict[str, IO[str]] = {}
        self._frames = 0

    def table(self, name: str, units: dict[str, str], **columns: NDArray[Any]) -> None:
        """Append rows to a table."""
        single: dict[str, NDArray[Any]] = {}
        headings = []
        for key, column in columns.items():
            names = [key] if column.ndim == 1 else [f'{key}_{axis}' for axis in AXES]
            single.update(zip(names, np.atleast_2d(column.T), strict=True))
            headings += [f'{each} [{units[key]}]' for each in names]
        fraction = '%.9g' if name == 'imu' else '%.17g'
        form = ','.join(fraction if each.dtype.kind == 'f' else '%d' for each in single.values())
        rows = zip(*(each.tolist() for each in single.values()), strict=True)
        self._write(name, headings, ''.join([form % row + '\n' for row in rows]))

    def frame(self, frame: Frame) -> None:
        """Write a frame."""
        name = f'frames/{self._frames:06d}.png'
        self._frames += 1
        path = self._folder / name
        path.parent.mkdir(exist_ok=True)
        if not cv2.imwrite(str(path), left_aligned(frame.image)):
            raise RecordingError(f'cannot write {path}', remedy='free some space')
        times = [f'{each} [{CAMERA_TIME}]' for each in ('exposure_start', 'exposure_end')]
        row = (name, frame.exposure_start_us, frame.exposure_end_us, frame.x, frame.y)
        self._write('frames', ['file', *times, 'x [px]', 'y [px]'], ','.join(map(str, row)) + '\n')

    def close(self) -> None:
        """Finish the files."""
        for file in self._files.values():
            file.close()

    def _write(self, name: str, headings: list[str], text: str) -> None:
        if name not in self._files:
            self._files[name] = (self._folder / f'{name}.csv').open('x', encoding='utf8')
            self._files[name].write(','.join(f'"{each}"' for each in headings) + '\n')
        self._files[name].write(text)


class NpzWriter(TableWriter):
    """One .npz per table, with its units in the array `units`; held in memory until the end.

    Args:
        folder: Folder for them.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._parts: dict[str, list[dict[str, NDArray[Any]]]] = {}
        self._units: dict[str, str] = {}

    def table(self, name: str, units: dict[str, str], **columns: NDArray[Any]) -> None:
        """Append rows to the arrays of a file."""
        parts = self._parts.setdefault(name, [])
        for key, rows in columns.items() if parts else ():
            _check_shape(name, parts[0][key].shape[1:], rows.shape[1:])
        parts.append(columns)
        self._units[name] = units_text(units, columns)

    def close(self) -> None:
        """Write the files."""
        for name, parts in self._parts.items():
            columns = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
            columns['units'] = np.array(self._units[name])
            np.savez_compressed(self._folder / f'{name}.npz', allow_pickle=False, **columns)


HDF5_ROWS = 1 << 14
"""Rows of a chunk: those of a chunk fit into the library's cache."""


class Hdf5Writer(TableWriter):
    """One HDF5 file: events in the layout of the DSEC data set, other tables as groups.

    `events/p, x, y, t` with `t` in microseconds after `t_offset`, and `ms_to_idx`: the first event
    at or after each millisecond (https://dsec.ifi.uzh.ch/data-format/).

    Args:
        folder: Folder for it.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._file = open_hdf5(folder / HDF5_FILE, 'x')
        self._starts: list[NDArray[np.int64]] = []
        self._offset_us: int | None = None
        self._milliseconds = 0
        self._events = 0

    def table(self, name: str, units: dict[str, str], **columns: NDArray[Any]) -> None:
        """Append rows to the data sets of a group."""
        group = self._file.require_group(name)
        group.attrs['units'] = units_text(units, columns)
        for key, rows in columns.items():
            if key not in group:
                chunk = (1 if rows.ndim > 2 else HDF5_ROWS, *rows.shape[1:])
                shape = (0, *rows.shape[1:])
                options = {'maxshape': (None, *rows.shape[1:]), 'compression': 'gzip'}
                group.create_dataset(key, shape, rows.dtype, chunks=chunk, **options)
            held = group[key]
            _check_shape(name, held.shape[1:], rows.shape[1:])
            held.resize(len(held) + len(rows), axis=0)
            held[-len(rows) :] = rows

    def events(self, events: Events) -> None:
        """Write events."""
        if self._offset_us is None:
            self._offset_us = int(events.t[0])
        t = events.t - self._offset_us
        if t[-1] > np.iinfo(np.uint32).max or t[0] < 0:
            raise RecordingError(
                f'events at {int(t[0])} .. {int(t[-1])} us after the first: the layout holds 71'
                ' minutes',
                remedy='export with --to npz',
            )
        limits = np.arange(self._milliseconds, int(t[-1]) // 1000 + 1)
        self._starts.append(self._events + np.searchsorted(t, 1000 * limits))
        self._milliseconds += len(limits)
        self._events += len(t)
        p = events.polarity.astype(np.uint8)
        self.table('events', UNITS, p=p, x=events.x, y=events.y, t=t.astype(np.uint32))

    def close(self) -> None:
        """Write offset and index of the events, and close the file."""
        if self._offset_us is not None and 't_offset' not in self._file:
            self._file['t_offset'] = np.int64(self._offset_us)
            self._file['ms_to_idx'] = np.concatenate(self._starts).astype(np.uint64)
        self._file.close()


def units_text(units: dict[str, str], columns: dict[str, NDArray[Any]]) -> str:
    """Return the units of columns as one text: `t [us, camera clock], x [px]`."""
    return ', '.join(f'{key} [{units[key]}]' for key in columns)


def _check_shape(name: str, held: tuple[int, ...], found: tuple[int, ...]) -> None:
    if held != found:
        raise RecordingError(
            f'{name} of {found} after {held}: one array holds one size',
            remedy='export with --to csv or aedat4',
        )
