# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What `validity` remembers of a stream: the latest windows, and what is known again.

All memory is bounded.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

from mixtac_events.arrays import Events

KEPT_US = 500_000
"""Time, at least, whose events are kept for the next frame [us]."""
MOST_PER_MS = 2048
"""Events of a window that are kept [1/ms]: in twice a blow nobody looks at more."""


class Known:
    """What the latest frames, or stretches of events, were known by.

    Args:
        most: Number of those that are remembered.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._groups: deque[frozenset[int]] = deque()
        self._latest: dict[int, int] = {}
        self._number = 0

    def add(self, group: frozenset[int]) -> int:
        """Add what the next one is known by; return how much of it was known before."""
        known = len(group & self._latest.keys())
        self._number += 1
        self._latest.update(dict.fromkeys(group, self._number))
        self._groups.append(group)
        if len(self._groups) > self._most:
            for each in self._groups.popleft():
                # What came again since is still known.
                if self._latest[each] <= self._number - self._most:
                    del self._latest[each]
        return known


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
        self._events = Events.empty(2 * self._kept * self.most)
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
        number = events.t.shape[0]
        self.ends_us.append(end_us)
        self.numbers.append(number)
        if number > self.most:
            events, number = events[: self.most], self.most
        start, room = self._starts[-1], self._events
        self._starts.append(start + number)
        # In one place, so that no later step has to put windows together.
        into = slice(start, start + number)
        room.t[into], room.x[into], room.y[into] = events.t, events.x, events.y
        room.polarity[into] = events.polarity

    def events(self, chosen: slice) -> Events:
        """Return the events of windows, as views; of each the first `most`."""
        return self._events[self._starts[chosen.start] : self._starts[chosen.stop]]

    def latest(self, count: int) -> slice:
        """Return the last windows."""
        return slice(len(self.numbers) - count, len(self.numbers))

    def between(self, start_us: int, end_us: int) -> slice:
        """Return which windows end after a time, and not after another."""
        return slice(bisect_right(self.ends_us, start_us), bisect_right(self.ends_us, end_us))

    def _forget_first(self, count: int) -> None:
        kept = self._events[self._starts[count] : self._starts[-1]].copy()
        for name in ('t', 'x', 'y', 'polarity'):
            getattr(self._events, name)[: len(kept)] = getattr(kept, name)
        self._starts = [start - self._starts[count] for start in self._starts[count:]]
        del self.ends_us[:count], self.numbers[:count]
