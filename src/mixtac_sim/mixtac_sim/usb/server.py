# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Serves a virtual camera on a Unix socket, one thread per connection."""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Final

from mixtac_sim.usb import wire
from mixtac_sim.usb.device import Session, VirtualDavis346
from mixtac_sim.usb.faults import UsbTimeout, VirtualUsbError

# Longest wait of a read in the device before the server checks that the host is still there.
_SLICE_MS: Final = 250
# Pause after a connection could not be accepted, for example for lack of file descriptors.
_RETRY_S: Final = 0.1
# Connections that may wait to be accepted: without descriptors they wait until some are free.
_BACKLOG: Final = 64


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
        check_free(path)
        self._device = device
        self.path = path
        self._lock = threading.Lock()
        self._connections: set[socket.socket] = set()
        self._sessions: dict[int, Session] = {}
        # Open connections of each session.
        self._open: Counter[int] = Counter()
        self._closing = threading.Event()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            Path(path).unlink(missing_ok=True)
            self._listener.bind(path)
            self._inode = Path(path).stat().st_ino
            Path(path).chmod(0o600)
            self._listener.listen(_BACKLOG)
        except OSError as error:
            self._listener.close()
            raise VirtualUsbError(
                f'cannot listen on {path}: {error.strerror or error}',
                remedy='choose another socket',
            ) from error
        self._thread = threading.Thread(target=self._accept, name='usb-accept', daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Unplug the camera, end all connections and remove the socket."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._device.unplug()
        with self._lock:
            sockets = [self._listener, *self._connections]
        for each in sockets:
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
        self._thread.join(2.0)
        self._listener.close()
        # Another sensor may have replaced the socket.
        with contextlib.suppress(OSError):
            if Path(self.path).stat().st_ino == self._inode:
                Path(self.path).unlink()

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
            threading.Thread(
                target=self._serve, args=(connection,), name='usb-connection', daemon=True
            ).start()

    def _serve(self, connection: socket.socket) -> None:
        number = None
        try:
            with connection, contextlib.suppress(OSError):
                while True:
                    header = wire.REQUEST.unpack(wire.receive(connection, wire.REQUEST.size))
                    if number is None:
                        number = self._join(header[-1])
                    status, answer = 0, b''
                    try:
                        answer = self._answer(connection, header, self._sessions[number])
                    except VirtualUsbError as error:
                        status = error.errno
                    connection.sendall(wire.REPLY.pack(status, len(answer)) + answer)
        finally:
            with self._lock:
                self._connections.discard(connection)
            if number is not None:
                self._leave(number)

    def _join(self, number: int) -> int:
        with self._lock:
            if number not in self._sessions:
                self._sessions[number] = Session(self._device)
            self._open[number] += 1
            return number

    def _leave(self, number: int) -> None:
        with self._lock:
            self._open[number] -= 1
            if self._open[number] == 0:
                del self._open[number]
                self._sessions.pop(number).close()

    def _answer(
        self, connection: socket.socket, header: tuple[int, ...], session: Session
    ) -> bytes:
        operation, kind, request, value, index, length, timeout_ms, _ = header
        if operation == wire.READ:
            return self._read(connection, session, kind, length, timeout_ms)
        if operation == wire.CONTROL:
            data = length if kind & wire.DIRECTION_IN else wire.receive(connection, length)
            return session.control((kind, request, value, index), data, timeout_ms)
        (session.claim if operation == wire.CLAIM else session.release)()
        return b''

    def _read(
        self,
        connection: socket.socket,
        session: Session,
        endpoint: int,
        length: int,
        timeout_ms: int,
    ) -> bytes:
        deadline = time.monotonic() + timeout_ms / 1000 if timeout_ms else math.inf
        while True:
            left_ms = math.ceil(1000 * (deadline - time.monotonic())) if timeout_ms else _SLICE_MS
            try:
                return session.read(endpoint, length, min(max(left_ms, 1), _SLICE_MS))
            except UsbTimeout:
                if time.monotonic() >= deadline:
                    raise
            # The host sends nothing while it waits: anything readable is its hang-up.
            if select.select([connection], [], [], 0)[0]:
                raise ConnectionResetError('the host hung up')


def check_free(path: str) -> None:
    """Refuse a path that cannot be served; call it before a long preparation.

    Raises:
        VirtualUsbError: It holds anything but a socket of a program that has ended.
    """
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
