# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Asynchronous reads through libusb: many reads are queued at the endpoint at once.

pyusb knows libusb's structures but waits for one transfer at a time
(https://libusb.sourceforge.io/api-1.0/group__libusb__asyncio.html). The camera's own buffer holds
only a few milliseconds of data at full rate, and a Python process can be busy for longer. Meanwhile
the kernel fills the queued reads: 128 reads of 64 KiB hold 8 MiB, more than 100 ms at the sensor's
highest rate of about 65 MB/s. Where the camera sends early, in short packets, each of them takes up
a read: 128 reads then hold 26 ms at a packet every 200 us.

There is no reader thread: the consumer collects what has arrived whenever it asks, because waking a
thread for every transfer would cost more than the transfer itself. A read is queued again once the
consumer has its data: where the consumer is too slow, all reads are full, and the camera itself
drops and counts events.
"""

from __future__ import annotations

import ctypes
import errno
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from usb.backend import libusb1
from usb.core import USBError

from mixtac_driver.errors import HungReadError, UsbError
from mixtac_driver.usb.protocol import usb_failure
from mixtac_driver.usb.transport import Transfer, TransportCounters

BULK = 2
"""Type of a bulk transfer (enum libusb_transfer_type)."""
COMPLETED = 0
"""Status of a transfer that ended as it should (enum libusb_transfer_status)."""
CANCELLED = 3
"""Status of a cancelled transfer."""
_ERRNO = {2: errno.ETIMEDOUT, 4: errno.EPIPE, 5: errno.ENODEV, 6: errno.EOVERFLOW}
"""Error number by status: time-out, stall, no device, overflow; others are input/output errors."""
_INTERRUPTED = -10


class _Time(ctypes.Structure):
    _fields_ = (('seconds', ctypes.c_long), ('microseconds', ctypes.c_long))


class LibusbPort:
    """The libusb handle of an open camera.

    Args:
        lib: The library.
        context: Its context.
        handle: The handle of the device.
    """

    def __init__(self, lib: Any, context: Any, handle: Any) -> None:  # noqa: ANN401
        self.lib, self.context, self.handle = lib, context, handle

    @classmethod
    def of(cls, device: Any) -> LibusbPort | None:  # noqa: ANN401
        """Return the port of an open `usb.core.Device`, or None if it is not one of libusb's."""
        backend = getattr(device, 'backend', None)
        if not isinstance(backend, libusb1._LibUSB):  # noqa: SLF001  (pyusb has no public way)
            return None
        device._ctx.managed_open()  # noqa: SLF001
        return cls(backend.lib, backend.ctx, device._ctx.handle.handle)  # noqa: SLF001

    def handle_events(self, timeout_s: float) -> None:
        """Wait for transfers to finish and call their callbacks.

        Args:
            timeout_s: Longest time to wait [s].

        Raises:
            usb.core.USBError: libusb failed.
        """
        time = _Time(int(timeout_s), int(timeout_s % 1 * 1e6))
        code = self.lib.libusb_handle_events_timeout(self.context, ctypes.byref(time))
        if code not in (0, _INTERRUPTED):
            raise usb_error(code)


class BulkTransfer:
    """One transfer that can be submitted again and again.

    Args:
        port: The camera.
        endpoint: Address of a bulk endpoint that sends to the host.
        size: Bytes to ask for.
        on_done: Called in `LibusbPort.handle_events` when it finished, in any way.
    """

    def __init__(
        self,
        port: LibusbPort,
        endpoint: int,
        size: int,
        on_done: Callable[[BulkTransfer], None],
    ) -> None:
        self._lib = port.lib
        self._buffer = (ctypes.c_ubyte * size)()
        self._address = ctypes.addressof(self._buffer)
        self._pointer = port.lib.libusb_alloc_transfer(0)
        if not self._pointer:
            raise USBError('no memory for a transfer', -11, errno.ENOMEM)
        # Kept here, because ctypes frees a callback without references.
        self._callback = libusb1._libusb_transfer_cb_fn_p(lambda _pointer: on_done(self))  # noqa: SLF001
        self._fields = fields = self._pointer.contents
        fields.dev_handle = port.handle
        fields.endpoint = endpoint
        fields.type = BULK
        fields.timeout = 0
        fields.length = size
        fields.buffer = self._address
        fields.callback = self._callback

    @property
    def status(self) -> int:
        """Status after it finished."""
        return int(self._fields.status)

    @property
    def data(self) -> bytes:
        """A copy of its data."""
        return ctypes.string_at(self._address, self._fields.actual_length)

    def submit(self) -> None:
        """Queue it at the endpoint.

        Raises:
            usb.core.USBError: It was not accepted.
        """
        code = self._lib.libusb_submit_transfer(self._pointer)
        if code:
            raise usb_error(code)

    def cancel(self) -> None:
        """Request its cancellation; it may still finish in another way."""
        self._lib.libusb_cancel_transfer(self._pointer)

    def free(self) -> None:
        """Free its memory; it must not be queued."""
        self._lib.libusb_free_transfer(self._pointer)


def usb_error(code: int) -> USBError:
    """Return pyusb's error for a libusb error code."""
    number = libusb1._libusb_errno.get(code)  # noqa: SLF001
    return USBError(f'libusb error {code}', code, number)


LONGEST_WAIT_S = 0.05
"""Longest wait for data [s]: a `stop` in another thread ends the wait within it."""
LOOK_PERIOD_S = 0.005
"""Time after which finished reads are fetched although others wait to be processed [s]."""
DRAIN_TIMEOUT_S = 2.0
"""Longest wait for the kernel to return cancelled reads [s]."""


class AsynchronousReader:
    """Keeps reads queued at the endpoint until stopped or until the camera goes away.

    Has the interface of `mixtac_driver.usb.transport.BulkReader`. `get` is for one thread; `stop`
    may be called from another. libusb may call back in any thread that makes a request of it.

    Args:
        port: The camera, open and claimed.
        endpoint: Address of the data endpoint.
        clear_halt: Clears a stall of the endpoint.
        transfers: Number of reads.
        transfer_size: Bytes requested per read.

    Attributes:
        counters: Counters since construction.
    """

    def __init__(
        self,
        port: LibusbPort,
        endpoint: int,
        clear_halt: Callable[[], None],
        *,
        transfers: int = 128,
        transfer_size: int = 65536,
    ) -> None:
        self._port, self._clear_halt = port, clear_halt
        self._endpoint = endpoint
        self._count, self._transfer_size = transfers, transfer_size
        self.counters = TransportCounters()
        self._transfers: list[BulkTransfer] = []
        self._queued: set[BulkTransfer] = set()
        self._done: deque[tuple[BulkTransfer, Transfer]] = deque()
        self._failure: USBError | None = None
        self._looked_s = 0.0
        self._stopped = False
        # After `stop` has set `_stopped` under this lock, no read is queued any more.
        self._submitting = threading.Lock()

    def start(self) -> None:
        """Queue the reads at the endpoint.

        Raises:
            UsbError: The kernel does not accept them.
        """
        for _ in range(self._count):
            self._transfers.append(
                BulkTransfer(self._port, self._endpoint, self._transfer_size, self._on_done)
            )
        self._submit(*self._transfers)
        error = self._failure
        if error is not None:
            self.stop()
            if error.errno == errno.ENOMEM:
                raise UsbError(
                    f'the kernel has no room for {self._count} USB reads of {self._transfer_size} '
                    'bytes; lower usb_transfers, or raise '
                    '/sys/module/usbcore/parameters/usbfs_memory_mb'
                ) from error
            raise usb_failure(error, 'queueing reads') from error

    def stop(self) -> None:
        """Cancel the reads and free their memory; received data can still be got.

        Raises:
            HungReadError: The kernel does not return the reads and may still write to their memory,
                which is therefore kept.
        """
        with self._submitting:
            self._stopped = True
        try:
            self._call_back()
        except USBError as error:
            self._failure = self._failure or error
            self._check_returned()
        transfers, self._transfers = self._transfers, []
        for transfer in transfers:
            transfer.free()

    def get(self, timeout_s: float) -> Transfer | None:
        """Return the next transfer, or None if none came in time or reading was stopped.

        Args:
            timeout_s: Longest time to wait [s]; may return None earlier.

        Raises:
            UsbError: Reading failed, and all data received before were taken.
        """
        # With a backlog, too: the time at which a read is fetched is its time of arrival.
        late = time.monotonic() > self._looked_s + LOOK_PERIOD_S
        if (late or not self._done) and not self._stopped and self._failure is None:
            self._looked_s = time.monotonic()
            try:
                self._port.handle_events(0.0 if self._done else min(timeout_s, LONGEST_WAIT_S))
            except USBError as error:
                self._failure = error
        if self._done:
            read, transfer = self._done.popleft()
            self._submit(read)
            return transfer
        if self._failure is not None and not self._stopped:
            self._recover(self._failure)
        return None

    def _on_done(self, read: BulkTransfer) -> None:
        status, data = read.status, read.data
        self._queued.discard(read)
        if status not in (COMPLETED, CANCELLED) and self._failure is None:
            number = _ERRNO.get(status, errno.EIO)
            self._failure = USBError(f'transfer ended with status {status}', None, number)
        # A read that failed or was cancelled may hold data.
        if data:
            self._done.append((read, self.counters.add(data)))
        elif status == COMPLETED:
            self._submit(read)

    def _submit(self, *reads: BulkTransfer) -> None:
        for read in reads:
            with self._submitting:
                if self._stopped or self._failure is not None:
                    return
                self._queued.add(read)
                try:
                    read.submit()
                except USBError as error:
                    self._queued.discard(read)
                    self._failure = error

    def _recover(self, error: USBError) -> None:
        """Clear a stall of the endpoint.

        Raises:
            UsbError: It was another failure, or there were too many consecutive stalls.
        """
        self.counters.add_failure(error)
        try:
            self._call_back()
            self._clear_halt()
        except USBError as failure:
            raise usb_failure(failure, 'reading data') from failure
        self._failure = None
        held = {read for read, _ in self._done}
        self._submit(*(read for read in self._transfers if read not in held))

    def _call_back(self) -> None:
        """Cancel the queued reads and take them back.

        Raises:
            HungReadError: The kernel does not return one.
        """
        deadline_s = time.monotonic() + DRAIN_TIMEOUT_S
        for read in list(self._queued):
            read.cancel()
        while self._queued and time.monotonic() < deadline_s:
            self._port.handle_events(LONGEST_WAIT_S)
        self._check_returned()

    def _check_returned(self) -> None:
        if self._queued:
            raise HungReadError(
                f'{len(self._queued)} USB reads were not returned within {DRAIN_TIMEOUT_S} s',
                remedy='restart the driver; if this persists, unplug the camera',
            )
