# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The files of exported data: AEDAT4, CSV, HDF5 and NPZ, written as the data come."""

from __future__ import annotations

import contextlib
import itertools
import shutil
import tempfile
import zipfile
from abc import ABC, abstractmethod
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_events.readings import Edges, Frame, InertialSamples
from mixtac_node.topics import REFERENCE
from mixtac_recordings import aedat4
from mixtac_recordings.aedat4_file import Aedat4Writer
from mixtac_recordings.messages import left_aligned
from mixtac_recordings.recording import RecordingError, RecordingInfo


class GrowingNpz:
    """An .npz file whose arrays grow: each is in a temporary file until the end.

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
        """Append rows to an array; all have the type and row shape of the first.

        Raises:
            RecordingError: The rows have another shape.
        """
        if name not in self._files:
            self._files[name] = (self._folder / name).open('w+b')
            self._shapes[name], self._types[name] = (0, *rows.shape[1:]), rows.dtype
        shape = self._shapes[name]
        if rows.shape[1:] != shape[1:]:
            raise RecordingError(
                f'{name} of {rows.shape[1:]} after {shape[1:]}: one array holds one size',
                remedy='export with --to csv or aedat4',
            )
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
        """Remove the temporary files."""
        for file in self._files.values():
            file.close()
        shutil.rmtree(self._folder, ignore_errors=True)


AEDAT4_FILE, HDF5_FILE = 'recording.aedat4', 'recording.h5'
"""Files of the formats that are one file."""
HDF5_SUFFIXES = frozenset({'.h5', '.hdf5'})


def load_h5py() -> Any:  # noqa: ANN401
    """Return the module h5py.

    Raises:
        RecordingError: It is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise RecordingError(
            f'HDF5 files need h5py, which is not installed ({error})',
            remedy='python3 tools/setup.py --with hdf5, or pip install h5py',
        ) from error
    return h5py


def open_hdf5(path: Path, mode: str) -> Any:  # noqa: ANN401
    """Return an HDF5 file, an `h5py.File`, opened to read (`r`) or newly made (`x`).

    Raises:
        RecordingError: h5py is not installed, or the file cannot be opened.
    """
    h5py = load_h5py()
    with contextlib.suppress(ImportError):
        # Registers the compression of DSEC where it is installed.
        import hdf5plugin  # noqa: F401
    try:
        return h5py.File(path, mode)
    except OSError as error:
        raise RecordingError(f'{path} cannot be opened as HDF5: {error}') from error


class Aedat4Sink:
    """One AEDAT4 file, which cannot hold wrenches.

    Args:
        folder: Folder for it.
        info: Description of the recording.
    """

    def __init__(self, folder: Path, info: RecordingInfo) -> None:
        size = (info.width, info.height)
        self._file = Aedat4Writer(folder / AEDAT4_FILE, size, info.camera or 'camera')

    def events(self, events: Events) -> None:
        """Write events."""
        self._write('EVTS', aedat4.events_packet(events), events.t)

    def frame(self, frame: Frame) -> None:
        """Write a frame."""
        self._write('FRME', aedat4.frame_packet(frame), np.array([frame.exposure_start_us]))

    def samples(self, samples: InertialSamples) -> None:
        """Write inertial samples."""
        self._write('IMUS', aedat4.samples_packet(samples), samples.t)

    def edges(self, edges: Edges) -> None:
        """Write edges."""
        self._write('TRIG', aedat4.edges_packet(edges), edges.t)

    def wrenches(self, topic: str, rows: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Ignore wrenches."""

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def discard(self) -> None:
        """Close the file as it is."""
        self._file.discard()

    def _write(self, stream: str, packet: bytes, t: NDArray[np.int64]) -> None:
        self._file.write(stream, packet, len(t), int(t[0]), int(t[-1]))


CAMERA = 'us, camera clock'
WRENCH_COLUMNS = (
    't [ns, clock of the topic]',
    *(f'force_{axis} [N]' for axis in 'xyz'),
    *(f'torque_{axis} [N m]' for axis in 'xyz'),
)
HEADINGS = {
    'events': (f't [{CAMERA}]', 'x [px]', 'y [px]', 'polarity [1 = brighter]'),
    'frames': (
        'file',
        f'exposure_start [{CAMERA}]',
        f'exposure_end [{CAMERA}]',
        'x [px]',
        'y [px]',
    ),
    'imu': (
        f't [{CAMERA}]',
        *(f'acceleration_{axis} [m/s^2]' for axis in 'xyz'),
        *(f'angular_velocity_{axis} [rad/s]' for axis in 'xyz'),
        'temperature [degC]',
    ),
    'edges': (f't [{CAMERA}]', 'kind [2 falling, 3 rising, 4 pulse, 16 and 17 generator]'),
}


def topic_file(topic: str) -> str:
    """Return the name under which a topic is exported."""
    return topic.strip('/').replace('/', '_')


class TableSink(ABC):
    """What receives recorded data, each kind in order of time, as tables with a row per reading."""

    def __init__(self) -> None:
        self._topics = {REFERENCE: topic_file(REFERENCE)}

    @abstractmethod
    def table(self, name: str, **columns: NDArray[Any]) -> None:
        """Append rows to a table; columns of several numbers are of shape (N, numbers)."""

    @abstractmethod
    def close(self) -> None:
        """Finish the files."""

    @abstractmethod
    def discard(self) -> None:
        """Close the files as they are."""

    def events(self, events: Events) -> None:
        """Write events."""
        self.table('events', t=events.t, x=events.x, y=events.y, polarity=events.polarity)

    def frame(self, frame: Frame) -> None:
        """Write a frame."""
        self.table(
            'frames',
            exposure_start=np.array([frame.exposure_start_us]),
            exposure_end=np.array([frame.exposure_end_us]),
            origin=np.array([[frame.x, frame.y]]),
            image=frame.image[None],
        )

    def samples(self, samples: InertialSamples) -> None:
        """Write inertial samples."""
        self.table(
            'imu',
            t=samples.t,
            acceleration=samples.acceleration,
            angular_velocity=samples.angular_velocity,
            temperature=samples.temperature,
        )

    def edges(self, edges: Edges) -> None:
        """Write edges."""
        self.table('edges', t=edges.t, kind=edges.kind)

    def wrenches(self, topic: str, rows: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Write stamps [ns, clock of the topic], shape (N,), and wrenches [N, N m], (N, 6)."""
        if topic not in self._topics:
            taken, name = {*HEADINGS, *self._topics.values()}, topic_file(topic)
            names = itertools.chain([name], (f'{name}_{n}' for n in itertools.count(2)))
            self._topics[topic] = next(each for each in names if each not in taken)
        self.table(self._topics[topic], t=rows, force=values[:, :3], torque=values[:, 3:])


class CsvSink(TableSink):
    """CSV tables with units in their headings; frames as PNG files of 16 bits, 10 left-aligned.

    Args:
        folder: Folder for them.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._files: dict[str, IO[str]] = {}
        self._frames = 0

    def table(self, name: str, **columns: NDArray[Any]) -> None:
        """Append rows to a table."""
        parts = [part for each in columns.values() for part in np.atleast_2d(each.T)]
        fraction = '%.9g' if name == 'imu' else '%.17g'
        form = ','.join(fraction if part.dtype.kind == 'f' else '%d' for part in parts)
        rows = zip(*(part.tolist() for part in parts), strict=True)
        self._write(name, HEADINGS.get(name, WRENCH_COLUMNS), form + '\n', rows)

    def frame(self, frame: Frame) -> None:
        """Write a frame."""
        name = f'frames/{self._frames:06d}.png'
        self._frames += 1
        path = self._folder / name
        path.parent.mkdir(exist_ok=True)
        if not cv2.imwrite(str(path), left_aligned(frame.image)):
            raise RecordingError(f'cannot write {path}', remedy='free some space')
        row = (name, frame.exposure_start_us, frame.exposure_end_us, frame.x, frame.y)
        self._write('frames', HEADINGS['frames'], '%s,%d,%d,%d,%d\n', [row])

    def close(self) -> None:
        """Finish the files."""
        for file in self._files.values():
            file.close()

    discard = close

    def _write(self, name: str, headings: tuple[str, ...], form: str, rows: Any) -> None:  # noqa: ANN401
        if name not in self._files:
            self._files[name] = (self._folder / f'{name}.csv').open('x', encoding='utf8')
            self._files[name].write(','.join(f'"{each}"' for each in headings) + '\n')
        self._files[name].write(''.join([form % row for row in rows]))


class NpzSink(TableSink):
    """One .npz per kind of data, and `UNITS_FILE` with the units of the arrays.

    Args:
        folder: Folder for them.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._files: dict[str, GrowingNpz] = {}

    def table(self, name: str, **columns: NDArray[Any]) -> None:
        """Append rows to the arrays of a file."""
        file = self._files.get(name)
        if file is None:
            file = self._files[name] = GrowingNpz(self._folder / f'{name}.npz')
        for key, rows in columns.items():
            file.append(key, rows)

    def close(self) -> None:
        """Finish the files."""
        for file in self._files.values():
            file.close()
        (self._folder / UNITS_FILE).write_text(UNITS, encoding='utf8')

    def discard(self) -> None:
        """Remove the temporary files."""
        for file in self._files.values():
            file.discard()


HDF5_ROWS = 1 << 14
"""Rows that are written at once, and of a chunk: those of a chunk fit into the library's cache."""


class Hdf5Sink(TableSink):
    """One HDF5 file: events in the layout of the DSEC data set, other tables as groups.

    `events/p, x, y, t` with `t` in microseconds after `t_offset`, and `ms_to_idx`: the first event
    at or after each millisecond (https://dsec.ifi.uzh.ch/data-format/).

    Args:
        folder: Folder for it.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._file = open_hdf5(folder / HDF5_FILE, 'x')
        self._waiting: dict[str, list[dict[str, NDArray[Any]]]] = {}
        self._rows: dict[str, int] = {}
        self._starts: list[NDArray[np.int64]] = []
        self._offset_us: int | None = None
        self._milliseconds = 0
        self._events = 0

    def table(self, name: str, **columns: NDArray[Any]) -> None:
        """Append rows to the data sets of a group."""
        self._waiting.setdefault(name, []).append(columns)
        self._rows[name] = self._rows.get(name, 0) + len(next(iter(columns.values())))
        if self._rows[name] >= HDF5_ROWS or name == 'frames':
            self._flush(name)

    def _flush(self, name: str) -> None:
        waiting, self._rows[name] = self._waiting.pop(name), 0
        group = self._file.require_group(name)
        for key in waiting[0]:
            rows = np.concatenate([each[key] for each in waiting])
            if key not in group:
                chunk = (1 if rows.ndim > 2 else HDF5_ROWS, *rows.shape[1:])
                shape = (0, *rows.shape[1:])
                options = {'maxshape': (None, *rows.shape[1:]), 'compression': 'gzip'}
                group.create_dataset(key, shape, rows.dtype, chunks=chunk, **options)
            held = group[key]
            if held.shape[1:] != rows.shape[1:]:
                raise RecordingError(
                    f'{name} of {rows.shape[1:]} after {held.shape[1:]}: a data set holds one size',
                    remedy='export with --to csv or aedat4',
                )
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
        self.table('events', p=p, x=events.x, y=events.y, t=t.astype(np.uint32))

    def close(self) -> None:
        """Write what waits, offset and index of the events, and the units."""
        for name in list(self._waiting):
            self._flush(name)
        if self._offset_us is not None:
            self._file['t_offset'] = np.int64(self._offset_us)
            self._file['ms_to_idx'] = np.concatenate(self._starts).astype(np.uint64)
        self._file.attrs['units'] = UNITS
        self._file.close()

    def discard(self) -> None:
        """Close the file as it is."""
        self._file.close()


UNITS = """\
events.npz  t [us, camera clock], x, y [px], polarity (true: brighter)
frames.npz  exposure_start, exposure_end [us, camera clock], origin (x, y of the first pixel),
            image [n, height, width], 0 .. 1023
imu.npz     t [us, camera clock], acceleration [m/s^2], angular_velocity [rad/s], temperature [degC]
edges.npz   t [us, camera clock], kind (2 falling, 3 rising, 4 pulse, 16 and 17 generator)
others      named after their topic: t [ns, clock of the topic], force [N], torque [N m]
"""
UNITS_FILE = 'units.txt'
"""What describes exported arrays, beside them."""
