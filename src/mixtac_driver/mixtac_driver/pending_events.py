# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Events that wait for their packet, in arrays that are used again and again."""

from __future__ import annotations

import numpy as np

from mixtac_events.arrays import Events


class PendingEvents:
    """A list of events that grows at the end and shrinks at the front.

    Args:
        capacity: Events to make room for at first.
    """

    def __init__(self, capacity: int = 4096) -> None:
        self._count = 0
        self._allocate(capacity)

    def __len__(self) -> int:
        """Return how many events wait."""
        return self._count

    @property
    def events(self) -> Events:
        """The events that wait: views, good until the next call of `append` or `drop`."""
        return self._arrays[: self._count]

    def append(self, events: Events, shift_us: int) -> None:
        """Copy events to the end.

        Args:
            events: Events.
            shift_us: What to add to their times [us].
        """
        count = len(events)
        if not count:
            return
        if self._count + count > len(self._arrays):
            waiting = self.events
            self._allocate(2 * (self._count + count))
            self._copy(waiting, 0)
        start = self._count
        self._copy(events, start)
        self._arrays.t[start : start + count] += shift_us
        self._count = start + count

    def drop(self, count: int) -> None:
        """Forget the first events."""
        rest = self._arrays[count : self._count]
        self._count -= count
        # Overlapping copies are safe in NumPy.
        self._copy(rest, 0)

    def _allocate(self, capacity: int) -> None:
        self._arrays = Events(
            np.empty(capacity, np.int64),
            np.empty(capacity, np.uint16),
            np.empty(capacity, np.uint16),
            np.empty(capacity, np.bool_),
        )

    def _copy(self, events: Events, start: int) -> None:
        end = start + len(events)
        self._arrays.t[start:end] = events.t
        self._arrays.x[start:end] = events.x
        self._arrays.y[start:end] = events.y
        self._arrays.polarity[start:end] = events.polarity
