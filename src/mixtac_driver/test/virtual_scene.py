# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual camera that sees noise in real time, with everything it was given to send."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import numpy as np
from faulty_camera import FaultyDavis346

from mixtac_core.events.arrays import Events
from mixtac_sim.usb.words import ImuReading


class Scene:
    """Feeds a virtual camera from a thread: events, 25 frames/s, 200 inertial samples/s."""

    def __init__(self, rate_hz=20_000, serial='V0000042'):
        self.start = time.monotonic_ns()
        self.device = FaultyDavis346(serial, clock=self.now)
        self.given = []
        self.frames = []
        self._rng = np.random.default_rng(1)
        self._rate_hz = rate_hz
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def now(self):
        return (time.monotonic_ns() - self.start) // 1000

    def close(self):
        self._stop.set()
        self._thread.join(5.0)

    def _run(self):
        done = 0
        while not self._stop.wait(0.004):
            until = self.now() // 1000 * 1000
            if until > done:
                self.device.submit(
                    self._events(done, until), self._frames(done, until), self._imu(done, until)
                )
                self.device.advance(until)
                done = until

    def _events(self, start, end):
        rng, n = self._rng, self._rng.poisson((end - start) * self._rate_hz / 1e6)
        x, y = rng.integers(0, 346, n), rng.integers(0, 260, n)
        t = np.sort(rng.integers(start, end, n))
        events = Events(t, x.astype(np.uint16), y.astype(np.uint16), rng.random(n) < 0.5)
        self.given.append(events)
        return events

    def _frames(self, start, end):
        return [self._frame(t) for t in range(-(-start // 40_000) * 40_000, end, 40_000)]

    def _frame(self, t):
        signal = self._rng.integers(1, 400, (260, 346)).astype(np.uint16)
        reset = np.full((260, 346), 900, np.uint16)
        self.frames.append(900 - signal)
        return SimpleNamespace(
            frame_start_us=t,
            exposure_start_us=t + 6000,
            exposure_end_us=t + 10_000,
            frame_end_us=t + 16_000,
            reset=reset,
            signal=signal,
        )

    def _imu(self, start, end):
        times = range(-(-start // 5000) * 5000, end, 5000)
        return [ImuReading(t, (0.0, 0.0, 1.0), (0.0, 90.0, 0.0), 40.0) for t in times]
