# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Serves a virtual camera on a Unix socket, one thread per connection."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Final

from mixtac_sim.usb import wire
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.faults import UsbTimeout, VirtualUsbError

# How long a read may wait in the device before the server checks that the host is still there.
_SLICE_S: Final = 0.25
# Pause after a connection could not be accepted, for example for lack of file descriptors.
_RETRY_S: Final = 0.1
# Connections that may wait to be accepted: without descriptors they wait until some are free.
_BACKLOG: Final = 64
_MAX_PATH: Final = 100


class UsbServer:
    """Listens on a socket and answers the USB transfers of hosts.

    The socket has mode 0600: only its owner can use the camera. A socket that a dead server left is
    replaced; any other file or socket at the path is left alone.

    Args:
        device: The camera.
        path: Socket to listen on.

    Raises:
        VirtualUsbError: Another program uses the path, or it cannot be used.
    """

    def __init__(self, device: VirtualDavis346, path: str) -> None:
        self._device = device
        self.path = path
        self._lock = threading.Lock()
        self._connections: set[socket.socket] = set()
        # Of each session: after which plugging-in it began, and its open connections.
        self._plugs: dict[int, int] = {}
        self._open: Counter[int] = Counter()
        self._closing = threading.Event()
        self._listen()
        self._threads = [threading.Thread(target=self._accept, name='usb-accept', daemon=True)]
        self._threads[0].start()

    def _listen(self) -> None:
        """Make the socket."""
        check_free(self.path)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            Path(self.path).unlink(missing_ok=True)
            self._listener.bind(self.path)
            self._inode = os.lstat(self.path).st_ino
            Path(self.path).chmod(0o600)
            self._listener.listen(_BACKLOG)
        except OSError as error:
            self._listener.close()
            raise VirtualUsbError(
                f'cannot listen on {self.path}: {error.strerror}', remedy='choose another socket'
            ) from error

    def close(self) -> None:
        """Unplug the camera, end all connections and remove the socket."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._device.unplug()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        with self._lock:
            connections = list(self._connections)
        for connection in connections:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        # Another program may have replaced the socket.
        with contextlib.suppress(OSError):
            if os.lstat(self.path).st_ino == self._inode:
                Path(self.path).unlink()
        for thread in self._threads:
            thread.join(2.0)

    def _accept(self) -> None:
        while not self._closing.is_set():
            try:
                connection, _ = self._listener.accept()
            except OSError:
                # Descriptors or memory ran out; the host waits in the backlog until some are free.
                self._closing.wait(_RETRY_S)
                continue
            with self._lock:
                self._connections.add(connection)
            thread = threading.Thread(
                target=self._serve, args=(connection,), name='usb-connection', daemon=True
            )
            thread.start()
            self._threads = [other for other in self._threads if other.is_alive()] + [thread]

    def _serve(self, connection: socket.socket) -> None:
        session = None
        reply = bytearray(wire.REPLY.size)
        try:
            with connection, contextlib.suppress(OSError):
                while True:
                    header = wire.REQUEST.unpack(wire.receive(connection, wire.REQUEST.size))
                    if session is None:
                        session = self._join(header[-1])
                    reply = self._reply(connection, header, session, reply)
        finally:
            if session is not None:
                self._leave(session)
            with self._lock:
                self._connections.discard(connection)

    def _join(self, session: int) -> int:
        with self._lock:
            self._plugs.setdefault(session, self._device.plugs)
            self._open[session] += 1
            return session

    def _leave(self, session: int) -> None:
        with self._lock:
            self._open[session] -= 1
            ended = not self._open[session]
            if ended:
                del self._open[session], self._plugs[session]
        if ended:
            self._device.release(session)

    def _reply(
        self, connection: socket.socket, header: tuple[int, ...], session: int, reply: bytearray
    ) -> bytearray:
        """Answer a request; return the buffer to use for the next reply."""
        status, size, start = 0, 0, wire.REPLY.size
        try:
            if header[0] == wire.READ:
                if len(reply) != start + header[5]:
                    reply = bytearray(start + header[5])
                with memoryview(reply) as view:
                    size = self._read(connection, header, session, view[start:])
            else:
                answer = self._perform(connection, header, session)
                size = len(answer)
                reply[start : start + size] = answer
        except VirtualUsbError as error:
            status = error.errno
        wire.REPLY.pack_into(reply, 0, status, size)
        with memoryview(reply) as view:
            connection.sendall(view[: start + size])
        return reply

    def _perform(self, connection: socket.socket, header: tuple[int, ...], session: int) -> bytes:
        operation, kind, request, value, index, length, timeout_ms, _ = header
        incoming = kind & wire.DIRECTION_IN and operation == wire.CONTROL
        data = length if incoming else wire.receive(connection, length)
        self._device.check_present(self._plugs[session])
        if operation == wire.CONTROL:
            limit_s = timeout_ms / 1000 or None
            return self._device.control(kind, request, value, index, data, limit_s)
        if operation == wire.CLAIM:
            self._device.claim(session)
        elif operation == wire.RELEASE:
            self._device.release(session)
        elif operation == wire.RESET:
            self._device.reset()
        else:
            raise ConnectionAbortedError(f'unknown operation {operation}')
        return b''

    def _read(
        self, connection: socket.socket, header: tuple[int, ...], session: int, view: memoryview
    ) -> int:
        endpoint, limit_ms = header[1], header[6]
        self._device.check_present(self._plugs[session])
        deadline = time.monotonic() + limit_ms / 1000 if limit_ms else None
        while True:
            wait = _SLICE_S
            if deadline is not None:
                wait = min(wait, max(0.0, deadline - time.monotonic()))
            try:
                return self._device.read_into(endpoint, view, wait)
            except UsbTimeout:
                if deadline is not None and time.monotonic() >= deadline:
                    raise
            # The host sends nothing while it waits: anything readable is its hang-up.
            if select.select([connection], [], [], 0)[0]:
                raise ConnectionResetError('the host hung up')


def check_free(path: str) -> None:
    """Refuse a path that cannot be served; call it before a long preparation.

    Raises:
        VirtualUsbError: The path is too long, or it holds anything but a socket of a program that
            has ended.
    """
    if len(path.encode()) > _MAX_PATH:
        raise VirtualUsbError(
            f'the socket path {path} is too long', remedy='set XDG_RUNTIME_DIR to a shorter path'
        )
    if os.path.lexists(path) and not _is_left_over(path):
        raise VirtualUsbError(
            f'{path} is in use, or is no socket',
            remedy='stop the program that uses it, or give the virtual sensor another socket or '
            'ROS_DOMAIN_ID',
        )


def _is_left_over(path: str) -> bool:
    """Return whether a path is the socket of a program that has ended."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(path)
        except ConnectionRefusedError:
            return Path(path).is_socket()
        except OSError:
            return False
        return False
