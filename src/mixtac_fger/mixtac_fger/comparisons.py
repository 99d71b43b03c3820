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

F32 = NDArray[np.float32]

TILE_ROWS, TILE_COLUMNS = 6, 8
"""Tiles of a picture: about eight beads each."""
TILE_SUMS = 10
LEAST_VARIANCE = 1e-3
"""Added to the variance of a tile [log units^2]: a tile without texture is like any other."""
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
) -> tuple[float, float, float, float, float, float, float, float, float]:
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
    total = largest = np.float64(0.0)
    for index in range(count):
        change[index] = abs(change[index] - middle)
        u[index] -= shift_x
        v[index] -= shift_y
        squared[index] = u[index] * u[index] + v[index] * v[index]
        total += squared[index]
        largest = max(largest, squared[index])
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
        change[count // 2],
        shift,
        np.sqrt(largest),
        outward,
        sharpness[count // 2],
    )


MOST_EVENTS_PER_PIXEL = np.float64(2.0)
"""Events of a pixel of a bin between two frames beyond which more count as so many: hot pixels."""


@njit(cache=True, nogil=True, error_model='numpy')
def add_signs(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.bool_],
    size: int,
    out: F32,
) -> None:
    """Add ON less OFF events per pixel to bins.

    Args:
        x: Columns, uint16 [n].
        y: Rows, uint16 [n].
        polarity: True where brighter, bool [n].
        size: Pixels of a bin along each axis.
        out: float32 [rows, columns] of bins.
    """
    rows, columns = out.shape
    share = np.float32(1.0 / (size * size))
    pixels = np.uint32(size)  # fast to divide by
    for index in range(x.shape[0]):
        row, column = y[index] // pixels, x[index] // pixels
        if row < rows and column < columns:
            out[row, column] += share if polarity[index] else -share


MARKED_BITS, MOST_MARKS = 5, 32
"""One event in 32 is marked, up to so many between two frames."""


@njit(cache=True, nogil=True)
def marks(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.bool_],
    out: NDArray[np.uint64],
) -> tuple[int, int, int]:
    """Find places in a stream of events by which it is known again, wherever it is cut.

    A mark is a hash of four events in a row, and of the time from the first to the last; no pixel
    may be among them twice, since a few hot pixels come again and again.

    Args:
        t: Times [us], int64 [n].
        x: Columns, uint16 [n].
        y: Rows, uint16 [n].
        polarity: True where brighter, bool [n].
        out: Room for marks, uint64 [m].

    Returns:
        Number of marks, m at most; how many events are the one before once more; and how many
        different times the events have.
    """
    found = twice = 0
    times = min(x.shape[0], 1)
    for index in range(1, x.shape[0]):
        alike = x[index] == x[index - 1] and y[index] == y[index - 1]
        later = t[index] != t[index - 1]
        times += later
        twice += alike and not later and polarity[index] == polarity[index - 1]
    for index in range(x.shape[0] - 3):
        if found == out.shape[0]:
            break
        alike = False
        for place in range(index, index + 3):
            for other in range(place + 1, index + 4):
                alike |= x[place] == x[other] and y[place] == y[other]
        if alike:
            continue
        mark = np.uint64(t[index + 3] - t[index])
        for place in range(index, index + 4):
            pixel = (np.uint64(y[place]) << np.uint64(16)) | np.uint64(x[place])
            mark ^= (pixel << np.uint64(1)) | np.uint64(polarity[place])
            mark *= np.uint64(0x9E3779B97F4A7C15)
            mark ^= mark >> np.uint64(29)
        if mark >> np.uint64(64 - MARKED_BITS) == 0:
            out[found] = mark
            found += 1
    return found, twice, times


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
    place = np.zeros(1, np.uint16)
    picture_figures(contrast, contrast, flow)
    add_signs(place, place, np.ones(1, np.bool_), 4, contrast)
    marks(np.zeros(1, np.int64), place, place, np.ones(1, np.bool_), np.empty(1, np.uint64))
    agreement(contrast, contrast, contrast)
