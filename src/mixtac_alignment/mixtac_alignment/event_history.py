# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The events of the recent past by time, cell of the image and polarity, in bounded memory."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.frame_features import CELL_PX

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events

MOST_EVENTS: Final = 8_000_000
"""Events that are kept, 11 bytes each: a minute of ordinary contact."""
OUTSIDE: Final = 65_535
"""Cell of events beyond the last whole cell."""


@dataclass(frozen=True, slots=True, eq=False)
class CellEvents:
    """Events by cell, in the order of time.

    Attributes:
        t_us: Times, camera clock [us], ``int64 [n]``.
        cell: Number of the cell as in `frame_features.reduce_frame`, ``uint16 [n]``.
        on: Whether the pixel became brighter, ``bool [n]``.
    """

    t_us: NDArray[np.int64]
    cell: NDArray[np.uint16]
    on: NDArray[np.bool_]

    def between(self, start_us: int, end_us: int) -> CellEvents:
        """Return the events from start to end, camera clock [us]."""
        a, b = np.searchsorted(self.t_us, (start_us, end_us))
        return CellEvents(self.t_us[a:b], self.cell[a:b], self.on[a:b])

    @property
    def start_us(self) -> int:
        """Return the time of the first event [us]; 0 without events."""
        return int(self.t_us[0]) if len(self.t_us) else 0


def by_cell(events: Events, width: int, height: int) -> CellEvents:
    """Return events by cell.

    Args:
        events: Events, camera clock.
        width: Columns of the pixel array.
        height: Rows of the pixel array.
    """
    columns, rows = width // CELL_PX, height // CELL_PX
    x, y = events.x // CELL_PX, events.y // CELL_PX
    cell = np.where((x < columns) & (y < rows), y * np.uint16(columns) + x, OUTSIDE)
    return CellEvents(events.t.astype(np.int64), cell.astype(np.uint16), events.polarity)


class EventHistory:
    """Keeps the events of a stream by cell, dropping the oldest.

    Attributes:
        dropped: Events that were dropped to make room.

    Args:
        span_s: Time to remember [s].
        most: Events to remember.
    """

    def __init__(self, span_s: float, most: int = MOST_EVENTS) -> None:
        self.dropped = 0
        self._span_us = round(1e6 * span_s)
        self._most = most
        self._parts: deque[CellEvents] = deque()
        self._held = 0

    def push(self, part: CellEvents) -> None:
        """Add the events of a packet; times that step back start anew."""
        if not len(part.t_us):
            return
        if self._parts and part.t_us[0] < self._parts[-1].t_us[-1] - 1_000_000:
            self.clear()
        self._parts.append(part)
        self._held += len(part.t_us)
        while self._held > self._most:
            self.dropped += self._forget()
        while self._parts[0].t_us[-1] < part.t_us[-1] - self._span_us:
            self._forget()

    def clear(self) -> None:
        """Forget everything."""
        self._parts.clear()
        self._held = 0

    def snapshot(self) -> CellEvents:
        """Return what is remembered, a copy in the order of time."""
        if not self._parts:
            return CellEvents(np.zeros(0, np.int64), np.zeros(0, np.uint16), np.zeros(0, np.bool_))
        t_us = np.concatenate([part.t_us for part in self._parts])
        cell = np.concatenate([part.cell for part in self._parts])
        on = np.concatenate([part.on for part in self._parts])
        if np.any(np.diff(t_us) < 0):
            order = np.argsort(t_us, kind='stable')
            t_us, cell, on = t_us[order], cell[order], on[order]
        return CellEvents(t_us, cell, on)

    def _forget(self) -> int:
        oldest = len(self._parts.popleft().t_us)
        self._held -= oldest
        return oldest
