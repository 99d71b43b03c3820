# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Samples on their way to a plot: bounded, thinned without losing peaks, counted."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

Columns = tuple[NDArray[np.int64], NDArray[np.float64]]


class Curve:
    """Keeps the samples of one plotted line until they are taken.

    One thread adds, another takes.

    Args:
        capacity: Samples that are kept; when nobody takes them, further ones are counted as lost.

    Attributes:
        received: All samples so far.
        dropped: Those that found no room.
        latest: The last value, NaN before the first.
    """

    def __init__(self, capacity: int = 4000) -> None:
        self.received = 0
        self.dropped = 0
        self.latest = float('nan')
        self._time_ns = np.zeros(capacity, np.int64)
        self._value = np.zeros(capacity)
        self._count = 0
        self._lock = threading.Lock()

    def add(self, time_ns: int, value: float) -> None:
        """Keep a sample.

        Args:
            time_ns: Where it stands in the plot [ns].
            value: What is plotted.
        """
        self.received += 1
        self.latest = value
        with self._lock:
            i = self._count
            if i == len(self._value):
                self.dropped += 1
                return
            self._time_ns[i] = time_ns
            self._value[i] = value
            self._count = i + 1

    def take(self, most: int) -> Columns:
        """Return times [ns] and values since the last call, at most `most` of them.

        Of each group of neighbours the one farthest from their mean stays, so that a peak is never
        thinned away.
        """
        with self._lock:
            n = self._count
            times, values = self._time_ns[:n].copy(), self._value[:n].copy()
            self._count = 0
        return thinned(times, values, most)


def thinned(times: NDArray[np.int64], values: NDArray[np.float64], most: int) -> Columns:
    """Return at most `most` of the samples, keeping the extreme one of each group.

    Args:
        times: Times [ns].
        values: Values at these.
        most: Largest number of samples to return, at least 1.
    """
    n = len(values)
    if n <= most:
        return times, values
    starts = np.linspace(0, n, most + 1).astype(np.intp)[:-1]
    lengths = np.diff(np.append(starts, n))
    means = np.add.reduceat(values, starts) / lengths
    distance = np.abs(values - np.repeat(means, lengths))
    # Stable order by group, then by distance: the last of each group is its farthest.
    group = np.repeat(np.arange(most), lengths)
    kept = np.lexsort((distance, group))[np.append(starts[1:], n) - 1]
    return times[kept], values[kept]
