# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading the data endpoint in a thread of its own, with a bounded queue behind it."""

from __future__ import annotations

import errno
import threading
import time
from array import array
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from usb.core import USBError, USBTimeoutError

from mixtac_driver.errors import StreamError, UsbError
from mixtac_driver.protocol import usb_failure
from mixtac_driver.wrap_count import Gap, gap_of

if TYPE_CHECKING:
    from collections.abc import Callable

READ_TIMEOUT_MS = 100
STOP_TIMEOUT_S = 3.0
MOST_STALLS = 5


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


class BulkReader:
    """Reads transfers until stopped or until the camera goes away.

    When the consumer is too slow the newest transfers are thrown away and counted; the time that
    passed in them is kept (see `Transfer.gap`).

    Args:
        read: Reads into a buffer within a time [ms] and returns the number of bytes; raises as
            pyusb does.
        clear_halt: Sets a stalled endpoint going again.
        transfer_size: Bytes asked for per read.
        queue_size: Bytes that may wait for the consumer.
        now_ns: Host clock [ns since the Unix epoch].
    """

    def __init__(
        self,
        read: Callable[[array[int], int], int],
        clear_halt: Callable[[], None],
        *,
        transfer_size: int = 65536,
        queue_size: int = 32 << 20,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._read = read
        self._clear_halt = clear_halt
        self._buffer = array('B', bytes(transfer_size))
        self._queue_size = queue_size
        self._now_ns = now_ns
        self._queue: deque[Transfer] = deque()
        self._ready = threading.Condition()
        self._stopping = threading.Event()
        self._error: UsbError | None = None
        self._gap = Gap()
        self._transfers = self._size = self._timeouts = self._stalls = 0
        self._dropped_transfers = self._dropped_size = 0
        self._queued_size = self._most_queued_size = 0
        self._thread = threading.Thread(target=self._run, name='davis-usb', daemon=True)

    @property
    def counters(self) -> TransportCounters:
        """What the reader did so far."""
        return TransportCounters(
            transfers=self._transfers,
            size=self._size,
            timeouts=self._timeouts,
            stalls=self._stalls,
            dropped_transfers=self._dropped_transfers,
            dropped_size=self._dropped_size,
            queued_size=self._queued_size,
            most_queued_size=self._most_queued_size,
        )

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """End reading; what is in the queue stays there.

        Raises:
            StreamError: The read in progress does not return.
        """
        self._stopping.set()
        with self._ready:
            self._ready.notify_all()
        if self._thread.ident is None:
            return
        self._thread.join(STOP_TIMEOUT_S)
        if self._thread.is_alive():
            raise StreamError(f'a USB read did not return within {STOP_TIMEOUT_S} s of stopping')

    def get(self, timeout_s: float) -> Transfer | None:
        """Return the next transfer, or None when none came in time or reading was stopped.

        Args:
            timeout_s: Longest time to wait [s].

        Raises:
            UsbError: Reading ended because of it, and all that came before it was taken.
        """
        with self._ready:
            self._ready.wait_for(self._has_news, timeout_s)
            if self._queue:
                transfer = self._queue.popleft()
                self._queued_size -= len(transfer.data)
                return transfer
            if self._error is not None:
                raise self._error
            return None

    def _has_news(self) -> bool:
        return bool(self._queue) or self._error is not None or self._stopping.is_set()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._read_once()
        except UsbError as error:
            self._end(error)
        except OSError as error:
            self._end(UsbError(f'reading data: {error}'))

    def _end(self, error: UsbError) -> None:
        with self._ready:
            self._error = error
            self._ready.notify_all()

    def _read_once(self) -> None:
        try:
            count = self._read(self._buffer, READ_TIMEOUT_MS)
        except USBTimeoutError:
            self._timeouts += 1
            return
        except USBError as error:
            self._recover(error)
            return
        if count:
            self._put(memoryview(self._buffer)[:count], self._now_ns())
        else:
            self._timeouts += 1

    def _recover(self, error: USBError) -> None:
        self._stalls += 1
        if error.errno != errno.EPIPE or self._stalls > MOST_STALLS:
            raise usb_failure(error, 'reading data') from error
        self._clear_halt()

    def _put(self, data: memoryview, arrival_ns: int) -> None:
        self._transfers += 1
        self._size += len(data)
        # Only this thread adds, so the queue cannot grow between this look and the append.
        if self._queued_size + len(data) > self._queue_size:
            self._dropped_transfers += 1
            self._dropped_size += len(data)
            self._gap += gap_of(data)
            return
        short = len(data) < len(self._buffer)
        transfer = Transfer(bytes(data), arrival_ns, short, self._gap)
        self._gap = Gap()
        with self._ready:
            self._queue.append(transfer)
            self._queued_size += len(data)
            self._most_queued_size = max(self._most_queued_size, self._queued_size)
            self._ready.notify()
