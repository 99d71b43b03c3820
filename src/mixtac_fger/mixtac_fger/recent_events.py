# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What `validity` remembers of a stream: the latest windows, and what is known again.

An event is kept as one integer, so that compiled code takes one array, and two events are compared
at once. From the lowest bit on it holds the polarity, the column, the row and the low 31 bits of
the time [us]. All memory is bounded.
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_events.arrays import Events

KEPT_US = 500_000
"""Time, at least, whose events are kept for the next frame [us]."""
MOST_PER_MS = 2048
"""Events of a window that are kept [1/ms]: in twice a blow nobody looks at more."""
SPARSE = 8
"""Slots, at least, per mark that is remembered: one in eight at most is forgotten early."""

Packed = NDArray[np.int64]
"""Events, each as one integer; int64 [n]."""
COLUMN_BIT, ROW_BIT, TIME_BIT = 1, 17, 33
COORDINATE, PLACE, TIME = 2**16 - 1, 2**TIME_BIT - 1, 2**31 - 1
"""Masks: of a coordinate, of row, column and polarity together, and of a time."""


@njit(cache=True, nogil=True)
def pack(
    t: NDArray[np.int64],
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.bool_],
    out: Packed,
) -> None:
    """Write the first events, as many as there is room for.

    Args:
        t: Times [us], int64 [n].
        x: Columns, uint16 [n].
        y: Rows, uint16 [n].
        polarity: True where brighter, bool [n].
        out: int64 [n] at most.
    """
    for index in range(out.shape[0]):
        place = (np.int64(y[index]) << ROW_BIT) | (np.int64(x[index]) << COLUMN_BIT)
        out[index] = (t[index] << TIME_BIT) | place | np.int64(polarity[index])


@njit(cache=True, nogil=True)
def column_of(event: int) -> int:
    """Return the column of a packed event."""
    return (event >> COLUMN_BIT) & COORDINATE


@njit(cache=True, nogil=True)
def row_of(event: int) -> int:
    """Return the row of a packed event."""
    return (event >> ROW_BIT) & COORDINATE


@njit(cache=True, nogil=True)
def inverse_of(size: int) -> int:
    """Return what `bin_of` multiplies by: divisions are what takes longest."""
    return 2**32 // size + 1


@njit(cache=True, nogil=True)
def bin_of(coordinate: int, inverse: int) -> int:
    """Return the bin of a coordinate below 2^16, of bins of the size of an inverse."""
    return (coordinate * inverse) >> 32


def packed(events: Events) -> Packed:
    """Return events, each as one integer."""
    out = np.empty(len(events), np.int64)
    pack(events.t, events.x, events.y, events.polarity, out)
    return out


@njit(cache=True, nogil=True)
def count_known(
    marks: NDArray[np.uint64],
    keys: NDArray[np.uint64],
    latest: NDArray[np.int64],
    number: int,
    most: int,
) -> int:
    """Count the marks of a group that one of the groups before it had, and remember them.

    Args:
        marks: Of this group, uint64 [n].
        keys: Mark of each slot, uint64 [2^k]; changed in place.
        latest: Number of the latest group with that mark, int64 [2^k]; changed in place.
        number: Number of this group.
        most: Groups that are remembered.
    """
    known = 0
    for mark in marks:
        slot = mark & np.uint64(keys.shape[0] - 1)
        known += keys[slot] == mark and number - most <= latest[slot] < number
        keys[slot], latest[slot] = mark, number
    return known


class Known:
    """Marks by which the latest frames, or stretches of events, are known again.

    Each mark has one slot, so that of two with the same slot the earlier one is forgotten.

    Args:
        most: Number of frames or stretches that are remembered.
        marks: Marks that each of them has at most.
    """

    def __init__(self, most: int, marks: int) -> None:
        self._most, self._number = most, 0
        slots = 1 << (SPARSE * most * marks - 1).bit_length()
        self._keys = np.zeros(slots, np.uint64)
        self._latest = np.full(slots, -most, np.int64)

    def add(self, marks: NDArray[np.uint64]) -> int:
        """Add the marks of the next one, uint64 [n]; return how many were known before."""
        self._number += 1
        return count_known(  # type: ignore[no-any-return]
            marks, self._keys, self._latest, self._number, self._most
        )


class RecentWindows:
    """The latest windows, in order.

    Args:
        window_us: Length of a window [us].

    Attributes:
        ends_us: Their ends.
        numbers: The numbers of their events.
        most: Number of events of a window that are kept.
    """

    def __init__(self, window_us: int) -> None:
        self.most = max(MOST_PER_MS * window_us // 1000, 1)
        self._kept = -(-KEPT_US // window_us)
        self._events = np.empty(2 * self._kept * self.most, np.int64)
        self.clear()

    def clear(self) -> None:
        """Forget all windows."""
        self.ends_us: list[int] = []
        self.numbers: list[int] = []
        self._starts = [0]

    def add(self, end_us: int, events: Events) -> None:
        """Add the next window; its events are copied.

        Args:
            end_us: Its end, camera clock [us].
            events: Its events.
        """
        if len(self.numbers) == 2 * self._kept:
            self._forget_first(self._kept)
        number, start = events.t.shape[0], self._starts[-1]
        stop = start + min(number, self.most)
        self.ends_us.append(end_us)
        self.numbers.append(number)
        self._starts.append(stop)
        # In one place, so that no later step has to put windows together.
        pack(events.t, events.x, events.y, events.polarity, self._events[start:stop])

    def events(self, chosen: slice) -> Packed:
        """Return the events of windows, as a view; of each the first `most`."""
        return self._events[self._starts[chosen.start] : self._starts[chosen.stop]]

    def latest(self, count: int) -> slice:
        """Return the last windows."""
        return slice(len(self.numbers) - count, len(self.numbers))

    def between(self, start_us: int, end_us: int) -> slice:
        """Return which windows end after a time, and not after another."""
        return slice(bisect_right(self.ends_us, start_us), bisect_right(self.ends_us, end_us))

    def _forget_first(self, count: int) -> None:
        kept = self._events[self._starts[count] : self._starts[-1]].copy()
        self._events[: len(kept)] = kept
        self._starts = [start - self._starts[count] for start in self._starts[count:]]
        del self.ends_us[:count], self.numbers[:count]


def warm_up() -> None:
    """Compile what a stretch needs, so that the first one is not late."""
    packed(Events.empty())
    Known(1, 1).add(np.zeros(1, np.uint64))
