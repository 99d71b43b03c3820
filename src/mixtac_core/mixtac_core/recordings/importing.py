# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Make bags from CSV, NPZ, HDF5 or AEDAT4 files, with forces from a table.

`mixtac_core.recordings.tables` reads the tables. Times are kept as they are: nothing is aligned.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.node.files import new_folder
from mixtac_core.node.topics import REFERENCE, REFERENCE_FRAME, REFERENCE_WRENCH
from mixtac_core.recordings.bag import check_new
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.camera_stream import open_recording
from mixtac_core.recordings.export import Counts
from mixtac_core.recordings.recording import (
    Piece,
    Recording,
    RecordingError,
    Selection,
    Wrenches,
)
from mixtac_core.recordings.stream_writer import StreamWriter
from mixtac_core.recordings.table_recording import table_wrenches
from mixtac_core.recordings.tables import TableOptions


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
            on the camera's clock do not overlap its data in time, or the bag exists.
        FileError: The bag cannot be written.
    """
    options = options or TableOptions()
    check_new(out)
    with contextlib.closing(open_recording(path, selection, options)) as recording:
        recorded = recording.wrenches().get(REFERENCE)
        wrenches = table_wrenches(forces, options) if forces else recorded
        info = recording.info
        with new_folder(out) as folder, McapBag(folder) as bag:
            writer = StreamWriter(bag, (info.width, info.height), color_filter=info.color_filter)
            counts = _write(recording, wrenches or iter(()), writer, same_clock=same_clock)
        counts.info = recording.info
        counts.forces_replaced = forces is not None and recorded is not None
    return counts


def _write(
    recording: Recording, wrenches: Wrenches, writer: StreamWriter, *, same_clock: bool
) -> Counts:
    counts = Counts(recording.info, recording.counters)
    waiting = (
        (int(stamp), row)
        for stamps, values in wrenches
        for stamp, row in zip(stamps, values, strict=True)
    )
    following = next(waiting, None)
    first = last = following
    first_ns = None if same_clock or first is None else first[0]
    reached_us = start_us = latest_us = -1
    for piece in recording.pieces():
        piece.check()
        if start_us < 0:
            start_us = piece.start_us
        if len(piece.events):
            last_us = _checked_end(piece.events, latest_us)
            counts.add_times(piece.events, latest_us)
            latest_us = last_us
        reached_us = max(reached_us, piece.until_us)
        received_ns = 1000 * reached_us
        # Of another clock only the time since the first sample can be compared.
        shift_ns = 0 if first_ns is None else first_ns - 1000 * start_us
        while following is not None and following[0] - shift_ns <= received_ns:
            _write_wrench(writer, counts, *following, following[0] - shift_ns)
            last, following = following, next(waiting, None)
        _write_piece(writer, piece, received_ns)
        counts.add(piece)
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


def _write_piece(writer: StreamWriter, piece: Piece, received_ns: int) -> None:
    if len(piece.events):
        writer.events(piece.events, piece.until_us, received_ns)
    for frame in piece.frames:
        writer.frame(frame, 0, received_ns)
    writer.samples(piece.imu, 0, received_ns)
    writer.edges(piece.edges, 0, received_ns)


def _write_wrench(
    writer: StreamWriter,
    counts: Counts,
    stamp_ns: int,
    values: NDArray[np.float64],
    received_ns: int,
) -> None:
    writer.wrench(REFERENCE_WRENCH, stamp_ns, values, REFERENCE_FRAME, max(received_ns, 0))
    counts.wrenches[REFERENCE] = counts.wrenches.get(REFERENCE, 0) + 1
