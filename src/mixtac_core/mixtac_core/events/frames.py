# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiled operations on frames: binning, log contrast, gradients, displacement.

Kernels of this project use explicit loops: numba needs seconds to compile expressions of whole
arrays, with their checks of shapes. Constants are passed as `np.int64`; otherwise numba would
compile a kernel again for each of them.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F32 = NDArray[np.float32]

PICTURE_KERNELS = 'the picture kernels'
"""Name under which programs compile these and what calls them; see `mixtac_core.node.process`."""


@njit(cache=True, nogil=True)
def bin_mean(image: NDArray[np.generic], size: int, out: F32) -> None:
    """Write the means of `size` x `size` blocks of `image` to `out` (float32 [rows, columns])."""
    rows, columns = out.shape
    scale = np.float32(1.0 / (size * size))
    for row in range(rows):
        for column in range(columns):
            total = np.float32(0.0)
            for i in range(size):
                for j in range(size):
                    total += np.float32(image[row * size + i, column * size + j])
            out[row, column] = total * scale


@njit(cache=True, nogil=True)
def log_contrast(image: F32, floor: float, out: F32) -> None:
    """Write ln(image / mean(image) + floor) to `out`; a black image gives ln(floor) everywhere."""
    rows, columns = image.shape
    total = 0.0
    for row in range(rows):
        for column in range(columns):
            total += image[row, column]
    mean = total / (rows * columns)
    scale = np.float32(1.0 / mean) if mean > 0.0 else np.float32(0.0)
    for row in range(rows):
        for column in range(columns):
            out[row, column] = np.log(image[row, column] * scale + np.float32(floor))


@njit(cache=True, nogil=True)
def gradients(image: F32, spacing: float, along_x: F32, along_y: F32) -> None:
    """Write central differences of `image` per `spacing`; the border repeats the last pixel."""
    rows, columns = image.shape
    half = np.float32(0.5 / spacing)
    for row in range(rows):
        above, below = max(row - 1, 0), min(row + 1, rows - 1)
        for column in range(columns):
            left, right = max(column - 1, 0), min(column + 1, columns - 1)
            along_x[row, column] = (image[row, right] - image[row, left]) * half
            along_y[row, column] = (image[below, column] - image[above, column]) * half


@njit(cache=True, nogil=True)
def _sum_along_rows(field: F32, radius: int, out: F32) -> None:
    """Write the sums of 2 radius + 1 neighbours in a row, cut at the border."""
    rows, columns = field.shape
    for row in range(rows):
        total = np.float32(0.0)
        for column in range(min(radius, columns)):
            total += field[row, column]
        for column in range(columns):
            if column + radius < columns:
                total += field[row, column + radius]
            if column - radius > 0:
                total -= field[row, column - radius - 1]
            out[row, column] = total


@njit(cache=True, nogil=True)
def displacement(
    reference: F32, image: F32, radius: int, regularisation: float, work: F32, out: F32
) -> None:
    """Least-squares displacement of `image` against `reference` (Lucas and Kanade, one step).

    Args:
        reference: Log contrast without contact, float32 [rows, columns].
        image: Log contrast now, same shape.
        radius: Half width of the box [px of these images].
        regularisation: Added per pixel of the box to the structure tensor's diagonal.
        work: Scratch, float32 [9, rows, columns].
        out: Displacement along x and y [px], float32 [2, rows, columns].
    """
    rows, columns = image.shape
    mean = work[8]
    for row in range(rows):
        for column in range(columns):
            mean[row, column] = np.float32(0.5) * (reference[row, column] + image[row, column])
    gradients(mean, np.int64(1), work[5], work[6])
    for row in range(rows):
        for column in range(columns):
            gx, gy = work[5, row, column], work[6, row, column]
            change = image[row, column] - reference[row, column]
            work[0, row, column] = gx * gx
            work[1, row, column] = gx * gy
            work[2, row, column] = gy * gy
            work[3, row, column] = gx * change
            work[4, row, column] = gy * change
    for index in range(5):
        _sum_along_rows(work[index], radius, work[7])
        _sum_along_rows(work[7].T, radius, work[index].T)
    ridge = np.float32(regularisation * (2 * radius + 1) ** 2)
    for row in range(rows):
        for column in range(columns):
            xx, yy = work[0, row, column] + ridge, work[2, row, column] + ridge
            xy = work[1, row, column]
            bx, by = work[3, row, column], work[4, row, column]
            inverse = np.float32(-1.0) / (xx * yy - xy * xy)
            out[0, row, column] = (yy * bx - xy * by) * inverse
            out[1, row, column] = (xx * by - xy * bx) * inverse
