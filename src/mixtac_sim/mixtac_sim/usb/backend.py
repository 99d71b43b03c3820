# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The pyusb backend for a virtual camera behind a Unix socket; entry point of ``virtual``."""

from __future__ import annotations

import errno
import secrets
import socket
import threading
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

from mixtac_sim.usb import wire
from mixtac_sim.usb.errors import (
    NoVirtualSensorError,
    UsbBusy,
    UsbGone,
    UsbOverflow,
    UsbStall,
    UsbTimeout,
    VirtualUsbError,
)
from mixtac_sim.usb.pyusb_backend import VirtualBackend

if TYPE_CHECKING:
    from array import array
    from collections.abc import Iterator

_CONTROL_CHANNEL: Final = 0
# How long after its time-out an answer may come before the server counts as dead.
_GRACE_S: Final = 5.0
# What needs no answer of the camera, only of its server, takes no longer.
_QUICK_MS: Final = 100
_ERRORS: Final = {
    errno.EPIPE: UsbStall,
    errno.ETIMEDOUT: UsbTimeout,
    errno.EBUSY: UsbBusy,
    errno.ENODEV: UsbGone,
    errno.EOVERFLOW: UsbOverflow,
}


class SocketLink:
    """One host session over Unix sockets: one connection for control, one for each endpoint.

    Args:
        path: Where the server listens.

    Raises:
        NoVirtualSensorError: Nobody listens there.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._session = secrets.randbits(63) | 1
        self._closed = False
        self._lock = threading.Lock()
        self._channels: dict[int, tuple[socket.socket, threading.Lock]] = {}
        self._channel(_CONTROL_CHANNEL)

    def control(
        self,
        request_type: int,
        request: int,
        value: int,
        index: int,
        data: bytes | int,
        timeout_ms: int = 0,
    ) -> bytes:
        """Make a control request; a timeout of 0 waits for ever."""
        sent, wanted = (b'', data) if isinstance(data, int) else (data, 0)
        return self._call(
            wire.CONTROL,
            kind=request_type,
            request=request,
            value=value,
            index=index,
            data=sent,
            wanted=wanted,
            timeout_ms=timeout_ms,
        )

    def read(self, endpoint: int, buffer: array[int], timeout_ms: int) -> int:
        """Read at most a buffer full; a timeout of 0 waits for ever."""
        view = memoryview(buffer).cast('B')
        connection, lock = self._channel(endpoint)
        header = wire.REQUEST.pack(
            *(wire.READ, endpoint, 0, 0, 0, len(view), timeout_ms, self._session)
        )
        with self._errors(), lock:
            _set_patience(connection, timeout_ms)
            connection.sendall(header)
            status, size = wire.REPLY.unpack(wire.receive(connection, wire.REPLY.size))
            if status:
                raise wire.TransferError(status, f'reading endpoint {endpoint:#04x} failed')
            wire.receive_into(connection, view[:size])
        return int(size)

    def claim(self) -> None:
        """Claim the interface for this session."""
        self._call(wire.CLAIM)

    def release(self) -> None:
        """Give the interface back."""
        self._call(wire.RELEASE)

    def reset(self) -> None:
        """Do a USB port reset."""
        self._call(wire.RESET)

    def close(self) -> None:
        """End the session; reads that wait end with `UsbGone`."""
        # The server notices a closed connection only later; whoever opens next must not wait.
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
        *,
        kind: int = 0,
        request: int = 0,
        value: int = 0,
        index: int = 0,
        data: bytes = b'',
        wanted: int = 0,
        timeout_ms: int = _QUICK_MS,
    ) -> bytes:
        connection, lock = self._channel(_CONTROL_CHANNEL)
        with self._errors(), lock:
            _set_patience(connection, timeout_ms)
            return wire.call(
                connection,
                operation,
                kind=kind,
                request=request,
                value=value,
                index=index,
                data=data,
                wanted=wanted,
                timeout_ms=timeout_ms,
                session=self._session,
            )

    def _channel(self, number: int) -> tuple[socket.socket, threading.Lock]:
        with self._lock:
            if self._closed:
                raise UsbGone('the virtual camera was closed; open it again')
            if number not in self._channels:
                self._channels[number] = (_connect(self._path), threading.Lock())
            return self._channels[number]

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except wire.TransferError as error:
            kind = _ERRORS.get(error.errno or 0, VirtualUsbError)
            raise kind(f'virtual camera on {self._path}: {error.strerror}') from error
        except OSError as error:
            raise UsbGone(f'virtual camera on {self._path} is gone: {error}') from error


def _set_patience(connection: socket.socket, timeout_ms: int) -> None:
    # A server that was stopped must not hold its hosts up for ever.
    connection.settimeout(timeout_ms / 1000 + _GRACE_S if timeout_ms else None)


def _connect(path: str) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.connect(path)
    except OSError as error:
        connection.close()
        raise NoVirtualSensorError(
            f'no virtual sensor listens on {path}; start one with '
            '"ros2 run mixtac_sim virtual_sensor_node" or name its socket: device:=virtual:PATH'
        ) from error
    return connection


def open_backend(device: str) -> VirtualBackend:
    """Return a pyusb backend for a device string of the driver.

    Args:
        device: ``virtual`` for the socket of this user and ROS domain, or ``virtual:PATH``.

    Raises:
        NoVirtualSensorError: Nobody serves a virtual sensor there.
    """
    path = device.partition(':')[2] or wire.default_socket_path()
    SocketLink(path).close()
    return VirtualBackend(lambda: SocketLink(path))
