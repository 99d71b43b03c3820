# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Asynchronous bulk transfers through the libusb that pyusb has loaded.

pyusb knows the structures but only waits for one transfer at a time. Here any number wait at the
endpoint together. libusb 1.0 API, https://libusb.sourceforge.io/api-1.0/group__libusb__asyncio.html
"""

from __future__ import annotations

import ctypes
import errno
from typing import TYPE_CHECKING, Any

from usb.backend import libusb1
from usb.core import USBError

if TYPE_CHECKING:
    from collections.abc import Callable

BULK = 2
COMPLETED, FAILED, TIMED_OUT, CANCELLED, STALLED, NO_DEVICE, OVERFLOW = range(7)
"""Status of a finished transfer (enum libusb_transfer_status)."""
_ERRNO = {
    FAILED: errno.EIO,
    TIMED_OUT: errno.ETIMEDOUT,
    CANCELLED: errno.ECANCELED,
    STALLED: errno.EPIPE,
    NO_DEVICE: errno.ENODEV,
    OVERFLOW: errno.EOVERFLOW,
}
_INTERRUPTED = -10
_abandoned: list[Any] = []
"""Transfers that the kernel never gave back: freeing their memory would let it write anywhere."""


class _Time(ctypes.Structure):
    _fields_ = (('seconds', ctypes.c_long), ('microseconds', ctypes.c_long))


class LibusbPort:
    """An open camera as libusb knows it.

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
        on_done: Called in `LibusbPort.handle_events` when it finished, however it did.
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
        # Kept here, because libusb does not: ctypes frees a callback nobody refers to.
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
        """How it finished."""
        return int(self._fields.status)

    @property
    def data(self) -> bytes:
        """What it brought, copied."""
        return ctypes.string_at(self._address, self._fields.actual_length)

    def submit(self) -> None:
        """Let it wait at the endpoint.

        Raises:
            usb.core.USBError: It was not accepted.
        """
        code = self._lib.libusb_submit_transfer(self._pointer)
        if code:
            raise usb_error(code)

    def cancel(self) -> None:
        """Ask for it back; it finishes as cancelled unless it finishes otherwise before."""
        self._lib.libusb_cancel_transfer(self._pointer)

    def free(self) -> None:
        """Give its memory back; it must not be waiting."""
        self._lib.libusb_free_transfer(self._pointer)

    def abandon(self) -> None:
        """Keep its memory for ever, because the kernel may still write to it."""
        _abandoned.append(self)


def usb_error(code: int) -> USBError:
    """Return pyusb's error for a libusb error code."""
    number = libusb1._libusb_errno.get(code)  # noqa: SLF001
    return USBError(f'libusb error {code}', code, number)


def transfer_error(status: int) -> USBError:
    """Return pyusb's error for the status of a transfer that brought nothing."""
    number = _ERRNO.get(status, errno.EIO)
    return USBError(f'transfer ended with status {status}', None, number)
