# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading the data endpoint one transfer after the other, as every pyusb backend can.

Between two reads nobody asks the camera for data. For a camera on USB `AsynchronousReader` keeps
many reads waiting instead; this one serves the backends that know no asynchronous transfers, which
have room for more than a camera has.
"""

from __future__ import annotations

import errno
import threading
import time
from array import array
from typing import TYPE_CHECKING

from usb.core import USBError, USBTimeoutError

from mixtac_driver.errors import UsbError
from mixtac_driver.protocol import usb_failure
from mixtac_driver.transfer_queue import TransferQueue

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_driver.transfer_queue import Transfer, TransportCounters

POLL_S = 0.1
"""Longest read: so late `stop` is noticed in another thread."""
MOST_STALLS = 5
"""Stalls in a row after which clearing them is given up."""


class BulkReader:
    """Reads whenever it is asked for data.

    Args:
        read: Reads into a buffer within a time [ms] and returns the number of bytes; raises as
            pyusb does.
        clear_halt: Sets a stalled endpoint going again.
        transfer_size: Bytes asked for per read.
        now_ns: Host clock [ns since the Unix epoch].
    """

    def __init__(
        self,
        read: Callable[[array[int], int], int],
        clear_halt: Callable[[], None],
        *,
        transfer_size: int = 65536,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._read = read
        self._clear_halt = clear_halt
        self._buffer = array('B', bytes(transfer_size))
        self._queue = TransferQueue(transfer_size)
        self._now_ns = now_ns
        self._stopping = threading.Event()
        self._timeouts = self._stalls = self._stalls_in_a_row = 0

    @property
    def counters(self) -> TransportCounters:
        """What the reader did so far."""
        return self._queue.counters(timeouts=self._timeouts, stalls=self._stalls)

    def start(self) -> None:
        """Do nothing: reading begins with the first `get`."""

    def stop(self) -> None:
        """Let no further read begin; one that another thread waits in ends at its time-out."""
        self._stopping.set()

    def get(self, timeout_s: float) -> Transfer | None:
        """Return the next transfer, or None when none came in time or reading was stopped.

        Args:
            timeout_s: Longest time to wait [s]; it may come back empty before.

        Raises:
            UsbError: Reading failed, or the camera is gone.
        """
        if self._stopping.is_set():
            return None
        try:
            count = self._read(self._buffer, max(round(min(timeout_s, POLL_S) * 1000), 1))
        except USBTimeoutError:
            count = 0
        except USBError as error:
            self._recover(error)
            return None
        except OSError as error:
            raise UsbError(f'reading data: {error}') from error
        if not count:
            self._timeouts += 1
            return None
        self._stalls_in_a_row = 0
        data = bytes(memoryview(self._buffer)[:count])
        self._queue.put(data, self._now_ns(), short_packet=count < len(self._buffer))
        return self._queue.pop()

    def _recover(self, error: USBError) -> None:
        self._stalls += 1
        self._stalls_in_a_row += 1
        if error.errno != errno.EPIPE or self._stalls_in_a_row > MOST_STALLS:
            raise usb_failure(error, 'reading data') from error
        self._clear_halt()
