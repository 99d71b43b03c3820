# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Peaks that rise over what is around them, and how wide they are.

The definitions are those of `scipy.signal.find_peaks` and `peak_widths`, which the tests hold this
to; loading `scipy.signal` takes longer than aligning a recording.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Peaks(NamedTuple):
    """Peaks in the order of their places.

    Attributes:
        places: Index of each, the middle of a plateau, ``int64 [n]``.
        prominences: Rise over the higher one of the lowest values to both sides, ``float64 [n]``.
        widths: Width at half the prominence, in samples, ``float64 [n]``.
    """

    places: NDArray[np.int64]
    prominences: NDArray[np.float64]
    widths: NDArray[np.float64]


def prominent_peaks(values: NDArray[np.float64], prominence: float, window: int) -> Peaks:
    """Return the peaks of some prominence.

    Args:
        values: Evenly spaced samples.
        prominence: Least prominence.
        window: Samples, an odd number, about a peak among which its prominence is taken.
    """
    rows = _peaks(np.ascontiguousarray(values, np.float64), prominence, window // 2)
    return Peaks(rows[:, 0].astype(np.int64), rows[:, 1], rows[:, 2])


@njit(cache=True, nogil=True)
def _peaks(values: NDArray[np.float64], least: float, reach: int) -> NDArray[np.float64]:
    count = len(values)
    rows = np.empty((count // 2 + 1, 3))
    found = 0
    i = 1
    while i < count - 1:
        end = i
        while end < count - 1 and values[end + 1] == values[i]:
            end += 1
        if values[i - 1] < values[i] and end < count - 1 and values[end + 1] < values[i]:
            peak = (i + end) // 2
            left, low_left = _foot(values, peak, max(peak - reach, 0), -1)
            right, low_right = _foot(values, peak, min(peak + reach, count - 1), 1)
            height = values[peak] - max(low_left, low_right)
            if height >= least:
                level = values[peak] - 0.5 * height
                rows[found, 0] = peak
                rows[found, 1] = height
                rows[found, 2] = _crossing(values, peak, right, level, 1) - _crossing(
                    values, peak, left, level, -1
                )
                found += 1
        i = end + 1
    return rows[:found]


@njit(cache=True, nogil=True)
def _foot(values: NDArray[np.float64], peak: int, last: int, step: int) -> tuple[int, float]:
    """Return the lowest sample on the way to `last` that comes before a higher one than the peak.

    It is given as its place and its value.
    """
    place, low = peak, values[peak]
    i = peak
    while i != last and values[i + step] <= values[peak]:
        i += step
        if values[i] < low:
            place, low = i, values[i]
    return place, low


@njit(cache=True, nogil=True)
def _crossing(values: NDArray[np.float64], peak: int, foot: int, level: float, step: int) -> float:
    """Return where the samples from the peak to its foot first cross a level, interpolated."""
    i = peak
    while i != foot and values[i] > level:
        i += step
    if values[i] >= level:
        return float(i)
    return float(i - step * (level - values[i]) / (values[i - step] - values[i]))
