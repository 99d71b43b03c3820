# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiled part of the decoder for frames: columns of reset and signal samples, in any order.

A pixel is reset - signal (correlated double sampling), 0 .. 1023. Where the reset sample is below
384 or the signal sample is 0 the pixel saw so much light that the difference means nothing: 1023.
"""

from __future__ import annotations

from typing import Any

from numba import int32, njit, uint16, uint64

from mixtac_driver.decode.state import (
    APS_COLUMNS,
    APS_INVERTED,
    APS_ROWS,
    C_APS_UNEXPECTED,
    C_FRAMES,
    C_FRAMES_DROPPED,
    C_FRAMES_WITHOUT_EXPOSURE,
    C_ROI_OUTSIDE,
    C_SAMPLES,
    C_SAMPLES_UNEXPECTED,
    COLUMN_TYPE,
    COLUMNS,
    EXPOSURE_CYCLES,
    EXPOSURE_END,
    EXPOSURE_START,
    EXPOSURE_WORDS,
    FRAME_BROKEN,
    FRAME_END,
    FRAME_GLOBAL,
    FRAME_OPEN,
    FRAME_START,
    RESET_COLUMNS,
    ROI_0,
    ROI_1,
    ROI_HIGH,
    ROI_WORDS,
    SAMPLE,
    SAMPLES,
    SIGNAL_COLUMNS,
    SIZE_X,
    SIZE_Y,
    TIME,
)

Int = Any
Array = Any
OVEREXPOSED_BELOW = 384
WHITE = 1023
SAMPLE_WORD = uint16(0x4000)
CHUNK = 64


@njit(nogil=True, forceinline=True)
def aps_drop(state: Array, counters: Array) -> None:
    """Drop the frame in progress, if any."""
    if state[FRAME_OPEN]:
        counters[C_FRAMES_DROPPED] += 1
    state[FRAME_OPEN] = 0
    state[COLUMN_TYPE] = -1


@njit(nogil=True, forceinline=True)
def aps_frame_start(global_shutter: Int, state: Array, counters: Array) -> None:
    """Begin a frame."""
    aps_drop(state, counters)
    state[FRAME_OPEN] = 1
    state[FRAME_BROKEN] = 0
    state[FRAME_GLOBAL] = 1 if global_shutter else 0
    state[FRAME_START] = state[TIME]
    state[EXPOSURE_START] = -1
    state[EXPOSURE_END] = -1
    state[EXPOSURE_CYCLES] = 0
    state[EXPOSURE_WORDS] = 0
    state[ROI_WORDS] = 0
    state[ROI_HIGH] = 0
    state[RESET_COLUMNS] = 0
    state[SIGNAL_COLUMNS] = 0


@njit(nogil=True, forceinline=True)
def aps_exposure_data(data: Int, state: Array, counters: Array) -> None:
    """Take 10 more bits of the exposure in ADC cycles, lowest first."""
    if not state[FRAME_OPEN] or state[EXPOSURE_WORDS] >= 3:
        counters[C_APS_UNEXPECTED] += 1
        return
    state[EXPOSURE_CYCLES] |= data << 10 * state[EXPOSURE_WORDS]
    state[EXPOSURE_WORDS] += 1


@njit(nogil=True, forceinline=True)
def aps_region_data(high: Int, data: Int, state: Array, counters: Array) -> None:
    """Take one byte of start column, start row, end column, end row; high bytes come first."""
    if not state[FRAME_OPEN] or state[ROI_WORDS] >= 4:
        counters[C_APS_UNEXPECTED] += 1
    elif high:
        state[ROI_HIGH] = data << 8
    else:
        state[ROI_0 + state[ROI_WORDS]] = state[ROI_HIGH] | data
        state[ROI_WORDS] += 1
        if state[ROI_WORDS] == 4:
            _set_region(state, counters)


@njit(nogil=True, forceinline=True)
def _clip_axis(first: Int, size: Int, state: Array, counters: Array) -> Int:
    """Correct start and end of one axis of the region; return its length."""
    start, end = state[first], state[first + 2]
    if start >= size or end >= size or end < start:
        counters[C_ROI_OUTSIDE] += 1
        start = start if start < size else 0
        end = end if start <= end < size else size - 1
        state[first], state[first + 2] = start, end
    return end + 1 - start


@njit(nogil=True, forceinline=True)
def _set_region(state: Array, counters: Array) -> None:
    inverted = state[APS_INVERTED]
    width = state[APS_ROWS] if inverted else state[APS_COLUMNS]
    height = state[APS_COLUMNS] if inverted else state[APS_ROWS]
    size_x = _clip_axis(ROI_0, width, state, counters)
    size_y = _clip_axis(ROI_1, height, state, counters)
    state[SIZE_X], state[SIZE_Y] = size_x, size_y
    state[COLUMNS] = size_y if inverted else size_x
    state[SAMPLES] = size_x if inverted else size_y


@njit(nogil=True, forceinline=True)
def aps_column_start(column_type: Int, state: Array, counters: Array) -> None:
    """Begin a column of reset (0) or signal (1) samples."""
    if not state[FRAME_OPEN]:
        counters[C_APS_UNEXPECTED] += 1
        return
    column = state[RESET_COLUMNS + column_type]
    unknown_size = state[ROI_WORDS] < 4
    signal_without_reset = column_type == 1 and column >= state[RESET_COLUMNS]
    if unknown_size or signal_without_reset or column >= state[COLUMNS]:
        counters[C_APS_UNEXPECTED] += 1
        state[FRAME_BROKEN] = 1
        state[COLUMN_TYPE] = -1
        return
    state[COLUMN_TYPE] = column_type
    state[SAMPLE] = 0


@njit(nogil=True, forceinline=True)
def _run_end(words: Array, first: Int, stop: Int) -> Int:
    """Return the index of the first word that is no sample."""
    i = first
    while i + CHUNK <= stop:
        others = uint16(0)
        for j in range(uint64(i), uint64(i + CHUNK)):
            others |= words[j] ^ SAMPLE_WORD
        if others > 0xFFF:
            break
        i += CHUNK
    while i < stop and words[uint64(i)] >> 12 == 4:
        i += 1
    return i


@njit(nogil=True, forceinline=True)
def _take_chunk(
    words: Array, i: Int, place: Int, size: Int, signal: Int, resets: Array, image: Array
) -> None:
    for j in range(uint64(size)):
        sample = words[uint64(i) + j] & uint16(0x3FF)
        if signal:
            reset = resets[uint64(place) + j]
            white = (reset < OVEREXPOSED_BELOW) | (sample == 0)
            difference = max(int32(reset) - int32(sample), int32(0))
            image[uint64(place) + j] = int32(WHITE) if white else difference
        else:
            resets[uint64(place) + j] = sample


@njit(nogil=True, forceinline=True)
def _take_samples(
    words: Array, first: Int, count: Int, place: Int, signal: Int, resets: Array, image: Array
) -> None:
    """Store reset samples, or subtract signal samples from them."""
    if count < CHUNK:
        _take_chunk(words, first, place, count, signal, resets, image)
        return
    # Whole chunks suit the vector unit; the last one overlaps the one before.
    for done in range(0, count, CHUNK):
        k = min(done, count - CHUNK)
        _take_chunk(words, first + k, place + k, CHUNK, signal, resets, image)


@njit(nogil=True, forceinline=True)
def aps_samples(
    words: Array, size: Int, first: Int, state: Array, counters: Array, resets: Array, image: Array
) -> Int:
    """Take the run of samples at word `first`; return the index of the word after it.

    The samples stay in the order of the wire; who takes a complete frame turns it.
    """
    column_type = state[COLUMN_TYPE]
    room = state[SAMPLES] - state[SAMPLE] if column_type >= 0 else 0
    end = _run_end(words, first, min(size, first + room))
    count = end - first
    if column_type >= 0:
        place = state[RESET_COLUMNS + column_type] * state[SAMPLES] + state[SAMPLE]
        _take_samples(words, first, count, place, column_type, resets, image)
        state[SAMPLE] += count
    while end < size and words[uint64(end)] >> 12 == 4:
        end += 1
    counters[C_SAMPLES] += end - first
    counters[C_SAMPLES_UNEXPECTED] += end - first - count
    return end


@njit(nogil=True, forceinline=True)
def aps_column_end(state: Array, counters: Array) -> None:
    """Finish a column; one that is too short breaks the frame."""
    column_type = state[COLUMN_TYPE]
    if column_type < 0:
        counters[C_APS_UNEXPECTED] += 1
        return
    if state[SAMPLE] != state[SAMPLES]:
        state[FRAME_BROKEN] = 1
    state[RESET_COLUMNS + column_type] += 1
    state[COLUMN_TYPE] = -1


@njit(nogil=True, forceinline=True)
def aps_mark(place: Int, state: Array, counters: Array) -> None:
    """Take the time as start or end of the exposure."""
    if state[FRAME_OPEN]:
        state[place] = state[TIME]
    else:
        counters[C_APS_UNEXPECTED] += 1


@njit(nogil=True, forceinline=True)
def aps_frame_end(state: Array, counters: Array) -> Int:
    """Finish a frame; return whether it is complete."""
    if not state[FRAME_OPEN]:
        counters[C_APS_UNEXPECTED] += 1
        return False
    columns = state[COLUMNS] if state[ROI_WORDS] == 4 else -1
    done = state[RESET_COLUMNS] == columns and state[SIGNAL_COLUMNS] == columns
    if state[FRAME_BROKEN] or not done:
        aps_drop(state, counters)
        return False
    state[FRAME_OPEN] = 0
    state[COLUMN_TYPE] = -1
    state[FRAME_END] = state[TIME]
    if state[EXPOSURE_START] < 0 or state[EXPOSURE_END] < state[EXPOSURE_START]:
        counters[C_FRAMES_WITHOUT_EXPOSURE] += 1
        state[EXPOSURE_START] = state[FRAME_START]
        state[EXPOSURE_END] = state[FRAME_END]
    counters[C_FRAMES] += 1
    return True
