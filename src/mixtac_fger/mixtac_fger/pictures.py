# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A picture compared with the reference, and what no contact does to one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.reasons import Reason

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


LEAST_LIKENESS = ((0.85, -0.15), (0.93, -0.45))
"""Limits of a picture: a value, and its change per bin that a tile has moved, since large
displacements are found too small, and beads come and go. The second line holds for small ones: what
a contact explains, no contact does not. Without a fault 0.86 or more, at rest 0.99; where a tile
moves by 1.6 bins 0.72."""
LEAST_FADING, MOST_ROUGHNESS = ((0.4, -0.2), (0.75, -0.7)), ((1.8, 0.3), (1.3, 1.0))
"""Without a fault 0.63 to 1.31, at rest 0.90 to 1.13. A strong pull that moves a tile by 1.2 bins
has a fading of 0.26, one by 1.1 bins a roughness of 1.85."""
LEAST_SHARPNESS, MOST_SHARPNESS = ((0.8, 0.0), (0.92, -0.25)), ((1.25, 0.0), (1.1, 0.3))
"""Without a fault 0.93 to 1.02 (34 trials), at rest 0.99 to 1.01."""
MOST_SHADING, MOST_UNEVENNESS = ((0.17, 0.06), (0.04, 0.2)), ((0.03, 0.0), (0.01, 0.05))
"""Without a fault up to 0.12 and 0.0125, at rest 0.007 and 0.0015 [log units]. A strong pull that
moves a tile by 1.15 bins has a shading of 0.19 (5.2 hours)."""
MOST_STILL_SHADING = 0.035
"""The same of tiles that do not move, however far others do; without a fault 0.021 at most (37
trials)."""
MOST_SHIFT = ((0.08, 0.01),)
"""Without a fault up to 0.051 bins; a bin has four pixels. A blow that moves a tile by 1.7 bins has
a shift of 0.082 (5.2 hours)."""


def picture_findings(picture: PictureFigures) -> set[Reason]:
    """Return what is wrong with a picture; nothing below any contact."""
    found = set()
    moved = picture.displacement
    shaded = picture.shading > _most(MOST_SHADING, moved)
    shaded |= picture.still_shading > MOST_STILL_SHADING
    if shaded or picture.unevenness > _most(MOST_UNEVENNESS, moved):
        found.add(Reason.LIGHT_CHANGED)
    if picture.shift > _most(MOST_SHIFT, moved):
        found.add(Reason.CAMERA_MOVED)
    unlike = is_unlike(picture) or picture.fading < _least(LEAST_FADING, moved)
    unlike |= picture.roughness > _most(MOST_ROUGHNESS, moved)
    dull, keen = _least(LEAST_SHARPNESS, moved), _most(MOST_SHARPNESS, moved)
    if unlike or not dull <= picture.sharpness <= keen:
        found.add(Reason.PICTURE_UNLIKE_REFERENCE)
    return found


def is_unlike(picture: PictureFigures) -> bool:
    """Return whether a picture is not that of the reference under any contact."""
    return picture.likeness < _least(LEAST_LIKENESS, picture.displacement)


Lines = tuple[tuple[float, float], ...]


def _most(lines: Lines, moved: float) -> float:
    return min(value + slope * moved for value, slope in lines)


def _least(lines: Lines, moved: float) -> float:
    return max(value + slope * moved for value, slope in lines)


def warm_up() -> None:
    """Compile what a frame needs, so that the first one is not late."""
    picture = np.zeros((8, 8), np.float32)
    picture_figures(picture, picture, np.zeros((2, 8, 8), np.float32))
