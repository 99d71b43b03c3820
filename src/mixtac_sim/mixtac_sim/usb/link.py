# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a host needs from a transport to a USB device."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from array import array


class Link(Protocol):
    """A connection of one host session to one camera.

    All methods raise `UsbStall`, `UsbTimeout`, `UsbGone` or `UsbBusy` where USB would fail so.
    """

    def control(
        self,
        request_type: int,
        request: int,
        value: int,
        index: int,
        data: bytes | int,
        timeout_ms: int = 0,
    ) -> bytes:
        """Make a control request (see `mixtac_sim.usb.device.VirtualDavis346.control`).

        A timeout of 0 waits for ever.
        """

    def read(self, endpoint: int, buffer: array[int], timeout_ms: int) -> int:
        """Read at most a buffer full and return the bytes read; a timeout of 0 waits for ever."""

    def claim(self) -> None:
        """Claim the interface for this session."""

    def release(self) -> None:
        """Give the interface back."""

    def reset(self) -> None:
        """Do a USB port reset."""

    def close(self) -> None:
        """End the session."""
