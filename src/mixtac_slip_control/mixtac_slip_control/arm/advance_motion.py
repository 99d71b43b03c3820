# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plans one coordinate and checks what it asks of every joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from mixtac_slip_control.arm.path_polynomial import exceeds, joint_states
from mixtac_slip_control.arm.scalar_profile import (
    fastest,
    integrate,
    jerks,
    land,
    travel,
    velocity_change,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SHARES = (0.97, 0.92, 0.85, 0.75, 0.6, 0.45, 0.3)
"""Of the limits, tried in turn: what the grid adds to the optimum needs some room."""
LONGEST = 400
"""Cells of the longest smooth motion tried."""


@njit(cache=True)
def replan(
    coefficients: Floats,
    centre: float,
    half: float,
    start: Floats,
    target: float,
    motion: tuple[float, float, float],
    acceleration_limit: Floats,
    jerk_limit: Floats,
    dt: float,
) -> Floats:
    """Return states (m, 3) on the grid from a state to rest at a target; none if it cannot be.

    The fastest motion that keeps all limits at every point and between them; where its shape does
    not fit the grid, the smoothest that does.

    Args:
        coefficients: Of the joint path, see `path_polynomial.derivatives`.
        centre: Middle of its range [m].
        half: Half its width [m].
        start: Position [m], velocity [m/s], acceleration [m/s2] (3,).
        target: Position to end at [m].
        motion: Largest speed [m/s], acceleration [m/s2] and jerk [m/s3] of the coordinate.
        acceleration_limit: Of the joints (n,) [rad/s2].
        jerk_limit: Of the joints (n,) [rad/s3].
        dt: Time between points [s].
    """
    V, A, J = motion
    shortest = 0
    for share in SHARES:
        phases = fastest(target - start[0], start[1], start[2], V * share, A * share, J * share)
        jerk = jerks(phases, start[2], dt)
        if share == SHARES[0]:
            shortest = jerk.size
            # Where rounding up to the grid leaves time, the smoothest motion is as early.
            states: Floats = _smooth(shortest, start, target, dt)
            if _fits(states, coefficients, centre, half, V, acceleration_limit, jerk_limit, dt):
                return states
        land(jerk, start, target, dt)
        states = integrate(jerk, start, target, dt)
        if _fits(states, coefficients, centre, half, V, acceleration_limit, jerk_limit, dt):
            return states
    for cells in range(shortest, LONGEST):
        states = _smooth(cells, start, target, dt)
        if _fits(states, coefficients, centre, half, V, acceleration_limit, jerk_limit, dt):
            return states
    return np.empty((0, 3))


@njit(cache=True)
def _smooth(cells: int, start: Floats, target: float, dt: float) -> Floats:
    """Return the states of the motion of a number of cells whose squared jerk is least."""
    jerk = np.zeros(cells)
    land(jerk, start, target, dt)
    states: Floats = integrate(jerk, start, target, dt)
    return states


@njit(cache=True)
def stopping_distance(start: Floats, A: float, J: float) -> float:
    """Return the distance [m] to rest from a state (3,), braking within limits."""
    share = SHARES[1]
    phases = velocity_change(start[1], start[2], 0.0, A * share, J * share)
    distance: float = travel(start[1], start[2], phases)
    return distance


@njit(cache=True)
def _fits(
    states: Floats,
    coefficients: Floats,
    centre: float,
    half: float,
    V: float,
    acceleration_limit: Floats,
    jerk_limit: Floats,
    dt: float,
) -> bool:
    for k in range(states.shape[0]):
        if not (abs(states[k, 0] - centre) <= half and abs(states[k, 1]) <= V):
            return False
    joints = joint_states(coefficients, centre, half, states)
    return not exceeds(joints, jerk_limit, acceleration_limit, dt)
