# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""AEDAT 2.0 files of a DAVIS240 or DAVIS346, as jAER records them: their events.

A word of 8 bytes holds an address and a time [us], both big-endian. The address of an event has row
(9 bits from bit 22), column (10 bits from bit 12, counted from the right) and polarity (bit 11).
Bit 31 marks pixels of frames and inertial samples, bit 10 edges of the external input: these are
skipped and counted. Rows are numbered as jAER numbers them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from mixtac_core.recordings.recording import NONE, ReadCounters, RecordingError, Selection
from mixtac_core.recordings.table_recording import FileRecording
from mixtac_core.recordings.tables import Rows

SIZES: Final = {'davis346': (346, 260), 'davis240': (240, 180), 'sbret': (240, 180)}
"""Width and height of the sensor by a part of the chip's name in lower case."""
NO_EVENT: Final = 1 << 31 | 1 << 10
"""Bits that no event has."""
WORDS: Final = 10_000
"""Words that are read at once."""
_HEADER_LINE: Final = re.compile(rb'#[^\x00-\x08\x0a-\x0c\x0e-\x1f]*\n')


def open_aedat2(
    path: Path, selection: Selection, size: tuple[int, int] | None = None
) -> FileRecording:
    """Open an AEDAT 2.0 file.

    Args:
        path: The file.
        selection: `NONE` for events is refused: there is nothing else to read.
        size: Width and height of the sensor; None for those of the chip that the header names.

    Raises:
        RecordingError: It holds no events, or the size is not known.
    """
    with path.open('rb') as file:
        start, chip = 0, ''
        while line := _HEADER_LINE.fullmatch(file.readline(1000)):
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
    streams = {'events': partial(_events, path, start, size[0], counters)}
    if selection.events == NONE:
        streams = {}
    return FileRecording(path, 'AEDAT 2 file', streams, size, counters=counters)


def _events(path: Path, start: int, width: int, counters: ReadCounters) -> Iterator[Rows]:
    """Yield the events; times [us] continue where 32 bits roll over."""
    others, latest_us = 0, None
    with path.open('rb') as file:
        file.seek(start)
        while len(data := file.read(8 * WORDS)) >= 8:
            words = np.frombuffer(data, '>u4', len(data) // 8 * 2).reshape(-1, 2).astype(np.int64)
            address, t = words[words[:, 0] & NO_EVENT == 0].T
            others += len(words) - len(t)
            if not len(t):
                continue
            latest_us = int(t[0]) if latest_us is None else latest_us
            # Steps of 32 bits are shorter than 2^31 us.
            steps = np.diff(t, prepend=latest_us) + (1 << 31) & 0xFFFFFFFF
            t = latest_us + np.cumsum(steps - (1 << 31))
            latest_us = int(t[-1])
            # Columns left of the first become large, outside of any sensor.
            x = (width - 1 - (address >> 12 & 0x3FF)).astype(np.uint16)
            y, polarity = address >> 22 & 0x1FF, address >> 11 & 1 == 1
            yield {'t': t, 'x': x, 'y': y, 'polarity': polarity}
    counters.other_words += others
