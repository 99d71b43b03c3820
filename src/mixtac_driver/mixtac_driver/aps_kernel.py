# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiled part of the decoder for frames: columns of reset and signal samples, in any order.

A pixel is reset - signal (correlated double sampling), 0 .. 1023. Where the reset sample is below
384 or the signal sample is 0 the pixel saw so much light that the difference means nothing: 1023.
"""

from __future__ import annotations

from typing import Any

from numba import int64, njit

from mixtac_driver.decoder_state import (
    ADDRESS,
    APS_COLUMNS,
    APS_FLIP_X,
    APS_FLIP_Y,
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
    STEP,
    TIME,
)

Int = Any
Array = Any

OVEREXPOSED_BELOW = 384
WHITE = 1023


@njit(cache=True, nogil=True)
def aps_drop(state: Array, counters: Array) -> None:
    """Drop the frame in progress, if any."""
    if state[FRAME_OPEN]:
        counters[C_FRAMES_DROPPED] += 1
    state[FRAME_OPEN] = 0
    state[COLUMN_TYPE] = -1


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def aps_exposure_data(data: Int, state: Array, counters: Array) -> None:
    """Take 10 more bits of the exposure in ADC cycles, lowest first."""
    if not state[FRAME_OPEN] or state[EXPOSURE_WORDS] >= 3:
        counters[C_APS_UNEXPECTED] += 1
        return
    state[EXPOSURE_CYCLES] |= data << 10 * state[EXPOSURE_WORDS]
    state[EXPOSURE_WORDS] += 1


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _clip_axis(first: Int, size: Int, state: Array, counters: Array) -> Int:
    """Correct start and end of one axis of the region; return its length."""
    start, end = state[first], state[first + 2]
    if start >= size or end >= size or end < start:
        counters[C_ROI_OUTSIDE] += 1
        start = start if start < size else 0
        end = end if start <= end < size else size - 1
        state[first], state[first + 2] = start, end
    return end + 1 - start


@njit(cache=True, nogil=True)
def _set_region(state: Array, counters: Array) -> None:
    inverted = state[APS_INVERTED]
    width = state[APS_ROWS] if inverted else state[APS_COLUMNS]
    height = state[APS_COLUMNS] if inverted else state[APS_ROWS]
    size_x = _clip_axis(ROI_0, width, state, counters)
    size_y = _clip_axis(ROI_1, height, state, counters)
    state[SIZE_X], state[SIZE_Y] = size_x, size_y
    state[COLUMNS] = size_y if inverted else size_x
    state[SAMPLES] = size_x if inverted else size_y


@njit(cache=True, nogil=True)
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
    _aim(column, state)


@njit(cache=True, nogil=True)
def _aim(column: Int, state: Array) -> None:
    """Find where the samples of a column go."""
    place = state[COLUMNS] - 1 - column if state[APS_FLIP_X] else column
    first = state[SAMPLES] - 1 if state[APS_FLIP_Y] else 0
    direction = -1 if state[APS_FLIP_Y] else 1
    if state[APS_INVERTED]:
        state[ADDRESS] = place * state[SIZE_X] + first
        state[STEP] = direction
    else:
        state[ADDRESS] = first * state[SIZE_X] + place
        state[STEP] = direction * state[SIZE_X]


@njit(cache=True, nogil=True)
def aps_samples(
    words: Array, i: Int, state: Array, counters: Array, resets: Array, image: Array
) -> Int:
    """Take the run of samples at word `i`; return the index of the word after it."""
    first = i
    column_type, address, step = state[COLUMN_TYPE], state[ADDRESS], state[STEP]
    room = state[SAMPLES] - state[SAMPLE] if column_type >= 0 else 0
    stop = min(int64(len(words)), i + room)
    if column_type == 0:
        while i < stop and words[i] >> 12 == 4:
            resets[address] = words[i] & 0x3FF
            address += step
            i += 1
    else:
        while i < stop and words[i] >> 12 == 4:
            signal, reset = int64(words[i] & 0x3FF), int64(resets[address])
            white = reset < OVEREXPOSED_BELOW or signal == 0
            image[address] = WHITE if white else max(reset - signal, 0)
            address += step
            i += 1
    state[SAMPLE] += i - first
    state[ADDRESS] = address
    expected = i
    while i < len(words) and words[i] >> 12 == 4:
        i += 1
    counters[C_SAMPLES] += i - first
    counters[C_SAMPLES_UNEXPECTED] += i - expected
    return i


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def aps_mark(place: Int, state: Array, counters: Array) -> None:
    """Take the time as start or end of the exposure."""
    if state[FRAME_OPEN]:
        state[place] = state[TIME]
    else:
        counters[C_APS_UNEXPECTED] += 1


@njit(cache=True, nogil=True)
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
