# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiled core of the stream decoder: one pass over 16-bit words into preallocated arrays.

| bits 15:12 | word |
|---|---|
| 8 .. 15 | time stamp, 15 bits [us] |
| 0 | special: reset, edge, or part of a frame or an inertial sample |
| 1 | row address |
| 2, 3 | column address, polarity OFF or ON: an event |
| 4 | frame sample |
| 5, 6 | data of frames and inertial samples |
| 7 | wrap of the time stamp |

Event words and frame samples, nearly all of a busy stream, are decoded many at a time where
possible.

Inertial samples come as a start word, an info byte, up to 14 bytes of payload and an end word. The
info byte says which groups follow: acceleration (bytes 0 .. 5), temperature (6, 7) and rotation
(8 .. 13). Groups that are not sent are skipped in the payload and stay zero.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import int64, njit, uint64
from numpy.typing import NDArray

from mixtac_driver.decode.events import BLOCK, take_block, take_event_word
from mixtac_driver.decode.frames import (
    column_end,
    column_start,
    frame_drop,
    frame_end,
    frame_exposure,
    frame_mark,
    frame_region,
    frame_samples,
    frame_start,
)
from mixtac_driver.decode.state import (
    IMU_AWAITS_INFO,
    IMU_BYTES,
    IMU_OUTSIDE,
    READINGS_CAPACITY,
    Buffers,
)

DONE = 0
"""`decode_words` returns because the words ended."""
FULL = 1
"""It returns because an output has no room."""
FRAME = 2
"""It returns because a frame is complete."""
RESET = 3
"""It returns because the clock was reset."""
Record = Any
HAS_ACCELERATION = 0x80
"""Bit of the info byte: acceleration follows."""
HAS_ROTATION = 0x40
"""Bit of the info byte: rotation follows."""
HAS_TEMPERATURE = 0x20
"""Bit of the info byte: temperature follows."""


@njit(nogil=True)
def _imu_drop(s: Record, c: Record) -> None:
    """Drop the sample in progress, if any."""
    if s.imu_index != IMU_OUTSIDE:
        c.imu_dropped += 1
        s.imu_index = IMU_OUTSIDE


@njit(nogil=True)
def _next_byte(index: int, info: int) -> int:
    """Return the index of the next byte that is sent, at or after this one."""
    if index == 0 and not info & HAS_ACCELERATION:
        index = 6
    if index == 6 and not info & HAS_TEMPERATURE:
        index = 8
    if index == 8 and not info & HAS_ROTATION:
        index = IMU_BYTES
    return index


@njit(nogil=True)
def _imu_info(data: int, s: Record, c: Record, r: Record) -> None:
    """Take the info byte."""
    if s.imu_index != IMU_AWAITS_INFO:
        c.words_unexpected += 1
        _imu_drop(s, c)
        return
    s.imu_info = data
    s.imu_index = _next_byte(int64(0), data)
    if s.imu_index == IMU_BYTES:
        _imu_drop(s, c)
        return
    for k in range(IMU_BYTES):
        r.imu_raw[r.imu_count, k] = 0
    r.imu_raw[r.imu_count, IMU_BYTES] = data


@njit(nogil=True)
def _imu_byte(data: int, s: Record, c: Record, r: Record) -> None:
    """Take one byte of the payload."""
    if s.imu_index < 0 or s.imu_index >= IMU_BYTES:
        c.words_unexpected += 1
        return
    r.imu_raw[r.imu_count, s.imu_index] = data
    s.imu_index = _next_byte(s.imu_index + 1, s.imu_info)


@njit(nogil=True)
def _imu_end(s: Record, c: Record, r: Record) -> None:
    """Finish the sample; its time is that of the end word."""
    if s.imu_index == IMU_OUTSIDE:
        c.words_unexpected += 1
        return
    if s.imu_index != IMU_BYTES:
        _imu_drop(s, c)
        return
    r.imu_t[r.imu_count] = s.time
    r.imu_count += 1
    s.imu_index = IMU_OUTSIDE


@njit(nogil=True)
def _take_reset(s: Record, c: Record) -> None:
    frame_drop(s, c)
    _imu_drop(s, c)
    s.time_before_reset = s.time
    s.time = 0
    s.wrap_base = 0


@njit(nogil=True)
def _take_special(code: int, s: Record, c: Record, r: Record) -> int:
    """Take a special word; return the reason to stop, or DONE."""
    if code == 1:
        _take_reset(s, c)
        return RESET
    reason = DONE
    if 2 <= code <= 4 or 16 <= code <= 17:
        r.edge_t[r.edge_count] = s.time
        r.edge_kind[r.edge_count] = code
        r.edge_count += 1
    elif code == 5:
        _imu_drop(s, c)
        s.imu_index = IMU_AWAITS_INFO
    elif code == 7:
        _imu_end(s, c, r)
    elif 8 <= code <= 9:
        frame_start(code == 8, s, c)
    elif code == 10:
        reason = FRAME if frame_end(s, c) else DONE
    elif 11 <= code <= 12:
        column_start(code - 11, s, c)
    elif code == 13:
        column_end(s, c)
    elif 14 <= code <= 15:
        frame_mark(code == 14, s, c)
    else:
        c.words_unexpected += 1
    return reason


@njit(nogil=True)
def _take_data(word: int, s: Record, c: Record, r: Record) -> None:
    """Take a data word of a frame or an inertial sample."""
    code = word >> 8
    if code == 0x50:
        _imu_byte(word & 0xFF, s, c, r)
    elif code == 0x53:
        _imu_info(word & 0xFF, s, c, r)
    elif 0x51 <= code <= 0x52:
        frame_region(code == 0x51, word & 0xFF, s, c)
    elif 0x60 <= code <= 0x63:
        frame_exposure(word & 0x3FF, s, c)
    else:
        c.words_unexpected += 1


@njit(cache=True, nogil=True)
def decode_words(words: NDArray[np.uint16], i: int, n: int, b: Buffers) -> tuple[int, int, int]:
    """Decode words until they end, an output is full, a frame is complete or the clock reset.

    Args:
        words: `uint16` [W], the stream.
        i: Index of the first word to decode.
        n: Events already in the output.
        b: State, counters and outputs.

    Returns:
        Index of the next word, events in the output, and DONE, FULL, FRAME or RESET.
    """
    s, c, r, p = b.state[0], b.counters[0], b.readings[0], b.pixels[0]
    out = (b.t, b.row, b.column, b.polarity)
    size, capacity = len(words), len(b.t)
    next_block = i
    reason = DONE
    while i < size and reason == DONE:
        if n >= capacity or max(r.imu_count, r.edge_count) >= READINGS_CAPACITY:
            reason = FULL
            break
        word = int64(words[uint64(i)])
        kind = word >> 12
        if kind == 4:
            i = frame_samples(words, i, s, c, p)
            continue
        if kind >= 8 or 1 <= kind <= 3:
            if next_block <= i <= size - BLOCK and n <= capacity - BLOCK:
                end = take_block(words, i, n, s, out)
                if end >= 0:
                    i, n = i + BLOCK, end
                    continue
                next_block = i + BLOCK
            n = take_event_word(word, n, s, c, out)
        elif kind == 0:
            reason = _take_special(word, s, c, r)
        elif word == 0x7000:
            c.words_unexpected += 1
        elif kind == 7:
            s.wrap_base += (word & 0xFFF) * 0x8000
            s.time = s.wrap_base
        else:
            _take_data(word, s, c, r)
        i += 1
    return i, n, reason
