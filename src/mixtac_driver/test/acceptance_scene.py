# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual camera at rest: noise that follows the biases, a still picture, a person beside it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from virtual_scene import Scene

from mixtac_driver.doctor.acceptance import Person
from mixtac_events.arrays import Events
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.pixels.biases import DEFAULT_REGISTERS, PixelBiases
from mixtac_sim.usb.faults import Fault, FaultKind
from mixtac_sim.usb.registers import Module

NOISE_HZ = 10_000
"""Rate of either polarity at the default biases."""
EDGES_HZ = 20.0
FLASHES = 8


def noise_hz(registers):
    """Return the rates of OFF and ON noise, by the square of the threshold for a clear effect."""
    now, usual = PixelBiases.from_registers(registers), PixelBiases.from_registers({})
    speed = now.source_follower_hz / usual.source_follower_hz
    on, off = now.threshold_on / usual.threshold_on, now.threshold_off / usual.threshold_off
    return NOISE_HZ * speed / off**2, NOISE_HZ * speed / on**2


class RestingScene(Scene):
    """As `Scene`, but at rest."""

    def __init__(self):
        rng = np.random.default_rng(2)
        detail = gaussian_filter(rng.normal(0.0, 1.0, (260, 346)), 0.8)
        self._picture = 300.0 + 60.0 * detail / detail.std()
        super().__init__()

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
        self.inject(FaultKind.UNPLUG, seconds=0.2)
