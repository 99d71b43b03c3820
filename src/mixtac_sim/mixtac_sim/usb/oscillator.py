# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera's own clock: it runs a little fast or slow and starts at zero on a reset."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Oscillator:
    """Maps true time to the camera clock.

    Both are int64 microseconds; true time counts from the construction of the device on the
    host's monotonic clock, camera time from the last timestamp reset.

    Args:
        skew_ppm: How much faster than true time the camera counts [1e-6], kept to 1e-9.
    """

    def __init__(self, skew_ppm: float) -> None:
        self._skew_ppb = round(skew_ppm * 1000)
        self.origin_us = 0

    def reset(self, true_us: int) -> None:
        """Let camera time be zero at this true time."""
        self.origin_us = true_us

    def to_camera(self, true_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert true times [us, int64 array] to camera time, rounded down to whole us."""
        elapsed = true_us - np.int64(self.origin_us)
        drift = elapsed * self._skew_ppb // 1_000_000_000
        return np.asarray(elapsed + drift, np.int64)

    def now(self, true_us: int) -> int:
        """Convert one true time [us] to camera time [us]."""
        return int(self.to_camera(np.array([true_us], np.int64))[0])
