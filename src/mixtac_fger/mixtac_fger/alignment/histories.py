# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Events, frames and force that the alignment keeps, in bounded memory.

Events are counted in bins of 0.5 ms, and kept by image cell and polarity (`EventHistory`,
`EventCounts`, `CellEvents`). Frames are reduced to the log brightness of coarse
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
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.packets import DecodedPacket, SequenceCounter

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

    def lost_near(self, index: int, reach: int) -> bool:
        """Return whether packets were lost within `reach` bins of a bin."""
        return any(first - reach <= index < end + reach for first, end in self.lost)


BATCH: Final = 256
"""Packets that are reduced at once."""
LONGEST_HOLE_US: Final = 3_600_000_000
"""A longer hole in the events is a clock that jumped [us]."""
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
    """Counts the events of a stream, and keeps its latest events by cell.

    Packets are reduced in batches: one by one would take most of the time of an alignment.

    Attributes:
        packets: Follows the packets' numbers.
        restarts: Times the camera clock or its driver started anew, which empties the history.
        dropped: Events by cell that were dropped to make room.

    Args:
        span_s: Time to remember [s].
        most: Events by cell to remember.
    """

    def __init__(self, span_s: float, most: int = MOST_EVENTS) -> None:
        self.packets = SequenceCounter()
        self.restarts = self.dropped = 0
        self._span_us, self._most = round(1e6 * span_s), most
        self._size = (0, 0)
        self._clear()

    def _clear(self) -> None:
        self._batch: list[Events] = []
        self._cells: deque[CellEvents] = deque()
        self._held, self._first, self._end_us = 0, -1, 0
        self._lost: list[tuple[int, int]] = []

    def add(self, packet: DecodedPacket, seq: int, width: int, height: int) -> bool:
        """Add a packet; return whether its clock or its driver has started anew.

        Args:
            packet: The packet.
            seq: Its number.
            width: Columns of the pixel array.
            height: Rows of the pixel array.
        """
        ahead_us, before = packet.start_us - self._end_us, self.packets.restarts
        missing = self.packets.update(seq)
        jumped = self._first >= 0 and not -RESTART_US <= ahead_us <= LONGEST_HOLE_US
        anew = jumped or self.packets.restarts > before
        if anew:
            self.restarts += 1
            self._clear()
        if self._size != (width, height):
            self._reduce()
        self._size = width, height
        if self._first < 0:
            self._first = packet.start_us // BIN_US
        elif missing:
            self._lost.append((self._end_us // BIN_US, packet.start_us // BIN_US + 1))
        self._end_us = max(self._end_us, packet.complete_until)
        if len(packet.events):
            self._batch.append(packet.events)
        if len(self._batch) >= BATCH:
            self._reduce()
        return anew

    def counts(self) -> EventCounts:
        """Return the counts of the bins that are complete, as far back as events are kept."""
        self._reduce()
        end = max(self._end_us // BIN_US, self._first + 1)
        first = max(self._first, end - self._span_us // BIN_US)
        total = np.zeros(end - first, np.int64)
        for part in self._cells:
            bins = part.t_us // BIN_US - first
            bins = bins[(bins >= 0) & (bins < len(total))]
            total += np.bincount(bins, minlength=len(total)) if len(bins) else 0
        lost = tuple((a - first, b - first) for a, b in self._lost if b > first)
        return EventCounts(first * BIN_US, BIN_US, total, lost)

    def events(self) -> CellEvents:
        """Return the latest events by cell, in the order of time."""
        self._reduce()
        parts = self._cells or [by_cell(Events.empty(), *self._size)]
        t_us, cell, on = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ('t_us', 'cell', 'on')
        )
        order = np.argsort(t_us, kind='stable')
        return CellEvents(t_us[order], cell[order], on[order])

    def _reduce(self) -> None:
        if not self._batch:
            return
        events, self._batch = Events.concatenate(self._batch), []
        self._cells.append(by_cell(events, *self._size))
        self._held += len(events)
        oldest_us = self._end_us - self._span_us
        while len(self._cells) > 1 and (
            self._held > self._most or self._cells[0].t_us[-1] < oldest_us
        ):
            part = self._cells.popleft()
            self._held -= len(part.t_us)
            self._first = max(self._first, int(part.t_us[-1]) // BIN_US + 1)
            self.dropped += len(part.t_us) if part.t_us[-1] >= oldest_us else 0


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


class ForceHistory:
    """The latest force samples, with increasing stamps.

    Attributes:
        refused: Samples without a stamp, with an earlier one, or whose force is no number.
        restarts: Times the reference clock went back by more than a second.

    Args:
        span_s: Time to remember [s].
        capacity: Most samples to remember.
    """

    def __init__(self, span_s: float, capacity: int) -> None:
        self.refused = self.restarts = 0
        self._span_ns = round(span_s * 1e9)
        self._samples: deque[tuple[int, tuple[float, float, float]]] = deque(maxlen=capacity)

    def push(self, t_ns: int, force: tuple[float, float, float]) -> bool:
        """Add a sample; return whether it was kept.

        Args:
            t_ns: Stamp, reference clock [ns].
            force: Force (x, y, z) [N].
        """
        samples = self._samples
        sound = t_ns != 0 and bool(np.isfinite(force).all())
        if sound and samples and has_restarted(t_ns, samples[-1][0]):
            self.restarts += 1
            samples.clear()
        # Seconds in float64 hold no less than a microsecond.
        if not sound or (samples and t_ns // 1000 <= samples[-1][0] // 1000):
            self.refused += 1
            return False
        samples.append((t_ns, force))
        return True

    def snapshot(self, axis: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times (reference clock [s]) and forces [N] along an axis, oldest first."""
        t_ns = np.array([t for t, _ in self._samples], np.int64)
        force = np.array([force for _, force in self._samples], np.float64).reshape(-1, 3)
        recent = t_ns >= (t_ns[-1] if len(t_ns) else 0) - self._span_ns
        return t_ns[recent] / 1e9, force[recent, 'xyz'.index(axis)]


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What both clocks recorded; camera times on the camera clock, the others on the reference's.

    Attributes:
        counts: Event counts, with lost packets marked.
        events: Events by cell; the latest ones where there are very many.
        frames: Frames, or None where there are no exposure times.
        force_t_s: Stamps of the reference sensor [s], ``float64 [n]``, increasing.
        force: Its normal force [N], of either sign.
        edges_us: Edges at the camera's synchronisation input, camera clock [us].
        reference_edges_s: The same edges on the reference clock [s].
        all_edges: Whether the first edges of both clocks are the same one, and so on.
        damage: What is missing because the bag is incomplete; empty for a sound one.
    """

    counts: EventCounts
    events: CellEvents
    frames: FrameFeatures | None
    force_t_s: NDArray[np.float64]
    force: NDArray[np.float64]
    edges_us: NDArray[np.int64]
    reference_edges_s: NDArray[np.float64]
    damage: str = ''
    all_edges: bool = False
