# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual camera on a socket that sees noise in real time, for the recovery benchmark."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

import numpy as np

from mixtac_events.arrays import Events
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.imu_words import ImuReading
from mixtac_sim.usb.server import UsbServer

if TYPE_CHECKING:
    from types import TracebackType

SERIAL = 'V0000346'
PERIOD_S = 0.002
EVENTS_PER_S = 50_000
READING_INTERVAL_US = 1000
WIDTH, HEIGHT = 346, 260


class RecoveryScene:
    """Feeds the camera from a thread: 50,000 events and 1,000 inertial samples per second.

    Args:
        path: Socket to listen on.
        seed: Of the events.

    Attributes:
        device: The camera.
    """

    def __init__(self, path: str, seed: int) -> None:
        self._began_ns = time.monotonic_ns()
        self.device = VirtualDavis346(SERIAL, clock=self._now_us)
        self._server = UsbServer(self.device, path)
        self._rng = np.random.default_rng(seed)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name='scene', daemon=True)

    def __enter__(self) -> RecoveryScene:
        """Let time run."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop time and remove the camera."""
        self._stopping.set()
        self._thread.join()
        self._server.close()

    def _now_us(self) -> int:
        return (time.monotonic_ns() - self._began_ns) // 1000

    def _run(self) -> None:
        done_us = 0
        while not self._stopping.wait(PERIOD_S):
            until_us = self._now_us()
            readings = self._readings(done_us, until_us)
            self.device.submit(self._events(done_us, until_us), readings=readings)
            self.device.advance(until_us)
            done_us = until_us

    def _events(self, start_us: int, end_us: int) -> Events:
        rng, count = self._rng, (end_us - start_us) * EVENTS_PER_S // 1_000_000
        return Events(
            np.sort(rng.integers(start_us, end_us, count)),
            rng.integers(0, WIDTH, count, np.uint16),
            rng.integers(0, HEIGHT, count, np.uint16),
            rng.random(count) < 0.5,
        )

    def _readings(self, start_us: int, end_us: int) -> list[ImuReading]:
        first_us = -(-start_us // READING_INTERVAL_US) * READING_INTERVAL_US
        times = range(first_us, end_us, READING_INTERVAL_US)
        return [ImuReading(t, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 30.0) for t in times]
