# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Serves a virtual camera on a Unix socket, one thread per connection."""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mixtac_sim.usb import wire
from mixtac_sim.usb.errors import (
    UsbBusy,
    UsbGone,
    UsbStall,
    UsbTimeout,
    VirtualUsbError,
)

if TYPE_CHECKING:
    from mixtac_sim.usb.device import VirtualDavis346

# How long a read may sit in the device before the server looks whether the host still waits.
_SLICE_S: Final = 0.25
_MAX_PATH: Final = 100
_STATUS: Final = {
    UsbStall: errno.EPIPE,
    UsbTimeout: errno.ETIMEDOUT,
    UsbBusy: errno.EBUSY,
    UsbGone: errno.ENODEV,
}


class UsbServer:
    """Listens on a socket and answers the USB transfers of hosts.

    The socket has mode 0600: only its owner can use the camera. A socket that a dead server left
    is replaced; one that answers is not.

    Args:
        device: The camera.
        path: Where to listen.

    Raises:
        VirtualUsbError: Another server listens there or the path cannot be used.
    """

    def __init__(self, device: VirtualDavis346, path: str) -> None:
        self._device = device
        self.path = path
        self._lock = threading.Lock()
        self._connections: set[socket.socket] = set()
        self._sessions: dict[int, int] = {}
        self._closing = False
        self._listener = _listen(path)
        self._threads = [threading.Thread(target=self._accept, name='usb-accept', daemon=True)]
        self._threads[0].start()

    def close(self) -> None:
        """Unplug the camera, end all connections and remove the socket."""
        if self._closing:
            return
        self._closing = True
        self._device.unplug()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        with self._lock:
            connections = list(self._connections)
        for connection in connections:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        Path(self.path).unlink(missing_ok=True)
        for thread in self._threads:
            thread.join(2.0)

    def _accept(self) -> None:
        while not self._closing:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with self._lock:
                self._connections.add(connection)
            thread = threading.Thread(
                target=self._serve, args=(connection,), name='usb-connection', daemon=True
            )
            self._threads = [other for other in self._threads if other.is_alive()] + [thread]
            thread.start()

    def _serve(self, connection: socket.socket) -> None:
        session = 0
        try:
            with connection, contextlib.suppress(OSError):
                while True:
                    header = wire.REQUEST.unpack(wire.receive(connection, wire.REQUEST.size))
                    session = self._join(session, header[-1])
                    self._reply(connection, header)
        finally:
            self._leave(session)
            with self._lock:
                self._connections.discard(connection)

    def _join(self, before: int, session: int) -> int:
        if not before and session:
            with self._lock:
                self._sessions[session] = self._sessions.get(session, 0) + 1
        return before or session

    def _leave(self, session: int) -> None:
        with self._lock:
            if session:
                self._sessions[session] -= 1
            ended = session and not self._sessions[session]
            if ended:
                del self._sessions[session]
        if ended:
            self._device.release(session)

    def _reply(self, connection: socket.socket, header: tuple[int, ...]) -> None:
        status, answer = 0, b''
        try:
            answer = self._perform(connection, header)
        except VirtualUsbError as error:
            status = _STATUS.get(type(error), errno.EIO)
        connection.sendall(wire.REPLY.pack(status, len(answer)) + answer)

    def _perform(self, connection: socket.socket, header: tuple[int, ...]) -> bytes:
        operation, kind, request, value, index, length, timeout_ms, session = header
        if length > wire.MAX_TRANSFER:
            raise ConnectionAbortedError(f'a transfer of {length} bytes is not sensible')
        if operation == wire.CONTROL:
            incoming = kind & wire.DIRECTION_IN
            data = length if incoming else wire.receive(connection, length)
            return self._device.control(kind, request, value, index, data)
        if operation == wire.READ:
            return self._read(connection, kind, length, timeout_ms)
        if operation == wire.CLAIM:
            self._device.claim(session)
        elif operation == wire.RELEASE:
            self._device.release(session)
        elif operation == wire.RESET:
            self._device.reset()
        else:
            raise ConnectionAbortedError(f'unknown operation {operation}')
        return b''

    def _read(self, connection: socket.socket, endpoint: int, length: int, limit_ms: int) -> bytes:
        deadline = time.monotonic() + limit_ms / 1000 if limit_ms else None
        while True:
            wait = _SLICE_S
            if deadline is not None:
                wait = min(wait, max(0.0, deadline - time.monotonic()))
            try:
                return self._device.read_bulk(endpoint, length, wait)
            except UsbTimeout:
                if deadline is not None and time.monotonic() >= deadline:
                    raise
            # The host sends nothing while it waits: anything readable is its hang-up.
            if select.select([connection], [], [], 0)[0]:
                raise ConnectionResetError('the host hung up')


def check_free(path: str) -> None:
    """Refuse a path that cannot be served; worth asking before a long preparation.

    Raises:
        VirtualUsbError: Another server listens there, or the path is too long.
    """
    if len(path.encode()) > _MAX_PATH:
        raise VirtualUsbError(f'the socket path {path} is too long; set XDG_RUNTIME_DIR shorter')
    if _answers(path):
        raise VirtualUsbError(
            f'another virtual sensor already listens on {path}; '
            'stop it, or give this one another socket or ROS_DOMAIN_ID'
        )


def _listen(path: str) -> socket.socket:
    check_free(path)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if Path(path).is_socket():
            Path(path).unlink()
        listener.bind(path)
        Path(path).chmod(0o600)
        listener.listen(8)
    except OSError as error:
        listener.close()
        raise VirtualUsbError(f'cannot listen on {path}: {error.strerror}') from error
    return listener


def _answers(path: str) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(path)
        except OSError:
            return False
        return True
