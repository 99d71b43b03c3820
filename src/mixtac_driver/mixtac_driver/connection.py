# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""An open camera on the USB: configured, claimed, ready for registers and data."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import usb.util
from usb.core import USBError

from mixtac_driver.backend import find_camera, open_backend
from mixtac_driver.errors import InUseError
from mixtac_driver.libusb_transfers import LibusbPort
from mixtac_driver.protocol import Protocol, usb_failure
from mixtac_driver.reads_in_progress import ReadsInProgress

if TYPE_CHECKING:
    from array import array

DATA_ENDPOINT = 0x82
DEBUG_ENDPOINT = 0x81
CONFIGURATION = 1
INTERFACE = 0
LAST_READ_S = 0.3
"""How long a read may take to end by itself; reads of this driver wait 0.1 s for data."""
STUCK_READ_S = 1.0
"""How long it may take after the port was reset."""
_abandoned: list[Any] = []
"""Devices with a read that never returned: closing them could crash the process."""


class Connection:
    """Opens a camera; close it when done.

    Args:
        device: Device string (see `mixtac_driver.backend`).
        serial: Serial number, or empty for the only camera.
        preferred: Serial number of the camera to take where several are attached and `serial` is
            empty.
        backend: A pyusb backend to use instead of the one that `device` names.

    Attributes:
        serial: Serial number of the camera.
        protocol: Register access.

    Raises:
        UnknownDeviceError: Nothing is known by that device string.
        NoCameraError: No such camera is attached.
        UsbError: It cannot be opened.
    """

    def __init__(
        self,
        device: str,
        serial: str = '',
        backend: Any = None,  # noqa: ANN401
        preferred: str = '',
    ) -> None:
        self._backend = open_backend(device) if backend is None else backend
        self._device, self.serial = find_camera(self._backend, device, serial, preferred)
        self._reads = ReadsInProgress()
        self.protocol = Protocol(self._device)
        try:
            self._claim()
        except USBError as error:
            self.close()
            failure = usb_failure(error, 'claiming the camera')
            if _abandoned and isinstance(failure, InUseError):
                failure = InUseError(
                    'a read of the camera never returned and still holds it; restart the driver'
                )
            raise failure from error

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

    def check(self) -> None:
        """Make sure that the camera still answers requests, whoever made them.

        Raises:
            NoAnswerError: It did not, lately; whether it obeyed is not known, so open it again.
        """
        if self.protocol.failure is not None:
            raise self.protocol.failure

    def libusb_port(self) -> LibusbPort | None:
        """Return the camera as libusb knows it, or None where another backend serves it."""
        return LibusbPort.of(self._device)

    def read_data(self, buffer: array[int], timeout_ms: int) -> int:
        """Read from the data endpoint into a buffer; return the number of bytes.

        Raises:
            usb.core.USBError: As pyusb raises it; a time-out is a USBTimeoutError.
        """
        with self._reads:
            return int(self._device.read(DATA_ENDPOINT, buffer, timeout_ms))

    def read_debug(self, buffer: array[int], timeout_ms: int) -> int:
        """Read from the debug endpoint into a buffer; return the number of bytes.

        Raises:
            usb.core.USBError: As pyusb raises it; a time-out is a USBTimeoutError.
            ValueError: The camera has no such endpoint.
        """
        with self._reads:
            return int(self._device.read(DEBUG_ENDPOINT, buffer, timeout_ms))

    def close(self) -> None:
        """Give the camera back; harmless when it is gone.

        A read that does not return is ended by a reset of the port. Where not even that ends it,
        the camera stays claimed until the process ends, because its handle is in use.
        """
        if not self._reads.wait(LAST_READ_S) and not self._end_reads():
            _abandoned.append(self._device)
            return
        with contextlib.suppress(USBError):
            usb.util.dispose_resources(self._device)

    def _end_reads(self) -> bool:
        with contextlib.suppress(USBError, NotImplementedError):
            # Not Device.reset: it closes the handle, which the read still uses.
            context = self._device._ctx  # noqa: SLF001
            context.backend.reset_device(context.handle)
        return self._reads.wait(STUCK_READ_S)

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
