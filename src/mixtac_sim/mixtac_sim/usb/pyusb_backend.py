# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The host side of the virtual camera: a pyusb backend with it as the only device.

The camera is reached through a link, which is one session of a host: `SocketLink` talks to a server
in another process (entry point `virtual` of `mixtac.usb_backends`), `Session` calls a device in
this one. Both raise `UsbStall`, `UsbTimeout`, `UsbGone` or `UsbBusy` where real USB would fail in
the same way.
"""
# ruff: noqa: ARG002 - pyusb fixes the signatures

from __future__ import annotations

import errno
import secrets
import socket
import threading
from contextlib import contextmanager, suppress
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from usb.backend import IBackend
from usb.core import USBError, USBTimeoutError

from mixtac_sim.usb import endpoints, wire
from mixtac_sim.usb.faults import (
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
    from collections.abc import Callable, Iterator, Mapping

    from mixtac_sim.usb.device import Session, Setup, VirtualDavis346

    Link: TypeAlias = 'Session | SocketLink'


_GET_DESCRIPTOR: Final = 6
_SUPER_SPEED: Final = 4
# Bus number to show; no real bus has it.
_BUS: Final = 346
# Error codes of libusb; -1 for all others.
_LIBUSB: Final = {errno.ENODEV: -4, errno.EBUSY: -6, errno.EOVERFLOW: -8, errno.EPIPE: -9}
# libusb and the kernel wait this long for the answers to standard requests.
_STANDARD_MS: Final = 1000


@contextmanager
def _as_usb_errors() -> Iterator[None]:
    try:
        yield
    except UsbTimeout as error:
        raise USBTimeoutError(str(error), -7, errno.ETIMEDOUT) from error
    except VirtualUsbError as error:
        raise USBError(str(error), _LIBUSB.get(error.errno, -1), error.errno) from error


def _described(fields: Mapping[str, int], **more: object) -> SimpleNamespace:
    return SimpleNamespace(**fields, **more, extra_descriptors=[])


class VirtualBackend(IBackend):  # type: ignore[misc]
    """Implements pyusb's backend interface on a link.

    Failures surface as pyusb's own: ``ENODEV`` after a disconnect, ``EPIPE`` for a STALL, ``EBUSY``
    when another program has the camera, `usb.core.USBTimeoutError` when nothing came in time.

    Args:
        connect: Opens a link to the camera, or raises `VirtualUsbError` when there is none.
    """

    def __init__(self, connect: Callable[[], Link]) -> None:
        self._connect = connect

    def enumerate_devices(self) -> Iterator[str]:
        """Yield the identity of the camera, if it is there."""
        try:
            link = self._connect()
            try:
                link.control((0x80, _GET_DESCRIPTOR, 0x0100, 0), endpoints.DEVICE['bLength'])
            finally:
                link.close()
        except VirtualUsbError:
            return
        yield 'virtual'

    def get_device_descriptor(self, dev: object) -> SimpleNamespace:
        """Return the device descriptor and where the device sits."""
        place = {'bus': _BUS, 'address': 1, 'port_number': 1, 'port_numbers': (1,)}
        return _described(endpoints.DEVICE, speed=_SUPER_SPEED, **place)

    def get_configuration_descriptor(self, dev: object, config: int) -> SimpleNamespace:
        """Return the configuration of this index; `IndexError` if there is none."""
        return _described((endpoints.CONFIGURATION,)[config])

    def get_interface_descriptor(
        self, dev: object, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Return the interface of this index; `IndexError` if there is none."""
        return _described((endpoints.INTERFACE,)[intf + alt + config])

    def get_endpoint_descriptor(
        self, dev: object, ep: int, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Return the endpoint of this index; `IndexError` if there is none."""
        return _described(endpoints.ENDPOINTS[ep], bRefresh=0, bSynchAddress=0)

    def get_parent(self, dev: object) -> None:
        """Return None: the camera is not behind a hub."""

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
            dev_handle.control((0x00, 9, config_value, 0), b'', _STANDARD_MS)

    def get_configuration(self, dev_handle: Link) -> int:
        """Return the value of the active configuration."""
        with _as_usb_errors():
            return dev_handle.control((0x80, 8, 0, 0), 1, _STANDARD_MS)[0]

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
        """Read from an endpoint into the buffer; return the number of bytes."""
        with _as_usb_errors():
            data = dev_handle.read(ep, buff.itemsize * len(buff), timeout)
            memoryview(buff).cast('B')[: len(data)] = data
            return len(data)

    # The debug endpoint is read like the data endpoint.
    intr_read = bulk_read

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
            setup = (bmRequestType, bRequest, wValue, wIndex)
            if not bmRequestType & 0x80:
                dev_handle.control(setup, bytes(view), timeout)
                return len(view)
            answer = dev_handle.control(setup, len(view), timeout)
            view[: len(answer)] = answer
            return len(answer)

    def clear_halt(self, dev_handle: Link, ep: int) -> None:
        """Clear a halted endpoint."""
        with _as_usb_errors():
            dev_handle.control((0x02, 1, 0, ep), b'', _STANDARD_MS)


def in_process_backend(device: VirtualDavis346) -> VirtualBackend:
    """Return a pyusb backend that finds this one device."""
    from mixtac_sim.usb.device import Session  # compiles; a host on the socket need not wait

    return VirtualBackend(lambda: Session(device))


_CONTROL_CHANNEL: Final = 0
# Time beyond its time-out after which an answer counts as lost and the server as dead.
_GRACE_S: Final = 5.0
# Longest wait for requests that the server answers without the camera.
_QUICK_MS: Final = 100
_ERRORS: Final = {
    kind.errno: kind for kind in (UsbStall, UsbTimeout, UsbGone, UsbBusy, UsbOverflow)
}


class SocketLink:
    """One host session over Unix sockets: one connection for control, one for each endpoint.

    Args:
        path: Where the server listens.

    Raises:
        NoVirtualSensorError: No virtual sensor listens there.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._session = secrets.randbits(63) | 1
        self._closed = False
        self._lock = threading.Lock()
        self._channels: dict[int, tuple[socket.socket, threading.Lock]] = {}
        self._channel(_CONTROL_CHANNEL)

    def control(self, setup: Setup, data: bytes | int, timeout_ms: int = 0) -> bytes:
        """Make a control request; arguments as of `Session.control`."""
        sent, wanted = (b'', data) if isinstance(data, int) else (data, 0)
        return self._call(wire.CONTROL, setup, timeout_ms, sent, wanted)

    def read(self, endpoint: int, length: int, timeout_ms: int) -> bytes:
        """Read from an endpoint; arguments as of `Session.read`."""
        setup = (endpoint, 0, 0, 0)
        return self._call(wire.READ, setup, timeout_ms, wanted=length, channel=endpoint)

    def claim(self) -> None:
        """Claim the interface for this session."""
        self._call(wire.CLAIM)

    def release(self) -> None:
        """Give the interface back."""
        self._call(wire.RELEASE)

    def close(self) -> None:
        """End the session; reads that wait end with `UsbGone`."""
        # The server notices a closed connection only later; the next host must not wait.
        with suppress(VirtualUsbError):
            self.release()
        with self._lock:
            self._closed = True
            channels, self._channels = self._channels, {}
        for connection, _ in channels.values():
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()

    def _call(
        self,
        operation: int,
        setup: Setup = (0, 0, 0, 0),
        timeout_ms: int = _QUICK_MS,
        data: bytes = b'',
        wanted: int = 0,
        channel: int = _CONTROL_CHANNEL,
    ) -> bytes:
        connection, lock = self._channel(channel)
        try:
            with lock:
                # A server that was stopped must not block its hosts.
                connection.settimeout(timeout_ms / 1000 + _GRACE_S if timeout_ms else None)
                sent = (operation, setup, data, wanted, timeout_ms, self._session)
                return wire.call(connection, *sent)
        except wire.TransferError as error:
            kind = _ERRORS.get(error.errno or 0, VirtualUsbError)
            raise kind(f'virtual camera on {self._path}: {error.strerror}') from error
        except OSError as error:
            raise UsbGone(f'virtual camera on {self._path} is gone: {error}') from error

    def _channel(self, number: int) -> tuple[socket.socket, threading.Lock]:
        with self._lock:
            if self._closed:
                raise UsbGone('the virtual camera was closed; open it again')
            if number not in self._channels:
                self._channels[number] = (_connect(self._path), threading.Lock())
            return self._channels[number]


def _connect(path: str) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.connect(path)
    except OSError as error:
        connection.close()
        raise NoVirtualSensorError(
            f'no virtual sensor listens on {path}',
            remedy='wait until it has started, or name its socket: virtual:PATH',
        ) from error
    return connection


def open_backend(device: str) -> VirtualBackend:
    """Return a pyusb backend for a device string of the driver.

    Args:
        device: ``virtual`` for the socket of this user and ROS domain, or ``virtual:PATH``.

    Raises:
        NoVirtualSensorError: No virtual sensor listens there.
    """
    path = device.partition(':')[2] or wire.default_socket_path()
    SocketLink(path).close()
    return VirtualBackend(lambda: SocketLink(path))
