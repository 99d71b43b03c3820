# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the alignment remembers of events, frames and force, in bounded memory.

Events are kept twice: counted in bins of 0.5 ms (`EventRateHistory`, `EventCounts`), and by image
cell and polarity (`EventHistory`, `CellEvents`). Frames are reduced to the log brightness of coarse
cells and joined with their exposure times (`FrameHistory`, `FrameFeatures`): a frame shows the
deformation of the gel averaged over its exposure, whose times the camera gives exactly, without the
latency of the event pixels. `ForceHistory` holds samples of the reference force.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_alignment.errors import AlignmentError
from mixtac_events.arrays import Events
from mixtac_events.windows import counts_per_window

CELL_PX: Final = 10
"""Side of a cell: several beads wide at most, so that motion of a part of a pixel shows."""
DARK: Final = 0.008
"""Part of the full scale that is added before the logarithm, so that dark cells do not count."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameFeatures:
    """Frames of a recording, camera clock.

    Attributes:
        start_us: Start of each exposure, camera clock [us], ``int64 [n]``, increasing.
        end_us: End of each exposure, camera clock [us], ``int64 [n]``.
        values: Log brightness of the cells, ``float32 [n, cells]``.
    """

    start_us: NDArray[np.int64]
    end_us: NDArray[np.int64]
    values: NDArray[np.float32]

    def __post_init__(self) -> None:
        """Refuse arrays that do not pair up.

        Raises:
            AlignmentError: As above, or exposures that end before they begin.
        """
        n = len(self.start_us)
        if self.end_us.shape != (n,) or self.values.ndim != 2 or len(self.values) != n:
            raise AlignmentError(
                f'{n} exposure starts, {len(self.end_us)} ends and {len(self.values)} frames: give '
                'one of each per frame'
            )
        if n and not (np.all(self.end_us > self.start_us) and np.all(np.diff(self.start_us) > 0)):
            raise AlignmentError('exposure times do not increase: sort the frames, drop repeats')


def reduce_frame(image: NDArray[Any], full_scale: float) -> NDArray[np.float32]:
    """Return the log brightness of the cells of an image, ``float32 [cells]``.

    Args:
        image: Intensity, any integer type, ``[rows, columns]``.
        full_scale: Value of white.
    """
    rows, columns = (size // CELL_PX for size in image.shape)
    cells = image[: rows * CELL_PX, : columns * CELL_PX].reshape(rows, CELL_PX, columns, CELL_PX)
    means = cells.mean(axis=(1, 3), dtype=np.float32).ravel()
    return np.asarray(np.log(means / np.float32(full_scale) + np.float32(DARK)), np.float32)


BIN_US: Final = 500
"""Width of a bin [us]: bursts of an impulse last 2 to 20 ms."""
RESTART_US: Final = 1_000_000
"""A larger step back of a clock is a restart of it [us]."""


def has_restarted(stamp_ns: int, newest_ns: int) -> bool:
    """Return whether a clock has restarted between two stamps [ns]."""
    return stamp_ns < newest_ns - 1000 * RESTART_US


def follow_stamps(queues: Iterable[Any], stamp_ns: int, newest_ns: int) -> int:
    """Empty what waits to be paired where its clock has restarted; return the newest stamp [ns].

    What waits is of the clock before, and would push out all that is new.

    Args:
        queues: Those of a synchroniser of `message_filters`.
        stamp_ns: Stamp of a message that has just come.
        newest_ns: That of the one before.
    """
    if has_restarted(stamp_ns, newest_ns):
        for queue in queues:
            queue.clear()
    return stamp_ns


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
        if self._end == 0 or complete < self._complete - RESTART_US // self._width_us:
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

    def _restart(self, t_us: int) -> None:
        self.restarts += self._end != 0
        self._lost.clear()
        self._first = self._end = self._complete = t_us // self._width_us

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


MOST_EVENTS: Final = 8_000_000
"""Events that are kept, 11 bytes each: a minute of ordinary contact."""
OUTSIDE: Final = 65_535
"""Cell of events beyond the last whole cell."""


@dataclass(frozen=True, slots=True, eq=False)
class CellEvents:
    """Events by cell, in the order of time.

    Attributes:
        t_us: Times, camera clock [us], ``int64 [n]``.
        cell: Number of the cell as in `reduce_frame`, ``uint16 [n]``.
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
    cell = np.where((x < columns) & (y < rows), y * np.uint32(columns) + x, OUTSIDE)
    cell = np.minimum(cell, OUTSIDE).astype(np.uint16)
    return CellEvents(events.t.astype(np.int64), cell, events.polarity)


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
        """Add the events of a packet; times that step back restart the history."""
        if not len(part.t_us):
            return
        if self._parts and part.t_us[0] < self._parts[-1].t_us[-1] - RESTART_US:
            self._parts.clear()
            self._held = 0
        self._parts.append(part)
        self._held += len(part.t_us)
        while self._held > self._most and len(self._parts) > 1:
            self.dropped += self._forget()
        while self._parts[0].t_us[-1] < part.t_us[-1] - self._span_us:
            self._forget()

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


FRAMES_PER_S: Final = 60
"""Most frames a second that are remembered."""


class FrameHistory:
    """Frames of the last minutes, with the time of their exposure.

    Args:
        span_s: Time to remember [s].
    """

    def __init__(self, span_s: float) -> None:
        self._span_us = round(span_s * 1e6)
        self._frames: deque[tuple[int, int, NDArray[np.float32]]] = deque(
            maxlen=max(16, round(span_s * FRAMES_PER_S))
        )

    def push(self, start_us: int, end_us: int, values: NDArray[np.float32]) -> None:
        """Add a frame; an earlier exposure, or another size, restarts the history.

        An image that is smaller than a cell shows nothing and is left out, and so is one whose
        exposure has no length: its times are missing.

        Args:
            start_us: Start of the exposure, camera clock [us].
            end_us: Its end.
            values: Log brightness, as `reduce_frame` gives it.
        """
        if not values.size or start_us >= end_us:
            return
        if self._frames:
            before_us, _, before = self._frames[-1]
            if start_us <= before_us or values.shape != before.shape:
                self._frames.clear()
        self._frames.append((start_us, end_us, values))

    def snapshot(self) -> FrameFeatures | None:
        """Return the frames, oldest first; none if there are none."""
        if not self._frames:
            return None
        oldest = self._frames[-1][0] - self._span_us
        rows = [row for row in self._frames if row[0] >= oldest]
        start, end = (np.array([row[k] for row in rows], np.int64) for k in (0, 1))
        return FrameFeatures(start, end, np.stack([row[2] for row in rows]))


MOST_REFUSED: Final = 20
"""Samples in a row with an earlier stamp; from then on the clock was set back."""


FINEST_NS: Final = 1000
"""Stamps that are nearer to each other than this are one: seconds in float64 hold no less."""


class ForceHistory:
    """A ring of force samples with increasing stamps.

    Attributes:
        out_of_order: Samples dropped because they had no stamp (0), it did not increase by a
            microsecond, or their force was no number.
        restarts: Times the reference clock jumped back: by more than a second, or for good.
        dropped: Samples that were dropped to make room.

    Args:
        span_s: Time to remember [s].
        capacity: Most samples to remember.
    """

    def __init__(self, span_s: float, capacity: int) -> None:
        self.out_of_order = 0
        self.restarts = 0
        self.dropped = 0
        self._span_ns = round(span_s * 1e9)
        self._t_ns = np.zeros(capacity, np.int64)
        self._force = np.zeros((capacity, 3))
        self._count = self._refused = 0

    def push(self, t_ns: int, force: tuple[float, float, float]) -> bool:
        """Add a sample; return whether it was taken.

        Args:
            t_ns: Stamp, reference clock [ns].
            force: Force (x, y, z) [N].
        """
        late_ns = (
            self._t_ns[(self._count - 1) % len(self._t_ns)] - t_ns if self._count else -FINEST_NS
        )
        sound = t_ns != 0 and bool(np.isfinite(force).all())
        self._refused += sound and late_ns > 0
        restarted = late_ns > 1000 * RESTART_US or self._refused > MOST_REFUSED
        if not sound or (late_ns > -FINEST_NS and not restarted):
            self.out_of_order += 1
            return False
        if late_ns >= 0:
            self.restarts += 1
            self._count = 0
        self._refused = 0
        slot = self._count % len(self._t_ns)
        if self._count >= len(self._t_ns) and self._t_ns[slot] >= t_ns - self._span_ns:
            self.dropped += 1
        self._t_ns[slot] = t_ns
        self._force[slot] = force
        self._count += 1
        return True

    def snapshot(self, axis: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times (reference clock [s]) and forces [N] along an axis, oldest first."""
        size = len(self._t_ns)
        slots = np.arange(max(0, self._count - size), self._count) % size
        t_ns = self._t_ns[slots]
        recent = slots[t_ns >= t_ns[-1] - self._span_ns] if len(t_ns) else slots
        seconds = np.asarray(self._t_ns[recent] / 1e9, np.float64)
        return seconds, np.asarray(self._force[recent, 'xyz'.index(axis)])
