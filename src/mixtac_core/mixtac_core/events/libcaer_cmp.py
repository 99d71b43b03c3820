# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The compressed encoding `libcaer_cmp` of `event_camera_msgs/EventPacket`.

Little-endian 16-bit words: a code in the top 4 bits and a value in the low 12.

==== =========== ====================================== =====================================
code name        value                                  effect
==== =========== ====================================== =====================================
0    TIME_HIGH   bits 12 to 23 of dt [us]               sets the upper half of the time
1    TIME_LOW    bits 0 to 11 of dt [us]                sets the lower half of the time
2    ADDR_X      column (11 bits)                       sets the column
3    ADDR_Y      row (11 bits), polarity (bit 11)       one event
4    VECT_BASE_Y first row (11 bits), polarity (bit 11) sets the base of the vectors that follow
5    VECT_8      8 valid bits                           events at base + bit, then base += 8
==== =========== ====================================== =====================================

dt counts from `time_base` [ns], the camera time of the packet's first event; both halves start at 0
in every packet. A TIME_LOW always follows a TIME_HIGH, because decoders that stop at a time limit
look at the clock only there. After the last event, this encoder may set the time once more. Other
decoders read it as an ordinary time word; the decoder of this project reads it as the time up to
which the stream is complete.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
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
"""Fewest events worth a vector: it takes two words for up to eight."""


@njit(cache=True, nogil=True)
def encode_words(t: Times, x: Words, y: Words, polarity: Flags, end: int, words: Words) -> int:
    """Write all events and the final time.

    Args:
        t: Times [us], not empty.
        x: Columns.
        y: Rows.
        polarity: Whether pixels became brighter.
        end: Final time [us], not before the last event.
        words: Filled; four words for each event and two more suffice.

    Returns:
        The number of words; or -1 less the number of the first event that is earlier than the one
        before, too late after the first one, or outside `MAX_COORDINATE`.
    """
    count = len(t)
    used = 0
    dt = 0
    high = 0
    column = -1
    first = int(np.int64(0))
    while first < count:
        now = t[first] - t[0]
        x_first = int(x[first])
        y_first = int(y[first])
        if now < dt or now > MAX_SPAN_US or (x_first | y_first) > MAX_COORDINATE:
            return -1 - first
        # Each word is written, then kept or not, without branches: which words are needed is
        # random, and a mispredicted branch costs more than all of them.
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
        on = int(polarity[first]) * _ON
        if last - first < SHORTEST_VECTOR:
            for i in range(first, last):
                words[used] = _ADDR_Y | on | y[i]
                used += 1
        else:
            used = _write_run(words, used, y, first, last, on)
        if y[last - 1] > MAX_COORDINATE:
            return -int(last)
        first = last
    now = end - t[0]
    if now > MAX_SPAN_US:
        return -count
    words[used] = now >> 12
    used += int((now >> 12) != high)
    words[used] = _TIME_LOW | (now & 0xFFF)
    return used + int(now != dt)


@njit(cache=True, nogil=True)
def _end_of_run(t: Times, x: Words, y: Words, polarity: Flags, first: int) -> int:
    """Return the end of the run from `first` on of events that differ in increasing rows only."""
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

    Rows are in blocks of 8. A chain of adjacent blocks costs one word per block and one for the
    base. Skipping an empty block costs as much as a new base, so that coding each chain separately
    is shortest.
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
def count_events(words: Words) -> int:
    """Return the number of events; or -1 less the number of a word that is not possible there."""
    count = 0
    column = False
    base = False
    for i in range(len(words)):
        code = words[i] >> 12
        if code == 3:
            if not column:
                return -1 - i
            count += 1
        elif code == 5:
            if not (base and column):
                return -1 - i
            for bit in range(8):
                count += (words[i] >> bit) & 1
        elif code > 5:
            return -1 - i
        column = column or code == 2
        base = base or code == 4
    return count


@njit(cache=True, nogil=True)
def decode_words(
    words: Words, start: int, width: int, height: int, t: Times, x: Words, y: Words, polarity: Flags
) -> int:
    """Fill the event arrays, whose times count from `start` [us].

    Returns:
        The final dt [us]; or -1 less the number of a word with an event outside the sensor.
    """
    n = np.int64(0)
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
                return -1 - i
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
                return -1 - i
            for k in range(n, after):
                t[k] = start + (high | low)
                x[k] = column
                y[k] += base
                polarity[k] = base_on
            n = after
            base += 8
    return int(high | low)


@njit(cache=True, nogil=True)
def _decode_vector(word: int, n: int, columns_left: int, rows_left: int, y: Words) -> int:
    """Write the rows of a vector, counted from its base; return their end, or -1 outside.

    Written into the loop over the words, it would slow all of them down.
    """
    for bit in range(8):
        if (word >> bit) & 1:
            if bit >= rows_left or columns_left <= 0:
                return -1
            y[n] = bit
            n += 1
    return n
