# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiled core of the stream decoder: one pass over 16-bit words into preallocated arrays.

Bits 15:12 of a word give its kind: 8 .. 15 time stamp, 0 special, 1 row, 2 and 3 column with
polarity (an event), 4 frame sample, 5 and 6 data of frames and inertial samples, 7 time wrap.
Rows, columns and stamps make up nearly all of a busy stream, and samples nearly all of a frame, so
each is taken in runs; the other words come one by one.

Compiled functions receive bare pointers: numba counts references atomically for nearly every array
argument and tests every index for being negative, which costs ten times what decoding a word does.
The compilation cache is keyed by a fingerprint of all source files of the decoder, because numba
itself only notices changes of the file that holds the function.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numba import int64, njit, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from mixtac_driver.decode.events import event_words
from mixtac_driver.decode.frames import (
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
from mixtac_driver.decode.imu import imu_byte, imu_drop, imu_end, imu_info, imu_start
from mixtac_driver.decode.state import (
    C_EDGES,
    C_MISC,
    C_MISC_UNKNOWN,
    C_RESETS,
    C_SPECIALS,
    C_SPECIALS_UNKNOWN,
    C_TIMESTAMPS_BACKWARDS,
    C_WORDS,
    C_WRAPS,
    DONE,
    EDGES,
    EXPOSURE_END,
    EXPOSURE_START,
    FRAME,
    FULL,
    IMU_SAMPLES,
    RESET,
    TIME,
    TIME_BEFORE_RESET,
    WRAP_BASE,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


def _codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
    return make_array(signature.args[0])(context, builder, args[0]).data


@intrinsic
def pointer_to(typingctx: Any, array: Any) -> Any:  # noqa: ANN401, ARG001
    """Return a pointer to the first element of a contiguous array; for compiled code.

    It can be indexed like a one-dimensional array that has no length. The caller must hold the
    array for as long as the pointer is used.
    """
    return types.CPointer(array.dtype)(array), _codegen


def source_fingerprint(*patterns: str, folder: Path = Path(__file__).parent) -> int:
    """Return a number that changes when one of these sources does.

    Args:
        patterns: Names of files in the folder, or patterns of names.
        folder: This package unless said otherwise.
    """
    fingerprint = 0
    for path in sorted(path for pattern in patterns for path in folder.glob(pattern)):
        fingerprint = zlib.crc32(path.read_bytes(), fingerprint)
    return fingerprint


# Scalars are compiler integers and arrays vary in layout: the compiler infers both.
Int = Any
Array = Any


@njit(nogil=True, forceinline=True)
def _wrap(count: Int, state: Array, counters: Array) -> None:
    if count == 0:
        counters[C_TIMESTAMPS_BACKWARDS] += 1
        return
    state[WRAP_BASE] += count * 0x8000
    state[TIME] = state[WRAP_BASE]
    counters[C_WRAPS] += 1


@njit(nogil=True, forceinline=True)
def _drop_items(state: Array, counters: Array) -> None:
    aps_drop(state, counters)
    imu_drop(state, counters)


@njit(nogil=True, forceinline=True)
def _reset(state: Array, counters: Array) -> None:
    _drop_items(state, counters)
    state[TIME_BEFORE_RESET] = state[TIME]
    state[TIME] = 0
    state[WRAP_BASE] = 0
    counters[C_RESETS] += 1


@njit(nogil=True, forceinline=True)
def _frame_special(code: Int, state: Array, counters: Array) -> Int:
    """Take a special word of frames; return FRAME where one is complete, or DONE."""
    if 8 <= code <= 9:
        aps_frame_start(code == 8, state, counters)
    elif code == 10:
        return FRAME if aps_frame_end(state, counters) else DONE
    elif 11 <= code <= 12:
        aps_column_start(code - 11, state, counters)
    elif code == 13:
        aps_column_end(state, counters)
    else:
        aps_mark(EXPOSURE_START if code == 14 else EXPOSURE_END, state, counters)
    return DONE


@njit(nogil=True, forceinline=True)
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
    if 2 <= code <= 4 or 16 <= code <= 17:
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


@njit(nogil=True, forceinline=True)
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


@njit(nogil=True)
def _decode(
    words: Array,
    size: Int,
    i: Int,
    state: Array,
    counters: Array,
    events: tuple[Array, Array, Array, Array],
    capacity: Int,
    n: Int,
    imu_t: Array,
    imu_raw: Array,
    imu_capacity: Int,
    edge_t: Array,
    edge_code: Array,
    edge_capacity: Int,
    resets: Array,
    image: Array,
) -> tuple[Int, Int, Int]:
    first, reason = i, DONE
    while i < size and reason == DONE:
        full = n >= capacity or state[IMU_SAMPLES] >= imu_capacity
        if full or state[EDGES] >= edge_capacity:
            reason = FULL
            break
        word = int64(words[i])
        kind = word >> 12
        if kind == 4:
            i = aps_samples(words, size, i, state, counters, resets, image)
            continue
        if kind >= 8 or 1 <= kind <= 3:
            i, n = event_words(words, size, i, state, counters, events, capacity, n)
            continue
        i += 1
        if kind == 0:
            reason = _special(word & 0xFFF, state, counters, imu_t, edge_t, edge_code)
        elif kind == 7:
            _wrap(word & 0xFFF, state, counters)
        else:
            _misc(word, state, counters, imu_raw)
    counters[C_WORDS] += i - first
    return i, n, reason


def _entries(fingerprint: int) -> tuple[Callable[..., tuple[int, int, int]], Callable[..., None]]:
    """Return the functions that Python calls, cached under the fingerprint of all the rest."""

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
        """Decode words until they end, an output is full, a frame is complete or the clock reset.

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
        _ = fingerprint
        events = (
            pointer_to(t_out),
            pointer_to(row_out),
            pointer_to(column_out),
            pointer_to(polarity_out),
        )
        result: tuple[int, int, int] = _decode(
            pointer_to(words),
            len(words),
            i,
            pointer_to(state),
            pointer_to(counters),
            events,
            len(t_out),
            n,
            pointer_to(imu_t),
            pointer_to(imu_raw),
            len(imu_t),
            pointer_to(edge_t),
            pointer_to(edge_code),
            len(edge_t),
            pointer_to(resets),
            pointer_to(image),
        )
        return result

    @njit(cache=True, nogil=True)
    def drop_items(state: NDArray[Any], counters: NDArray[Any]) -> None:
        """Drop the frame and the inertial sample in progress.

        Args:
            state: `int64` [STATE_SIZE].
            counters: `int64` [COUNTER_SIZE].
        """
        _ = fingerprint
        _drop_items(state, counters)

    return decode_words, drop_items


decode_words, drop_items = _entries(
    source_fingerprint('kernel.py', 'state.py', 'events.py', 'vectors.py', 'frames.py', 'imu.py')
)
