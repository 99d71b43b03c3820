# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors that depend on time: fast ones, at peaks, and over a long hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

FRAME_LIMIT_S = 0.08
"""Two frame intervals at 25 Hz: what is faster than this, frames alone cannot follow."""
ROLLING_S = 0.5
"""Window of the rolling error (paper, section IV-B)."""
PEAK_TOLERANCE_S = 0.01
"""A peak may be estimated this much early or late."""


def fast_part(values: NDArray[np.float64], interval_s: float) -> NDArray[np.float64]:
    """Return values without their moving average over `FRAME_LIMIT_S`.

    Args:
        values: Evenly sampled, [T].
        interval_s: Between samples [s].
    """
    return values - moving_mean(values, max(round(FRAME_LIMIT_S / interval_s), 1))


def moving_mean(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Return the centred mean over `width` samples, of fewer at the ends, [T]."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(len(values))
    low = np.maximum(index - width // 2, 0)
    high = np.minimum(index - width // 2 + width, len(values))
    return np.asarray((total[high] - total[low]) / (high - low))


def fast_error(
    known: NDArray[np.float64], estimate: NDArray[np.float64], interval_s: float
) -> tuple[float, float]:
    """Return the mean absolute error of the fast part, and the same of no estimate [N]."""
    fast = fast_part(known, interval_s)
    error = fast_part(estimate, interval_s) - fast
    return float(np.abs(error).mean()), float(np.abs(fast).mean())


def peak_error(
    known: NDArray[np.float64], estimate: NDArray[np.float64], interval_s: float
) -> float:
    """Return |estimated - known| / known of the largest known force.

    The estimate is the largest one within `PEAK_TOLERANCE_S` of it. nan where nothing is pressed.
    """
    at = int(np.argmax(known))
    if known[at] <= 0.0:
        return float('nan')
    reach = round(PEAK_TOLERANCE_S / interval_s)
    near = estimate[max(at - reach, 0) : at + reach + 1]
    return float(abs(near.max() - known[at]) / known[at])


def rolling_errors(
    known: NDArray[np.float64], estimate: NDArray[np.float64], interval_s: float
) -> NDArray[np.float64]:
    """Return the mean absolute error in consecutive windows of `ROLLING_S` [N]."""
    size = max(round(ROLLING_S / interval_s), 1)
    error = np.abs(estimate - known)
    count = max(len(error) // size, 1)
    return np.array([part.mean() for part in np.array_split(error, count)])
