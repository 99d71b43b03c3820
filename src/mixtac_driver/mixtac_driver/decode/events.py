# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event words: time stamps, rows, and columns with polarity; nearly all words of a busy stream.

The number of columns that follow a row is random in a real scene, so a loop that branches on the
kind of word spends most of its time on mispredicted branches: at two events per row on average it
takes three times as long as `take_block`, which has no such branches. There, every word of a block
is written as if it were an event, but only an event advances the output, so that the next word
overwrites anything else.
"""

from __future__ import annotations

from typing import Any

from numba import int64, njit, uint8, uint16, uint64

BLOCK = 256
"""Words that `take_block` takes at once."""
Words = Any
Record = Any
Columns = Any


@njit(nogil=True, forceinline=True)
def _survey(words: Words, start: int, rows: int, columns: int) -> tuple[bool, int, int]:
    """Return whether a block holds event words inside the array only; its rows; its events."""
    # 16 bits throughout: the compiler then handles 16 words or more per instruction.
    row_limit, column_limit = uint16(rows), uint16(columns)
    row_count = event_count = others = uint16(0)
    for k in range(uint64(start), uint64(start + BLOCK)):
        word = words[k]
        is_row = uint16(word - 0x1000) < row_limit
        is_event = uint16((word & 0xEFFF) - 0x2000) < column_limit
        row_count = uint16(row_count + uint16(is_row))
        event_count = uint16(event_count + uint16(is_event))
        others = uint16(others | uint16(not (is_row | is_event | (word >= 0x8000))))
    return others == 0, int64(row_count), int64(event_count)


@njit(nogil=True, forceinline=True)
def take_block(words: Words, start: int, n: int, s: Record, c: Record, out: Columns) -> int:
    """Decode the next BLOCK words if all are event words inside the array and the row is known.

    Args:
        words: `uint16` [W], the stream.
        start: Index of the first word, at most W - BLOCK.
        n: Events in the output, at most its size - BLOCK. What is behind them is overwritten.
        s: State.
        c: Counters.
        out: Times, rows, columns and polarities, as in `Buffers`.

    Returns:
        Events in the output; -1 if the words have to be taken one by one. Nothing changed then.
    """
    usual, row_count, event_count = _survey(words, start, s.dvs_rows, s.dvs_columns)
    if not usual or s.row < 0:
        return -1
    t_out, row_out, column_out, polarity_out = out
    first, end = uint64(n), uint64(n)
    time, row, offset, before = s.time, uint64(s.row), s.wrap_base - 0x8000, 0
    for k in range(uint64(start), uint64(start + BLOCK)):
        word = uint64(words[k])
        stamp = offset + int64(word)  # without meaning, and before `time`, unless it is a stamp
        before += stamp < time
        time = max(time, stamp)
        row = word - uint64(0x1000) if word >> 12 == 1 else row
        t_out[end] = time
        row_out[end] = row
        column_out[end] = word
        end += uint64(word >> 13 == 1)
    for k in range(first, end):
        word = column_out[k]
        column_out[k] = word & uint16(0xFFF)
        polarity_out[k] = uint8(word >> 12) & uint8(1)
    s.time = time
    s.row = row
    c.rows += row_count
    c.events += event_count
    c.timestamps += BLOCK - before
    c.timestamps_backwards += before - row_count - event_count
    taken: int = int64(end)
    return taken


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
        if stamp < s.time:
            c.timestamps_backwards += 1
        else:
            c.timestamps += 1
            s.time = stamp
    elif kind == 1:
        if address < s.dvs_rows:
            c.rows += 1
            s.row = address
        else:
            c.rows_outside += 1
    elif address >= s.dvs_columns:
        c.events_outside += 1
    elif s.row < 0:
        c.events_without_row += 1
    else:
        c.events += 1
        t_out, row_out, column_out, polarity_out = out
        t_out[n] = s.time
        row_out[n] = s.row
        column_out[n] = address
        polarity_out[n] = kind & 1
        n += 1
    return n
