# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Registers of an open camera: written once, then only what changes."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from mixtac_driver.errors import UsbError
from mixtac_driver.register_writes import exposure_write, register_writes, run_writes
from mixtac_driver.registers import Aps, Module, Write
from mixtac_driver.sequences import STOP_WRITES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_driver.configuration import Configuration
    from mixtac_driver.identity import Identity
    from mixtac_driver.protocol import Protocol

REGION = tuple(
    (int(Module.APS), int(parameter))
    for parameter in (Aps.START_COLUMN, Aps.START_ROW, Aps.END_COLUMN, Aps.END_ROW)
)
FRAMES_ON = Write(Module.APS, Aps.RUN, 1)
FRAMES_OFF = Write(Module.APS, Aps.RUN, 0)


class RegisterWriter:
    """Puts settings into a camera and remembers what it wrote. For one thread at a time.

    Args:
        protocol: Register access.
        identity: The camera.

    Attributes:
        running: True between `started` and `stopped`: the sensors follow their run bits.
    """

    def __init__(self, protocol: Protocol, identity: Identity) -> None:
        self.running = False
        self._protocol = protocol
        self._identity = identity
        self._written: dict[tuple[int, int], int] = {}

    def configure(self, configuration: Configuration) -> None:
        """Write all settings in the order that cameras know; nothing is started.

        Raises:
            ConfigurationError: A setting is out of range; nothing was written.
            UsbError: A request failed.
        """
        self._write_each(register_writes(configuration, self._identity))

    def started(self, configuration: Configuration) -> None:
        """Take note that the sensors of a configuration run."""
        self._written.update({(m, p): value for m, p, value in run_writes(configuration)})
        self.running = True

    def stopped(self) -> None:
        """Take note that the sensors were stopped; they start with the stream."""
        self.running = False
        for address in map(_address, STOP_WRITES):
            self._written.pop(address, None)

    def change(self, old: Configuration, new: Configuration) -> None:
        """Write what differs from what the camera has.

        Args:
            old: Settings so far, to go back to if a request fails.
            new: Wanted settings.

        Raises:
            ConfigurationError: A setting is out of range; nothing was written.
            UsbError: A request failed; what can be was set back.
        """
        wanted = self._wanted(new)
        try:
            self._write_changes(wanted)
        except UsbError:
            with contextlib.suppress(UsbError):
                self._write_changes(self._wanted(old))
            raise

    def set_exposure(self, exposure_us: int) -> None:
        """Write the exposure [us] and nothing else.

        Raises:
            UsbError: The request failed.
        """
        self._write_changes([exposure_write(exposure_us, self._identity.clocks)])

    def request_frame(self) -> None:
        """Make a camera whose frames are off take one.

        Raises:
            UsbError: The request failed.
        """
        self._protocol.write_at_once([FRAMES_ON, FRAMES_OFF])

    def _wanted(self, configuration: Configuration) -> list[Write]:
        wanted = register_writes(configuration, self._identity)
        return wanted + run_writes(configuration) if self.running else wanted

    def _write_changes(self, wanted: Sequence[Write]) -> None:
        changed = [w for w in wanted if self._written.get(_address(w)) != w.value]
        self._write_each([w for w in changed if _address(w) not in REGION])
        if any(_address(w) in REGION for w in changed):
            self._write_region([w for w in wanted if _address(w) in REGION])

    def _write_region(self, region: Sequence[Write]) -> None:
        # The read-out takes a new region only while it is idle, and all of it at once.
        running = self._written.get(_address(FRAMES_ON), 0)
        again = [FRAMES_ON] if running else []
        for write in region:
            self._written.pop(_address(write), None)
        self._protocol.write_at_once([FRAMES_OFF, *region, *again])
        for write in region:
            self._written[_address(write)] = write.value

    def _write_each(self, writes: Sequence[Write]) -> None:
        for write in writes:
            # A request that failed may or may not have been obeyed.
            self._written.pop(_address(write), None)
            self._protocol.write(*write)
            self._written[_address(write)] = write.value


def _address(write: Write) -> tuple[int, int]:
    return int(write.module), int(write.parameter)
