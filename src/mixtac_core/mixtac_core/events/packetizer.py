# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Cutting events into packets on a fixed grid of camera time, so that time always progresses.

A packet is closed as soon as the stream has passed the end of its cell of the grid. It carries the
time up to which the stream is complete, so that consumers can close their own windows at once.
Cells without events give empty packets.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode
from mixtac_core.events.packets import EncodedPacket


class _Pending:
    """Buffer of events not yet packed, in reused arrays.

    Args:
        capacity: Initial capacity [events].
    """

    def __init__(self, capacity: int = 4096) -> None:
        self._count = 0
        self._arrays = Events.empty(capacity)

    def __len__(self) -> int:
        """Return the number of events."""
        return self._count

    @property
    def events(self) -> Events:
        """The events, as views that are valid until the next call of `append` or `drop`."""
        return self._arrays[: self._count]

    def append(self, events: Events, origin_us: int = 0) -> None:
        """Copy events to the end, with the origin added to their times [us]."""
        count = len(events)
        if not count:
            return
        if self._count + count > len(self._arrays):
            waiting = self.events
            self._arrays = Events.empty(2 * (self._count + count))
            self._copy(waiting, 0)
        self._copy(events, self._count)
        self._count += count
        self._arrays.t[self._count - count : self._count] += origin_us

    def drop(self, count: int) -> None:
        """Remove the first events."""
        rest = self._arrays[count : self._count]
        self._count -= count
        # NumPy handles overlapping copies.
        self._copy(rest, 0)

    def _copy(self, events: Events, start: int) -> None:
        end = start + len(events)
        self._arrays.t[start:end] = events.t
        self._arrays.x[start:end] = events.x
        self._arrays.y[start:end] = events.y
        self._arrays.polarity[start:end] = events.polarity


ENCODING = 'libcaer_cmp'
"""Default encoding of the driver."""
PACKET_PERIOD_US = 1_000
"""Default grid of the driver's packets [us]."""
PACKET_BYTES = 300_000
"""Default limit of the payload of the driver's packets [bytes]."""
MOST_BYTES_PER_EVENT = 8
"""Upper bound for both encodings: 4 words in `libcaer_cmp`, 8 bytes in `libcaer`."""
LONGEST_ANNOUNCEMENT_US = 1 << 23
"""Times in `libcaer_cmp` are relative to the first event and end after 2^24 us."""


@dataclass(frozen=True, slots=True, eq=False)
class Packet:
    """One packet.

    Attributes:
        encoding: Name of the encoding.
        arrival_ns: Host time at which the first transfer in it arrived [ns since the Unix epoch].
        events: Its events, as views that are valid until the next push.
        complete_until_us: Camera time before which no further event will follow.
    """

    encoding: str
    arrival_ns: int
    events: Events
    complete_until_us: int

    def encode(self) -> EncodedPacket:
        """Return encoding, time base and payload."""
        return encode(self.events, self.encoding, complete_until=self.complete_until_us)


class Packetizer:
    """Cuts a stream of events into packets.

    Args:
        encoding: One of `mixtac_core.events.codec.ENCODINGS`.
        period_us: Grid of camera time [us]; events of a packet span at most this much.
        most_bytes: Longest payload [bytes].
    """

    def __init__(self, encoding: str, period_us: int, most_bytes: int) -> None:
        self._encoding = encoding
        self._period_us = period_us
        self._most_events = max(most_bytes // MOST_BYTES_PER_EVENT, 1)
        self._pending = _Pending()
        self._taken = self._pending_arrival_ns = 0
        self._complete_us: int | None = None

    def push(
        self, events: Events, time_us: int, arrival_ns: int, origin_us: int = 0
    ) -> list[Packet]:
        """Add events and return the packets that are complete.

        Args:
            events: Events on a camera clock [us], sorted, not before those added earlier.
            time_us: Camera time that the stream has reached, origin included; no later event is
                before it.
            arrival_ns: Host time of their arrival.
            origin_us: Added to the times of the events.
        """
        if self._taken:
            # Only now: packets are views.
            self._pending.drop(self._taken)
            self._taken = 0
        held = len(self._pending)
        if not held:
            self._pending_arrival_ns = arrival_ns
        self._pending.append(events, origin_us)
        closed_us = time_us // self._period_us * self._period_us
        if self._complete_us is None:
            self._complete_us = min([closed_us, *self._pending.events.t[:1].tolist()])
        if closed_us <= self._complete_us and len(self._pending) < self._most_events:
            return []
        packets = self._cut(self._pending.events, held, closed_us, arrival_ns)
        self._taken = sum(len(packet.events) for packet in packets)
        if self._taken >= held:
            self._pending_arrival_ns = arrival_ns
        if closed_us > self._complete_us:
            packets.append(self._packet(Events.empty(), closed_us, arrival_ns))
        return packets

    def _cut(self, events: Events, held: int, closed_us: int, arrival_ns: int) -> list[Packet]:
        ready = int(events.t.searchsorted(closed_us))
        packets = []
        for start, end in self._cells(events, ready):
            for first in range(start, end, self._most_events):
                last = min(first + self._most_events, end)
                arrival = self._pending_arrival_ns if first < held else arrival_ns
                until = self._complete_after(events, last, ready, closed_us)
                packets.append(self._packet(events[first:last], until, arrival))
        # The open cell is cut by size only.
        first = ready
        while len(events) - first >= self._most_events:
            last = first + self._most_events
            arrival = self._pending_arrival_ns if first < held else arrival_ns
            packets.append(self._packet(events[first:last], int(events.t[last - 1]), arrival))
            first = last
        return packets

    def _cells(self, events: Events, ready: int) -> list[tuple[int, int]]:
        """Return the range of events of each cell that is closed and not empty."""
        if not ready:
            return []
        if int(events.t[0]) // self._period_us == int(events.t[ready - 1]) // self._period_us:
            return [(0, ready)]
        cells = events.t[:ready] // self._period_us
        starts = [0, *(np.flatnonzero(np.diff(cells)) + 1).tolist(), ready]
        return list(pairwise(starts))

    def _complete_after(self, events: Events, last: int, ready: int, closed_us: int) -> int:
        """Return the grid time up to which nothing follows the event before `last`."""
        latest = int(events.t[last - 1])
        if last < ready:
            following = int(events.t[last])
            closed_us = max(following // self._period_us * self._period_us, latest)
        return min(closed_us, latest + LONGEST_ANNOUNCEMENT_US)

    def _packet(self, events: Events, until_us: int, arrival_ns: int) -> Packet:
        # Packets with events carry the time that the stream has reached in libcaer_cmp only.
        silent = len(events) and self._encoding != 'libcaer_cmp'
        self._complete_us = int(events.t[-1]) if silent else until_us
        return Packet(self._encoding, arrival_ns, events, self._complete_us)
