# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Makes something go wrong on a virtual camera in another process."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from mixtac_sim.usb import wire
from mixtac_sim.usb.errors import FaultError, NoVirtualSensorError

if TYPE_CHECKING:
    from mixtac_sim.usb.faults import Fault


def inject(path: str, fault: Fault) -> None:
    """Let something go wrong on the virtual camera behind a socket.

    Args:
        path: Socket of the virtual sensor, as `mixtac_sim.usb.wire.default_socket_path`.
        fault: What.

    Raises:
        NoVirtualSensorError: Nobody serves a virtual sensor there.
        FaultError: It does not know such a fault.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        try:
            connection.connect(path)
            wire.call(connection, wire.FAULT, data=fault.to_json())
        except wire.TransferError as error:
            raise FaultError(f'the virtual sensor on {path} refused {fault}: {error}') from error
        except OSError as error:
            raise NoVirtualSensorError(
                f'no virtual sensor listens on {path} ({error}); '
                'start one with "ros2 run mixtac_sim virtual_sensor_node"'
            ) from error
