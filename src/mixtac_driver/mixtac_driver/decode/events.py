# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event words: time stamps, rows, and columns with polarity; nearly all words of a busy stream.

The number of columns that follow a row is random in a real scene, so a loop that branches on the
kind of word spends most of its time on mispredicted branches. `take_block` has no such branches:
it writes every word as if it were an event, but only an event advances the output, so that the
next word overwrites anything else. Stores limit its speed, so it packs time and row into one number
per word. A second loop, only over the events of a block, separates them; the compiler turns it into
vector instructions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import int64, njit, uint8, uint16, uint64

BLOCK = 256
"""Words that `take_block` takes at once."""
# Effect of a word by its bits 15:12: a row is 1, an event 2 or 3, a time stamp 8 .. 15. The header
# holds the time stamp (bits 31:16) and the row (15:0) of the next events.
_ADVANCE = np.array([1, 0, *[1] * 6, *[0] * 8], np.uint64)
"""Number of events that a word adds to the output."""
_KEEP = np.array([0xFFFFFFFF, 0xFFFF0000, *[0xFFFFFFFF] * 6, *[0x0000FFFF] * 8], np.uint64)
"""Bits of the header that stay."""
_SCALE = np.array([0, 1, *[0] * 6, *[0x10000] * 8], np.uint64)
"""Factor by which a word is multiplied before it is added to the header."""
Words = Any
Record = Any
Columns = Any


@njit(nogil=True, forceinline=True)
def _is_usual(words: Words, start: int, rows: int, columns: int) -> bool:
    """Return whether a block holds event words inside the array only."""
    # 16 bits throughout: the compiler then handles 16 words or more per instruction.
    last_row, last_column = uint16(rows - 1), uint16(columns - 1)
    unusual = uint16(0)
    for k in range(uint64(start), uint64(start + BLOCK)):
        word = words[k]
        row, column = uint16(word - 0x1000), uint16((word & 0xEFFF) - 0x2000)
        not_row = uint16(max(row, last_row) - last_row)
        not_event = uint16(max(column, last_column) - last_column)
        not_stamp = uint16(max(word, uint16(0x8000)) - word)
        unusual = uint16(unusual | min(not_row, not_event, not_stamp))
    usual: bool = unusual == 0
    return usual


@njit(nogil=True, forceinline=True)
def take_block(words: Words, start: int, n: int, s: Record, out: Columns) -> int:
    """Decode the next BLOCK words if they are the usual ones.

    That is, all are event words inside the array, no time stamp goes back, and the row is known.

    Args:
        words: `uint16` [W], the stream.
        start: Index of the first word, at most W - BLOCK.
        n: Events in the output, at most its size - BLOCK. What is behind them is overwritten.
        s: State.
        out: Times, rows, columns and polarities, as in `Buffers`.

    Returns:
        Events in the output; -1 if the words have to be taken one by one. Nothing changed then.
    """
    if s.row < 0 or not _is_usual(words, start, s.dvs_rows, s.dvs_columns):
        return -1
    t_out, row_out, column_out, polarity_out = out
    first, end, late = uint64(n), uint64(n), uint64(0)
    offset = s.wrap_base - 0x8000
    header = uint64(s.time - offset) << uint64(16) | uint64(s.row)
    for k in range(uint64(start), uint64(start + BLOCK)):
        word = uint64(words[k])
        kind = word >> uint64(12)
        t_out[end] = header
        column_out[end] = word
        end += _ADVANCE[kind]
        before = header
        header = (before & _KEEP[kind]) + word * _SCALE[kind]
        late += uint64(header + uint64(0xFFFF) < before)
    if late > uint64(0):
        return -1
    whole = end + (first - end) % uint64(32)  # whole vectors; there is room for a block
    for k in range(first, whole):
        packed = t_out[k]
        t_out[k] = offset + (packed >> 16)
        row_out[k] = uint16(packed) & uint16(0xFFF)
    for k in range(first, whole):
        word = column_out[k]
        column_out[k] = word & uint16(0xFFF)
        polarity_out[k] = uint8(word >> 12) & uint8(1)
    s.time = offset + int64(header >> uint64(16))
    s.row = int64(header & uint64(0xFFF))
    events: int = int64(end - first)
    return n + events


@njit(nogil=True, forceinline=True)
def take_event_word(word: int, n: int, s: Record, c: Record, out: Columns) -> int:
    """Decode any time stamp, row or column.

    Args:
        word: The word.
        n: Events in the output, less than its size.
        s: State.
        c: Counters.
        out: Times, rows, columns and polarities, as in `Buffers`.

    Returns:
        Events in the output.
    """
    kind, address = word >> 12, word & 0xFFF
    if kind >= 8:
        stamp = s.wrap_base + (word & 0x7FFF)
        c.words_unexpected += stamp < s.time
        s.time = max(s.time, stamp)
    elif kind == 1:
        c.words_unexpected += address >= s.dvs_rows
        s.row = address if address < s.dvs_rows else s.row
    elif address >= s.dvs_columns or s.row < 0:
        c.words_unexpected += 1
    else:
        t_out, row_out, column_out, polarity_out = out
        t_out[n] = s.time
        row_out[n] = s.row
        column_out[n] = address
        polarity_out[n] = kind & 1
        n += 1
    return n
