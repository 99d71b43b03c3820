# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera's inertial sensor: gravity, a little noise, a warm chip, and what shakes the head."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import lfilter

from mixtac_sim.contact_steps import GRAVITY, STEP_US
from mixtac_sim.mount import Mount
from mixtac_sim.random_streams import log_uniform, stream
from mixtac_sim.usb.imu_words import ImuReading

if TYPE_CHECKING:
    from numpy.random import Generator
    from numpy.typing import NDArray

ACCELERATION_NOISE_G = 0.004
"""Noise of one sample [g]: 300 ug/sqrt(Hz) over 184 Hz (MPU-9250 data sheet)."""
RATE_NOISE_DPS = 0.14
"""Noise of one sample [deg/s]: 0.01 deg/s/sqrt(Hz) over 184 Hz (MPU-9250 data sheet)."""
TEMPERATURE_C = 38.0
"""Die temperature of a camera that has run for a while (estimate)."""


HEAD_KG = (0.15, 0.4)
"""Mass of the sensor's head [kg] (estimate)."""
RESONANCE_HZ = (250.0, 1300.0)
"""Resonance of the head on its mount [Hz] (estimate)."""
CORNER_HZ = 184.0
"""Bandwidth of the acceleration [Hz] (MPU-9250 data sheet, default filter)."""


class InertialUnit:
    """Makes the samples of a sensor that stands on its mount, lens up.

    Args:
        seed: Fixes biases and noise.
    """

    def __init__(self, seed: int) -> None:
        self._rng: Generator = stream(seed, 'inertial unit')
        self._bias_g = self._rng.normal((0.0, 0.0, 1.0), 0.02)
        self._bias_dps = self._rng.normal(0.0, 1.0, 3)
        self._next_us = 0
        mount = stream(seed, 'inertial mount')
        self._mount = Mount(log_uniform(mount, RESONANCE_HZ), 0.04)
        self._per_n = 1.0 / (mount.uniform(*HEAD_KG) * GRAVITY)
        self._kept = float(np.exp(-2.0 * np.pi * CORNER_HZ * 1e-6 * STEP_US))
        self._memory = np.zeros((1, 3))
        self._felt_us, self._felt_g = np.zeros(1), np.zeros((1, 3))

    def feel(self, t_us: NDArray[np.int64], wrench: NDArray[np.float64]) -> None:
        """Take in what shakes the head; call it before the ``readings`` of that time.

        Args:
            t_us: Simulated time [n] [us], 125 us apart, later than at the previous call.
            wrench: Force [N] and torque [Nm] on the skin [n, 6]; right, down, normal.
        """
        if not len(t_us):
            return
        _, left = self._mount.swing(t_us, wrench)
        # The camera looks up, so a press on the skin accelerates it downwards.
        push = self._per_n * left[:, :3] * np.array([1.0, 1.0, -1.0])
        soft, self._memory = lfilter(
            [1.0 - self._kept], [1.0, -self._kept], push, axis=0, zi=self._memory
        )
        keep = max(int(np.searchsorted(self._felt_us, self._next_us)) - 1, 0)
        self._felt_us = np.append(self._felt_us[keep:], t_us.astype(np.float64))
        self._felt_g = np.vstack([self._felt_g[keep:], soft])

    def readings(self, until_us: int, interval_us: int) -> list[ImuReading]:
        """Return the samples before a time [us, simulated time] that were not returned before.

        Args:
            until_us: End, not earlier than at the previous call.
            interval_us: Time between samples [us]; 0 switches the unit off.
        """
        if not interval_us:
            self._next_us = until_us
            return []
        times = range(self._next_us, until_us, interval_us)
        if not times:
            return []
        self._next_us = times[-1] + interval_us
        acceleration = self._rng.normal(self._bias_g, ACCELERATION_NOISE_G, (len(times), 3))
        for axis in range(3):
            acceleration[:, axis] += np.interp(times, self._felt_us, self._felt_g[:, axis])
        rate = self._rng.normal(self._bias_dps, RATE_NOISE_DPS, (len(times), 3))
        return [
            ImuReading(t, (a[0], a[1], a[2]), (r[0], r[1], r[2]), TEMPERATURE_C)
            for t, a, r in zip(times, acceleration.tolist(), rate.tolist(), strict=True)
        ]
