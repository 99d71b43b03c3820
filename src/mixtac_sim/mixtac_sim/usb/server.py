# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Serves a virtual camera on a Unix socket, one thread per connection."""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import socketserver
import threading
import time
from errno import ECONNREFUSED
from pathlib import Path
from typing import Final

from usb.core import USBError, USBTimeoutError

from mixtac_sim import SimulationError
from mixtac_sim.usb import wire
from mixtac_sim.usb.device import Session, VirtualDavis346

# Longest wait of a read in the device before the server checks that the host is still there.
_SLICE_MS: Final = 250


class UsbServer(socketserver.ThreadingUnixStreamServer):
    """Listens on a socket and answers the USB transfers of hosts.

    The socket has mode 0600: only its owner can use the camera. A socket that a dead server left is
    replaced; any other file or socket at the path is left alone.

    Args:
        device: The camera.
        path: Socket to listen on.

    Attributes:
        device: The camera.
        path: Socket to listen on.

    Raises:
        SimulationError: Another program uses the path, or it cannot be used.
    """

    daemon_threads = True
    request_queue_size = 64

    def __init__(self, device: VirtualDavis346, path: str) -> None:
        check_free(path)
        self.device, self.path = device, path
        try:
            Path(path).unlink(missing_ok=True)
            super().__init__(path, _Connection)
        except OSError as error:
            raise SimulationError(
                f'cannot listen on {path}: {error.strerror or error}',
                remedy='choose another socket',
            ) from error
        threading.Thread(target=self.serve_forever, args=(0.1,), daemon=True).start()

    def server_bind(self) -> None:
        """Make the socket, and nobody else's."""
        super().server_bind()
        Path(self.path).chmod(0o600)

    def handle_error(self, *_: object) -> None:
        """Ignore a connection that broke: the host opens another."""

    def close(self) -> None:
        """Unplug the camera, which ends all transfers, and remove the socket."""
        self.device.unplug()
        self.shutdown()
        self.server_close()
        Path(self.path).unlink(missing_ok=True)


class _Connection(socketserver.BaseRequestHandler):
    """Answers the requests on one connection, one after the other."""

    request: socket.socket
    server: UsbServer

    def handle(self) -> None:
        session = Session(self.server.device)
        try:
            with contextlib.suppress(OSError):
                while True:
                    data = wire.receive(self.request, wire.REQUEST.size)
                    status, answer = 0, b''
                    try:
                        answer = self._answer(session, wire.REQUEST.unpack(data))
                    except USBError as error:
                        status = error.errno
                    self.request.sendall(wire.REPLY.pack(status, len(answer)) + answer)
        finally:
            session.close()

    def _answer(self, session: Session, header: tuple[int, ...]) -> bytes:
        operation, kind, request, value, index, length, timeout_ms = header
        if operation == wire.READ:
            return self._read(session, kind, length, timeout_ms)
        if operation == wire.CONTROL:
            data = length if kind & wire.DIRECTION_IN else wire.receive(self.request, length)
            return session.control((kind, request, value, index), data)
        (session.claim if operation == wire.CLAIM else session.release)()
        return b''

    def _read(self, session: Session, endpoint: int, length: int, timeout_ms: int) -> bytes:
        deadline = time.monotonic() + timeout_ms / 1000 if timeout_ms else math.inf
        while True:
            left_ms = math.ceil(1000 * (deadline - time.monotonic())) if timeout_ms else _SLICE_MS
            try:
                return session.read(endpoint, length, min(max(left_ms, 1), _SLICE_MS))
            except USBTimeoutError:
                if time.monotonic() >= deadline:
                    raise
            # The host sends nothing while it waits: anything readable is its hang-up.
            if select.select([self.request], [], [], 0)[0]:
                raise ConnectionResetError('the host hung up')


def check_free(path: str) -> None:
    """Refuse a path that cannot be served; call it before a long preparation.

    Raises:
        SimulationError: It holds anything but a socket of a program that has ended.
    """
    if not os.path.lexists(path):
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        with contextlib.suppress(OSError):
            # Nobody answers on a socket that was left over.
            if probe.connect_ex(path) == ECONNREFUSED and Path(path).is_socket():
                return
    raise SimulationError(
        f'{path} is in use, or is no socket',
        remedy='stop the program that uses it, or give the virtual sensor another socket or '
        'ROS_DOMAIN_ID',
    )
