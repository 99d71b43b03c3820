# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels on events: gradient flow and counts on a coarse grid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    Index = NDArray[np.int64]


@njit(cache=True, nogil=True)
def cell_solvers(
    along_x: F32,
    along_y: F32,
    row_cell: Index,
    column_cell: Index,
    pixels_per_bin: int,
    regularisation: float,
    out: F32,
) -> None:
    """Write the inverse of each cell's regularised structure tensor.

    Args:
        along_x: Log-gradient along x [1/px], float32 [rows, columns] of bins.
        along_y: The same along y.
        row_cell: Grid row of each row of bins, int64 [rows].
        column_cell: Grid column of each column of bins, int64 [columns].
        pixels_per_bin: Sensor pixels in a bin.
        regularisation: Added per pixel to the diagonal [1/px^2].
        out: xx, xy, yy of the inverse, float32 [grid rows, grid columns, 3].
    """
    rows, columns = along_x.shape
    tensor = np.zeros((out.shape[0], out.shape[1], 3), np.float64)
    for row in range(rows):
        for column in range(columns):
            cell = tensor[row_cell[row], column_cell[column]]
            gx = np.float64(along_x[row, column])
            gy = np.float64(along_y[row, column])
            cell[0] += pixels_per_bin * (gx * gx + regularisation)
            cell[1] += pixels_per_bin * gx * gy
            cell[2] += pixels_per_bin * (gy * gy + regularisation)
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            xx, xy, yy = tensor[row, column]
            inverse = 1.0 / (xx * yy - xy * xy)
            out[row, column, 0] = yy * inverse
            out[row, column, 1] = -xy * inverse
            out[row, column, 2] = xx * inverse


@njit(cache=True, nogil=True)
def grid_features(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.bool_],
    along_x: F32,
    along_y: F32,
    row_cell: Index,
    column_cell: Index,
    bins: NDArray[np.uint16],
    solvers: F32,
    flow_limit: float,
    out: F32,
) -> None:
    """Write the features of one window: per cell flow x, flow y, ln(1 + ON), ln(1 + OFF).

    A bead edge that moves by u changes the log intensity by -g u; each event reports one threshold
    of that change with its sign, so the sums of sign times gradient give u per threshold by least
    squares. Events outside the map are ignored.

    Args:
        x: Columns, uint16 [n].
        y: Rows, uint16 [n].
        polarity: True where brighter, bool [n].
        along_x: Log-gradient of the latest frame along x [1/px], float32 [rows, columns] of bins.
        along_y: The same along y.
        row_cell: Grid row of each row of bins.
        column_cell: Grid column of each column of bins.
        bins: Bin of each coordinate that there can be, uint16 [65536]: a table, since divisions are
            what takes longest.
        solvers: From `cell_solvers`.
        flow_limit: Bound of |flow| per axis [px per threshold].
        out: float32 [grid rows, grid columns, 4].
    """
    rows, columns = along_x.shape
    out[:] = 0.0
    for index in range(x.shape[0]):
        row, column = bins[y[index]], bins[x[index]]
        if row >= rows or column >= columns:
            continue
        cell = out[row_cell[row], column_cell[column]]
        if polarity[index]:
            cell[0] += along_x[row, column]
            cell[1] += along_y[row, column]
            cell[2] += np.float32(1.0)
        else:
            cell[0] -= along_x[row, column]
            cell[1] -= along_y[row, column]
            cell[3] += np.float32(1.0)
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            cell, inverse = out[row, column], solvers[row, column]
            sum_x, sum_y = cell[0], cell[1]
            flow_x = -(inverse[0] * sum_x + inverse[1] * sum_y)
            flow_y = -(inverse[1] * sum_x + inverse[2] * sum_y)
            cell[0] = min(max(flow_x, -flow_limit), flow_limit)
            cell[1] = min(max(flow_y, -flow_limit), flow_limit)
            cell[2] = np.log1p(cell[2])
            cell[3] = np.log1p(cell[3])
