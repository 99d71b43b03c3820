# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags from other files: tables in csv, NPZ or HDF5, AEDAT4 files, and forces beside them.

`mixtac_core.recordings.tables` reads the tables. Times are kept as they are: nothing is aligned.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import Edges, Frame, InertialSamples
from mixtac_core.node.files import new_folder
from mixtac_core.node.topics import REFERENCE, REFERENCE_FRAME, REFERENCE_WRENCH
from mixtac_core.recordings.bag import BagFile, check_new, find_bags
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.camera_stream import BagRecording, open_recording
from mixtac_core.recordings.export import AEDAT4_FILE, Counts, bag_wrenches
from mixtac_core.recordings.recording import Piece, ReadCounters, RecordingError, Selection
from mixtac_core.recordings.stream_writer import StreamWriter
from mixtac_core.recordings.tables import TIME_UNITS, Rows, Tables, open_tables
from mixtac_core.recordings.writers import AXES, HDF5_FILE, HDF5_SUFFIXES, topic_file

PACKET_US = 10_000
"""Longest stretch of a table that is written at once [us]."""
DAVIS346: Final = (346, 260)


@dataclass(frozen=True, slots=True)
class TableOptions:
    """How to read tables that do not say it themselves.

    Attributes:
        time_unit: Unit of the times of camera data where the file states none, one of
            `TIME_UNITS`; empty for `us`.
        force_unit: Unit of the times of forces, likewise; empty for `s`.
        size: Width and height of the camera; None for that of its frames, else 346 x 260.
    """

    time_unit: str = ''
    force_unit: str = ''
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        """Check the units.

        Raises:
            RecordingError: One is unknown.
        """
        for unit in (self.time_unit, self.force_unit):
            if unit and unit not in TIME_UNITS:
                raise RecordingError(
                    f'unknown unit of time {unit!r}', remedy=f'use one of {", ".join(TIME_UNITS)}'
                )


def import_recording(
    path: Path,
    out: Path,
    *,
    forces: Path | None = None,
    same_clock: bool = False,
    options: TableOptions | None = None,
    selection: Selection | None = None,
) -> Counts:
    """Write camera data and forces of other files as a bag, whole or not at all.

    Args:
        path: An .aedat4, .csv, .npz or .h5 file, a bag, or a folder of tables.
        out: Folder of the new bag.
        forces: Table of the reference force, csv or NPZ; None for that of the bag or beside the
            tables, if any.
        same_clock: Forces are on the camera's clock.
        options: How to read tables.
        selection: Which topics or streams of a bag or an AEDAT4 file; None for the only one of each
            kind.

    Returns:
        What was written.

    Raises:
        RecordingError: A file cannot be read, the choice is ambiguous, times go backwards, forces
            on the camera's clock have no time in common with its data, or the bag exists.
        FileError: The bag cannot be written.
    """
    options = options or TableOptions()
    check_new(out)
    with _open_camera(path, options, selection) as camera:
        wrenches = _wrenches(forces, options) if forces else camera.wrenches
        with new_folder(out) as folder, McapBag(folder) as bag:
            writer = StreamWriter(bag, camera.size, color_filter=camera.color_filter)
            counts = _write(camera, wrenches or iter(()), writer, same_clock=same_clock)
        counts.damage = camera.damage()
    counts.size, counts.lost = camera.size, camera.lost
    counts.forces_replaced = forces is not None and camera.wrenches is not None
    return counts


Wrenches = Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]
"""Stamps [ns], int64 [n], and force [N] and torque [N m], float64 [n, 6]."""


@dataclass(slots=True)
class _Camera:
    """Camera data to import: pieces in the order of time."""

    pieces: Iterator[Piece]
    size: tuple[int, int]
    wrenches: Wrenches | None = None
    color_filter: int = 0
    damage: Callable[[], str] = str
    lost: ReadCounters = field(default_factory=ReadCounters)


_WHOLE: Final = ([AEDAT4_FILE], [HDF5_FILE])
"""Contents of a folder that `mixtac export` wrote as one file."""


@contextlib.contextmanager
def _open_camera(
    path: Path, options: TableOptions, selection: Selection | None
) -> Iterator[_Camera]:
    path = path.expanduser()
    if path.is_dir() and (names := [each.name for each in path.iterdir()]) in _WHOLE:
        path /= names[0]
    is_bag, selection = path.is_dir() and bool(find_bags(path, 0)), selection or Selection()
    is_hdf5 = path.suffix.lower() in HDF5_SUFFIXES
    tables = None if is_bag else open_tables(path, group=selection.events if is_hdf5 else '')
    if tables is None:
        with _open_stream(path, selection) as camera:
            yield camera
        return
    if selection != Selection() and not is_hdf5:
        raise RecordingError(
            f'{path} holds tables: there is nothing to choose',
            remedy='leave out --events, --image and --imu',
        )
    with contextlib.closing(tables):
        yield _table_camera(tables, options)


@contextlib.contextmanager
def _open_stream(path: Path, selection: Selection) -> Iterator[_Camera]:
    """Open a bag or an AEDAT4 file."""
    with contextlib.ExitStack() as stack:
        recording = stack.enter_context(contextlib.closing(open_recording(path, selection)))
        info, wrenches = recording.info, None
        if isinstance(recording, BagRecording):
            file = stack.enter_context(BagFile(path))
            if REFERENCE in file.topics(REFERENCE_WRENCH.type_name):
                wrenches = bag_wrenches(file, REFERENCE)
        yield _Camera(
            pieces=recording.pieces(0),
            size=(info.width, info.height),
            wrenches=wrenches,
            color_filter=info.color_filter,
            damage=lambda: recording.info.damage,
            lost=recording.counters,
        )


def _table_camera(tables: Tables, options: TableOptions) -> _Camera:
    if not tables.names & {'events', 'frames'}:
        raise RecordingError(
            f'{tables.path} holds neither events nor frames, but'
            f' {", ".join(sorted(tables.names)) or "nothing"}',
            remedy='name the tables events and frames; in HDF5, choose a group with --events',
        )
    unit = options.time_unit
    size = options.size or _frame_size(tables, unit) or DAVIS346
    parts = [
        _cut(tables.rows(name, unit), 't', make)
        for name, make in (('imu', _samples), ('edges', _edges))
        if name in tables.names
    ]
    if 'events' in tables.names:
        parts.append(_cut(tables.rows('events', unit), 't', _events_inside(size)))
    if 'frames' in tables.names:
        parts.append(_cut(tables.rows('frames', unit), 'exposure_end', _frames, one=True))
    name = topic_file(REFERENCE)
    wrenches = _force_rows(tables, name, options) if name in tables.names else None
    return _Camera(heapq.merge(*parts, key=lambda piece: piece.until_us), size, wrenches)


def _write(
    camera: _Camera, wrenches: Wrenches, writer: StreamWriter, *, same_clock: bool
) -> Counts:
    counts = Counts()
    waiting = (
        (int(stamp), row)
        for stamps, values in wrenches
        for stamp, row in zip(stamps, values, strict=True)
    )
    following = next(waiting, None)
    first = last = following
    first_ns = None if same_clock or first is None else first[0]
    reached_us = start_us = latest_us = -1
    for piece in camera.pieces:
        piece.check()
        if start_us < 0:
            start_us = piece.start_us
        if len(piece.events):
            latest_us = _checked_end(piece.events, latest_us)
        reached_us = max(reached_us, piece.until_us)
        received_ns = 1000 * reached_us
        # Of another clock only the time since the first sample can be compared.
        shift_ns = 0 if first_ns is None else first_ns - 1000 * start_us
        while following is not None and following[0] - shift_ns <= received_ns:
            _write_wrench(writer, counts, *following, following[0] - shift_ns)
            last, following = following, next(waiting, None)
        _write_piece(writer, counts, piece, received_ns)
    if start_us < 0:
        raise RecordingError('there is nothing to import: no events and no frames')
    counts.length_us = reached_us - start_us
    while following is not None:
        _write_wrench(writer, counts, *following, 1000 * reached_us)
        last, following = following, next(waiting, None)
    if same_clock and first and last:
        _check_overlap((first[0], last[0]), (1000 * start_us, 1000 * reached_us))
    # Closes the packet of the last millisecond.
    writer.events(Events.empty(), reached_us + 1000, 1000 * reached_us)
    return counts


def _check_overlap(forces_ns: tuple[int, int], camera_ns: tuple[int, int]) -> None:
    """Refuse forces on the clock of the camera that end before its data begin, or begin later.

    Raises:
        RecordingError: As above.
    """
    if forces_ns[1] < camera_ns[0] or forces_ns[0] > camera_ns[1]:
        forces, camera = (
            f'{start / 1e9:.3f} to {end / 1e9:.3f} s' for start, end in (forces_ns, camera_ns)
        )
        raise RecordingError(
            f'forces of {forces} and camera data of {camera} are not of one clock',
            remedy='give the units of the times, or leave --same-clock out and align the bag',
        )


def _checked_end(events: Events, latest_us: int) -> int:
    """Return the time of the last event [us].

    Raises:
        RecordingError: One is earlier than the one before.
    """
    steps = np.diff(events.t, prepend=np.int64(max(latest_us, 0)))
    if (steps < 0).any():
        raise RecordingError(
            f'events go back in time at {int(events.t[int(np.argmax(steps < 0))])} us',
            remedy='sort them by time (columns without headings are t, x, y, p), and cut a'
            ' recording where its clock was reset',
        )
    return int(events.t[-1])


def _write_piece(writer: StreamWriter, counts: Counts, piece: Piece, received_ns: int) -> None:
    if len(piece.events):
        writer.events(piece.events, piece.until_us, received_ns)
        counts.events += len(piece.events)
    for frame in piece.frames:
        writer.frame(frame, 0, received_ns)
        counts.frames += 1
    writer.samples(piece.imu, 0, received_ns)
    counts.samples += len(piece.imu.t)
    writer.edges(piece.edges, 0, received_ns)
    counts.edges += len(piece.edges.t)


def _write_wrench(
    writer: StreamWriter,
    counts: Counts,
    stamp_ns: int,
    values: NDArray[np.float64],
    received_ns: int,
) -> None:
    writer.wrench(REFERENCE_WRENCH, stamp_ns, values, REFERENCE_FRAME, max(received_ns, 0))
    counts.wrenches[REFERENCE] = counts.wrenches.get(REFERENCE, 0) + 1


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


def _events_inside(size: tuple[int, int]) -> Callable[[Rows], dict[str, Any]]:
    def make(rows: Rows) -> dict[str, Any]:
        x, y = rows['x'], rows['y']
        if min(x.min(), y.min()) < 0 or x.max() >= size[0] or y.max() >= size[1]:
            raise RecordingError(
                f'events at {int(x.min())} .. {int(x.max())}, {int(y.min())} .. {int(y.max())} are'
                f' outside of {size[0]} x {size[1]} pixels',
                remedy='give the size of the camera with --size',
            )
        columns = (x.astype(np.uint16), y.astype(np.uint16), rows['polarity'])
        return {'events': Events(rows['t'], *columns)}

    return make


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


def _frame_size(tables: Tables, unit: str) -> tuple[int, int] | None:
    """Return width and height of the first frame, None without frames."""
    if 'frames' not in tables.names:
        return None
    first = next(tables.rows('frames', unit), None)
    return None if first is None else (int(first['image'].shape[2]), int(first['image'].shape[1]))


def _wrenches(path: Path, options: TableOptions) -> Wrenches:
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
