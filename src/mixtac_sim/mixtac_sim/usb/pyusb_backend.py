# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A pyusb backend whose only device is a virtual camera."""
# ruff: noqa: ARG002 - pyusb fixes the signatures

from __future__ import annotations

import errno
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from usb.backend import IBackend
from usb.core import USBError, USBTimeoutError

from mixtac_sim.usb import descriptors
from mixtac_sim.usb.errors import (
    NoVirtualSensorError,
    UsbBusy,
    UsbGone,
    UsbOverflow,
    UsbStall,
    UsbTimeout,
    VirtualUsbError,
)

if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable, Iterator
    from types import SimpleNamespace

    from mixtac_sim.usb.link import Link

_GET_DESCRIPTOR: Final = 6
_SUPER_SPEED: Final = 4
# libusb and the kernel wait this long for the answers to standard requests.
_STANDARD_MS: Final = 1000


@contextmanager
def _as_usb_errors() -> Iterator[None]:
    try:
        yield
    except UsbTimeout as error:
        raise USBTimeoutError(str(error), -7, errno.ETIMEDOUT) from error
    except UsbStall as error:
        raise USBError(str(error), -9, errno.EPIPE) from error
    except (UsbGone, NoVirtualSensorError) as error:
        raise USBError(str(error), -4, errno.ENODEV) from error
    except UsbBusy as error:
        raise USBError(str(error), -6, errno.EBUSY) from error
    except UsbOverflow as error:
        raise USBError(str(error), -8, errno.EOVERFLOW) from error
    except VirtualUsbError as error:
        raise USBError(str(error), -1, errno.EIO) from error


class VirtualBackend(IBackend):  # type: ignore[misc]
    """Implements pyusb's backend interface on a `Link`.

    Failures surface as pyusb's own: ``ENODEV`` after a disconnect, ``EPIPE`` for a STALL, ``EBUSY``
    when another program has the camera, `usb.core.USBTimeoutError` when nothing came in time.

    Args:
        connect: Opens a link to the camera, or raises `VirtualUsbError` when there is none.
        bus: Bus number to show.
    """

    def __init__(self, connect: Callable[[], Link], *, bus: int = 346) -> None:
        self._connect = connect
        self._bus = bus
        self._lock = threading.Lock()
        self._parsed: list[SimpleNamespace] | None = None

    def enumerate_devices(self) -> Iterator[str]:
        """Yield the identity of the camera, if it is there."""
        try:
            self._descriptors()
        except VirtualUsbError:
            return
        yield 'virtual'

    def _descriptors(self) -> list[SimpleNamespace]:
        with self._lock:
            link = self._connect()
            try:
                device = link.control(0x80, _GET_DESCRIPTOR, 0x0100, 0, 18)
                configuration = link.control(0x80, _GET_DESCRIPTOR, 0x0200, 0, 4096)
            finally:
                link.close()
            self._parsed = descriptors.parse(device + configuration)
            return self._parsed

    def _of_type(self, kind: int) -> list[SimpleNamespace]:
        with _as_usb_errors():
            parsed = self._parsed or self._descriptors()
        return [found for found in parsed if found.bDescriptorType == kind]

    def get_device_descriptor(self, dev: object) -> SimpleNamespace:
        """Return the device descriptor and where the device sits."""
        found = self._of_type(1)[0]
        found.bus, found.address, found.speed = self._bus, 1, _SUPER_SPEED
        found.port_number, found.port_numbers = 1, (1,)
        return found

    def get_configuration_descriptor(self, dev: object, config: int) -> SimpleNamespace:
        """Return the configuration of this index; `IndexError` if there is none."""
        return self._of_type(2)[config]

    def get_interface_descriptor(
        self, dev: object, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Return the interface of this index; `IndexError` if there is none."""
        if alt or config:
            raise IndexError(alt)
        return self._of_type(4)[intf]

    def get_endpoint_descriptor(
        self, dev: object, ep: int, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Return the endpoint of this index; `IndexError` if there is none."""
        found = self._of_type(5)[ep]
        found.bRefresh = found.bSynchAddress = 0
        return found

    def get_parent(self, dev: object) -> None:
        """Return none: the camera hangs on no hub."""

    def open_device(self, dev: object) -> Link:
        """Start a host session."""
        with _as_usb_errors():
            return self._connect()

    def close_device(self, dev_handle: Link) -> None:
        """End a host session."""
        dev_handle.close()

    def set_configuration(self, dev_handle: Link, config_value: int) -> None:
        """Choose a configuration."""
        with _as_usb_errors():
            dev_handle.control(0x00, 9, config_value, 0, b'', _STANDARD_MS)

    def get_configuration(self, dev_handle: Link) -> int:
        """Return the value of the active configuration."""
        with _as_usb_errors():
            return dev_handle.control(0x80, 8, 0, 0, 1, _STANDARD_MS)[0]

    def set_interface_altsetting(self, dev_handle: Link, intf: int, altsetting: int) -> None:
        """Choose an alternate setting; there is only 0."""
        with _as_usb_errors():
            dev_handle.control(0x01, 11, altsetting, intf, b'', _STANDARD_MS)

    def claim_interface(self, dev_handle: Link, intf: int) -> None:
        """Claim the interface for this session."""
        with _as_usb_errors():
            dev_handle.claim()

    def release_interface(self, dev_handle: Link, intf: int) -> None:
        """Give the interface back."""
        with _as_usb_errors():
            dev_handle.release()

    def bulk_read(
        self, dev_handle: Link, ep: int, intf: int, buff: array[int], timeout: int
    ) -> int:
        """Read from the data endpoint into the buffer; return the number of bytes."""
        with _as_usb_errors():
            return dev_handle.read(ep, buff, timeout)

    def intr_read(
        self, dev_handle: Link, ep: int, intf: int, size: array[int], timeout: int
    ) -> int:
        """Read from the debug endpoint into the buffer; return the number of bytes."""
        with _as_usb_errors():
            return dev_handle.read(ep, size, timeout)

    def ctrl_transfer(
        self,
        dev_handle: Link,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: array[int],
        timeout: int,
    ) -> int:
        """Make a control request; return the number of bytes moved."""
        with _as_usb_errors():
            view: Any = memoryview(data).cast('B')
            if not bmRequestType & 0x80:
                dev_handle.control(bmRequestType, bRequest, wValue, wIndex, bytes(view), timeout)
                return len(view)
            wanted = len(view)
            answer = dev_handle.control(bmRequestType, bRequest, wValue, wIndex, wanted, timeout)
            view[: len(answer)] = answer
            return len(answer)

    def clear_halt(self, dev_handle: Link, ep: int) -> None:
        """Clear a halted endpoint."""
        with _as_usb_errors():
            dev_handle.control(0x02, 1, 0, ep, b'', _STANDARD_MS)

    def reset_device(self, dev_handle: Link) -> None:
        """Reset the camera to its power-up state."""
        with _as_usb_errors():
            dev_handle.reset()

    def is_kernel_driver_active(self, dev_handle: Link, intf: int) -> bool:
        """Return false: no kernel knows of this device."""
        return False

    def detach_kernel_driver(self, dev_handle: Link, intf: int) -> None:
        """Do nothing: there is no kernel driver."""

    def attach_kernel_driver(self, dev_handle: Link, intf: int) -> None:
        """Do nothing: there is no kernel driver."""
