# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual camera in the same process as its host: no socket, no thread of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_sim.usb.pyusb_backend import VirtualBackend

if TYPE_CHECKING:
    from array import array

    from mixtac_sim.usb.device import VirtualDavis346


class InProcessLink:
    """One host session that calls the device directly (see `mixtac_sim.usb.link.Link`).

    Args:
        device: The camera.
    """

    def __init__(self, device: VirtualDavis346) -> None:
        self._device = device
        self._plugs = device.plugs

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
        self._device.check_present(self._plugs)
        limit_s = timeout_ms / 1000 or None
        return self._device.control(request_type, request, value, index, data, limit_s)

    def read(self, endpoint: int, buffer: array[int], timeout_ms: int) -> int:
        """Read at most a buffer full; a timeout of 0 waits for ever."""
        self._device.check_present(self._plugs)
        return self._device.read_into(endpoint, buffer, timeout_ms / 1000 or None)

    def claim(self) -> None:
        """Claim the interface for this session."""
        self._device.check_present(self._plugs)
        self._device.claim(self)

    def release(self) -> None:
        """Give the interface back."""
        self._device.release(self)

    def reset(self) -> None:
        """Do a USB port reset."""
        self._device.check_present(self._plugs)
        self._device.reset()

    def close(self) -> None:
        """End the session."""
        self._device.release(self)


def in_process_backend(device: VirtualDavis346) -> VirtualBackend:
    """Return a pyusb backend that finds this one device."""
    return VirtualBackend(lambda: InProcessLink(device))
