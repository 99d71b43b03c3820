# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The compiled sum over the events of a window."""

from __future__ import annotations

from typing import TYPE_CHECKING

from numba import njit

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def window_sums(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.bool_],
    fields: NDArray[np.float32],
    bin_size: int,
    sums: NDArray[np.float64],
) -> int:
    """Write the signed sums of the fields over some events; events outside are left out.

    Args:
        x: Columns, uint16 [n].
        y: Rows, uint16 [n].
        polarity: True where brighter, bool [n].
        fields: Of a `FlowGuide`, float32 [modes, rows, columns] of bins.
        bin_size: Pixels along a bin.
        sums: Written, float64 [modes].

    Returns:
        Number of ON events.
    """
    modes, rows, columns = fields.shape
    on = 0
    sums[:] = 0.0
    for index in range(x.shape[0]):
        brighter = polarity[index]
        on += brighter
        row, column = y[index] // bin_size, x[index] // bin_size
        if row >= rows or column >= columns:
            continue
        sign = 1.0 if brighter else -1.0
        for mode in range(modes):
            sums[mode] += sign * fields[mode, row, column]
    return on
