# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The event rate of the recent past in fixed memory, and recorded event counts."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numba import njit

from mixtac_alignment.errors import AlignmentError
from mixtac_events.windows import counts_per_window

if TYPE_CHECKING:
    from numpy.typing import NDArray

BIN_US: Final = 500
"""Width of a bin: bursts of an impulse last 2 to 20 ms."""
LONGEST_GAP_US: Final = 1_000_000
"""A step back of the stream beyond this is a restarted clock."""


@dataclass(frozen=True, slots=True, eq=False)
class EventCounts:
    """Event counts in equal, adjoining bins.

    Attributes:
        start_us: Start of the first bin, camera clock [us].
        width_us: Width of a bin [us].
        counts: Events per bin, ``int64 [N]``.
        lost: Ranges of bins (first, end) in which packets were lost.
    """

    start_us: int
    width_us: int
    counts: NDArray[np.int64]
    lost: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, t_us: NDArray[np.int64], width_us: int = BIN_US) -> EventCounts:
        """Count recorded events.

        Args:
            t_us: Event times, camera clock [us], any order, not empty.
            width_us: Width of a bin [us].

        Raises:
            AlignmentError: No events.
        """
        if len(t_us) == 0:
            raise AlignmentError('no events recorded: check that the camera sees light and motion')
        start = int(t_us.min())
        end = start + (int(t_us.max()) - start) // width_us * width_us + width_us
        return cls(start, width_us, counts_per_window(t_us, start, end, width_us))

    def lost_near(self, index: int, reach: int) -> bool:
        """Return whether packets were lost within `reach` bins of a bin."""
        return any(first - reach <= index < end + reach for first, end in self.lost)


class EventRateHistory:
    """Counts a live stream into a ring of bins, instead of keeping its events.

    Attributes:
        restarts: Times the clock of the stream jumped back.

    Args:
        span_s: Time to remember [s].
        width_us: Width of a bin [us].
    """

    def __init__(self, span_s: float, width_us: int = BIN_US) -> None:
        self.restarts = 0
        self._width_us = width_us
        self._ring = np.zeros(max(16, round(span_s * 1e6 / width_us)), np.int64)
        self._lost: deque[tuple[int, int]] = deque(maxlen=1000)
        self._first = self._end = self._complete = 0

    def push(self, t_us: NDArray[np.int64], complete_until: int) -> None:
        """Add the events of a packet.

        Args:
            t_us: Event times, camera clock [us].
            complete_until: Camera clock [us]: no event before this time will follow.
        """
        complete = complete_until // self._width_us
        if self._end == 0 or complete < self._complete - LONGEST_GAP_US // self._width_us:
            self._restart(complete_until if len(t_us) == 0 else int(t_us[0]))
        newest = max(complete, int(t_us.max()) // self._width_us if len(t_us) else complete)
        self._extend(newest + 1)
        _count(np.ascontiguousarray(t_us, np.int64), self._width_us, self._first, self._ring)
        self._complete = max(self._complete, complete)

    def mark_lost(self, until_us: int) -> None:
        """Note that packets between the latest complete time and `until_us` never came."""
        self._lost.append((self._complete, until_us // self._width_us + 1))

    def snapshot(self) -> EventCounts:
        """Return the complete bins, a copy."""
        bins = np.arange(self._first, max(self._first, self._complete))
        lost = tuple((a - self._first, b - self._first) for a, b in self._lost if b > self._first)
        return EventCounts(
            self._first * self._width_us, self._width_us, self._ring[bins % len(self._ring)], lost
        )

    def clear(self) -> None:
        """Forget everything."""
        self._first = self._end = self._complete = 0
        self._lost.clear()

    def _restart(self, t_us: int) -> None:
        self.restarts += self._end != 0
        self.clear()
        self._first = self._complete = t_us // self._width_us
        self._end = self._first

    def _extend(self, end: int) -> None:
        """Make room for bins up to `end`, dropping the oldest."""
        size = len(self._ring)
        if end > self._end:
            fresh = np.arange(max(self._end, end - size), end)
            self._ring[fresh % size] = 0
            self._end = end
            self._first = max(self._first, end - size)


@njit(cache=True, nogil=True)
def _count(t: NDArray[np.int64], width_us: int, first: int, ring: NDArray[np.int64]) -> None:
    for now in t:
        index = now // width_us
        if index >= first:
            ring[index % len(ring)] += 1
