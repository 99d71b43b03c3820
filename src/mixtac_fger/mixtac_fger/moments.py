# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""Moments of the displacement of the beads about the contact: forces, up to a constant.

Far from a load, a layer moves as if the load acted at one point. In a window that is much wider
than the contact, neither the shape of the contact nor the pressure distribution matters. With
:math:`x` from the contact, :math:`u` the displacement and :math:`g` a Gaussian of width :math:`w`,

.. math:: D = \sum x \cdot u \, g / w^2, \quad S = \sum u \, g / w, \quad
          T_w = \sum (x \times u) \, g / w^2

are proportional to the normal force, the sideways force and the torque; the constants depend on the
stiffness of the gel. For a press and a pull, T is zero; for a turn, D and S are zero. Beads that
are pressed towards the camera move away from the optical axis in the image. For a contact at c from
the axis, this adds to S a part proportional to :math:`L = D c / w`; L is therefore computed as
well.

The contact is at the mean of the places, weighted by the square of the divergence of u where that
is positive. A turn has no divergence. A pull shifts the mean along its own direction only, which
adds no moment.

Between two frames, the same moments are computed from events: their flow over the grid is the
change of u.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.config import MOMENTS, TURNING_WIDTHS

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

RISE: Final = 2
"""Half the distance over which the divergence is taken [bins]."""


@njit(cache=True, nogil=True)
def moments(flow: F32, out: F32) -> None:
    """Write the moments of a displacement, in axes of the contact frame (x right, y upwards).

    Args:
        flow: Displacement x and y since the reference, y downwards [bins], [2, rows, columns].
        out: D, S right and up, L right and up, T over each of `TURNING_WIDTHS`; all but T over the
            last of these; [bins], float32 [`MOMENTS`]. 0 where nothing has moved.
    """
    rows, columns = flow.shape[1:]
    total, right, below = 0.0, 0.0, 0.0
    for row in range(RISE, rows - RISE):
        for column in range(RISE, columns - RISE):
            spread = flow[0, row, column + RISE] - flow[0, row, column - RISE]
            spread += flow[1, row + RISE, column] - flow[1, row - RISE, column]
            if spread > 0.0:
                weight = spread * spread
                total += weight
                right += weight * column
                below += weight * row
    out[:] = 0.0
    if not total > 0.0:
        return
    right, below = right / total, below / total
    for index in range(len(TURNING_WIDTHS)):
        width = TURNING_WIDTHS[index]
        across = np.exp(-0.5 * ((np.arange(columns) - right) / width) ** 2)
        press, pull_x, pull_y, turn = 0.0, 0.0, 0.0, 0.0
        for row in range(rows):
            y = row - below
            row_press, row_x, row_y, row_turn = 0.0, 0.0, 0.0, 0.0
            for column in range(columns):
                x = column - right
                u, v = across[column] * flow[0, row, column], across[column] * flow[1, row, column]
                row_x += u
                row_y += v
                row_press += x * u + y * v
                row_turn += y * u - x * v
            down = np.exp(-0.5 * (y / width) ** 2)
            press += down * row_press
            pull_x += down * row_x
            pull_y += down * row_y
            turn += down * row_turn
        out[MOMENTS - len(TURNING_WIDTHS) + index] = turn / (width * width)
        # What is left after the last width stays.
        out[0] = press / (width * width)
        out[1] = pull_x / width
        out[2] = -pull_y / width
        out[3] = out[0] * (right - 0.5 * (columns - 1)) / width
        out[4] = -out[0] * (below - 0.5 * (rows - 1)) / width


def contact_of(found: F32 | F64, shape: tuple[int, int]) -> tuple[float, float]:
    """Return column and row of the contact that moments are about [bins].

    Args:
        found: Of `moments`.
        shape: Rows and columns of the displacement.
    """
    rows, columns = shape
    right, below = 0.5 * (columns - 1), 0.5 * (rows - 1)
    press, _, _, lean_x, lean_y = found[:5].tolist()
    if press:
        right += TURNING_WIDTHS[-1] * lean_x / press
        below -= TURNING_WIDTHS[-1] * lean_y / press
    return min(max(right, 0.0), columns - 1.0), min(max(below, 0.0), rows - 1.0)


@njit(cache=True, nogil=True)
def moments_of_cells(contact: tuple[float, float], shape: tuple[int, int], out: F64) -> None:
    """Write the contribution of the displacements x and y of each cell of a grid to the moments.

    Args:
        contact: Column and row of the contact [bins].
        shape: Rows and columns of the displacement, which the cells divide evenly.
        out: float64 [`MOMENTS`, grid rows, grid columns, 2], y downwards.
    """
    rows, columns = out.shape[1:3]
    bins = shape[0] * shape[1] / (rows * columns)
    lean_x, lean_y = contact[0] - 0.5 * (shape[1] - 1), contact[1] - 0.5 * (shape[0] - 1)
    out[:] = 0.0
    for row in range(rows):
        for column in range(columns):
            cell = out[:, row, column]
            x = (column + 0.5) * shape[1] / columns - 0.5 - contact[0]
            y = (row + 0.5) * shape[0] / rows - 0.5 - contact[1]
            near, width = 0.0, 1.0
            for index in range(len(TURNING_WIDTHS)):
                width = TURNING_WIDTHS[index]
                near = bins * np.exp(-0.5 * (x * x + y * y) / width**2)
                turn = cell[MOMENTS - len(TURNING_WIDTHS) + index]
                turn[0], turn[1] = near * y / width**2, -near * x / width**2
            cell[0, 0], cell[0, 1] = near * x / width**2, near * y / width**2
            cell[1, 0], cell[2, 1] = near / width, -near / width
            for axis in range(2):
                cell[3, axis] = cell[0, axis] * lean_x / width
                cell[4, axis] = -cell[0, axis] * lean_y / width
