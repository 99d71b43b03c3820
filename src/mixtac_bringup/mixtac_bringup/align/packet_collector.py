# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counts and keeps the events of a bag's packets, from their serialised form.

A bag has a packet every millisecond: building a message for each, and reducing it by itself, would
take most of the time of `mixtac align`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.event_history import EventHistory, by_cell
from mixtac_alignment.rate_history import BIN_US, EventCounts
from mixtac_bringup.errors import BagError
from mixtac_events.arrays import Events
from mixtac_events.codec import decode
from mixtac_events.errors import CodecError
from mixtac_events.serialised_packet import read_packet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.event_history import CellEvents

BATCH: Final = 256
"""Packets that are reduced at once."""
STEP_BACK_US: Final = 1_000_000
"""A step back of the stream beyond this is a restarted clock."""


class PacketCollector:
    """Counts events packet by packet and keeps them by cell: whole ones would take gigabytes.

    Args:
        span_s: Time to keep events for [s].
    """

    def __init__(self, span_s: float) -> None:
        self._history = EventHistory(span_s)
        self._parts: list[tuple[int, NDArray[np.int64]]] = []
        self._lost: list[tuple[int, int]] = []
        self._sequence: int | None = None
        self._first: int | None = None
        self._end = 0
        self._batch: list[Events] = []
        self._size = (0, 0)
        self._newest_us = 0

    def add(self, data: bytes) -> None:
        """Add a serialised `EventPacket`.

        Raises:
            CodecError: It is cut off, or its events are damaged.
        """
        message = read_packet(data)
        if message.is_bigendian:
            raise CodecError('event packet is big-endian: record or publish it little-endian')
        packet = decode(
            # A copy lies at an aligned address, for which the decoders are compiled already.
            bytes(message.events),
            message.encoding,
            message.time_base,
            width=message.width,
            height=message.height,
        )
        start_us = packet.start_us
        size = (message.width, message.height)
        if size != self._size or start_us < self._newest_us - STEP_BACK_US:
            self._reduce()
        self._size, self._newest_us = size, packet.complete_until
        if self._first is None:
            self._first = start_us // BIN_US
        elif self._sequence is not None and message.seq > self._sequence + 1:
            self._lost.append((self._end, start_us // BIN_US + 1))
        self._sequence = message.seq
        self._end = max(self._end, packet.complete_until // BIN_US)
        if len(packet.events.t):
            self._batch.append(packet.events)
        if len(self._batch) >= BATCH:
            self._reduce()

    def events(self) -> CellEvents:
        """Return the events by cell."""
        self._reduce()
        return self._history.snapshot()

    def counts(self, where: str) -> EventCounts:
        """Return the counts of all packets.

        Args:
            where: What the packets came from, for the message.

        Raises:
            BagError: There were none.
        """
        if self._first is None:
            raise BagError(f'{where} is empty: the camera sent nothing during the recording')
        self._reduce()
        first, end = self._first, max(self._end, self._first + 1)
        total = np.zeros(end - first, np.int64)
        for low, part in self._parts:
            a, b = max(low, first), min(low + len(part), end)
            if b > a:
                total[a - first : b - first] += part[a - low : b - low]
        gaps = tuple((a - first, b - first) for a, b in self._lost)
        return EventCounts(first * BIN_US, BIN_US, total, gaps)

    def _reduce(self) -> None:
        if not self._batch:
            return
        events = Events.concatenate(self._batch)
        self._batch = []
        self._history.push(by_cell(events, *self._size))
        bins = events.t // BIN_US
        low = int(bins.min())
        self._parts.append((low, np.bincount(bins - low)))
