# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Smoothing of sampled signals, their prominent peaks, and the sign of a force.

`smooth_force` is wavelet shrinkage without decimation. Quiet stretches are smoothed over many
samples, so that the slope of the force is known well; a band whose local power stands out of the
noise, as in a tap or a bounce, is kept. All filters are symmetric in time and add no delay.

SciPy is imported inside the functions: it takes a second to load, which the commands that do not
align need not wait for. `warm_up` loads it.
"""

from __future__ import annotations

import warnings
from typing import Final

import numpy as np
from numpy.typing import NDArray


def warm_up() -> None:
    """Load what the alignment uses of SciPy, so that the first fit does not wait for it."""
    import scipy.interpolate
    import scipy.ndimage
    import scipy.optimize
    import scipy.signal  # noqa: F401


def gaussian_smooth(values: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """Return samples smoothed by a Gaussian; beyond the ends the last samples go on.

    Args:
        values: Evenly spaced samples, ``float64 [n]``, not empty.
        width: Standard deviation, in samples.
    """
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(values, max(width, 1e-9), mode='nearest'))


SCALES_S: Final = (0.0025, 0.005, 0.010)
"""Standard deviations of the Gaussians between which the bands lie [s]."""
CAUTION: Final = 2.5
"""Factor on the noise power: power is estimated from few samples."""
HALF_KERNEL: Final = 200
"""Samples to both sides of an impulse that show the filters completely."""


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
    impulse = np.eye(1, 2 * HALF_KERNEL + 1, HALF_KERNEL)[0]
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


def even_force(
    t_s: NDArray[np.float64], force_N: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return evenly spaced times [s] within those of the samples, and the smooth force there [N].

    Args:
        t_s: Increasing sample times [s], ``float64 [n]``, small numbers.
        force_N: Force [N], ``float64 [n]``.
    """
    period = float(np.median(np.diff(t_s)))
    even = np.arange(t_s[0], t_s[-1], period)
    return even, smooth_force(np.interp(even, t_s, force_N), period)


def pressing_sign(force_N: NDArray[np.float64]) -> float:
    """Return the sign that makes pressing positive: 1 or -1."""
    relative = force_N - np.median(force_N)
    return 1.0 if relative.max() >= -relative.min() else -1.0


def prominent_peaks(
    values: NDArray[np.float64], prominence: float, window: int
) -> list[tuple[int, float, float]]:
    """Return place, prominence and width at half the prominence of peaks [samples].

    The place of a plateau is its middle.

    Args:
        values: Evenly spaced samples.
        prominence: Least prominence.
        window: Samples, an odd number, about a peak among which its prominence is taken.
    """
    from scipy.signal import find_peaks

    with warnings.catch_warnings():
        # SciPy warns of peaks without prominence before it leaves them out.
        warnings.simplefilter('ignore', RuntimeWarning)
        places, found = find_peaks(values, prominence=prominence, width=0.0, wlen=window)
    sizes = found['prominences'].tolist(), found['widths'].tolist()
    return list(zip(places.tolist(), *sizes, strict=True))
