# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Smoothing of sampled signals, and their prominent peaks.

`smooth_force` is wavelet shrinkage without decimation. Quiet stretches are smoothed over many
samples, so that the slope of the force is known well; a band whose local power stands out of the
noise, as in a tap or a bounce, is kept. All filters are symmetric in time and add no delay.

`prominent_peaks` uses the definitions of `scipy.signal.find_peaks` and `peak_widths`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray


KERNEL_REACH: Final = 4.0
"""Standard deviations at which the kernel ends."""


def gaussian_smooth(values: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """Return samples smoothed by a Gaussian; beyond the ends the last samples go on.

    Args:
        values: Evenly spaced samples, ``float64 [n]``, not empty.
        width: Standard deviation, in samples.
    """
    half = int(KERNEL_REACH * width + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / max(width, 1e-9)) ** 2)
    kernel /= kernel.sum()
    return np.asarray(np.convolve(np.pad(values, half, mode='edge'), kernel, mode='valid'))


SCALES_S: Final = (0.0025, 0.005, 0.010)
"""Standard deviations of the Gaussians between which the bands lie [s]."""
CAUTION: Final = 2.5
"""Noise power counts this many times: power is estimated from few samples."""
_HALF: Final = 200


def noise_std(force_N: NDArray[np.float64]) -> float:
    """Return the standard deviation of the white noise of samples [N], from second differences."""
    second = np.diff(force_N, 2)
    return float(1.4826 * np.median(np.abs(second - np.median(second))) / np.sqrt(6.0))


def smooth_force(force_N: NDArray[np.float64], period_s: float) -> NDArray[np.float64]:
    """Return a force without most of its noise, on the same samples.

    Args:
        force_N: Force [N], ``float64 [n]``, sampled evenly.
        period_s: Time between samples [s].
    """
    power = noise_std(force_N) ** 2
    finer: NDArray[np.float64] = force_N
    impulse = np.eye(1, 2 * _HALF + 1, _HALF)[0]
    kernel = impulse
    kept = np.zeros_like(force_N)
    for scale_s in SCALES_S:
        width = scale_s / period_s
        coarser = gaussian_smooth(force_N, width)
        wider = gaussian_smooth(impulse, width)
        noise = power * float(np.sum((kernel - wider) ** 2))
        band = finer - coarser
        local = gaussian_smooth(band**2, 2.0 * width)
        kept += band * np.clip(1.0 - CAUTION * noise / np.maximum(local, 1e-12), 0.0, 1.0)
        finer, kernel = coarser, wider
    return np.asarray(finer + kept)


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
