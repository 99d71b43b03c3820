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
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.recordings.recording import (
    NONE,
    Piece,
    ReadCounters,
    RecordingError,
    RecordingInfo,
    Selection,
    Wrenches,
)

SIZES: Final = {'davis346': (346, 260), 'davis240': (240, 180), 'sbret': (240, 180)}
"""Width and height of the sensor by a part of the chip's name in lower case."""
NO_EVENT: Final = 1 << 31 | 1 << 10
"""Bits that no event has."""
WORDS: Final = 10_000
"""Words that are read at once."""
_HEADER_LINE: Final = re.compile(rb'#[^\x00-\x08\x0a-\x0c\x0e-\x1f]*\n')


class Aedat2Recording:
    """An AEDAT 2.0 file.

    Args:
        path: The file.
        selection: `NONE` for events is refused: there is nothing else to read.
        size: Width and height of the sensor; None for those of the chip that the header names.

    Attributes:
        info: Its description.
        counters: Losses found so far.

    Raises:
        RecordingError: It holds no events, or the size is not known.
    """

    def __init__(
        self, path: Path, selection: Selection, size: tuple[int, int] | None = None
    ) -> None:
        self.counters = ReadCounters()
        with path.open('rb') as file:
            start, chip = 0, ''
            while line := _HEADER_LINE.fullmatch(file.readline(1000)):
                start = file.tell()
                if b'AEChip:' in line[0]:
                    chip = line[0].partition(b':')[2].decode(errors='replace').strip()
        named = [found for name, found in SIZES.items() if name in chip.lower()]
        if not size and not named:
            raise RecordingError(
                f'{path} is of the chip {chip or "(not named)"}: only events of DAVIS240 and'
                ' DAVIS346 are read',
                remedy='give --size 346x260 or 240x180 if it is such a camera, or open it in jAER'
                ' and export events as csv with columns t, x, y, p',
            )
        count = (path.stat().st_size - start) // 8
        shape = (count, 2)
        self._words = np.memmap(path, '>u4', 'r', start, shape) if count else np.empty(shape, '>u4')
        first = self._words[:WORDS][self._words[:WORDS, 0] & NO_EVENT == 0]
        if not len(first) or selection.events == NONE:
            raise RecordingError(f'{path} holds no events', remedy='AEDAT 2 is read for its events')
        width, height = size or named[0]
        start_us, end_us = int(first[0, 1]), int(self._words[-1, 1])
        self.info = RecordingInfo(
            path=path,
            kind='AEDAT 2 file',
            camera='',
            width=width,
            height=height,
            color_filter=0,
            start_us=start_us,
            length_us=(end_us - start_us) % (1 << 32),
            contents=(('events', 'events'),),
        )

    def pieces(self) -> Generator[Piece, None, None]:
        """Yield the events in stretches; times [us] continue where 32 bits roll over."""
        width, height = self.info.width, self.info.height
        latest_us = self.info.start_us
        for begin in range(0, len(self._words), WORDS):
            words = self._words[begin : begin + WORDS].astype(np.int64)
            address, t = words[words[:, 0] & NO_EVENT == 0].T
            self.counters.other_words += len(words) - len(t)
            if not len(t):
                continue
            t = _unrolled(t, latest_us)
            latest_us = int(t[-1])
            x = width - 1 - (address >> 12 & 0x3FF)
            y = address >> 22 & 0x1FF
            inside = (x >= 0) & (y < height)
            self.counters.events_outside += int(np.count_nonzero(~inside))
            columns = (x.astype(np.uint16), y.astype(np.uint16), address >> 11 & 1 == 1)
            events = Events(t, *columns)[inside]
            yield Piece(int(t[0]), latest_us, advances=True, events=events)

    def wrenches(self) -> Mapping[str, Wrenches]:
        """Return none: the format holds no forces."""
        return {}

    def close(self) -> None:
        """Close the file."""
        del self._words


def _unrolled(t: NDArray[np.int64], latest_us: int) -> NDArray[np.int64]:
    """Return times of 32 bits [us] as continuations of a time; steps are shorter than 2^31 us."""
    steps = np.diff(t, prepend=latest_us) + (1 << 31) & 0xFFFFFFFF
    return latest_us + np.cumsum(steps - (1 << 31))
