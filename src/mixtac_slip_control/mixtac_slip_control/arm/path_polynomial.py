# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiled evaluation of a joint path that is a polynomial of the advance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@njit(cache=True)
def derivatives(coefficients: Floats, centre: float, half: float, s: float) -> Floats:
    """Return joint positions and their first three derivatives by the advance (4, n).

    Args:
        coefficients: Of the powers of (s - centre) / half, lowest first (m, n).
        centre: Middle of the fitted range [m].
        half: Half its width [m].
        s: Advance [m].
    """
    u = (s - centre) / half
    m, n = coefficients.shape
    out = np.zeros((4, n))
    for k in range(m - 1, -1, -1):
        for i in range(n):
            out[3, i] = out[3, i] * u + 3.0 * out[2, i]
            out[2, i] = out[2, i] * u + 2.0 * out[1, i]
            out[1, i] = out[1, i] * u + out[0, i]
            out[0, i] = out[0, i] * u + coefficients[k, i]
    out[1] /= half
    out[2] /= half**2
    out[3] /= half**3
    return out


@njit(cache=True)
def joint_states(coefficients: Floats, centre: float, half: float, states: Floats) -> Floats:
    """Return joint positions, velocities, accelerations (k, 3, n) along a motion on the path.

    Args:
        coefficients: See `derivatives`.
        centre: Middle of the fitted range [m].
        half: Half its width [m].
        states: Advance [m], its velocity [m/s] and acceleration [m/s2] (k, 3).
    """
    out = np.empty((states.shape[0], 3, coefficients.shape[1]))
    for k in range(states.shape[0]):
        s, v, a = states[k]
        p = derivatives(coefficients, centre, half, s)
        out[k, 0] = p[0]
        out[k, 1] = p[1] * v
        out[k, 2] = p[1] * a + p[2] * v * v
    return out


@njit(cache=True)
def exceeds(joints: Floats, jerk_limit: Floats, acceleration_limit: Floats, dt: float) -> bool:
    """Tell whether quintics through joint states break limits of acceleration or jerk.

    Args:
        joints: Positions, velocities, accelerations at the points (k, 3, n).
        jerk_limit: Largest jerk (n,) [rad/s3].
        acceleration_limit: Largest acceleration (n,) [rad/s2].
        dt: Time between the points [s].
    """
    for k in range(joints.shape[0]):
        for i in range(joints.shape[2]):
            # NaN must not pass.
            if not abs(joints[k, 2, i]) <= acceleration_limit[i]:
                return True
            if k == 0:
                continue
            v0, a0 = joints[k - 1, 1, i], joints[k - 1, 2, i]
            v1, a1 = joints[k, 1, i], joints[k, 2, i]
            step = 60.0 * (joints[k, 0, i] - joints[k - 1, 0, i]) / dt**3
            first = step - (36.0 * v0 + 24.0 * v1) / dt**2 - (9.0 * a0 - 3.0 * a1) / dt
            last = step - (24.0 * v0 + 36.0 * v1) / dt**2 - (3.0 * a0 - 9.0 * a1) / dt
            # The jerk of a quintic is a parabola; its mean is that of the accelerations' change.
            middle = 1.5 * (a1 - a0) / dt - 0.25 * (first + last)
            if not max(abs(first), abs(middle), abs(last)) <= jerk_limit[i]:
                return True
    return False
