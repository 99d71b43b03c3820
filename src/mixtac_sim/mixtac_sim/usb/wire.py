# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Protocol of the virtual camera's USB transfers over a Unix socket.

Standard library only: the tests run it under another interpreter.

A request is `REQUEST` (operation, bmRequestType or endpoint, bRequest, wValue, wIndex, data length,
timeout in ms where 0 means none), followed by that many bytes where data go to the device. A reply
is `REPLY` (0 or an errno value, length), followed by that many bytes. One request at a time travels
on a connection; a host opens one connection for control requests, which may claim the interface,
and others for reads.
"""

from __future__ import annotations

import os
import socket
import struct
from pathlib import Path
from typing import Final

REQUEST: Final = struct.Struct('<BBBxHHII')
REPLY: Final = struct.Struct('<iI')
CONTROL: Final = 1
READ: Final = 2
CLAIM: Final = 3
RELEASE: Final = 4
DIRECTION_IN: Final = 0x80


class TransferError(OSError):
    """The device refused a transfer; ``errno`` says why. Broken connections are other errors."""


def default_socket_path() -> str:
    """Return where a virtual sensor of this user and ROS domain listens."""
    folder = os.environ.get('XDG_RUNTIME_DIR') or '/tmp'  # noqa: S108 - sockets have mode 0600
    domain = os.environ.get('ROS_DOMAIN_ID') or '0'
    return str(Path(folder) / f'mixtac-virtual-{os.getuid()}-{domain}.sock')


def receive(connection: socket.socket, count: int) -> bytes:
    """Return exactly ``count`` bytes.

    Raises:
        ConnectionError: The other side closed it.
    """
    data = bytearray(count)
    view = memoryview(data)
    while view:
        received = connection.recv_into(view)
        if received == 0:
            raise ConnectionResetError('the other side closed the connection')
        view = view[received:]
    return bytes(data)


def call(
    connection: socket.socket,
    operation: int,
    setup: tuple[int, int, int, int] = (0, 0, 0, 0),
    data: bytes = b'',
    wanted: int = 0,
    timeout_ms: int = 0,
) -> bytes:
    """Send one request and wait for its reply.

    Args:
        connection: A connected socket that no other thread uses during the call.
        operation: `CONTROL`, `READ`, `CLAIM` or `RELEASE`.
        setup: ``bmRequestType`` or endpoint address, ``bRequest``, ``wValue`` and ``wIndex``.
        data: Data to the device.
        wanted: Bytes wanted from the device, where none are sent.
        timeout_ms: Longest wait [ms], 0 without limit.

    Returns:
        The data of the reply.

    Raises:
        TransferError: The device refused.
        ConnectionError: The server is gone.
    """
    length = len(data) or wanted
    header = REQUEST.pack(operation, *setup, length, timeout_ms)
    connection.sendall(header + data)
    status, size = REPLY.unpack(receive(connection, REPLY.size))
    answer = receive(connection, size)
    if status:
        raise TransferError(status, os.strerror(status))
    return answer
