# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Evenly spaced samples made finer by a natural cubic spline, without loading `scipy`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def refined(values: NDArray[np.float64], finer: int) -> NDArray[np.float64]:
    """Return the natural cubic spline through samples at finer steps.

    Args:
        values: Evenly spaced samples, ``float64 [n]``, at least two.
        finer: Steps per sample.

    Returns:
        ``float64 [(n - 1) * finer + 1]``, with the samples themselves among them.
    """
    bend = _second_differences(values)
    count = len(values)
    fine = np.empty((count - 1) * finer + 1)
    for i in range(count - 1):
        for k in range(finer):
            right = k / finer
            left = 1.0 - right
            fine[i * finer + k] = (
                left * values[i]
                + right * values[i + 1]
                + ((left**3 - left) * bend[i] + (right**3 - right) * bend[i + 1]) / 6.0
            )
    fine[-1] = values[-1]
    return fine


@njit(cache=True, nogil=True)
def _second_differences(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the second derivatives at the samples, by elimination in a tridiagonal matrix."""
    count = len(values)
    bend, upper = np.zeros(count), np.zeros(count)
    for i in range(1, count - 1):
        pivot = 4.0 - upper[i - 1]
        upper[i] = 1.0 / pivot
        right = 6.0 * (values[i + 1] - 2.0 * values[i] + values[i - 1])
        bend[i] = (right - bend[i - 1]) / pivot
    for i in range(count - 2, 0, -1):
        bend[i] -= upper[i] * bend[i + 1]
    return bend
