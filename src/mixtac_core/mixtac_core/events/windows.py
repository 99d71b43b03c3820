# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Cutting an event stream on a grid of camera time: into packets to send, into windows to process.

A packet is closed as soon as the stream has passed the end of its cell of the grid. It carries the
time up to which the stream is complete, so that consumers can close their own windows at once.
Cells without events give empty packets, so that time always progresses.

Window k covers ``[k * width, (k + 1) * width)``; it is labelled with its end.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode
from mixtac_core.events.packets import EncodedPacket

PACKET_PERIOD_US = 1_000
"""Default grid of the driver's packets [us]."""
PACKET_BYTES = 300_000
"""Default limit of the payload of the driver's packets [bytes]."""
MOST_BYTES_PER_EVENT = 8
"""Longest coding of an event in `libcaer_cmp` [bytes]: four words."""
LONGEST_ANNOUNCEMENT_US = 1 << 23
"""Times in `libcaer_cmp` are relative to the first event and end after 2^24 us."""


@dataclass(frozen=True, slots=True, eq=False)
class Packet:
    """One packet.

    Attributes:
        arrival_ns: Host time at which the first transfer in it arrived [ns since the Unix epoch].
        events: Its events.
        complete_until_us: Camera time before which no further event will follow.
    """

    arrival_ns: int
    events: Events
    complete_until_us: int

    def encode(self) -> EncodedPacket:
        """Return time base and payload."""
        return encode(self.events, complete_until=self.complete_until_us)


class Packetizer:
    """Cuts a stream of events into packets.

    Args:
        period_us: Grid of camera time [us]; events of a packet span at most this much.
        most_bytes: Longest payload [bytes].
    """

    def __init__(self, period_us: int = PACKET_PERIOD_US, most_bytes: int = PACKET_BYTES) -> None:
        self._period_us = period_us
        self._most_events = max(most_bytes // MOST_BYTES_PER_EVENT, 1)
        self._pending = Events.empty()
        self._pending_arrival_ns = 0
        self._complete_us: int | None = None

    def push(
        self, events: Events, time_us: int, arrival_ns: int, origin_us: int = 0
    ) -> list[Packet]:
        """Add events and return the packets that are complete.

        Args:
            events: Events on a camera clock [us], sorted, not before those added earlier. They
                are copied.
            time_us: Camera time that the stream has reached, origin included; no later event is
                before it.
            arrival_ns: Host time of their arrival.
            origin_us: Added to the times of the events.
        """
        held = len(self._pending)
        if not held:
            self._pending_arrival_ns = arrival_ns
        pending = self._pending = Events.concatenate([self._pending, events])
        pending.t[held:] += origin_us
        closed_us = time_us // self._period_us * self._period_us
        if self._complete_us is None:
            self._complete_us = min([closed_us, *pending.t[:1].tolist()])
        if closed_us <= self._complete_us and len(pending) < self._most_events:
            return []
        packets, begin = [], 0
        for end, until_us in self._ends(pending.t, closed_us):
            arrival = self._pending_arrival_ns if begin < held else arrival_ns
            packets.append(Packet(arrival, pending[begin:end], until_us))
            begin, self._complete_us = end, until_us
        self._pending = pending[begin:]
        if begin >= held:
            self._pending_arrival_ns = arrival_ns
        if closed_us > self._complete_us:
            packets.append(Packet(arrival_ns, Events.empty(), closed_us))
            self._complete_us = closed_us
        return packets

    def _ends(self, t: NDArray[np.int64], closed_us: int) -> list[tuple[int, int]]:
        """Return where packets end, and up to when nothing follows each; the rest stays open."""
        period_us, most = self._period_us, self._most_events
        ready = int(t.searchsorted(closed_us))
        edges = [0, ready]
        if ready and t[0] // period_us != t[ready - 1] // period_us:
            cells = t[:ready] // period_us
            edges[1:1] = (np.flatnonzero(np.diff(cells)) + 1).tolist()
        found = []
        for start, end in pairwise(edges):
            for last in [*range(start + most, end, most), end] if end else ():
                latest, following = int(t[last - 1]), closed_us
                if last < ready:
                    following = max(int(t[last]) // period_us * period_us, latest)
                found.append((last, min(following, latest + LONGEST_ANNOUNCEMENT_US)))
        # The open cell is cut by size only.
        return found + [(end, int(t[end - 1])) for end in range(ready + most, len(t) + 1, most)]


RESTART_US: Final = 1_000_000
"""A larger step back in time [us] is a clock that was reset, not a late packet."""


class WindowSlicer:
    """Cuts a live stream into windows and closes each as soon as it is known to be complete.

    The first window begins on the grid before the first time, so it may be incomplete. Only the
    events of open windows are kept. One push skips empty windows before the latest `max_empty_run`
    windows, which bounds its work after a gap; windows with events are never skipped.

    Attributes:
        width_us: Width of a window [us].
        late_events: Events dropped because their window had been closed.

    Args:
        width_us: Width of a window [us], positive.
        max_empty_run: Latest windows that one push returns although they are empty, positive.
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
            self._pending.append(fresh)
        closed = complete_until // self.width_us
        if closed <= following:
            return []
        held = Events.concatenate(self._pending)
        if (held.t[1:] < held.t[:-1]).any():
            held = held[np.argsort(held.t, kind='stable')]
        self._next = closed
        begin, parts = 0, []
        for index in self._to_close(held, following, closed):
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
        keep = events.t >= start_us
        late = len(events) - int(np.count_nonzero(keep))
        self.late_events += late
        return events[keep] if late else events

    def _to_close(self, held: Events, first: int, end: int) -> list[int]:
        """Return the windows in ``[first, end)`` to close: the latest ones, and all with events."""
        near = max(first, end - self._max_empty_run)
        if near == first:
            return list(range(first, end))
        before = held.between(first * self.width_us, near * self.width_us).t // self.width_us
        return [*np.unique(before).tolist(), *range(near, end)]
