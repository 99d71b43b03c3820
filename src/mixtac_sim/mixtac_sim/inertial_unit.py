# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera's inertial sensor at rest: gravity, a little noise, a warm chip."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_sim.random_streams import stream
from mixtac_sim.usb.imu_words import ImuReading

if TYPE_CHECKING:
    from numpy.random import Generator

ACCELERATION_NOISE_G = 0.004
"""Noise of one sample [g]: 300 ug/sqrt(Hz) over 184 Hz (MPU-9250 data sheet)."""
RATE_NOISE_DPS = 0.14
"""Noise of one sample [deg/s]: 0.01 deg/s/sqrt(Hz) over 184 Hz (MPU-9250 data sheet)."""
TEMPERATURE_C = 38.0
"""Die temperature of a camera that has run for a while (estimate)."""


class InertialUnit:
    """Makes the samples of a sensor that lies still, lens up.

    Args:
        seed: Fixes biases and noise.
    """

    def __init__(self, seed: int) -> None:
        self._rng: Generator = stream(seed, 'inertial unit')
        self._bias_g = self._rng.normal((0.0, 0.0, 1.0), 0.02)
        self._bias_dps = self._rng.normal(0.0, 1.0, 3)
        self._next_us = 0

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
        rate = self._rng.normal(self._bias_dps, RATE_NOISE_DPS, (len(times), 3))
        return [
            ImuReading(t, (a[0], a[1], a[2]), (r[0], r[1], r[2]), TEMPERATURE_C)
            for t, a, r in zip(times, acceleration.tolist(), rate.tolist(), strict=True)
        ]
