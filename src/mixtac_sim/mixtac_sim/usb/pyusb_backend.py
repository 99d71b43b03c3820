# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The host side of the virtual camera: a pyusb backend with it as the only device.

The camera is reached through a link, which is one session of a host: `SocketLink` talks to a server
in another process (entry point `virtual` of `mixtac.usb_backends`), `Session` calls a device in
this one. Both raise the errors of pyusb where real USB would fail in the same way.
"""
# ruff: noqa: ARG002 - pyusb fixes the signatures

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from errno import ENODEV, ETIMEDOUT
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from usb.backend import IBackend
from usb.core import USBError, USBTimeoutError

from mixtac_sim import SimulationError
from mixtac_sim.usb import endpoints, wire

if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable, Iterator, Mapping

    from mixtac_sim.usb.device import Session, Setup, VirtualDavis346

    Link: TypeAlias = 'Session | SocketLink'


_GET_DESCRIPTOR: Final = 6
_SUPER_SPEED: Final = 4
# Bus number to show; no real bus has it.
_BUS: Final = 346


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
        except USBError:
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

    def open_device(self, dev: object) -> Link:
        """Start a host session."""
        return self._connect()

    def close_device(self, dev_handle: Link) -> None:
        """End a host session."""
        dev_handle.close()

    def set_configuration(self, dev_handle: Link, config_value: int) -> None:
        """Choose a configuration."""
        dev_handle.control((0x00, 9, config_value, 0), b'')

    def get_configuration(self, dev_handle: Link) -> int:
        """Return the value of the active configuration."""
        return dev_handle.control((0x80, 8, 0, 0), 1)[0]

    def claim_interface(self, dev_handle: Link, intf: int) -> None:
        """Claim the interface for this session."""
        dev_handle.claim()

    def release_interface(self, dev_handle: Link, intf: int) -> None:
        """Give the interface back."""
        dev_handle.release()

    def bulk_read(
        self, dev_handle: Link, ep: int, intf: int, buff: array[int], timeout: int
    ) -> int:
        """Read from an endpoint into the buffer; return the number of bytes."""
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
        view: Any = memoryview(data).cast('B')
        setup = (bmRequestType, bRequest, wValue, wIndex)
        if not bmRequestType & 0x80:
            dev_handle.control(setup, bytes(view))
            return len(view)
        answer = dev_handle.control(setup, len(view))
        view[: len(answer)] = answer
        return len(answer)

    def clear_halt(self, dev_handle: Link, ep: int) -> None:
        """Clear a halted endpoint."""
        dev_handle.control((0x02, 1, 0, ep), b'')


def in_process_backend(device: VirtualDavis346) -> VirtualBackend:
    """Return a pyusb backend that finds this one device."""
    from mixtac_sim.usb.device import Session  # compiles; a host on the socket need not wait

    return VirtualBackend(lambda: Session(device))


# Longest wait for what the server answers at once, and for an answer after the time-out of a read.
_GRACE_S: Final = 5.0


class SocketLink:
    """One host session over Unix sockets: one connection for requests, one for reads.

    Args:
        path: Where the server listens.

    Raises:
        USBError: ENODEV, no virtual sensor listens there.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._requests, self._reads = _connect(path), _connect(path)
        self._requesting, self._reading = threading.Lock(), threading.Lock()

    def control(self, setup: Setup, data: bytes | int) -> bytes:
        """Make a control request; arguments as of `Session.control`."""
        sent, wanted = (b'', data) if isinstance(data, int) else (data, 0)
        return self._request(wire.CONTROL, setup, sent, wanted)

    def read(self, endpoint: int, length: int, timeout_ms: int) -> bytes:
        """Read from an endpoint; arguments as of `Session.read`."""
        with self._reading:
            return self._call(self._reads, wire.READ, (endpoint, 0, 0, 0), b'', length, timeout_ms)

    def claim(self) -> None:
        """Claim the interface for this session."""
        self._request(wire.CLAIM)

    def release(self) -> None:
        """Give the interface back."""
        self._request(wire.RELEASE)

    def close(self) -> None:
        """End the session; a read that waits ends with ENODEV."""
        # The server notices a closed connection only later; the next host must not wait.
        with suppress(USBError):
            self.release()
        for connection in (self._requests, self._reads):
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()

    def _request(
        self, operation: int, setup: Setup = (0, 0, 0, 0), data: bytes = b'', wanted: int = 0
    ) -> bytes:
        with self._requesting:
            return self._call(self._requests, operation, setup, data, wanted, 1)

    def _call(self, connection: socket.socket, *request: Any) -> bytes:  # noqa: ANN401
        try:
            timeout_ms = request[-1]
            # A server that was stopped must not block its hosts.
            connection.settimeout(timeout_ms / 1000 + _GRACE_S if timeout_ms else None)
            return wire.call(connection, *request)
        except wire.TransferError as error:
            kind = USBTimeoutError if error.errno == ETIMEDOUT else USBError
            text = f'virtual camera on {self._path}: {error.strerror}'
            raise kind(text, errno=error.errno) from error
        except OSError as error:
            text = f'virtual camera on {self._path} is gone: {error}'
            raise USBError(text, errno=ENODEV) from error


def _connect(path: str) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.connect(path)
    except OSError as error:
        connection.close()
        raise USBError(f'no virtual sensor listens on {path}', errno=ENODEV) from error
    return connection


def open_backend(device: str) -> VirtualBackend:
    """Return a pyusb backend for a device string of the driver.

    Args:
        device: ``virtual`` for the socket of this user and ROS domain, or ``virtual:PATH``.

    Raises:
        SimulationError: No virtual sensor listens there.
    """
    path = device.partition(':')[2] or wire.default_socket_path()
    try:
        SocketLink(path).close()
    except USBError as error:
        raise SimulationError(
            f'no virtual sensor listens on {path}',
            remedy='wait until it has started, or name its socket: virtual:PATH',
        ) from error
    return VirtualBackend(lambda: SocketLink(path))
