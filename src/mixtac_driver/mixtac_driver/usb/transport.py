# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Synchronous reader of the data endpoint, and the bounded queue of transfers.

`BulkReader` reads one transfer after the other and serves the pyusb backends that have no
asynchronous transfers; a camera on USB is read by `mixtac_driver.usb.libusb.AsynchronousReader`.
When the consumer is too slow, `TransferQueue` drops and counts the newest transfers and keeps the
camera time that passed in them as a `Gap`.
"""

from __future__ import annotations

import errno
import threading
import time
from array import array
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from usb.core import USBError, USBTimeoutError

from mixtac_driver.errors import UsbError
from mixtac_driver.usb.protocol import usb_failure

Octets = bytes | bytearray | memoryview | NDArray[Any]


@dataclass(frozen=True, slots=True)
class Gap:
    """Data that were lost between two transfers.

    Attributes:
        size: Bytes lost.
        wraps: Wraps of the 15-bit time among them, since the last reset among them.
        resets: Resets of the clock among them.
    """

    size: int = 0
    wraps: int = 0
    resets: int = 0

    def __add__(self, later: Gap) -> Gap:
        """Return this gap and the one after it as one."""
        wraps = later.wraps if later.resets else self.wraps + later.wraps
        return Gap(self.size + later.size, wraps, self.resets + later.resets)


@njit(cache=True, nogil=True)
def _count(words: Any) -> tuple[int, int]:  # noqa: ANN401
    wraps = resets = 0
    for word in words:
        if word >> 12 == 7:
            wraps += word & 0xFFF
        elif word == 1:
            resets += 1
            wraps = 0
    return wraps, resets


def gap_of(data: Octets) -> Gap:
    """Return the gap that dropping these bytes leaves."""
    octets = np.frombuffer(data, np.uint8)
    wraps, resets = _count(octets[: len(octets) // 2 * 2].view('<u2'))
    return Gap(len(octets), int(wraps), int(resets))


@dataclass(frozen=True, slots=True, eq=False)
class Transfer:
    """The data of one read.

    Attributes:
        data: Bytes.
        arrival_ns: Host time of arrival [ns since the Unix epoch].
        short_packet: True where the camera ended the transfer before the buffer was full.
        gap: Data dropped between the previous transfer and this one.
    """

    data: bytes
    arrival_ns: int
    short_packet: bool
    gap: Gap


@dataclass(slots=True)
class TransportCounters:
    """Counters of a reader. Each is written by one thread at a time.

    Attributes:
        transfers: Reads with data.
        size: Bytes received.
        stalls: Stalls of the endpoint.
        dropped_transfers: Transfers dropped because the queue was full.
        dropped_size: Bytes dropped.
        taken_size: Bytes that the consumer took from the queue.
        most_queued_size: Greatest number of bytes in the queue.
    """

    transfers: int = 0
    size: int = 0
    stalls: int = 0
    dropped_transfers: int = 0
    dropped_size: int = 0
    taken_size: int = 0
    most_queued_size: int = 0

    @property
    def queued_size(self) -> int:
        """Bytes in the queue now."""
        return self.size - self.dropped_size - self.taken_size


MOST_STALLS = 5
"""Consecutive stalls after which clearing them is given up."""


class TransferQueue:
    """Transfers in order, and stalls of the endpoint between them.

    When the consumer is too slow, the newest transfers are dropped and counted; the camera time in
    them is kept (see `Transfer.gap`).

    Args:
        limit: Bytes that may wait for the consumer.

    Attributes:
        counters: Counters since construction.
    """

    def __init__(self, limit: int) -> None:
        self.counters = TransportCounters()
        self._waiting: deque[Transfer] = deque()
        self._limit = limit
        self._gap = Gap()
        self._stalls_in_a_row = 0

    def __len__(self) -> int:
        """Return how many transfers wait."""
        return len(self._waiting)

    def put(self, data: bytes, arrival_ns: int, *, short_packet: bool) -> None:
        """Append a transfer, or drop it if there is no room.

        Args:
            data: Bytes, at least one.
            arrival_ns: Host time of arrival [ns since the Unix epoch].
            short_packet: Whether the camera ended it before the buffer was full.
        """
        counters = self.counters
        counters.transfers += 1
        counters.size += len(data)
        self._stalls_in_a_row = 0
        if counters.queued_size > self._limit:
            counters.dropped_transfers += 1
            counters.dropped_size += len(data)
            self._gap += gap_of(data)
            return
        self._waiting.append(Transfer(data, arrival_ns, short_packet, self._gap))
        self._gap = Gap()
        counters.most_queued_size = max(counters.most_queued_size, counters.queued_size)

    def pop(self) -> Transfer | None:
        """Return the oldest transfer, or None if there is none."""
        if not self._waiting:
            return None
        transfer = self._waiting.popleft()
        self.counters.taken_size += len(transfer.data)
        return transfer

    def note_failure(self, error: USBError) -> None:
        """Count a failed read: a few stalls in a row may be cleared.

        Raises:
            UsbError: It was no stall, or there were too many.
        """
        self.counters.stalls += 1
        self._stalls_in_a_row += 1
        if error.errno != errno.EPIPE or self._stalls_in_a_row > MOST_STALLS:
            raise usb_failure(error, 'reading data') from error


LONGEST_READ_S = 0.1
"""Longest read, and delay of noticing `stop` in another thread."""


class BulkReader:
    """Reads one transfer per call of `get`.

    Args:
        read: Reads into a buffer within a time [ms] and returns the number of bytes; raises as
            pyusb does.
        clear_halt: Clears a stall of the endpoint.
        transfer_size: Bytes requested per read.

    Attributes:
        counters: Counters since construction.
    """

    def __init__(
        self,
        read: Callable[[array[int], int], int],
        clear_halt: Callable[[], None],
        *,
        transfer_size: int = 65536,
    ) -> None:
        self._read = read
        self._clear_halt = clear_halt
        self._buffer = array('B', bytes(transfer_size))
        self._queue = TransferQueue(transfer_size)
        self.counters = self._queue.counters
        self._stopping = threading.Event()

    def start(self) -> None:
        """Do nothing: the first `get` starts reading."""

    def stop(self) -> None:
        """Start no further read; one in another thread ends at its time-out."""
        self._stopping.set()

    def get(self, timeout_s: float) -> Transfer | None:
        """Return the next transfer, or None if none came in time or reading was stopped.

        Args:
            timeout_s: Longest time to wait [s]; may return None earlier.

        Raises:
            UsbError: Reading failed, or the camera is gone.
        """
        if self._stopping.is_set():
            return None
        try:
            count = self._read(self._buffer, max(round(min(timeout_s, LONGEST_READ_S) * 1000), 1))
        except USBTimeoutError:
            count = 0
        except USBError as error:
            self._queue.note_failure(error)
            self._clear_halt()
            return None
        except OSError as error:
            raise UsbError(f'reading data: {error}') from error
        if not count:
            return None
        data = bytes(memoryview(self._buffer)[:count])
        self._queue.put(data, time.time_ns(), short_packet=count < len(self._buffer))
        return self._queue.pop()
