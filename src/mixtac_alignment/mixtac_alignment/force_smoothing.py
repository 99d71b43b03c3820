# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Smoothing of the reference force that keeps impacts: wavelet shrinkage without decimation.

Quiet stretches are smoothed over many samples, so that the slope of the force is known well; a band
whose local power stands out of the noise, as in a tap or a bounce, is kept. All filters are
symmetric in time and move nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.gaussian_smoothing import gaussian_smooth

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
