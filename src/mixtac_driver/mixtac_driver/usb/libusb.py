# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Asynchronous reads through libusb: many reads are queued at the endpoint at once.

pyusb knows libusb's structures but waits for one transfer at a time
(https://libusb.sourceforge.io/api-1.0/group__libusb__asyncio.html). The camera's own buffer holds
only a few milliseconds of data at full rate, and a Python process can be busy for longer. Meanwhile
the kernel fills the queued reads: 128 reads of 64 KiB hold 8 MiB, more than 100 ms at the sensor's
highest rate of about 65 MB/s. There is no reader thread: the consumer collects what has arrived
whenever it asks, because waking a thread for every transfer would cost more than the transfer
itself.
"""

from __future__ import annotations

import ctypes
import errno
import threading
import time
from collections.abc import Callable
from typing import Any

from usb.backend import libusb1
from usb.core import USBError

from mixtac_driver.errors import HungReadError, UsbError
from mixtac_driver.usb.protocol import usb_failure
from mixtac_driver.usb.transport import Transfer, TransferQueue

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
        self.size = size

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
ROOM_EVERY_S = 0.005
DRAIN_TIMEOUT_S = 2.0


class AsynchronousReader:
    """Keeps reads queued at the endpoint until stopped or until the camera goes away.

    Has the interface of `mixtac_driver.usb.transport.BulkReader`. `get` is for one thread; `stop`
    may be called from another. libusb may call back in any thread that makes a request of it.

    Args:
        port: The camera, open and claimed.
        endpoint: Address of the data endpoint.
        clear_halt: Clears a stall of the endpoint.
        transfers: Number of queued reads.
        transfer_size: Bytes requested per read.
        queue_size: Limit of received bytes waiting for the consumer.

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
        queue_size: int = 32 << 20,
    ) -> None:
        self._port, self._clear_halt = port, clear_halt
        self._endpoint = endpoint
        self._count, self._transfer_size = transfers, transfer_size
        self._queue = TransferQueue(queue_size)
        self.counters = self._queue.counters
        self._stopping = threading.Event()
        self._transfers: list[BulkTransfer] = []
        self._waiting: set[BulkTransfer] = set()
        self._failure: USBError | None = None
        self._looked_s = 0.0

    def start(self) -> None:
        """Queue the reads at the endpoint.

        Raises:
            UsbError: The kernel does not accept them.
        """
        try:
            for _ in range(self._count):
                self._transfers.append(
                    BulkTransfer(self._port, self._endpoint, self._transfer_size, self._on_done)
                )
            self._submit_all()
        except USBError as error:
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
        self._stopping.set()
        try:
            self._call_back()
        except USBError as error:
            self._failure = self._failure or error
        if self._waiting:
            raise HungReadError(
                f'{len(self._waiting)} USB reads were not returned within {DRAIN_TIMEOUT_S} s',
                remedy='restart the driver; if this persists, unplug the camera',
            )
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
        if not self._stopping.is_set() and self._failure is None:
            self._look(timeout_s)
        transfer = self._queue.pop()
        if transfer is None and self._failure is not None and not self._stopping.is_set():
            self._recover(self._failure)
        return transfer

    def _look(self, timeout_s: float) -> None:
        """Collect finished reads; with a backlog, only make room in the kernel."""
        now_s = time.monotonic()
        if len(self._queue):
            if now_s < self._looked_s + ROOM_EVERY_S:
                return
            timeout_s = 0.0
        self._looked_s = now_s
        try:
            self._port.handle_events(min(timeout_s, LONGEST_WAIT_S))
        except USBError as error:
            self._failure = error

    def _on_done(self, transfer: BulkTransfer) -> None:
        self._waiting.discard(transfer)
        status, data = transfer.status, transfer.data
        if status == COMPLETED:
            self._submit_again(transfer)
        elif status != CANCELLED and self._failure is None:
            number = _ERRNO.get(status, errno.EIO)
            self._failure = USBError(f'transfer ended with status {status}', None, number)
        # A read that failed or was cancelled may hold data.
        if data:
            self._queue.put(data, time.time_ns(), short_packet=len(data) < transfer.size)

    def _submit_again(self, transfer: BulkTransfer) -> None:
        if self._stopping.is_set() or self._failure is not None:
            return
        try:
            transfer.submit()
            self._waiting.add(transfer)
        except USBError as error:
            self._failure = error

    def _submit_all(self) -> None:
        for transfer in self._transfers:
            transfer.submit()
            self._waiting.add(transfer)

    def _recover(self, error: USBError) -> None:
        """Clear a stall of the endpoint.

        Raises:
            UsbError: It was another failure, or there were too many consecutive stalls.
        """
        self._queue.note_failure(error)
        try:
            self._call_back()
            self._clear_halt()
            self._failure = None
            self._submit_all()
        except USBError as failure:
            raise usb_failure(failure, 'reading data') from failure

    def _call_back(self) -> None:
        """Cancel the queued reads and take them back."""
        deadline_s = time.monotonic() + DRAIN_TIMEOUT_S
        for transfer in list(self._waiting):
            transfer.cancel()
        while self._waiting and time.monotonic() < deadline_s:
            self._port.handle_events(LONGEST_WAIT_S)
