# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Least squares with weights that are not negative (Lawson and Hanson 1974, chapter 23).

The same as `scipy.optimize.nnls`, which the tests hold this to; loading `scipy.optimize` takes
longer than fitting all taps of a recording.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

TOLERANCE: Final = 1e-10
"""Part of the largest gradient that counts as none."""
ROUNDS: Final = 10
ROUNDING: Final = 1e-13
"""Part of a column that is at least its own; columns may be nearly alike."""


def nonnegative_left(design: NDArray[np.float64], signal: NDArray[np.float64]) -> float:
    """Return the sum of squares that the best non-negative weights leave.

    Args:
        design: Columns, ``float64 [m, k]``.
        signal: What they are to make up, ``float64 [m]``.
    """
    left = signal - design @ nonnegative_weights(design.T @ design, design.T @ signal)
    return float(left @ left)


@njit(cache=True, nogil=True)
def nonnegative_weights(
    gram: NDArray[np.float64], moment: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the non-negative weights of least squares, ``float64 [k]``.

    Args:
        gram: Products of the columns with each other, ``float64 [k, k]``.
        moment: Their products with the signal, ``float64 [k]``.
    """
    count = len(moment)
    weights = np.zeros(count)
    active = np.zeros(count, np.bool_)
    small = TOLERANCE * np.abs(moment).max()
    for _ in range(ROUNDS * count):
        best = _steepest(gram, moment, weights, active, small)
        if best < 0:
            break
        active[best] = True
        while not _advance(weights, _solve(gram, moment, active), active):
            pass
    return weights


@njit(cache=True, nogil=True)
def _steepest(
    gram: NDArray[np.float64],
    moment: NDArray[np.float64],
    weights: NDArray[np.float64],
    active: NDArray[np.bool_],
    small: float,
) -> int:
    """Return the idle column that would lower the sum of squares fastest; -1 if none would."""
    best, steepest = -1, small
    for k in range(len(moment)):
        if not active[k]:
            gradient = moment[k] - np.sum(gram[k] * weights)
            if gradient > steepest:
                best, steepest = k, gradient
    return best


@njit(cache=True, nogil=True)
def _advance(
    weights: NDArray[np.float64], wanted: NDArray[np.float64], active: NDArray[np.bool_]
) -> bool:
    """Move towards the wanted weights as far as all stay positive; return whether all the way."""
    part, first = 1.0, -1
    for k in range(len(weights)):
        if active[k] and wanted[k] <= 0.0:
            reach = weights[k] / (weights[k] - wanted[k]) if weights[k] > 0.0 else 0.0
            if first < 0 or reach < part:
                part, first = reach, k
    for k in range(len(weights)):
        weights[k] = max(weights[k] + part * (wanted[k] - weights[k]), 0.0)
    if first < 0:
        return True
    active[first] = False
    weights[first] = 0.0
    return False


@njit(cache=True, nogil=True)
def _solve(
    gram: NDArray[np.float64], moment: NDArray[np.float64], active: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the weights of the active columns without the constraint, by Cholesky's factors."""
    chosen = np.flatnonzero(active)
    count = len(chosen)
    lower, part = np.zeros((count, count)), np.zeros(count)
    for i in range(count):
        for j in range(i + 1):
            rest = gram[chosen[i], chosen[j]] - np.sum(lower[i, :j] * lower[j, :j])
            if i == j:
                lower[i, i] = np.sqrt(max(rest, ROUNDING * gram[chosen[i], chosen[i]]))
            else:
                lower[i, j] = rest / lower[j, j]
        part[i] = (moment[chosen[i]] - np.sum(lower[i, :i] * part[:i])) / lower[i, i]
    weights = np.zeros(len(moment))
    for i in range(count - 1, -1, -1):
        part[i] = (part[i] - np.sum(lower[i + 1 :, i] * part[i + 1 :])) / lower[i, i]
        weights[chosen[i]] = part[i]
    return weights
