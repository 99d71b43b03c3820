# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which reader serves an open camera."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_driver.async_transport import AsynchronousReader
from mixtac_driver.connection import DATA_ENDPOINT
from mixtac_driver.transport import BulkReader

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_driver.connection import Connection
    from mixtac_driver.stream import StreamSettings

Reader = AsynchronousReader | BulkReader
"""What reads the data endpoint."""


def make_reader(
    connection: Connection, settings: StreamSettings, now_ns: Callable[[], int]
) -> Reader:
    """Return a reader of a camera's data: asynchronous through libusb, else one read at a time.

    Args:
        connection: The open camera.
        settings: How data are taken.
        now_ns: Host clock [ns since the Unix epoch].
    """
    port = connection.libusb_port()
    if port is not None:
        return AsynchronousReader(
            port,
            DATA_ENDPOINT,
            connection.clear_halt,
            transfers=settings.transfers,
            transfer_size=settings.transfer_size,
            queue_size=settings.queue_size,
            now_ns=now_ns,
        )
    return BulkReader(
        connection.read_data,
        connection.clear_halt,
        transfer_size=settings.transfer_size,
        now_ns=now_ns,
    )
