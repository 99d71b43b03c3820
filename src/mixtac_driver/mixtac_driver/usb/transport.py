# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Transfers of the data endpoint, their counters, and a reader of one transfer at a time.

`BulkReader` serves the pyusb backends that have no asynchronous transfers; a camera on USB is read
by `mixtac_driver.usb.libusb.AsynchronousReader`.
"""

from __future__ import annotations

import errno
import threading
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass

from usb.core import USBError, USBTimeoutError

from mixtac_driver.errors import UsbError
from mixtac_driver.usb.protocol import usb_failure

MOST_STALLS = 5
"""Consecutive stalls after which clearing them is given up."""


@dataclass(frozen=True, slots=True, eq=False)
class Transfer:
    """The data of one read.

    Attributes:
        data: Bytes.
        arrival_ns: Host time of arrival [ns since the Unix epoch].
    """

    data: bytes
    arrival_ns: int


@dataclass(slots=True)
class TransportCounters:
    """Counters of a reader. Each is written by one thread at a time.

    Attributes:
        size: Bytes received.
        stalls: Stalls of the endpoint.
        stalls_in_a_row: Stalls since the latest data.
    """

    size: int = 0
    stalls: int = 0
    stalls_in_a_row: int = 0

    def add(self, data: bytes) -> Transfer:
        """Count data that arrived now, and return them."""
        self.size += len(data)
        self.stalls_in_a_row = 0
        return Transfer(data, time.time_ns())

    def add_failure(self, error: USBError) -> None:
        """Count a failed read: a few stalls in a row may be cleared.

        Raises:
            UsbError: It was no stall, or there were too many.
        """
        self.stalls += 1
        self.stalls_in_a_row += 1
        if error.errno != errno.EPIPE or self.stalls_in_a_row > MOST_STALLS:
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
        self.counters = TransportCounters()
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
            self.counters.add_failure(error)
            self._clear_halt()
            return None
        except OSError as error:
            raise UsbError(f'reading data: {error}') from error
        if not count:
            return None
        data = bytes(memoryview(self._buffer)[:count])
        return self.counters.add(data)
