# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rates and ages over the recent past, in fixed memory, for diagnostics."""

from __future__ import annotations

import numpy as np


class RateMeter:
    """Events per second over the interval between two reads.

    Attributes:
        total: Everything counted so far.
    """

    def __init__(self) -> None:
        self.total = 0
        self._last_total = 0
        self._last_s: float | None = None

    def add(self, count: int = 1) -> None:
        """Count `count` more."""
        self.total += count

    def read(self, now_s: float) -> float:
        """Return the rate [1/s] since the previous read; 0 at the first one.

        Args:
            now_s: Any monotonic time [s].
        """
        last_s, self._last_s = self._last_s, now_s
        count, self._last_total = self.total - self._last_total, self.total
        if last_s is None or now_s <= last_s:
            return 0.0
        return count / (now_s - last_s)


class RecentValues:
    """A ring of the latest values (ages, durations) with their quantiles.

    Args:
        size: Number of values kept.
    """

    def __init__(self, size: int = 1024) -> None:
        self._ring = np.zeros(size)
        self._count = 0

    def add(self, value: float) -> None:
        """Append a value, dropping the oldest."""
        self._ring[self._count % len(self._ring)] = value
        self._count += 1

    def __len__(self) -> int:
        """Return the number of values held."""
        return min(self._count, len(self._ring))

    def quantile(self, q: float) -> float:
        """Return a quantile of the values held, NaN when there are none."""
        held = len(self)
        return float(np.quantile(self._ring[:held], q)) if held else float('nan')
