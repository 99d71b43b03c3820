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


@dataclass(frozen=True, slots=True)
class TransportCounters:
    """Counters of a reader.

    Attributes:
        transfers: Reads with data.
        size: Bytes received.
        stalls: Stalls of the endpoint that were cleared.
        dropped_transfers: Transfers dropped because the queue was full.
        dropped_size: Bytes dropped.
        queued_size: Bytes in the queue now.
        most_queued_size: Greatest number of bytes in the queue.
    """

    transfers: int = 0
    size: int = 0
    stalls: int = 0
    dropped_transfers: int = 0
    dropped_size: int = 0
    queued_size: int = 0
    most_queued_size: int = 0


class TransferQueue:
    """Transfers in order.

    When the consumer is too slow, the newest transfers are dropped and counted; the camera time in
    them is kept (see `Transfer.gap`).

    Args:
        limit: Bytes that may wait for the consumer.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._waiting: deque[Transfer] = deque()
        self._gap = Gap()
        self._transfers = self._size = self._dropped_transfers = self._dropped_size = 0
        # One for the thread that puts, one for the thread that pops: they may be different.
        self._size_in = self._size_out = self._most_queued_size = 0

    def __len__(self) -> int:
        """Return how many transfers wait."""
        return len(self._waiting)

    def counters(self, stalls: int = 0) -> TransportCounters:
        """Return the counters of the queue together with those of its reader."""
        return TransportCounters(
            transfers=self._transfers,
            size=self._size,
            stalls=stalls,
            dropped_transfers=self._dropped_transfers,
            dropped_size=self._dropped_size,
            queued_size=self._size_in - self._size_out,
            most_queued_size=self._most_queued_size,
        )

    def put(self, data: bytes, arrival_ns: int, *, short_packet: bool) -> None:
        """Append a transfer, or drop it if there is no room.

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


LONGEST_READ_S = 0.1
"""Longest read, and delay of noticing `stop` in another thread."""
MOST_STALLS = 5
"""Consecutive stalls after which clearing them is given up."""


class Stalls:
    """Counts stalls of the endpoint: a few may be cleared, many in a row are a failure.

    Attributes:
        total: Stalls since construction.
        in_a_row: Stalls since the latest data; the reader sets it back.
    """

    def __init__(self) -> None:
        self.total = self.in_a_row = 0

    def note(self, error: USBError) -> None:
        """Count a failed read.

        Raises:
            UsbError: It was no stall, or there were too many.
        """
        self.total += 1
        self.in_a_row += 1
        if error.errno != errno.EPIPE or self.in_a_row > MOST_STALLS:
            raise usb_failure(error, 'reading data') from error


class BulkReader:
    """Reads one transfer per call of `get`.

    Args:
        read: Reads into a buffer within a time [ms] and returns the number of bytes; raises as
            pyusb does.
        clear_halt: Clears a stall of the endpoint.
        transfer_size: Bytes requested per read.
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
        self._stopping = threading.Event()
        self._stalls = Stalls()

    @property
    def counters(self) -> TransportCounters:
        """Counters since construction."""
        return self._queue.counters(self._stalls.total)

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
            self._stalls.note(error)
            self._clear_halt()
            return None
        except OSError as error:
            raise UsbError(f'reading data: {error}') from error
        if not count:
            return None
        self._stalls.in_a_row = 0
        data = bytes(memoryview(self._buffer)[:count])
        self._queue.put(data, time.time_ns(), short_packet=count < len(self._buffer))
        return self._queue.pop()
