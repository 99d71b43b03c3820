# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Events, frames and force that the alignment keeps, in bounded memory.

Events are kept by image cell and polarity, and counted in bins of 0.5 ms (`EventHistory`). Frames
are reduced to the log brightness of coarse cells and joined with their exposure times
(`FrameHistory`): a frame shows the deformation of the gel averaged over its exposure, whose times
the camera gives exactly, without the latency of the event pixels. `force_arrays` sorts samples of
the reference force. A `Recording` holds these arrays; node and bags make it in the same way.
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
from mixtac_core.node.images import grey
from mixtac_core.node.topics import stamp_to_ns, stamp_to_us
from mixtac_fger.alignment.clock_fit import GapError

F64 = NDArray[np.float64]

CELL_PX: Final = 10
"""Side of a cell: several beads wide at most, so that motion of a part of a pixel shows."""
DARK: Final = 0.008
"""Part of the full scale that is added before the logarithm, so that dark cells do not count."""
BIN_US: Final = 500
"""Width of a bin [us]: bursts of an impulse last 2 to 20 ms."""
RESTART_US: Final = 1_000_000
"""A larger step back of a clock is a restart of it [us]."""


def has_restarted(stamp_ns: int, newest_ns: int) -> bool:
    """Return whether a clock has restarted between two stamps [ns]."""
    return stamp_ns < newest_ns - 1000 * RESTART_US


@dataclass(frozen=True, slots=True, eq=False)
class FrameFeatures:
    """Frames of a recording, camera clock.

    Attributes:
        start_us: Start of each exposure, camera clock [us], ``int64 [n]``.
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


FRAMES_PER_S: Final = 60
"""Most frames a second that are kept."""
WAITING: Final = 32
"""Images and exposures, at most, that wait for each other."""


class FrameHistory:
    """The latest frames; an image and its exposure times are joined by their stamp.

    Args:
        span_s: Time to remember [s].
    """

    def __init__(self, span_s: float) -> None:
        self._frames: deque[tuple[int, int, NDArray[np.float32]]] = deque(
            maxlen=max(16, round(span_s * FRAMES_PER_S))
        )
        self._span_us = round(1e6 * span_s)
        self._halves: dict[int, dict[str, Any]] = {}

    def add_image(self, message: Any) -> None:  # noqa: ANN401
        """Add a `sensor_msgs/Image`.

        Raises:
            ImageConversionError: Its encoding cannot be read.
        """
        pixels = grey(message)
        self._join(message, values=reduce_frame(pixels, float(np.iinfo(pixels.dtype).max)))

    def add_exposure(self, message: Any) -> None:  # noqa: ANN401
        """Add the `mixtac_msgs/FrameExposure` of an image."""
        start_us, end_us = map(stamp_to_us, (message.exposure_start, message.exposure_end))
        self._join(message, span=(start_us, end_us))

    def _join(self, message: Any, **half: Any) -> None:  # noqa: ANN401
        """Keep half of a frame until the other one comes.

        An image smaller than a cell shows nothing, and an exposure without length has no times.
        """
        stamp_ns = stamp_to_ns(message.header.stamp)
        both = self._halves.pop(stamp_ns, {}) | half
        if len(both) < 2:
            self._halves[stamp_ns] = both
            if len(self._halves) > WAITING:
                del self._halves[next(iter(self._halves))]
        elif both['values'].size and both['span'][0] < both['span'][1]:
            self._frames.append((*both['span'], both['values']))

    def snapshot(self) -> FrameFeatures | None:
        """Return the frames of the size of the latest one, oldest first, or None."""
        if not self._frames:
            return None
        latest_us, _, latest = self._frames[-1]
        rows = [
            row
            for row in self._frames
            if row[0] >= latest_us - self._span_us and row[2].shape == latest.shape
        ]
        start, end = (np.array([row[k] for row in rows], np.int64) for k in (0, 1))
        return FrameFeatures(start, end, np.stack([row[2] for row in rows]))


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
    """Keeps the latest events of a stream by cell, and counts them.

    Packets are reduced in batches: one by one would take most of the time of an alignment.

    Attributes:
        packets: Follows the packets' numbers.

    Args:
        span_s: Time to remember [s].
        most: Events to remember.
    """

    def __init__(self, span_s: float, most: int = MOST_EVENTS) -> None:
        self.packets = SequenceCounter()
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

        A new start empties the history.

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
            self._clear()
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

    def snapshot(self) -> tuple[EventCounts, CellEvents]:
        """Return counts in the bins that are complete, and the events in the order of time."""
        self._reduce()
        parts = self._cells or [by_cell(Events.empty(), *self._size)]
        t_us, cell, on = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ('t_us', 'cell', 'on')
        )
        order = np.argsort(t_us, kind='stable')
        events = CellEvents(t_us[order], cell[order], on[order])
        end = max(self._end_us // BIN_US, self._first + 1)
        first = max(self._first, end - self._span_us // BIN_US)
        bins = events.between(first * BIN_US, end * BIN_US).t_us // BIN_US - first
        lost = tuple((a - first, b - first) for a, b in self._lost if b > first)
        counts = np.bincount(bins, minlength=end - first)
        return EventCounts(first * BIN_US, BIN_US, counts, lost), events

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


def force_arrays(samples: Iterable[tuple[int, float]]) -> tuple[F64, F64]:
    """Return increasing times [s] and forces [N] of samples of the reference sensor.

    Late samples are sorted in. Repeated ones, and those without a stamp or a number, are left out.

    Args:
        samples: Stamps, reference clock [ns], and forces [N] in the order of arrival.

    Raises:
        GapError: The clock of the force sensor went back.
    """
    pairs = [(stamp, force) for stamp, force in samples if stamp > 0 and np.isfinite(force)]
    stamps = np.array([stamp for stamp, _ in pairs], np.int64)
    if has_restarted(int(np.diff(stamps).min(initial=0)), 0):
        raise GapError(
            'the clock of the force sensor went back',
            remedy='record again, and do not restart the force sensor between the taps',
        )
    stamps, first = np.unique(stamps, return_index=True)
    return stamps / 1e9, np.array([force for _, force in pairs], np.float64)[first]


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
        damage: What is missing because the bag is incomplete; empty for a sound one.
        all_edges: Whether the first edges of both clocks are the same one, and so on.
    """

    counts: EventCounts
    events: CellEvents
    frames: FrameFeatures | None
    force_t_s: F64
    force: F64
    edges_us: NDArray[np.int64]
    reference_edges_s: F64
    damage: str = ''
    all_edges: bool = False
