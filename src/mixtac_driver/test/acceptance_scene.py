# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual camera at rest: noise that follows the biases, a still picture, a person beside it.

Time is simulated, and passes only while the driver reads or sleeps: no busy computer is ever late.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from usb.core import USBTimeoutError

from mixtac_driver.doctor.acceptance import Person
from mixtac_events.arrays import Events
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.pixels.biases import DEFAULT_REGISTERS, PixelBiases
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.faults import Fault, FaultKind
from mixtac_sim.usb.pyusb_backend import in_process_backend
from mixtac_sim.usb.registers import Module
from mixtac_sim.usb.words import ImuReading

NOISE_HZ = 10_000
"""Rate of either polarity at the default biases."""
EDGES_HZ = 20.0
FLASHES = 8
STEP_US = 5000
OUTAGE_US = 200_000
EPOCH_NS = 1_700_000_000_000_000_000
USES_TIME = (
    *('mixtac_driver.usb.transport', 'mixtac_driver.doctor.acceptance', 'mixtac_driver.camera'),
    'mixtac_driver.davis346.writes',
)
"""Modules that take the time from the scene."""


def noise_hz(registers):
    """Return the rates of OFF and ON noise, by the square of the threshold for a clear effect."""
    now, usual = PixelBiases.from_registers(registers), PixelBiases.from_registers({})
    speed = now.source_follower_hz / usual.source_follower_hz
    on, off = now.threshold_on / usual.threshold_on, now.threshold_off / usual.threshold_off
    return NOISE_HZ * speed / off**2, NOISE_HZ * speed / on**2


class RestingScene:
    """A camera, what it sees, and the time.

    Args:
        monkeypatch: Puts the time of the scene in place.
    """

    def __init__(self, monkeypatch):
        rng = np.random.default_rng(2)
        detail = gaussian_filter(rng.normal(0.0, 1.0, (260, 346)), 0.8)
        self._picture = 300.0 + 60.0 * detail / detail.std()
        self._rng = np.random.default_rng(1)
        self.now_us = 0
        self._back_us = None
        self.device = VirtualDavis346('V0000042', clock=lambda: self.now_us)
        self.backend = SteppedBackend(self)
        for module in USES_TIME:
            monkeypatch.setattr(f'{module}.time', self)

    # What the driver sees of the module time.

    def monotonic(self):
        return self.now_us / 1e6

    def time_ns(self):
        return EPOCH_NS + 1000 * self.now_us

    def sleep(self, seconds):
        until_us = self.now_us + round(1e6 * seconds)
        while self.now_us < until_us:
            self.step(min(STEP_US, until_us - self.now_us))

    def step(self, length_us=STEP_US):
        start, end = self.now_us, self.now_us + length_us
        frames = [self._frame(t) for t in range(-(-start // 40_000) * 40_000, end, 40_000)]
        times = range(-(-start // 5000) * 5000, end, 5000)
        readings = [ImuReading(t, (0.0, 0.0, 1.0), (0.0, 90.0, 0.0), 40.0) for t in times]
        self.device.submit(self._events(start, end), frames, readings)
        self.now_us = end
        if self._back_us is not None and end >= self._back_us:
            self._back_us = None
            self.device.plug_in()
        self.device.advance(end)

    def _events(self, start, end):
        registers = {place: self.device.register(Module.BIAS, place) for place in DEFAULT_REGISTERS}
        counts = [self._rng.poisson((end - start) * hz / 1e6) for hz in noise_hz(registers)]
        n = sum(counts)
        polarity = self._rng.permutation(np.repeat([False, True], counts))
        x, y = self._rng.integers(0, 346, n), self._rng.integers(0, 260, n)
        t = np.sort(self._rng.integers(start, end, n))
        return Events(t, x.astype(np.uint16), y.astype(np.uint16), polarity)

    def _frame(self, t):
        seen = self._picture + self._rng.normal(0.0, 3.0, self._picture.shape)
        reset = np.full((260, 346), 950, np.uint16)
        signal = np.clip(950 - seen, 0, 1023).astype(np.uint16)
        return ApsFrame(t, t + 6000, t + 13_000, t + 19_000, reset, signal)

    def inject(self, *args, **fields):
        self.device.inject(Fault(*args, **fields))

    def person(self):
        """Return somebody who flashes a light, pulls the plug and has a signal generator."""
        self.inject(FaultKind.EDGES, amount=EDGES_HZ)
        return Person(self._flash, self._unplug, EDGES_HZ)

    def _flash(self, seconds):
        for k in range(FLASHES):
            start_s = 0.2 + k * (0.32 + 0.0247)
            self.inject(FaultKind.FLASH, seconds=0.1 + 0.0092 * k, delay=start_s)

    def _unplug(self):
        self.device.unplug()
        self._back_us = self.now_us + OUTAGE_US


class SteppedBackend:
    """A pyusb backend of the camera on which time passes in reads."""

    def __init__(self, scene):
        self._scene, self._inner = scene, in_process_backend(scene.device)

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def bulk_read(self, handle, endpoint, interface, buffer, timeout_ms):
        until_us = self._scene.now_us + 1000 * timeout_ms
        while True:
            if not self._scene.device.backlog:
                self._scene.step()
            try:
                return self._inner.bulk_read(handle, endpoint, interface, buffer, 1)
            except USBTimeoutError:
                self._scene.step()
                if self._scene.now_us >= until_us:
                    raise
