# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Register access over USB vendor requests, and USB failures as errors with a remedy.

| direction | request | value | index | data |
|---|---|---|---|---|
| write one | 0xBF | module | parameter | u32, big-endian |
| read one | 0xBF | module | parameter | u32, big-endian |
| write many | 0xC2 | number | 0 | per write u8 module, u8 parameter, u32 big-endian |
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

from usb.core import USBError, USBTimeoutError

from mixtac_driver.errors import (
    AccessError,
    BusError,
    DisconnectedError,
    InUseError,
    NoAnswerError,
    StallError,
    UsbError,
)


class Write(NamedTuple):
    """One register write.

    Attributes:
        module: Module number.
        parameter: Parameter number within the module.
        value: Unsigned 32-bit value.
    """

    module: int
    parameter: int
    value: int


REQUEST_ONE = 0xBF
REQUEST_MANY = 0xC2
VENDOR_OUT = 0x40
VENDOR_IN = 0xC0
CONTROL_TIMEOUT_MS = 500
"""A camera answers within a few ms."""
UDEV_REMEDY = (
    'install the rule share/mixtac_driver/65-mixtac.rules in /etc/udev/rules.d, '
    'run "udevadm control --reload" and reconnect the camera'
)
_RECONNECT = 'if this persists, unplug and reconnect the camera'
_CABLE = 'if this persists, use another cable or USB port'
_GONE = {errno.ENODEV, errno.ENOENT, errno.ENXIO, errno.ESHUTDOWN}
_BUS_FAILURE = (BusError, 'the USB transfer failed', _CABLE)
_FAILURES: dict[int | None, tuple[type[UsbError], str, str]] = {
    errno.EBUSY: (InUseError, 'the camera is in use', 'stop the other program that has it open'),
    errno.EPIPE: (StallError, 'the camera refused the request (stall)', _RECONNECT),
    errno.ETIMEDOUT: (NoAnswerError, f'no answer within {CONTROL_TIMEOUT_MS} ms', _RECONNECT),
    errno.EOVERFLOW: (BusError, 'the camera sent more than was requested', _CABLE),
    errno.EIO: _BUS_FAILURE,
    errno.EPROTO: _BUS_FAILURE,
    errno.EILSEQ: _BUS_FAILURE,
}


def usb_failure(error: USBError, doing: str) -> UsbError:
    """Return an error of pyusb as one of this package, with a remedy.

    Args:
        error: The error of pyusb.
        doing: The action that failed, as in 'reading register 6:0'.
    """
    number = errno.ETIMEDOUT if isinstance(error, USBTimeoutError) else error.errno
    if number in _GONE:
        return DisconnectedError(f'the camera was unplugged or switched off while {doing}')
    if number in {errno.EACCES, errno.EPERM}:
        return AccessError(f'no permission for {doing}', remedy=UDEV_REMEDY)
    kind, what, remedy = _FAILURES.get(number, (UsbError, str(error), ''))
    return kind(f'{doing}: {what}', remedy=remedy)


class Protocol:
    """Reads and writes registers of an open camera. May be used from several threads.

    A single read or write without an answer is repeated once, because repeating it is harmless.
    Several writes in one request may be a pulse and are not repeated.

    Args:
        device: A `usb.core.Device`.

    Attributes:
        failure: Error of the latest request that stayed unanswered, or None.
    """

    def __init__(self, device: Any) -> None:  # noqa: ANN401
        self.failure: NoAnswerError | None = None
        self._device = device

    def read(self, module: int, parameter: int) -> int:
        """Return the value of one register.

        Raises:
            UsbError: The request failed or its answer is not four bytes.
        """
        doing = f'reading register {int(module)}:{int(parameter)}'
        answer = self._transfer(VENDOR_IN, REQUEST_ONE, int(module), int(parameter), 4, doing)
        if len(answer) != 4:
            raise UsbError(f'{doing}: {len(answer)} bytes received instead of 4')
        return int.from_bytes(bytes(answer), 'big')

    def write(self, module: int, parameter: int, value: int) -> None:
        """Write one register.

        Raises:
            UsbError: The request failed.
        """
        self._out(REQUEST_ONE, int(module), int(parameter), struct.pack('>I', value))

    def write_each(self, writes: Sequence[Write]) -> None:
        """Write registers in order, one request each."""
        for module, parameter, value in writes:
            self.write(module, parameter, value)

    def write_at_once(self, writes: Sequence[Write]) -> None:
        """Write registers in order within one request, as close in time as possible.

        Raises:
            UsbError: The request failed.
        """
        data = b''.join(struct.pack('>BBI', *write) for write in writes)
        self._out(REQUEST_MANY, len(writes), 0, data)

    def _out(self, request: int, value: int, index: int, data: bytes) -> None:
        doing = (
            f'writing register {value}:{index}'
            if request == REQUEST_ONE
            else f'writing {value} registers at once'
        )
        self._transfer(VENDOR_OUT, request, value, index, data, doing)

    def _transfer(
        self, kind: int, request: int, value: int, index: int, data: bytes | int, doing: str
    ) -> Any:  # noqa: ANN401
        arguments = (kind, request, value, index, data, CONTROL_TIMEOUT_MS)
        try:
            try:
                return self._device.ctrl_transfer(*arguments)
            except USBTimeoutError:
                if request != REQUEST_ONE:
                    raise
                return self._device.ctrl_transfer(*arguments)
        except USBError as error:
            failure = usb_failure(error, doing)
            if isinstance(failure, NoAnswerError):
                self.failure = failure
            raise failure from error
