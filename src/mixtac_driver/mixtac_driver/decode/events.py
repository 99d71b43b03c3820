# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiled part of the decoder for events: rows, columns and time stamps, nearly the whole stream.

How many columns follow a row is random in a real scene, so a loop that branches on the kind of
word spends most of its time on wrong predictions. Here 32 words are taken at once, without
branches; only the last few before an end go word by word.
"""

from __future__ import annotations

from typing import Any

from numba import int64, njit

from mixtac_driver.decode.state import (
    C_EVENTS,
    C_EVENTS_OUTSIDE,
    C_EVENTS_WITHOUT_ROW,
    C_ROWS,
    C_ROWS_OUTSIDE,
    C_TIMESTAMPS,
    C_TIMESTAMPS_BACKWARDS,
    DVS_COLUMNS,
    DVS_ROWS,
    ROW,
    TIME,
    WRAP_BASE,
)
from mixtac_driver.decode.vectors import LANES, MAX_ROWS, take_vectors

Int = Any
Array = Any
Outputs = tuple[Array, Array, Array, Array]


@njit(nogil=True, forceinline=True)
def _many(
    words: Array,
    size: Int,
    i: Int,
    state: Array,
    counters: Array,
    out: Outputs,
    capacity: Int,
    n: Int,
) -> tuple[Int, Int]:
    """Take words 32 at a time as long as all are usual."""
    first, first_event, offset = i, n, state[WRAP_BASE] - 0x8000
    i, n, row_count, backwards, stamp, row = take_vectors(
        words, size, out[0], out[1], out[2], out[3], capacity,
        i, n, offset, state[TIME] - offset, state[ROW], state[DVS_ROWS], state[DVS_COLUMNS],
    )  # fmt: skip
    state[TIME] = offset + stamp
    state[ROW] = row
    counters[C_EVENTS] += n - first_event
    counters[C_ROWS] += row_count
    counters[C_TIMESTAMPS_BACKWARDS] += backwards
    counters[C_TIMESTAMPS] += i - first - (n - first_event) - row_count - backwards
    return i, n


@njit(nogil=True, forceinline=True)
def _one(
    word: Int,
    state: Array,
    counters: Array,
    out: Outputs,
    n: Int,
) -> Int:
    """Take any row, column or stamp; return the events in the output."""
    kind, address = word >> 12, word & 0xFFF
    if kind >= 8:
        stamp = state[WRAP_BASE] + (word & 0x7FFF)
        counters[C_TIMESTAMPS_BACKWARDS if stamp < state[TIME] else C_TIMESTAMPS] += 1
        state[TIME] = max(state[TIME], stamp)
    elif kind == 1:
        outside = address >= state[DVS_ROWS]
        counters[C_ROWS_OUTSIDE if outside else C_ROWS] += 1
        state[ROW] = state[ROW] if outside else address
    elif address >= state[DVS_COLUMNS]:
        counters[C_EVENTS_OUTSIDE] += 1
    elif state[ROW] < 0:
        counters[C_EVENTS_WITHOUT_ROW] += 1
    else:
        t_out, row_out, column_out, polarity_out = out
        t_out[n] = state[TIME]
        row_out[n] = state[ROW]
        column_out[n] = address
        polarity_out[n] = kind & 1
        counters[C_EVENTS] += 1
        return n + 1
    return n


@njit(nogil=True, forceinline=True)
def event_words(
    words: Array,
    size: Int,
    i: Int,
    state: Array,
    counters: Array,
    out: Outputs,
    capacity: Int,
    n: Int,
) -> tuple[Int, Int]:
    """Decode rows, columns and stamps: at least one, and not always all that follow.

    Args:
        words: `uint16` [size], the stream; word `i` is a row, a column or a stamp.
        size: Words.
        i: Index of the first word to decode.
        state: `int64` [STATE_SIZE].
        counters: `int64` [COUNTER_SIZE].
        out: Of events: `int64` times [us on the camera clock since its latest reset], `uint16`
            rows and `uint16` columns as on the wire, `uint8` polarities, 1 for ON.
        capacity: Events that the outputs hold.
        n: Events already in the output, fewer; what lies behind them is overwritten.

    Returns:
        Index of the first word not taken, and events in the output.
    """
    if state[ROW] >= 0 and state[DVS_ROWS] <= MAX_ROWS:
        i, n = _many(words, size, i, state, counters, out, capacity, n)
    stop = min(i + LANES, size)
    while i < stop and n < capacity:
        word = int64(words[i])
        if not (word >= 0x8000 or 0x1000 <= word < 0x4000):
            break
        n = _one(word, state, counters, out, n)
        i += 1
    return i, n
