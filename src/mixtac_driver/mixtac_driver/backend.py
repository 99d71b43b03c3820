# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From a device string to a USB camera.

`davis346` is a real camera, reached through libusb. Any other name is looked up, by its part
before a colon, among the entry points of the group `mixtac.usb_backends`: callables that take the
device string and return a pyusb backend.
"""

from __future__ import annotations

import contextlib
import importlib.util
from importlib.metadata import entry_points
from typing import Any

import usb.core
import usb.util
from usb.core import USBError

from mixtac_driver.errors import NoCameraError, UnknownDeviceError, UsbError
from mixtac_driver.protocol import usb_failure
from mixtac_events.errors import MixtacError

GROUP = 'mixtac.usb_backends'
REAL = 'davis346'
VENDOR, PRODUCT = 0x152A, 0x841A


def is_real(device: str) -> bool:
    """Return whether a device string names a real camera."""
    return device == REAL


def known_devices() -> list[str]:
    """Return the names that `open_backend` knows."""
    return [REAL, *sorted({point.name for point in entry_points(group=GROUP)} - {REAL})]


def check_device(device: str) -> None:
    """Refuse a device string that names nothing known.

    Raises:
        UnknownDeviceError: As said; lists the known names.
    """
    if not is_real(device) and device.partition(':')[0] not in known_devices()[1:]:
        raise UnknownDeviceError(
            f'device {device!r} is unknown; known are {", ".join(known_devices())}'
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
        raise UsbError('libusb is missing: install libusb-1.0-0, or "pip install libusb-package"')
    return backend


def attached_cameras(
    device: str,
    backend: Any = None,  # noqa: ANN401
) -> frozenset[tuple[int, int]]:
    """Return bus and address of every camera that is attached, without opening any.

    Plugging a camera in again gives it another address. No camera is returned where none can be
    looked for.

    Args:
        device: Device string.
        backend: A pyusb backend to use instead of the one that `device` names.
    """
    try:
        found = _all_cameras(open_backend(device) if backend is None else backend)
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
        serial: Serial number of the wanted camera; empty takes the only one there is.
        preferred: Serial number of the one to take where `serial` is empty and there are several.

    Raises:
        NoCameraError: There is none, none with that number, or several and no number was given.
        UsbError: A camera may not be opened, and the wanted one is not among the others.
    """
    found = _all_cameras(backend)
    if not found:
        raise NoCameraError(_none_found(device))
    chosen = None
    try:
        chosen, number = _choose(found, serial, preferred)
        return chosen, number
    finally:
        for camera in found:
            if camera is not chosen:
                with contextlib.suppress(USBError):
                    usb.util.dispose_resources(camera)


def _all_cameras(backend: Any) -> list[Any]:  # noqa: ANN401
    try:
        return list(
            usb.core.find(find_all=True, idVendor=VENDOR, idProduct=PRODUCT, backend=backend)
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
        raise NoCameraError(f'no camera has the serial number {serial!r}; attached: {listed}')
    if len(found) > 1:
        raise NoCameraError(f'{len(found)} cameras are attached ({listed}): choose one by serial')
    ((number, camera),) = by_serial.items()
    return camera, number


def _none_found(device: str) -> str:
    if is_real(device):
        return (
            f'no DAVIS346 (USB {VENDOR:04x}:{PRODUCT:04x}) is attached: plug one in, '
            'or use device:=virtual for the virtual sensor'
        )
    return f'no camera is behind device {device!r}: start what serves it'


def _serial_of(camera: Any) -> str:  # noqa: ANN401
    try:
        camera.get_active_configuration()
    except USBError as error:
        # An unconfigured camera gives no error number, and can still tell its serial number.
        if error.errno is not None:
            raise usb_failure(error, 'opening the camera') from error
    try:
        return str(camera.serial_number or '')
    except USBError as error:
        raise usb_failure(error, 'reading the serial number') from error
    except ValueError:
        return ''
