# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual DAVIS346 that sends a pattern: words are made at the moment they are asked for."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

from mixtac_sim.usb import descriptors
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.pattern import PatternPlayer
from mixtac_sim.usb.registers import Module, Usb

if TYPE_CHECKING:
    from mixtac_sim.usb.pattern import Pattern


class PatternCamera(VirtualDavis346):
    """Sends a pattern in step with its clock, whatever the host asks of sensor and filters.

    Nothing runs between two reads. A read that finds no time gone by since the last one waits for
    the early packet delay, as the camera does, and then brings everything up to its own moment;
    where the pattern has a pause it goes on so until there is something.

    Args:
        serial: Serial number, at most eight characters.
        pattern: What to send.
    """

    def __init__(self, serial: str, pattern: Pattern) -> None:
        super().__init__(serial)
        self.player = PatternPlayer(pattern)
        self._last_read_s = 0.0

    def true_time_us(self) -> int:
        """Return the true time now [us since construction]."""
        return self._clock()

    def _before_read(self, endpoint: int, timeout_s: float | None) -> None:
        if endpoint != descriptors.DATA_ENDPOINT:
            return
        deadline_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        while self.streaming:
            pause_s = self._last_read_s + self._delay_s() - time.monotonic()
            if pause_s > 0:
                time.sleep(min(pause_s, max(deadline_s - time.monotonic(), 0.0)))
            self._produce()
            self._last_read_s = time.monotonic()
            if len(self._fifo) or self._last_read_s >= deadline_s:
                return

    def _delay_s(self) -> float:
        cycles = self.register(Module.USB, Usb.EARLY_PACKET_DELAY)
        return cycles * 1e-3 / (self.board.usb_mhz * self.board.deviation)

    def _produce(self) -> None:
        with self._condition:
            words = self.player.due(self._oscillator.now(self._clock()))
            if len(words) and not self._fifo.push(words):
                self._fifo.push(self.player.refused(words))
            # What was made now has waited long enough.
            self._data.flush()
