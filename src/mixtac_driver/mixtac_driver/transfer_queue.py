# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What reading the data endpoint brings, waiting in a bounded queue for whoever decodes it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from mixtac_driver.wrap_count import Gap, gap_of


@dataclass(frozen=True, slots=True, eq=False)
class Transfer:
    """What one read brought.

    Attributes:
        data: Bytes.
        arrival_ns: Host time of arrival [ns since the Unix epoch].
        short_packet: True where the camera ended the transfer before the buffer was full.
        gap: What was thrown away between the transfer before and this one.
    """

    data: bytes
    arrival_ns: int
    short_packet: bool
    gap: Gap


@dataclass(frozen=True, slots=True)
class TransportCounters:
    """What the reader did so far.

    Attributes:
        transfers: Reads that brought data.
        size: Bytes they brought.
        timeouts: Reads that brought none; normal for a camera that is not running.
        stalls: Times the endpoint had to be set going again.
        dropped_transfers: Transfers thrown away because the queue was full.
        dropped_size: Bytes thrown away.
        queued_size: Bytes in the queue now.
        most_queued_size: Greatest number of bytes in the queue.
    """

    transfers: int = 0
    size: int = 0
    timeouts: int = 0
    stalls: int = 0
    dropped_transfers: int = 0
    dropped_size: int = 0
    queued_size: int = 0
    most_queued_size: int = 0


class TransferQueue:
    """Transfers in order.

    When the consumer is too slow the newest transfers are thrown away and counted; the time that
    passed in them is kept (see `Transfer.gap`).

    Args:
        limit: Bytes that may wait for the consumer.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._waiting: deque[Transfer] = deque()
        self._gap = Gap()
        self._transfers = self._size = 0
        self._dropped_transfers = self._dropped_size = 0
        # One for the thread that puts, one for the thread that pops: they may be different.
        self._size_in = self._size_out = self._most_queued_size = 0

    def __len__(self) -> int:
        """Return how many transfers wait."""
        return len(self._waiting)

    def counters(self, *, timeouts: int = 0, stalls: int = 0) -> TransportCounters:
        """Return the counters of the queue together with those of its reader."""
        return TransportCounters(
            transfers=self._transfers,
            size=self._size,
            timeouts=timeouts,
            stalls=stalls,
            dropped_transfers=self._dropped_transfers,
            dropped_size=self._dropped_size,
            queued_size=self._size_in - self._size_out,
            most_queued_size=self._most_queued_size,
        )

    def put(self, data: bytes, arrival_ns: int, *, short_packet: bool) -> None:
        """Append a transfer, or throw it away if there is no room.

        Args:
            data: Bytes, at least one.
            arrival_ns: Host time of arrival [ns since the Unix epoch].
            short_packet: Whether the camera ended it before the buffer was full.
        """
        self._transfers += 1
        self._size += len(data)
        queued_size = self._size_in - self._size_out + len(data)
        if queued_size > self._limit:
            self._dropped_transfers += 1
            self._dropped_size += len(data)
            self._gap += gap_of(data)
            return
        self._waiting.append(Transfer(data, arrival_ns, short_packet, self._gap))
        self._gap = Gap()
        self._size_in += len(data)
        self._most_queued_size = max(self._most_queued_size, queued_size)

    def pop(self) -> Transfer | None:
        """Return the oldest transfer, or None if there is none."""
        if not self._waiting:
            return None
        transfer = self._waiting.popleft()
        self._size_out += len(transfer.data)
        return transfer
