# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the checks of `validity` compare, compiled.

Two frames are compared with the events between them, and events with earlier ones, by marks.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.recent_events import (
    PLACE,
    TIME,
    TIME_BIT,
    Packed,
    bin_of,
    column_of,
    inverse_of,
    row_of,
)

F32 = NDArray[np.float32]

MOST_EVENTS_PER_PIXEL = np.float64(2.0)
"""Events of a pixel of a bin between two frames beyond which more count as so many: hot pixels."""


@njit(cache=True, nogil=True, fastmath={'reassoc', 'contract', 'nsz'})
def add_signs(events: Packed, size: int, out: F32, total: F32) -> tuple[int, float]:
    """Find ON less OFF events per pixel in bins, and add them to those of before.

    Args:
        events: int64 [n].
        size: Pixels of a bin along each axis.
        out: Written: those of these events, float32 [rows, columns] of bins.
        total: Those of before, same shape; changed in place.

    Returns:
        Number of ON events, and ON less OFF events, or the reverse, over all bins.
    """
    rows, columns = out.shape
    share = np.float32(1.0 / (size * size))
    inverse = inverse_of(size)
    brighter = 0
    out[:] = 0.0
    for event in events:
        row, column = bin_of(row_of(event), inverse), bin_of(column_of(event), inverse)
        brighter += event & 1
        if row < rows and column < columns:
            out[row, column] += share if event & 1 else -share
    net = np.float64(0.0)
    for row in range(rows):
        for column in range(columns):
            total[row, column] += out[row, column]
            net += abs(out[row, column])
    return brighter, net * (size * size)


MARKED_BITS, MOST_MARKS = 5, 32
"""One event in 32 is marked, up to so many between two frames."""


@njit(cache=True, nogil=True)
def marks(events: Packed, out: NDArray[np.uint64]) -> tuple[int, int, int, int, int]:
    """Find places in a stream of events by which it is known again, wherever it is cut.

    A mark is a hash of four events in a row, and of the time from the first to the last; no pixel
    may be among them twice, since a few hot pixels come again and again.

    Args:
        events: int64 [n].
        out: Room for marks, uint64 [m].

    Returns:
        Number of marks, m at most; number of ON events; how many events are the one before once
        more; how many different times follow one another; and the longest pause between them [us].
    """
    found = brighter = twice = longest = 0
    times = min(events.shape[0], 1)
    first = 0  # of the latest events without a pixel that is among them twice
    for index in range(events.shape[0]):
        event = events[index]
        brighter += event & 1
        if index:
            before = events[index - 1]
            pause = ((event >> TIME_BIT) - (before >> TIME_BIT)) & TIME
            twice += event == before
            times += pause > 0
            longest = max(longest, pause)
        for other in range(max(index - 3, first), index):
            if (event ^ events[other]) & PLACE <= 1:
                first = other + 1
        if index - 3 < first or found == out.shape[0]:
            continue
        mark = np.uint64(((event >> TIME_BIT) - (events[index - 3] >> TIME_BIT)) & TIME)
        for place in range(index - 3, index + 1):
            mark ^= np.uint64(events[place] & PLACE)
            mark *= np.uint64(0x9E3779B97F4A7C15)
            mark ^= mark >> np.uint64(29)
        if mark >> np.uint64(64 - MARKED_BITS) == 0:
            out[found] = mark
            found += 1
    return found, brighter, twice, times, longest


STRONG_CHANGE = 0.25
"""Change of a bin that lies above the thresholds of its pixels [log units]."""


@njit(cache=True, nogil=True, fastmath={'reassoc', 'contract', 'nsz'})
def agreement(before: F32, after: F32, signs: F32) -> tuple[float, float, float, int, float]:
    """Compare the change between two frames with the events between their exposures.

    Args:
        before: Coarse log contrast of the earlier frame, float32 [rows, columns].
        after: The same of the later one.
        signs: ON less OFF events per pixel between their centres, of `add_signs`.

    Returns:
        Root mean square of the change [log units] and of the events per pixel; their correlation, 0
        where one of them is constant; number of bins with a `STRONG_CHANGE`; events per pixel and
        log unit of change there, by least squares.
    """
    rows, columns = before.shape
    change = told = both = change_mean = told_mean = strong = told_of = np.float64(0.0)
    bins = np.float64(0.0)
    for row in range(rows):
        for column in range(columns):
            a = np.float64(after[row, column]) - np.float64(before[row, column])
            b = np.float64(signs[row, column])
            b = min(max(b, -MOST_EVENTS_PER_PIXEL), MOST_EVENTS_PER_PIXEL)
            change_mean += a
            told_mean += b
            change += a * a
            told += b * b
            both += a * b
            # No branch, so that it is vectorised.
            counts = np.float64(abs(a) > STRONG_CHANGE)
            bins += counts
            strong += counts * a * a
            told_of += counts * a * b
    count = rows * columns
    change_mean, told_mean = change_mean / count, told_mean / count
    change = max(change / count - change_mean * change_mean, np.float64(0.0))
    told = max(told / count - told_mean * told_mean, np.float64(0.0))
    spread = np.sqrt(change * told)
    correlation = (both / count - change_mean * told_mean) / spread if spread > 0.0 else 0.0
    slope = told_of / strong if strong > 0.0 else 0.0
    return np.sqrt(change), np.sqrt(told), correlation, int(bins), slope


def warm_up() -> None:
    """Compile what a frame needs, so that the first one is not late."""
    contrast, event = np.zeros((8, 8), np.float32), np.zeros(1, np.int64)
    add_signs(event, 4, contrast, contrast)
    marks(event, np.empty(1, np.uint64))
    agreement(contrast, contrast, contrast)
