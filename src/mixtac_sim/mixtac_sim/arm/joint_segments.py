# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Polynomials between two states of a joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def interpolate(
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    span_s: float,
    since_s: float,
    order: int,
) -> NDArray[np.float64]:
    """Return the state between two states.

    Args:
        start: Position, velocity, acceleration [3, joint] [rad, rad/s, rad/s2].
        end: The same at the end.
        span_s: Time between them [s], positive.
        since_s: Time since the start [s].
        order: 1 joins positions, 3 also velocities, 5 also accelerations.

    Returns:
        State [3, joint].
    """
    state = np.zeros_like(start)
    u = since_s / span_s
    for j in range(start.shape[1]):
        step = end[0, j] - start[0, j]
        if order == 1:
            state[0, j] = start[0, j] + u * step
            state[1, j] = step / span_s
            continue
        # In units of the span: p(u) = p0 + v0 u + a2 u^2 + ... + a5 u^5.
        v0, v1 = span_s * start[1, j], span_s * end[1, j]
        if order == 3:
            a2, a3, a4, a5 = 3.0 * step - 2.0 * v0 - v1, v0 + v1 - 2.0 * step, 0.0, 0.0
        else:
            half0 = 0.5 * span_s * span_s * start[2, j]
            half1 = 0.5 * span_s * span_s * end[2, j]
            gap, turn, bend = step - v0 - half0, v1 - v0 - 2.0 * half0, half1 - half0
            a2 = half0
            a3 = 10.0 * gap - 4.0 * turn + bend
            a4 = -15.0 * gap + 7.0 * turn - 2.0 * bend
            a5 = 6.0 * gap - 3.0 * turn + bend
        state[0, j] = start[0, j] + u * (v0 + u * (a2 + u * (a3 + u * (a4 + u * a5))))
        slope = v0 + u * (2.0 * a2 + u * (3.0 * a3 + u * (4.0 * a4 + u * 5.0 * a5)))
        bent = 2.0 * a2 + u * (6.0 * a3 + u * (12.0 * a4 + u * 20.0 * a5))
        state[1, j] = slope / span_s
        state[2, j] = bent / (span_s * span_s)
    return state
