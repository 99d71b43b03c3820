# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Smoothing with a Gaussian, symmetric in time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

REACH: Final = 4.0
"""Standard deviations at which the kernel ends."""


def gaussian_smooth(values: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """Return samples smoothed by a Gaussian; beyond the ends the last samples go on.

    Args:
        values: Evenly spaced samples, ``float64 [n]``, not empty.
        width: Standard deviation, in samples.
    """
    half = int(REACH * width + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / max(width, 1e-9)) ** 2)
    kernel /= kernel.sum()
    return np.asarray(np.convolve(np.pad(values, half, mode='edge'), kernel, mode='valid'))
