# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Cutting an event stream into windows of equal width, live or recorded.

Window k covers ``[k * width, (k + 1) * width)`` on the camera clock; it is labelled with its end.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events

RESTART_US: Final = 1_000_000
"""A larger step back in time [us] is a clock that was reset, not a late packet."""
MOST_HELD: Final = 1 << 22
"""Events of windows that do not close, beyond which they are dropped: time stands still."""


class WindowSlicer:
    """Cuts a live stream into windows and closes each as soon as it is known to be complete.

    The first window begins on the grid before the first time, so it may be incomplete. Only the
    events of open windows are kept. One push returns at most `max_empty_run` empty windows, the
    latest ones, which bounds its work after a gap; windows with events are never skipped.

    Attributes:
        width_us: Width of a window [us].
        late_events: Events dropped because their window had been closed, or did not close.

    Args:
        width_us: Width of a window [us], positive.
        max_empty_run: Most empty windows returned by one push, positive.
    """

    def __init__(self, width_us: int, *, max_empty_run: int = 500) -> None:
        self.width_us = int(width_us)
        self.late_events = 0
        self._max_empty_run = max_empty_run
        self._next: int | None = None
        self._pending: list[Events] = []

    def push(self, events: Events, complete_until: int) -> list[tuple[int, Events]]:
        """Add events and return the windows that can now be closed, in order.

        Args:
            events: The next events of the stream, camera clock; may be empty.
            complete_until: Camera clock [us]: no event before this time will follow.

        Returns:
            (end [us], events) of each closed window.
        """
        first = int(events.t[0]) if len(events) else complete_until
        following = self._begin(min(first, complete_until))
        fresh = self._in_time(events, following * self.width_us)
        if len(fresh):
            held_before = sum(map(len, self._pending))
            if held_before > MOST_HELD:
                self.late_events += held_before
                self._pending = []
            self._pending.append(fresh)
        closed = complete_until // self.width_us
        if closed <= following:
            return []
        held = Events.concatenate(self._pending)
        if not _ordered(held.t):
            held = held[np.argsort(held.t, kind='stable')]
        self._next = closed
        begin, parts = 0, []
        for index in self._occupied_or_near(held, following, closed):
            end_us = (index + 1) * self.width_us
            end = int(held.t.searchsorted(end_us))
            parts.append((end_us, held[begin:end]))
            begin = end
        self._pending = [held[begin:]] if begin < len(held) else []
        return parts

    @property
    def open_end_us(self) -> int:
        """End of the window that closes next, camera clock [us]; only after a push."""
        assert self._next is not None  # noqa: S101  (a push sets it)
        return (self._next + 1) * self.width_us

    def reset(self) -> None:
        """Discard open windows; the next push starts a new stream."""
        self._pending = []
        self._next = None

    def _begin(self, t_us: int) -> int:
        """Return the index of the first open window; restart after a step back in time."""
        if self._next is not None and t_us < self._next * self.width_us - RESTART_US:
            self.reset()
        if self._next is None:
            self._next = t_us // self.width_us
        return self._next

    def _in_time(self, events: Events, start_us: int) -> Events:
        if len(events) == 0 or (events.t[0] >= start_us and _ordered(events.t)):
            return events
        keep = events.t >= start_us
        self.late_events += len(events) - int(np.count_nonzero(keep))
        return events[keep]

    def _occupied_or_near(self, held: Events, first: int, end: int) -> list[int]:
        """Return the windows in ``[first, end)`` to close: all with events, the latest without."""
        run = self._max_empty_run
        if end - first <= run:
            return list(range(first, end))
        indices = held.t // self.width_us
        occupied = np.unique(indices[indices < end])
        near = np.arange(max(first, end - len(occupied) - run), end)
        empty = np.setdiff1d(near, occupied, assume_unique=True)[-run:]
        return [int(each) for each in np.sort(np.concatenate([occupied, empty]))]


@njit(cache=True, nogil=True)
def _ordered(t: NDArray[np.int64]) -> bool:
    for index in range(1, len(t)):  # noqa: SIM110 - numba has no all()
        if t[index] < t[index - 1]:
            return False
    return True
