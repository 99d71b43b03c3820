# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The mount of the sensor on the reference: a mass on a spring that rings after impacts.

A head of 0.15 to 0.4 kg on a stiffness of 1e6 to 1e7 N/m resonates at 250 to 1300 Hz (estimate).
The force that reaches the reference, y, follows the one on the skin, u, as
y'' + 2 d w y' + w^2 y = w^2 u; a step with u constant over it is exact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from mixtac_sim.contact_steps import STEP_US

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Mount:
    """Passes wrenches on, with a resonance of its own.

    Args:
        resonance_hz: Its resonance [Hz]; 0 for a rigid mount.
        damping: Damping ratio, 0 to below 1.
    """

    def __init__(self, resonance_hz: float, damping: float) -> None:
        self.resonance_hz = resonance_hz
        self.damping = damping
        self._state = np.zeros((2, 6))
        self._last_us: float | None = None

    def transmit(self, t_us: NDArray[np.int64], wrench: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what of a wrench [n, 6] arrives; at rest before the first call.

        Args:
            t_us: Times [n] [us], increasing from call to call.
            wrench: Force [N] and torque [Nm] up to each time [n, 6].
        """
        if self.resonance_hz <= 0.0:
            return wrench
        return self.swing(t_us, wrench)[0]

    def swing(
        self, t_us: NDArray[np.int64], wrench: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what arrives and what accelerates the head, both as wrenches [n, 6].

        Arguments are those of ``transmit``.
        """
        arrived, left = np.empty_like(wrench), np.zeros_like(wrench)
        if self.resonance_hz <= 0.0 or not len(t_us):
            return wrench, left
        first = float(t_us[0]) - STEP_US if self._last_us is None else self._last_us
        steps_s = 1e-6 * np.diff(np.append(first, t_us.astype(np.float64)))
        self._last_us = float(t_us[-1])
        omega = 2.0 * np.pi * self.resonance_hz
        _ring(self._state, omega, self.damping, steps_s, wrench, arrived, left)
        return arrived, left


@njit(cache=True, nogil=True)
def _ring(
    state: NDArray[np.float64],
    omega: float,
    damping: float,
    steps_s: NDArray[np.float64],
    wrench: NDArray[np.float64],
    arrived: NDArray[np.float64],
    left: NDArray[np.float64],
) -> None:
    """Advance displacement and velocity of each axis; see the module."""
    sigma = damping * omega
    turn = omega * np.sqrt(1.0 - damping * damping)
    for k in range(steps_s.size):
        decay = np.exp(-sigma * steps_s[k])
        cos, sin = decay * np.cos(turn * steps_s[k]), decay * np.sin(turn * steps_s[k])
        for axis in range(6):
            off, speed = state[0, axis] - wrench[k, axis], state[1, axis]
            swing = (speed + sigma * off) / turn
            state[0, axis] = wrench[k, axis] + off * cos + swing * sin
            state[1, axis] = speed * cos - (sigma * speed + omega * omega * off) / turn * sin
            arrived[k, axis] = state[0, axis]
            damped = 2.0 * damping / omega * state[1, axis]
            left[k, axis] = wrench[k, axis] - state[0, axis] - damped
