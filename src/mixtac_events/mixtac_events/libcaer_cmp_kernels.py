# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of `libcaer_cmp`: one pass to encode, two to decode.

They report faults as negative numbers, so that they run without the interpreter lock.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Times = NDArray[np.int64]
    Words = NDArray[np.uint16]
    Flags = NDArray[np.bool_]

MAX_COORDINATE: Final = (1 << 11) - 1
MAX_SPAN_US: Final = (1 << 24) - 1

_TIME_LOW: Final = 1 << 12
_ADDR_X: Final = 2 << 12
_ADDR_Y: Final = 3 << 12
_VECT_BASE_Y: Final = 4 << 12
_VECT_8: Final = 5 << 12
_ON: Final = 1 << 11
SHORTEST_VECTOR: Final = 3
"""A vector takes two words for up to eight events."""

UNSORTED: Final = -1
TOO_LONG: Final = -2
OUTSIDE: Final = -3
UNKNOWN_CODE: Final = -4
NO_COLUMN: Final = -5
NO_BASE: Final = -6


@njit(cache=True, nogil=True)
def encode_words(
    t: Times, x: Words, y: Words, polarity: Flags, end: int, words: Words
) -> tuple[int, int]:
    """Write all events and the closing time; return (words, 0) or (fault, event)."""
    count = len(t)
    used = 0
    dt = 0
    high = 0
    column = -1
    first = 0
    while first < count:
        now = t[first] - t[0]
        if now < dt:
            return UNSORTED, first
        if now > MAX_SPAN_US:
            return TOO_LONG, first
        x_first = int(x[first])
        y_first = int(y[first])
        if (x_first | y_first) > MAX_COORDINATE:
            return OUTSIDE, first
        # Each word is written and then kept or not: which are needed is as random as the scene,
        # and a branch that is guessed wrong costs more than the other words together.
        words[used] = now >> 12
        used += int((now >> 12) != high)
        high = now >> 12
        words[used] = _TIME_LOW | (now & 0xFFF)
        used += int(now != dt)
        dt = now
        words[used] = _ADDR_X | x_first
        used += int(x_first != column)
        column = x_first
        last = _end_of_run(t, x, y, polarity, first)
        on = _ON if polarity[first] else 0
        if last - first < SHORTEST_VECTOR:
            for i in range(first, last):
                words[used] = _ADDR_Y | on | y[i]
                used += 1
        else:
            used = _write_run(words, used, y, first, last, on)
        if y[last - 1] > MAX_COORDINATE:
            return OUTSIDE, last - 1
        first = last
    if end - t[0] > MAX_SPAN_US:
        return TOO_LONG, count
    return _write_time(words, used, dt, end - t[0]), 0


@njit(cache=True, nogil=True)
def _write_time(words: Words, used: int, dt: int, now: int) -> int:
    """Write the time words that lead from `dt` to `now`; return the words used."""
    if now == dt:
        return used
    if (now >> 12) != (dt >> 12):
        words[used] = now >> 12
        used += 1
    words[used] = _TIME_LOW | (now & 0xFFF)
    return used + 1


@njit(cache=True, nogil=True)
def _end_of_run(t: Times, x: Words, y: Words, polarity: Flags, first: int) -> int:
    """Return the end of the events from `first` on that differ only in a growing row."""
    last = first + 1
    while (
        last < len(t)
        and y[last] > y[last - 1]
        and x[last] == x[first]
        and t[last] == t[first]
        and polarity[last] == polarity[first]
    ):
        last += 1
    return last


@njit(cache=True, nogil=True)
def _write_run(words: Words, used: int, y: Words, first: int, last: int, on: int) -> int:
    """Write a run of one column, as vectors where they are shorter; return the words used.

    Rows fall into blocks of 8. A chain of neighbouring blocks costs one word each and one for the
    base; leaving a chain over an empty block costs as much as a new base, so that taking each
    chain for itself is the shortest code.
    """
    while first < last:
        start = y[first] >> 3
        block = start
        end = first + 1
        while end < last and (y[end] >> 3) <= block + 1:
            block = y[end] >> 3
            end += 1
        blocks = block - start + 1
        if end - first > blocks + 1:
            words[used] = _VECT_BASE_Y | on | (start << 3)
            words[used + 1 : used + 1 + blocks] = _VECT_8
            for i in range(first, end):
                words[used + 1 + (y[i] >> 3) - start] |= 1 << (y[i] & 7)
            used += 1 + blocks
        else:
            for i in range(first, end):
                words[used] = _ADDR_Y | on | y[i]
                used += 1
        first = end
    return used


@njit(cache=True, nogil=True)
def count_events(words: Words) -> tuple[int, int]:
    """Return (events, 0), or (fault, word) where the order of the words makes no sense."""
    count = 0
    column = False
    base = False
    for i in range(len(words)):
        code = words[i] >> 12
        if code == 3:
            if not column:
                return NO_COLUMN, i
            count += 1
        elif code == 5:
            if not (base and column):
                return (NO_BASE if column else NO_COLUMN), i
            for bit in range(8):
                count += (words[i] >> bit) & 1
        elif code > 5:
            return UNKNOWN_CODE, i
        column = column or code == 2
        base = base or code == 4
    return count, 0


@njit(cache=True, nogil=True)
def decode_words(
    words: Words, start: int, width: int, height: int, t: Times, x: Words, y: Words, polarity: Flags
) -> tuple[int, int]:
    """Fill the event arrays; return (final dt, 0) or (fault, word)."""
    n = 0
    high = np.int64(0)
    low = np.int64(0)
    column = np.int64(0)
    base = np.int64(0)
    base_on = False
    for i in range(len(words)):
        word = np.int64(words[i])
        code = word >> 12
        if code == 3:
            row = word & MAX_COORDINATE
            if row >= height or column >= width:
                return OUTSIDE, i
            t[n] = start + (high | low)
            x[n] = column
            y[n] = row
            polarity[n] = (word & _ON) != 0
            n += 1
        elif code == 2:
            column = word & MAX_COORDINATE
        elif code == 1:
            low = word & 0xFFF
        elif code == 0:
            high = (word & 0xFFF) << 12
        elif code == 4:
            base = word & MAX_COORDINATE
            base_on = (word & _ON) != 0
        else:
            after = _decode_vector(word, n, width - column, height - base, y)
            if after < 0:
                return OUTSIDE, i
            for k in range(n, after):
                t[k] = start + (high | low)
                x[k] = column
                y[k] += base
                polarity[k] = base_on
            n = after
            base += 8
    return int(high | low), 0


@njit(cache=True, nogil=True)
def _decode_vector(word: int, n: int, columns_left: int, rows_left: int, y: Words) -> int:
    """Write the rows of a vector, counted from its base; return their end, or -1 outside."""
    for bit in range(8):
        if (word >> bit) & 1:
            if bit >= rows_left or columns_left <= 0:
                return -1
            y[n] = bit
            n += 1
    return n
