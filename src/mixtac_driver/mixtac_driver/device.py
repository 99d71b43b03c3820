# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Find, open and claim a camera on the USB bus.

A device string that names a camera model (`davis346`) is a real camera, reached through libusb. Any
other name is looked up, by the part before the colon, among the entry points of the group
`mixtac.usb_backends`: callables that take the device string and return a pyusb backend. Behind a
backend, a camera of any model is accepted.
"""

from __future__ import annotations

import contextlib
import importlib.util
from array import array
from importlib.metadata import entry_points
from typing import Any

import usb.core
import usb.util
from usb.core import USBError

from mixtac_core.events.errors import MixtacError
from mixtac_driver.davis346.model import camera_models, models_for
from mixtac_driver.errors import NoCameraError, UnknownDeviceError, UsbError
from mixtac_driver.usb.libusb import LibusbPort
from mixtac_driver.usb.protocol import Protocol, usb_failure

GROUP = 'mixtac.usb_backends'


def is_real(device: str) -> bool:
    """Return whether a device string names a camera on USB."""
    return any(device == model.name for model in models_for(device))


def _backends() -> list[str]:
    return sorted({point.name for point in entry_points(group=GROUP)})


def check_device(device: str) -> None:
    """Check that a device string names a camera model or a USB backend.

    Raises:
        UnknownDeviceError: It names neither; the error lists the known names.
    """
    if is_real(device) or device.partition(':')[0] in _backends():
        return
    known = dict.fromkeys([*(model.name for model in camera_models()), *_backends()])
    raise UnknownDeviceError(
        f'device {device!r} is unknown', remedy=f'use one of {", ".join(known)}'
    )


def open_backend(device: str) -> Any:  # noqa: ANN401
    """Return the pyusb backend (`usb.backend.IBackend`) behind a device string.

    Raises:
        UnknownDeviceError: Nothing of that name is known.
        UsbError: libusb is not installed.
    """
    check_device(device)
    if is_real(device):
        return _libusb()
    name = device.partition(':')[0]
    (point, *_) = entry_points(group=GROUP, name=name)
    return point.load()(device)


def _libusb() -> Any:  # noqa: ANN401
    if importlib.util.find_spec('libusb_package') is not None:
        import libusb_package

        backend = libusb_package.get_libusb1_backend()
    else:
        from usb.backend import libusb1

        backend = libusb1.get_backend()
    if backend is None:
        raise UsbError(
            'libusb is missing', remedy='install libusb-1.0-0, or "pip install libusb-package"'
        )
    return backend


def attached_cameras(
    device: str,
    backend: Any = None,  # noqa: ANN401
) -> frozenset[tuple[int, int]]:
    """Return bus and address of every camera that is attached, without opening any.

    A camera that is plugged in again has another address. None is returned where the search fails.

    Args:
        device: Device string.
        backend: A pyusb backend to use instead of the one that `device` names.
    """
    try:
        found = _all_cameras(open_backend(device) if backend is None else backend, device)
    except MixtacError:
        return frozenset()
    return frozenset((int(camera.bus or 0), int(camera.address or 0)) for camera in found)


def find_camera(
    backend: Any,  # noqa: ANN401
    device: str,
    serial: str = '',
    preferred: str = '',
) -> tuple[Any, str]:
    """Return the wanted camera as a `usb.core.Device`, and its serial number.

    Args:
        backend: A pyusb backend.
        device: Device string, for messages.
        serial: Serial number of the wanted camera; empty for the only one.
        preferred: Serial number to prefer where `serial` is empty and there are several cameras.

    Raises:
        NoCameraError: No camera, none with that number, or several and no number was given.
        UsbError: A camera may not be opened, and the wanted one is not among the others.
    """
    found = _all_cameras(backend, device)
    if not found:
        raise _none_found(device)
    chosen = None
    try:
        chosen, number = _choose(found, serial, preferred)
        return chosen, number
    finally:
        for camera in found:
            if camera is not chosen:
                with contextlib.suppress(USBError):
                    usb.util.dispose_resources(camera)


def _all_cameras(backend: Any, device: str) -> list[Any]:  # noqa: ANN401
    ids = {(model.vendor, model.product) for model in models_for(device)}
    try:
        return list(
            usb.core.find(
                find_all=True,
                custom_match=lambda each: (each.idVendor, each.idProduct) in ids,
                backend=backend,
            )
        )
    except USBError as error:
        raise usb_failure(error, 'looking for cameras') from error


def _choose(found: list[Any], serial: str, preferred: str) -> tuple[Any, str]:
    by_serial: dict[str, Any] = {}
    failure = None
    for camera in found:
        try:
            by_serial[_serial_of(camera)] = camera
        except UsbError as error:
            # Another program may hold this one, and the wanted one may be free.
            failure = error
    wanted = serial or preferred
    if wanted in by_serial:
        return by_serial[wanted], wanted
    if failure is not None:
        raise failure
    listed = ', '.join(by_serial)
    if serial:
        raise NoCameraError(
            f'no camera has the serial number {serial!r}', remedy=f'use one of {listed}'
        )
    if len(found) > 1:
        raise NoCameraError(
            f'{len(found)} cameras are attached ({listed})',
            remedy='choose one by its serial number',
        )
    ((number, camera),) = by_serial.items()
    return camera, number


def _none_found(device: str) -> NoCameraError:
    if not is_real(device):
        return NoCameraError(
            f'no camera is behind device {device!r}', remedy='start the program that serves it'
        )
    ((vendor, product),) = {(model.vendor, model.product) for model in models_for(device)}
    return NoCameraError(
        f'no {device.upper()} (USB {vendor:04x}:{product:04x}) is attached',
        remedy='plug one in, or use device:=virtual for the virtual sensor',
    )


def _serial_of(camera: Any) -> str:  # noqa: ANN401
    try:
        camera.get_active_configuration()
    except USBError as error:
        # An unconfigured camera gives no error number, but still reports its serial number.
        if error.errno is not None:
            raise usb_failure(error, 'opening the camera') from error
    try:
        return str(camera.serial_number or '')
    except USBError as error:
        raise usb_failure(error, 'reading the serial number') from error
    except ValueError:
        return ''


DATA_ENDPOINT = 0x82
CONFIGURATION = 1
INTERFACE = 0


class Connection:
    """Opens a camera; close it when done.

    Args:
        device: Device string (see `mixtac_driver.device`).
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
        """Clear a halt of the data endpoint.

        Raises:
            UsbError: The request failed.
        """
        try:
            self._device.clear_halt(DATA_ENDPOINT)
        except USBError as error:
            raise usb_failure(error, 'clearing the data endpoint') from error

    def check(self) -> None:
        """Raise if the camera left a request unanswered, in any thread.

        Raises:
            NoAnswerError: A request got no answer. The camera may or may not have executed it:
                close the camera and open it again.
        """
        if self.protocol.failure is not None:
            raise self.protocol.failure

    def libusb_port(self) -> LibusbPort | None:
        """Return the libusb handle of the camera, or None where another backend serves it."""
        return LibusbPort.of(self._device)

    def read(self, endpoint: int, buffer: array[int], timeout_ms: int) -> int:
        """Read from an endpoint into a buffer; return the number of bytes.

        Raises:
            usb.core.USBError: As pyusb raises it; a time-out is a USBTimeoutError.
            ValueError: The camera has no such endpoint.
        """
        return int(self._device.read(endpoint, buffer, timeout_ms))

    def close(self) -> None:
        """Close the camera; harmless when it is gone. No read may be in progress."""
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
