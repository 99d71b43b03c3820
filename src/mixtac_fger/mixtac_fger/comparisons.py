# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the checks of `validity` look at, compiled: figures of pictures, of events, and of both.

A picture is compared with the reference, two frames with the events between them, and events with
earlier ones, by marks.
"""

from __future__ import annotations

from typing import NamedTuple

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

TILE_ROWS, TILE_COLUMNS = 6, 8
"""Tiles of a picture: about eight beads each."""
TILE_SUMS = 10
LEAST_VARIANCE = 1e-3
"""Added to the variance of a tile [log units^2]: a tile without texture is like any other."""
STILL_BINS = 0.06
"""Displacement below which a tile does not move [bins]."""
WORST_TILES = 3
"""Tiles that may be unlike the reference: those below a very sharp contact, and a defect."""


class PictureFigures(NamedTuple):
    """What a picture has in common with the reference.

    Attributes:
        likeness: Correlation with the displaced reference, the fourth lowest of the tiles.
        fading: Variance of a tile over that of the reference, the lowest of the tiles.
        roughness: The same, the highest of the tiles.
        shading: Mean of a tile less that of the displaced reference, against the median of all
            tiles, the largest [log units].
        still_shading: The same, the largest of the tiles that do not move against the median tile.
        unevenness: The same, the median of the tiles.
        shift: Displacement of the median tile, or of the median of the tiles along the border where
            that is less: a pull on a wide contact moves more than half of the picture [bins].
        displacement: Displacement of the tile that moved most against the median tile [bins].
        outward: Mean component of the displacement away from where it is largest [bins].
        sharpness: Variance of a tile over that of the reference, the median of the tiles.
        clipped: Share of the picture that is all white.
    """

    likeness: float
    fading: float
    roughness: float
    shading: float
    still_shading: float
    unevenness: float
    shift: float
    displacement: float
    outward: float
    sharpness: float
    clipped: float = 0.0


@njit(cache=True, nogil=True)
def _tile_sums(reference: F32, image: F32, flow: F32, sums: NDArray[np.float64]) -> None:
    """Write, per tile, the sums that `picture_figures` reads."""
    rows, columns = image.shape
    sums[:] = 0.0
    for row in range(rows):
        for column in range(columns):
            u, v = flow[0, row, column], flow[1, row, column]
            x = min(max(column - u, np.float32(0.0)), np.float32(columns - 1))
            y = min(max(row - v, np.float32(0.0)), np.float32(rows - 1))
            left, top = min(int(x), columns - 2), min(int(y), rows - 2)
            p, q = x - left, y - top
            above = (1 - p) * reference[top, left] + p * reference[top, left + 1]
            below = (1 - p) * reference[top + 1, left] + p * reference[top + 1, left + 1]
            moved = np.float64((1 - q) * above + q * below)
            here, before = np.float64(image[row, column]), np.float64(reference[row, column])
            tile = sums[row * TILE_ROWS // rows, column * TILE_COLUMNS // columns]
            tile[0] += 1.0
            tile[1] += moved
            tile[2] += moved * moved
            tile[3] += here
            tile[4] += here * here
            tile[5] += moved * here
            tile[6] += before
            tile[7] += before * before
            tile[8] += u
            tile[9] += v


@njit(cache=True, nogil=True)
def _sort(values: NDArray[np.float64]) -> None:
    """Sort a few values in place; np.sort and np.median take seconds to compile."""
    for index in range(1, values.shape[0]):
        value, place = values[index], index
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value


@njit(cache=True, nogil=True)
def _median(values: NDArray[np.float64]) -> float:
    """Return the (upper) median."""
    ordered = values.copy()
    _sort(ordered)
    return ordered[values.shape[0] // 2]  # type: ignore[no-any-return]


@njit(cache=True, nogil=True)
def _border_median(values: NDArray[np.float64]) -> float:
    """Return the (upper) median of the tiles along the border."""
    border = np.empty(2 * (TILE_ROWS + TILE_COLUMNS) - 4)
    found = 0
    for index in range(values.shape[0]):
        row, column = index // TILE_COLUMNS, index % TILE_COLUMNS
        if row in (0, TILE_ROWS - 1) or column in (0, TILE_COLUMNS - 1):
            border[found] = values[index]
            found += 1
    return _median(border)  # type: ignore[no-any-return]


@njit(cache=True, nogil=True, error_model='numpy')
def picture_figures(
    reference: F32, image: F32, flow: F32
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Compare a picture with the reference; returns fields of `PictureFigures`, all but the last.

    Args:
        reference: Coarse log contrast without contact, float32 [rows, columns].
        image: Coarse log contrast now, same shape.
        flow: Displacement of the image against the reference along x and y [bins], float32
            [2, rows, columns], of `mixtac_events.frames.displacement`.
    """
    sums = np.empty((TILE_ROWS, TILE_COLUMNS, TILE_SUMS), np.float64)
    _tile_sums(reference, image, flow, sums)
    tiles = sums.reshape(TILE_ROWS * TILE_COLUMNS, TILE_SUMS)
    count = tiles.shape[0]
    likeness, change = np.empty(count), np.empty(count)
    u, v = np.empty(count), np.empty(count)
    sharpness = np.empty(count)
    for index in range(count):
        tile = tiles[index]
        for place in range(TILE_SUMS - 1, -1, -1):
            tile[place] /= tile[0]
        moved = tile[2] - tile[1] * tile[1] + LEAST_VARIANCE
        here = tile[4] - tile[3] * tile[3] + LEAST_VARIANCE
        before = tile[7] - tile[6] * tile[6] + LEAST_VARIANCE
        likeness[index] = (tile[5] - tile[1] * tile[3] + LEAST_VARIANCE) / np.sqrt(moved * here)
        sharpness[index] = here / before
        change[index] = tile[3] - tile[1]
        u[index], v[index] = tile[8], tile[9]
    shift_x, shift_y = _median(u), _median(v)
    shift = min(np.hypot(shift_x, shift_y), np.hypot(_border_median(u), _border_median(v)))
    middle, squared = _median(change), np.empty(count)
    total = largest = still = np.float64(0.0)
    for index in range(count):
        change[index] = abs(change[index] - middle)
        u[index] -= shift_x
        v[index] -= shift_y
        squared[index] = u[index] * u[index] + v[index] * v[index]
        total += squared[index]
        largest = max(largest, squared[index])
        if squared[index] < STILL_BINS * STILL_BINS:
            still = max(still, change[index])
    total += 1e-12
    _sort(change)
    _sort(likeness)
    _sort(sharpness)
    middle_x = middle_y = outward = np.float64(0.0)
    for index in range(count):
        middle_x += squared[index] / total * (index % TILE_COLUMNS)
        middle_y += squared[index] / total * (index // TILE_COLUMNS)
    for index in range(count):
        away_x, away_y = index % TILE_COLUMNS - middle_x, index // TILE_COLUMNS - middle_y
        distance = np.sqrt(away_x * away_x + away_y * away_y) + 1e-3
        outward += (u[index] * away_x + v[index] * away_y) / distance / count
    return (
        likeness[WORST_TILES],
        sharpness[0],
        sharpness[-1],
        change[-1],
        still,
        change[count // 2],
        shift,
        np.sqrt(largest),
        outward,
        sharpness[count // 2],
    )


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
    contrast, flow = np.zeros((8, 8), np.float32), np.zeros((2, 8, 8), np.float32)
    event = np.zeros(1, np.int64)
    picture_figures(contrast, contrast, flow)
    add_signs(event, 4, contrast, contrast)
    marks(event, np.empty(1, np.uint64))
    agreement(contrast, contrast, contrast)
