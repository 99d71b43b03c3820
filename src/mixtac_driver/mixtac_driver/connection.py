# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""An open camera on the USB: configured, claimed, ready for registers and data."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import usb.util
from usb.core import USBError

from mixtac_driver.backend import find_camera, open_backend
from mixtac_driver.protocol import Protocol, usb_failure

if TYPE_CHECKING:
    from array import array

DATA_ENDPOINT = 0x82
CONFIGURATION = 1
INTERFACE = 0


class Connection:
    """Opens a camera; close it when done.

    Args:
        device: Device string (see `mixtac_driver.backend`).
        serial: Serial number, or empty for the only camera.
        backend: A pyusb backend to use instead of the one that `device` names.

    Attributes:
        serial: Serial number of the camera.
        protocol: Register access.

    Raises:
        UnknownDeviceError: Nothing is known by that device string.
        NoCameraError: No such camera is attached.
        UsbError: It cannot be opened.
    """

    def __init__(self, device: str, serial: str = '', backend: Any = None) -> None:  # noqa: ANN401
        self._backend = open_backend(device) if backend is None else backend
        self._device, self.serial = find_camera(self._backend, device, serial)
        self.protocol = Protocol(self._device)
        try:
            self._claim()
        except USBError as error:
            self.close()
            raise usb_failure(error, 'claiming the camera') from error

    @property
    def bcd_device(self) -> int:
        """Release number from the device descriptor: the firmware version."""
        return int(self._device.bcdDevice)

    def clear_halt(self) -> None:
        """Set the data endpoint going.

        Raises:
            UsbError: The request failed.
        """
        try:
            self._device.clear_halt(DATA_ENDPOINT)
        except USBError as error:
            raise usb_failure(error, 'clearing the data endpoint') from error

    def read_data(self, buffer: array[int], timeout_ms: int) -> int:
        """Read from the data endpoint into a buffer; return the number of bytes.

        Raises:
            usb.core.USBError: As pyusb raises it; a time-out is a USBTimeoutError.
        """
        return int(self._device.read(DATA_ENDPOINT, buffer, timeout_ms))

    def close(self) -> None:
        """Give the camera back; harmless when it is gone."""
        with contextlib.suppress(USBError):
            usb.util.dispose_resources(self._device)

    def _claim(self) -> None:
        if self._active_configuration() != CONFIGURATION:
            self._device.set_configuration(CONFIGURATION)
        usb.util.claim_interface(self._device, INTERFACE)

    def _active_configuration(self) -> int:
        try:
            return int(self._device.get_active_configuration().bConfigurationValue)
        except USBError as error:
            if error.errno is not None:
                raise
            return 0
