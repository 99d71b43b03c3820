# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Register access over USB vendor requests, and the errors of USB in clear words.

| direction | request | value | index | data |
|---|---|---|---|---|
| write one | 0xBF | module | parameter | u32, big-endian |
| read one | 0xBF | module | parameter | u32, big-endian |
| write many | 0xC2 | number | 0 | per write u8 module, u8 parameter, u32 big-endian |
"""

from __future__ import annotations

import errno
import struct
from typing import TYPE_CHECKING, Any

from usb.core import USBError, USBTimeoutError

from mixtac_driver.errors import DisconnectedError, UsbError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_driver.registers import Write

REQUEST_ONE = 0xBF
REQUEST_MANY = 0xC2
VENDOR_OUT = 0x40
VENDOR_IN = 0xC0
CONTROL_TIMEOUT_MS = 1000

UDEV_REMEDY = (
    'install the rule share/mixtac_driver/udev/65-mixtac.rules in /etc/udev/rules.d, '
    'run "udevadm control --reload" and plug the camera in again'
)


def usb_failure(error: USBError, doing: str) -> UsbError:
    """Return an error of pyusb as one of ours, with what to do about it.

    Args:
        error: What pyusb raised.
        doing: What was tried, as in 'reading register 6:0'.
    """
    if error.errno in {errno.ENODEV, errno.ESHUTDOWN}:
        return DisconnectedError(f'the camera was unplugged or switched off while {doing}')
    if error.errno in {errno.EACCES, errno.EPERM}:
        return UsbError(f'no permission for {doing}: {UDEV_REMEDY}')
    if error.errno == errno.EBUSY:
        return UsbError(f'{doing}: the camera is in use; stop the other program that has it open')
    if error.errno == errno.EPIPE:
        return UsbError(f'{doing}: the camera refused the request (stall)')
    if isinstance(error, USBTimeoutError):
        return UsbError(f'{doing}: no answer within {CONTROL_TIMEOUT_MS} ms; plug the camera anew')
    return UsbError(f'{doing}: {error}')


class Protocol:
    """Reads and writes registers of an open camera. May be used from several threads.

    Args:
        device: A `usb.core.Device`.
    """

    def __init__(self, device: Any) -> None:  # noqa: ANN401
        self._device = device

    def read(self, module: int, parameter: int) -> int:
        """Return the value of one register.

        Raises:
            UsbError: The request failed or its answer is not four bytes.
        """
        doing = f'reading register {int(module)}:{int(parameter)}'
        try:
            answer = self._device.ctrl_transfer(
                VENDOR_IN, REQUEST_ONE, int(module), int(parameter), 4, CONTROL_TIMEOUT_MS
            )
        except USBError as error:
            raise usb_failure(error, doing) from error
        if len(answer) != 4:
            raise UsbError(f'{doing}: {len(answer)} bytes came instead of 4')
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
        """Write registers in order within one request, so close in time as can be.

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
        try:
            self._device.ctrl_transfer(VENDOR_OUT, request, value, index, data, CONTROL_TIMEOUT_MS)
        except USBError as error:
            raise usb_failure(error, doing) from error
