# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frames: columns of reset and signal samples, in any order.

A pixel is reset - signal (correlated double sampling), 0 .. 1023. Where the reset sample is below
384 or the signal sample is 0, the pixel is overexposed and the difference means nothing: it is set
to 1023.
"""

from __future__ import annotations

from typing import Any

from numba import int32, njit, uint16, uint64

from mixtac_driver.decode.state import NO_COLUMN, RESET_COLUMN, SIGNAL_COLUMN

Words = Any
Record = Any
OVEREXPOSED_BELOW = 384
WHITE = 1023
CHUNK = 64


@njit(nogil=True)
def frame_drop(s: Record, c: Record) -> None:
    """Drop the frame in progress, if any."""
    c.frames_dropped += s.frame_open
    s.frame_open = 0
    s.column_type = NO_COLUMN


@njit(nogil=True)
def frame_start(is_global: bool, s: Record, c: Record) -> None:
    """Start a frame, with global or rolling shutter."""
    frame_drop(s, c)
    s.frame_open = 1
    s.frame_broken = 0
    s.frame_global = is_global
    s.frame_start = s.time
    s.exposure_start = -1
    s.exposure_end = -1
    s.exposure_cycles = 0
    s.exposure_words = 0
    s.roi_values = 0
    s.roi_high = 0
    s.columns_done[RESET_COLUMN] = 0
    s.columns_done[SIGNAL_COLUMN] = 0


@njit(nogil=True)
def frame_exposure(data: int, s: Record, c: Record) -> None:
    """Take 10 more bits of the exposure in ADC cycles, lowest bits first."""
    if not s.frame_open or s.exposure_words >= 3:
        c.words_unexpected += 1
        return
    s.exposure_cycles |= data << 10 * s.exposure_words
    s.exposure_words += 1


@njit(nogil=True)
def frame_region(is_high: bool, data: int, s: Record, c: Record) -> None:
    """Take a byte of start column, start row, end column or end row, high byte first."""
    if not s.frame_open or s.roi_values >= 4:
        c.words_unexpected += 1
    elif is_high:
        s.roi_high = data << 8
    else:
        s.roi[s.roi_values] = s.roi_high | data
        s.roi_values += 1
        if s.roi_values == 4:
            _set_region(s, c)


@njit(nogil=True)
def _clip_axis(axis: int, size: int, s: Record, c: Record) -> int:
    """Correct start and end of one axis of the region; return its length."""
    start, end = s.roi[axis], s.roi[axis + 2]
    if start >= size or end >= size or end < start:
        c.words_unexpected += 1
        start = start if start < size else 0
        end = end if start <= end < size else size - 1
        s.roi[axis] = start
        s.roi[axis + 2] = end
    length: int = end + 1 - start
    return length


@njit(nogil=True)
def _set_region(s: Record, c: Record) -> None:
    if s.aps_inverted:
        s.width = s.column_size = _clip_axis(0, s.aps_rows, s, c)
        s.height = s.columns = _clip_axis(1, s.aps_columns, s, c)
    else:
        s.width = s.columns = _clip_axis(0, s.aps_columns, s, c)
        s.height = s.column_size = _clip_axis(1, s.aps_rows, s, c)


@njit(nogil=True)
def column_start(column_type: int, s: Record, c: Record) -> None:
    """Start a column of RESET_COLUMN or SIGNAL_COLUMN samples."""
    if not s.frame_open:
        c.words_unexpected += 1
        return
    column, resets = s.columns_done[column_type], s.columns_done[RESET_COLUMN]
    no_reset = column_type == SIGNAL_COLUMN and column >= resets
    if s.roi_values < 4 or no_reset or column >= s.columns:
        c.words_unexpected += 1
        s.frame_broken = 1
        s.column_type = NO_COLUMN
        return
    s.column_type = column_type
    s.column_fill = 0


@njit(nogil=True, forceinline=True)
def _count_samples(words: Words, start: int, limit: int) -> int:
    """Return how many samples come one after the other, at most `limit`."""
    kinds = uint16(0)
    for k in range(uint64(start), uint64(start + limit)):
        kinds = uint16(kinds | (words[k] ^ uint16(0x4000)))
    if kinds <= 0xFFF:
        return limit
    count = 0
    while words[uint64(start + count)] >> 12 == 4:
        count += 1
    return count


@njit(nogil=True, forceinline=True)
def _take(words: Words, start: int, count: int, place: int, s: Record, p: Record) -> None:
    """Store reset samples, or subtract signal samples from them."""
    source, target, resets, image = uint64(start), uint64(place), p.resets, p.image
    if s.column_type == RESET_COLUMN:
        for k in range(uint64(count)):
            resets[target + k] = words[source + k] & uint16(0x3FF)
        return
    for k in range(uint64(count)):
        signal = words[source + k] & uint16(0x3FF)
        reset = resets[target + k]
        white = (reset < OVEREXPOSED_BELOW) | (signal == 0)
        difference = max(int32(reset) - int32(signal), int32(0))
        image[target + k] = int32(WHITE) if white else difference


@njit(nogil=True, forceinline=True)
def frame_samples(words: Words, start: int, s: Record, c: Record, p: Record) -> int:
    """Take the samples from word `start` on; return the index of the word after them.

    Samples stay in the order of the wire, column by column.
    """
    i, size = start, len(words)
    if s.column_type != NO_COLUMN:
        count = _count_samples(words, i, min(size - i, s.column_size - s.column_fill))
        place = s.columns_done[s.column_type] * s.column_size + s.column_fill
        if count < CHUNK:
            _take(words, i, count, place, s, p)
        else:  # in chunks of a fixed size, which suit vector instructions; the last one overlaps
            for done in range(0, count, CHUNK):
                k = min(done, count - CHUNK)
                _take(words, i + k, CHUNK, place + k, s, p)
        s.column_fill += count
        i += count
    stored = i
    while i < size and words[uint64(i)] >> 12 == 4:
        i += 1
    c.words_unexpected += i - stored
    return i


@njit(nogil=True)
def column_end(s: Record, c: Record) -> None:
    """Finish a column; one with samples missing breaks the frame."""
    if s.column_type == NO_COLUMN:
        c.words_unexpected += 1
        return
    s.frame_broken |= s.column_fill != s.column_size
    s.columns_done[s.column_type] += 1
    s.column_type = NO_COLUMN


@njit(nogil=True)
def frame_mark(is_start: bool, s: Record, c: Record) -> None:
    """Take the time as start or end of the exposure."""
    if not s.frame_open:
        c.words_unexpected += 1
    elif is_start:
        s.exposure_start = s.time
    else:
        s.exposure_end = s.time


@njit(nogil=True)
def frame_end(s: Record, c: Record) -> bool:
    """Finish a frame; return whether it is complete."""
    if not s.frame_open:
        c.words_unexpected += 1
        return False
    resets, signals = s.columns_done[RESET_COLUMN], s.columns_done[SIGNAL_COLUMN]
    if s.frame_broken or s.roi_values < 4 or resets != s.columns or signals != s.columns:
        frame_drop(s, c)
        return False
    s.frame_open = 0
    s.column_type = NO_COLUMN
    s.frame_end = s.time
    if s.exposure_start < 0 or s.exposure_end < s.exposure_start:
        s.exposure_start = s.frame_start
        s.exposure_end = s.frame_end
    return True
