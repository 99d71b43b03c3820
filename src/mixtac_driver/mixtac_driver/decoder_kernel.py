# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The compiled heart of the stream decoder: one pass over 16-bit words into preallocated arrays.

Bits 15:12 of a word say what it is: 8 .. 15 time stamp, 0 special, 1 row, 2 and 3 column with
polarity (an event), 4 frame sample, 5 and 6 data of frames and inertial samples, 7 wrap.

Rows, columns and stamps are nearly the whole of a busy stream, so a tight loop takes them and
leaves at every other word. Where the next word is the same kind as it was one row earlier, as in
quiet and in bright scenes, the branches of that loop are predicted and cost next to nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from numba import int64, njit

from mixtac_driver.aps_kernel import (
    aps_column_end,
    aps_column_start,
    aps_drop,
    aps_exposure_data,
    aps_frame_end,
    aps_frame_start,
    aps_mark,
    aps_region_data,
    aps_samples,
)
from mixtac_driver.decoder_state import (
    C_EDGES,
    C_EVENTS,
    C_EVENTS_OUTSIDE,
    C_EVENTS_WITHOUT_ROW,
    C_MISC,
    C_MISC_UNKNOWN,
    C_RESETS,
    C_ROWS,
    C_ROWS_OUTSIDE,
    C_SPECIALS,
    C_SPECIALS_UNKNOWN,
    C_TIMESTAMPS,
    C_TIMESTAMPS_BACKWARDS,
    C_WRAPS,
    DONE,
    DVS_COLUMNS,
    DVS_ROWS,
    EDGES,
    EXPOSURE_END,
    EXPOSURE_START,
    FRAME,
    FULL,
    IMU_SAMPLES,
    RESET,
    ROW,
    TIME,
    TIME_BEFORE_RESET,
    WRAP_BASE,
)
from mixtac_driver.imu_kernel import imu_byte, imu_drop, imu_end, imu_info, imu_start

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Scalars are compiler integers and arrays vary in layout: the compiler infers both.
Int = Any
Array = Any


@njit(cache=True, nogil=True)
def _event_words(
    words: Array,
    i: Int,
    stop: Int,
    state: Array,
    counters: Array,
    t_out: Array,
    row_out: Array,
    column_out: Array,
    polarity_out: Array,
    n: Int,
) -> tuple[Int, Int]:
    """Decode rows, columns and stamps up to the first word that is or does anything unusual."""
    base, t, row = state[WRAP_BASE], state[TIME], state[ROW]
    # Before the first row everything is unusual, which spares the loop a test.
    rows = state[DVS_ROWS] if row >= 0 else 0
    columns = state[DVS_COLUMNS] if row >= 0 else 0
    first, first_event, row_count = i, n, int64(0)
    while i < stop:
        word = int64(words[i])
        kind = word >> 12
        address = word & 0xFFF
        if kind == 1:
            if address >= rows:
                break
            row = address
            row_count += 1
        elif kind >> 1 == 1:
            if address >= columns:
                break
            t_out[n] = t
            row_out[n] = row
            column_out[n] = address
            polarity_out[n] = kind & 1
            n += 1
        elif kind >= 8:
            stamp = base + (word & 0x7FFF)
            if stamp < t:
                break
            t = stamp
        else:
            break
        i += 1
    state[TIME], state[ROW] = t, row
    events = n - first_event
    counters[C_EVENTS] += events
    counters[C_ROWS] += row_count
    counters[C_TIMESTAMPS] += i - first - events - row_count
    return i, n


@njit(cache=True, nogil=True)
def _unusual_event_word(word: Int, state: Array, counters: Array) -> None:
    """Take a row, column or stamp that the tight loop left."""
    kind, address = word >> 12, word & 0xFFF
    if kind >= 8:
        counters[C_TIMESTAMPS_BACKWARDS] += 1
    elif kind == 1:
        if address < state[DVS_ROWS]:
            state[ROW] = address
            counters[C_ROWS] += 1
        else:
            counters[C_ROWS_OUTSIDE] += 1
    elif address >= state[DVS_COLUMNS]:
        counters[C_EVENTS_OUTSIDE] += 1
    else:
        counters[C_EVENTS_WITHOUT_ROW] += 1


@njit(cache=True, nogil=True)
def _wrap(count: Int, state: Array, counters: Array) -> None:
    if count == 0:
        counters[C_TIMESTAMPS_BACKWARDS] += 1
        return
    state[WRAP_BASE] += count * 0x8000
    state[TIME] = state[WRAP_BASE]
    counters[C_WRAPS] += 1


@njit(cache=True, nogil=True)
def drop_items(state: Array, counters: Array) -> None:
    """Drop the frame and the inertial sample in progress."""
    aps_drop(state, counters)
    imu_drop(state, counters)


@njit(cache=True, nogil=True)
def _reset(state: Array, counters: Array) -> None:
    drop_items(state, counters)
    state[TIME_BEFORE_RESET] = state[TIME]
    state[TIME] = 0
    state[WRAP_BASE] = 0
    counters[C_RESETS] += 1


@njit(cache=True, nogil=True)
def _frame_special(code: Int, state: Array, counters: Array) -> Int:
    """Take a special word of frames; return FRAME where one is complete, or DONE."""
    if code in {8, 9}:
        aps_frame_start(code == 8, state, counters)
    elif code == 10:
        return FRAME if aps_frame_end(state, counters) else DONE
    elif code in {11, 12}:
        aps_column_start(code - 11, state, counters)
    elif code == 13:
        aps_column_end(state, counters)
    else:
        aps_mark(EXPOSURE_START if code == 14 else EXPOSURE_END, state, counters)
    return DONE


@njit(cache=True, nogil=True)
def _special(
    code: Int,
    state: Array,
    counters: Array,
    imu_t: Array,
    edge_t: Array,
    edge_code: Array,
) -> Int:
    """Take a special word; return the reason to stop, or DONE."""
    if code == 1:
        _reset(state, counters)
        return RESET
    if 8 <= code <= 15:
        counters[C_SPECIALS] += 1
        return _frame_special(code, state, counters)
    if code in {2, 3, 4, 16, 17}:
        edge_t[state[EDGES]] = state[TIME]
        edge_code[state[EDGES]] = code
        state[EDGES] += 1
        counters[C_EDGES] += 1
    elif code == 5:
        imu_start(state, counters)
    elif code == 7:
        imu_end(state, counters, imu_t)
    else:
        counters[C_SPECIALS_UNKNOWN] += 1
        return DONE
    counters[C_SPECIALS] += 1
    return DONE


@njit(cache=True, nogil=True)
def _misc(word: Int, state: Array, counters: Array, imu_raw: Array) -> None:
    """Take a data word of a frame or an inertial sample."""
    code, data = word >> 8 & 0xF, word & 0xFF
    if word >> 12 == 6 and word >> 10 & 3 == 0:
        aps_exposure_data(word & 0x3FF, state, counters)
    elif word >> 12 == 6 or code > 3:
        counters[C_MISC_UNKNOWN] += 1
        return
    elif code == 0:
        imu_byte(data, state, counters, imu_raw)
    elif code == 3:
        imu_info(data, state, counters, imu_raw)
    else:
        aps_region_data(code == 1, data, state, counters)
    counters[C_MISC] += 1


@njit(cache=True, nogil=True)
def decode_words(
    words: NDArray[Any],
    i: int,
    state: NDArray[Any],
    counters: NDArray[Any],
    t_out: NDArray[Any],
    row_out: NDArray[Any],
    column_out: NDArray[Any],
    polarity_out: NDArray[Any],
    n: int,
    imu_t: NDArray[Any],
    imu_raw: NDArray[Any],
    edge_t: NDArray[Any],
    edge_code: NDArray[Any],
    resets: NDArray[Any],
    image: NDArray[Any],
) -> tuple[int, int, int]:
    """Decode words until they end, an output is full, a frame is complete or the clock is reset.

    Args:
        words: `uint16` [W], the stream.
        i: Index of the first word to decode.
        state: `int64` [STATE_SIZE], kept from call to call.
        counters: `int64` [COUNTER_SIZE], kept from call to call.
        t_out: `int64` [N], event times [us on the camera clock since its latest reset].
        row_out: `uint16` [N], event rows as on the wire.
        column_out: `uint16` [N], event columns as on the wire.
        polarity_out: `uint8` [N], 1 for ON.
        n: Events already in the output.
        imu_t: `int64` [M], times of inertial samples [us].
        imu_raw: `uint8` [M + 1, 15], their bytes and last their info byte; one row of scratch.
        edge_t: `int64` [K], times of edges [us].
        edge_code: `uint8` [K], their special codes.
        resets: `uint16` [P], reset samples of the open frame.
        image: `uint16` [P], the open frame, 0 .. 1023.

    Returns:
        Index of the next word, events in the output, and DONE, FULL, FRAME or RESET.
    """
    capacity = len(t_out)
    while i < len(words):
        if n >= capacity or state[IMU_SAMPLES] >= len(imu_t) or state[EDGES] >= len(edge_t):
            return i, n, FULL
        # One word is at most one event, so within this bound the loop need not look.
        stop = min(len(words), i + capacity - n)
        i, n = _event_words(
            words, i, stop, state, counters, t_out, row_out, column_out, polarity_out, n
        )
        if i == stop:
            continue
        word = int64(words[i])
        kind = word >> 12
        if kind == 4:
            i = aps_samples(words, i, state, counters, resets, image)
            continue
        i += 1
        if kind == 0:
            reason = _special(word & 0xFFF, state, counters, imu_t, edge_t, edge_code)
            if reason != DONE:
                return i, n, reason
        elif kind == 7:
            _wrap(word & 0xFFF, state, counters)
        elif kind in {5, 6}:
            _misc(word, state, counters, imu_raw)
        else:
            _unusual_event_word(word, state, counters)
    return i, n, DONE
