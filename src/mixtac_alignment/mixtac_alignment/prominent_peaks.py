# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Peaks by their prominence."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from scipy.signal import find_peaks

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def prominent_peaks(
    values: NDArray[np.float64], prominence: float, window: int
) -> tuple[NDArray[np.int64], dict[str, Any]]:
    """Return the places of peaks and their properties; see `scipy.signal.find_peaks`.

    Args:
        values: Evenly spaced samples.
        prominence: Least prominence.
        window: Samples among which the prominence is taken.
    """
    with warnings.catch_warnings():
        # Plateaus wider than the window have no prominence, and are no peaks.
        warnings.filterwarnings('ignore', 'some peaks have a prominence of 0', RuntimeWarning)
        places, found = find_peaks(values, prominence=prominence, wlen=window)
    return places, found
