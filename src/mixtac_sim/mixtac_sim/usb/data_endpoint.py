# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera's endpoints for reading: when a read is answered, and with how much."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Final

from mixtac_sim.usb import descriptors
from mixtac_sim.usb.errors import UsbStall, UsbTimeout, VirtualUsbError

if TYPE_CHECKING:
    from collections.abc import Callable
    from threading import Condition

    from mixtac_sim.usb.fault_injector import FaultInjector
    from mixtac_sim.usb.fifo import ByteFifo
    from mixtac_sim.usb.presence import Presence

_LONGEST_WAIT_S: Final = 3600.0
_ENDPOINTS: Final = {descriptors.DATA_ENDPOINT, descriptors.DEBUG_ENDPOINT}


class DataEndpoint:
    """Lets hosts wait for data. Not thread safe: the device guards it with its condition.

    Args:
        condition: The device's; its lock is held whenever a method is called.
        fifo: The output buffer.
        presence: Whether the device is there.
        faults: What goes wrong.
        early_packet_s: Returns the early packet delay [s].
    """

    def __init__(
        self,
        condition: Condition,
        fifo: ByteFifo,
        presence: Presence,
        faults: FaultInjector,
        early_packet_s: Callable[[], float],
    ) -> None:
        self._condition = condition
        self._fifo = fifo
        self._presence = presence
        self._faults = faults
        self._early_packet_s = early_packet_s
        self._oldest_s = 0.0
        self._wanted = sys.maxsize

    def announce(self, *, was_empty: bool) -> None:
        """Wake readers if what was added may be news to one of them.

        Args:
            was_empty: Whether the buffer was empty before.
        """
        if was_empty and len(self._fifo):
            self._oldest_s = time.monotonic()
        elif len(self._fifo) < self._wanted:
            return
        self._condition.notify_all()

    def flush(self) -> None:
        """Let the next read have what is there, without the early packet delay."""
        self._oldest_s = 0.0

    def wait(self, endpoint: int, length: int, timeout_s: float | None) -> int:
        """Wait until a read is to be answered.

        Args:
            endpoint: 0x82 data, 0x81 debug messages, of which there are none.
            length: Most bytes that the host takes.
            timeout_s: How long it waits [s]; none waits for ever.

        Returns:
            How many bytes to take from the buffer.

        Raises:
            UsbTimeout: Nothing came in time.
            UsbStall: There is no such endpoint, or it is halted.
            UsbGone: The device was unplugged.
            VirtualUsbError: A fault of the bus.
        """
        if endpoint not in _ENDPOINTS:
            raise UsbStall(f'the camera has no endpoint {endpoint:#04x}; read 0x82 or 0x81')
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        plugs, resets = self._presence.plugs, self._presence.resets
        is_data = endpoint == descriptors.DATA_ENDPOINT
        while True:
            self._presence.check(plugs)
            if resets != self._presence.resets:
                raise VirtualUsbError('the port was reset during the read')
            if is_data:
                self._faults.before_read()
            now = time.monotonic()
            ready_at = self._ready_at(length, now) if is_data else None
            if ready_at is not None and ready_at <= now:
                self._oldest_s, self._wanted = now, sys.maxsize
                return self._faults.granted(min(length & ~1, len(self._fifo)))
            if deadline is not None and now >= deadline and not (is_data and self._faults.is_hung):
                raise UsbTimeout(f'no data on endpoint {endpoint:#04x} within {timeout_s} s')
            self._wanted = min(self._wanted, length & ~1)
            moments = (self._faults.thaws_at, ready_at, deadline, now + _LONGEST_WAIT_S)
            self._condition.wait(min(m for m in moments if m is not None and m > now) - now)

    def _ready_at(self, length: int, now: float) -> float | None:
        if self._faults.is_frozen:
            return None
        self._fifo.drop(self._faults.take_dropped(len(self._fifo)))
        if not len(self._fifo):
            return None
        if len(self._fifo) >= length & ~1:
            return now
        return self._oldest_s + self._early_packet_s()
