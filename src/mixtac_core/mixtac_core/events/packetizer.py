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
        self._pending = pending = Events.concatenate([self._pending, events])
        pending.t[held:] += origin_us
        closed_us = time_us // self._period_us * self._period_us
        if self._complete_us is None:
            first_us = int(pending.t[0]) if len(pending) else closed_us
            self._complete_us = min(closed_us, first_us)
        if closed_us <= self._complete_us and len(pending) < self._most_events:
            return []
        packets = self._cut(pending, held, closed_us, arrival_ns)
        cut = sum(len(packet.events) for packet in packets)
        self._pending = pending[cut:]
        if cut >= held:
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
        self._complete_us = until_us
        return Packet(arrival_ns, events, until_us)
