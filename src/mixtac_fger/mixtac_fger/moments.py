# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""Moments of the displacement of the beads, which all forces follow from.

Far from a load, a layer moves as if the load acted at one point. In a window that is much wider
than the contact, the pressure distribution does not matter. With :math:`x` from the contact,
:math:`u` the displacement and :math:`g` a Gaussian of width :math:`w`,

.. math:: D = \sum x \cdot u \, g / w^2, \quad S = \sum u \, g / w, \quad
          T_w = \sum (x \times u) \, g / w^2

are proportional to the normal force, the sideways force and the torque. For a press and a pull, T
is zero; for a turn, D and S are zero. Beads that are pressed towards the camera move away from the
optical axis in the image. For a contact at c from the axis, this adds to S a part proportional to
:math:`L = D c / w`; L is therefore computed as well.

A contact is no point. Its width r changes the displacement by parts proportional to even powers of
r, so that the normal force is

.. math:: F = D \, (p_0 + p_1 r^2 + p_2 r^4),

with constants p that depend on the gel only. The contact is at the mean of the places, weighted by
the divergence of u above a share of its peak, and r is the root mean square distance from it,
weighted alike. A turn has no divergence. A pull shifts the mean along its own direction only, which
adds no moment.

Between frames, the moments of the event flow, :math:`u = e \, v`, are added to the moments: v is
the displacement per contrast threshold, and e (`PER_EVENT`) scales it to the displacement in
frames. The same constants convert both to a force. The latest frame gives the width.

The contact frame gives the axes: x to the right and y upwards in the image.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.config import MOMENTS, PRESSES, TURNING_WIDTHS

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

RISE: Final = 4
"""Half the distance over which the divergence is taken [bins]."""
PEAK_SHARE: Final = 0.3
"""Share of the peak of the divergence above which a place counts as contact."""
SMALL_PRESS: Final = 3.0
"""Moment D at which half of the place and of the width of a contact is believed [bins]: 0.1 N."""


@njit(cache=True, nogil=True)
def moments(flow: F32, out: F32) -> None:
    """Write the moments of a displacement, in axes of the contact frame (x right, y upwards).

    Args:
        flow: Displacement x and y since the reference, y downwards [bins], [2, rows, columns].
        out: D, D r^2, D r^4, S right and up, L right and up, place of the contact right and up from
            the middle, its r^2, and T over each of `TURNING_WIDTHS`; all but T over the last of
            these; in bins, float32 [`MOMENTS`]. 0 where nothing has moved.
    """
    rows, columns = flow.shape[1:]
    out[:] = 0.0
    stretch = np.zeros((rows, columns), np.float32)
    for row in range(RISE, rows - RISE):
        for column in range(RISE, columns - RISE):
            along = flow[0, row, column + RISE] - flow[0, row, column - RISE]
            down = flow[1, row + RISE, column] - flow[1, row - RISE, column]
            stretch[row, column] = along + down
    least = PEAK_SHARE * stretch.max()
    if not least > 0.0:
        return
    total, right, below, square = 0.0, 0.0, 0.0, 0.0
    for row in range(rows):
        for column in range(columns):
            weight = stretch[row, column] - least
            if weight > 0.0:
                total += weight
                right += weight * column
                below += weight * row
                square += weight * (column * column + row * row)
    right, below = right / total, below / total
    # Rounding may leave less than nothing of a single place.
    wide = max(square / total - right * right - below * below, 0.0)
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
        # The values of the last width stay.
        out[0] = press / (width * width)
        out[1] = out[0] * wide
        out[2] = out[1] * wide
        out[PRESSES] = pull_x / width
        out[PRESSES + 1] = -pull_y / width
        out[PRESSES + 2] = out[0] * (right - 0.5 * (columns - 1)) / width
        out[PRESSES + 3] = -out[0] * (below - 0.5 * (rows - 1)) / width
    # Noise is at no place.
    sure = max(out[0], 0.0) / (max(out[0], 0.0) + SMALL_PRESS)
    out[PRESSES + 4] = sure * (right - 0.5 * (columns - 1))
    out[PRESSES + 5] = -sure * (below - 0.5 * (rows - 1))
    out[PRESSES + 6] = sure * wide


def contact_of(found: F32 | F64, shape: tuple[int, int]) -> tuple[float, float, float]:
    """Return column, row [bins] and squared width [bins^2] of the contact that moments are about.

    Args:
        found: Of `moments`.
        shape: Rows and columns of the displacement.
    """
    rows, columns = shape
    right, below = 0.5 * (columns - 1), 0.5 * (rows - 1)
    press, wide, *_, lean_x, lean_y = found[: PRESSES + 4].tolist()
    if press:
        wide /= press
        right += TURNING_WIDTHS[-1] * lean_x / press
        below -= TURNING_WIDTHS[-1] * lean_y / press
    return min(max(right, 0.0), columns - 1.0), min(max(below, 0.0), rows - 1.0), wide


@njit(cache=True, nogil=True)
def moments_of_cells(contact: tuple[float, float, float], shape: tuple[int, int], out: F64) -> None:
    """Write the contribution of the displacements x and y of each cell of a grid to the moments.

    Args:
        contact: Column, row [bins] and squared width [bins^2] of the contact.
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
            cell[PRESSES, 0], cell[PRESSES + 1, 1] = near / width, -near / width
            for axis in range(2):
                cell[1, axis] = cell[0, axis] * contact[2]
                cell[2, axis] = cell[1, axis] * contact[2]
                cell[PRESSES + 2, axis] = cell[0, axis] * lean_x / width
                cell[PRESSES + 3, axis] = -cell[0, axis] * lean_y / width


PER_EVENT: Final = 0.4
"""Displacement in frames over displacement per contrast threshold from events."""


@njit(cache=True, nogil=True)
def along_flow(features: F32, per_flow: F64) -> Any:  # noqa: ANN401
    """Return the change of a force by the flow of a window.

    Args:
        features: Grid features, float32 [grid rows, grid columns, 4].
        per_flow: Change by a flow of one pixel per threshold, [grid rows, grid columns, 2].
    """
    total = 0.0
    for row in range(features.shape[0]):
        for column in range(features.shape[1]):
            cell, gain = features[row, column], per_flow[row, column]
            total += gain[0] * cell[0] + gain[1] * cell[1]
    return total
