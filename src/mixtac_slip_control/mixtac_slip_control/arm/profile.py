# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Jerk-limited motion of one coordinate to rest at a target, on a fixed time grid.

The time-optimal motion changes the velocity to a cruise velocity at which the acceleration is zero,
cruises, and brakes to rest; each change of velocity ramps the acceleration up, holds it and ramps
it down (Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008,
section 3.4, for general initial states).

Its jerk switches between the points of the grid, which a controller that joins the points with
quintics would turn into overshoot: up to 1.5 times the jerk. Therefore the acceleration is sampled
at the points and joined linearly: the jerk is constant from point to point and never above that of
the optimum, as it is its mean, and a quintic through the points is exactly that cubic. The error
this leaves at the end is removed with the smallest jerks, in the least-squares sense, that do so.
`replan` checks the motion against the limits of every joint and slows it down where it must.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_slip_control.arm.normal_path import exceeds, joint_states

Floats = NDArray[np.float64]


BISECTIONS = 60
MIN_CELLS = 6
"""Cells of the smooth motion: three are needed to reach a state, more keep the jerk small."""


@njit(cache=True)
def velocity_change(v0: float, a0: float, v1: float, A: float, J: float) -> Floats:
    """Return the fastest change of velocity as three phases (3, 2): duration [s], jerk [m/s3].

    Args:
        v0: Velocity at the start [m/s].
        a0: Acceleration at the start [m/s2].
        v1: Velocity at the end [m/s], where the acceleration is zero.
        A: Largest acceleration [m/s2]; one that starts above it is not increased.
        J: Largest jerk [m/s3].
    """
    sign = 1.0 if v1 >= v0 + a0 * abs(a0) / (2.0 * J) else -1.0
    gain, a = sign * (v1 - v0), sign * a0
    top = max(A, a)
    peak = np.sqrt(max(J * gain + 0.5 * a * a, 0.0))
    held = 0.0
    if peak > top:
        peak = top
        held = max(gain - (2.0 * top * top - a * a) / (2.0 * J), 0.0) / top
    phases = np.empty((3, 2))
    phases[0] = max((peak - a) / J, 0.0), sign * J
    phases[1] = held, 0.0
    phases[2] = peak / J, -sign * J
    return phases


@njit(cache=True)
def travel(v: float, a: float, phases: Floats) -> float:
    """Return the distance [m] covered in phases of constant jerk from a velocity, acceleration."""
    s = 0.0
    for k in range(phases.shape[0]):
        t, j = phases[k]
        s += t * (v + t * (0.5 * a + t * j / 6.0))
        v += t * (a + 0.5 * t * j)
        a += t * j
    return s


@njit(cache=True)
def fastest(d: float, v0: float, a0: float, V: float, A: float, J: float) -> Floats:
    """Return the fastest motion to rest as phases (7, 2) of duration [s] and jerk [m/s3].

    Args:
        d: Distance to the target [m].
        v0: Velocity at the start [m/s].
        a0: Acceleration at the start [m/s2].
        V: Largest velocity [m/s].
        A: Largest acceleration [m/s2].
        J: Largest jerk [m/s3].
    """
    braking = travel(v0, a0, velocity_change(v0, a0, 0.0, A, J))
    bound = V if d >= braking else -V
    missing = d - _peak_travel(v0, a0, bound, A, J)
    cruise = bound
    if missing * bound < 0.0:
        inner, outer = 0.0, bound
        for _ in range(BISECTIONS):
            cruise = 0.5 * (inner + outer)
            if (d - _peak_travel(v0, a0, cruise, A, J)) * bound > 0.0:
                inner = cruise
            else:
                outer = cruise
        missing = 0.0
    phases = np.zeros((7, 2))
    phases[:3] = velocity_change(v0, a0, cruise, A, J)
    phases[3, 0] = missing / bound
    phases[4:] = velocity_change(cruise, 0.0, 0.0, A, J)
    return phases


@njit(cache=True)
def _peak_travel(v0: float, a0: float, cruise: float, A: float, J: float) -> float:
    """Return the distance [m] to rest by way of a velocity [m/s] at which one does not stay."""
    first = travel(v0, a0, velocity_change(v0, a0, cruise, A, J))
    total: float = first + travel(cruise, 0.0, velocity_change(cruise, 0.0, 0.0, A, J))
    return total


@njit(cache=True)
def jerks(phases: Floats, a0: float, dt: float) -> Floats:
    """Return the mean jerk (n,) [m/s3] of phases in each cell of a grid, enough cells to finish.

    Args:
        phases: Durations [s] and jerks [m/s3] (m, 2).
        a0: Acceleration at the start [m/s2].
        dt: Width of the cells [s].
    """
    cells = max(int(np.ceil(np.sum(phases[:, 0]) / dt - 1e-9)), MIN_CELLS)
    mean = np.empty(cells)
    before, a, start, phase = a0, a0, 0.0, 0
    for k in range(cells):
        end = (k + 1) * dt
        while phase < phases.shape[0] and start + phases[phase, 0] <= end:
            a += phases[phase, 0] * phases[phase, 1]
            start += phases[phase, 0]
            phase += 1
        after = a + (end - start) * phases[phase, 1] if phase < phases.shape[0] else 0.0
        mean[k] = (after - before) / dt
        before = after
    return mean


@njit(cache=True)
def land(jerk: Floats, start: Floats, target: float, dt: float) -> None:
    """Change jerks (n,) as little as possible, in place, so that they end at rest at a target.

    Args:
        jerk: Jerk of each cell [m/s3], at least three.
        start: Position [m], velocity [m/s], acceleration [m/s2] (3,).
        target: Position to end at [m].
        dt: Width of the cells [s].
    """
    n = jerk.size
    s, v, a = start
    for k in range(n):
        j = jerk[k]
        s += dt * (v + dt * (0.5 * a + dt * j / 6.0))
        v += dt * (a + 0.5 * dt * j)
        a += dt * j
    # Moments of the wanted change over the cells' centres x, symmetric about zero.
    half = 0.5 * (n - 1)
    m0 = -a / dt
    m1 = -v / dt**2 - m0 * (half + 0.5)
    level = 0.5 * half * (half + 1.0) + 1.0 / 6.0
    m2 = 2.0 * ((target - s) / dt**3 - (half + 0.5) * m1 - level * m0)
    x2 = x4 = 0.0
    for k in range(n):
        x = (half - k) ** 2
        x2 += x
        x4 += x * x
    curve = (m2 * n - m0 * x2) / (x4 * n - x2 * x2)
    level = (m0 - curve * x2) / n
    for k in range(n):
        x = half - k
        jerk[k] += level + x * (m1 / x2 + x * curve)


@njit(cache=True)
def integrate(jerk: Floats, start: Floats, target: float, dt: float) -> Floats:
    """Return position [m], velocity [m/s], acceleration [m/s2] (n + 1, 3) at the grid's points.

    The last is exactly at rest at the target.

    Args:
        jerk: Jerk of each cell (n,) [m/s3], as `land` left it.
        start: The same at the first point (3,).
        target: Position of the last point [m].
        dt: Width of the cells [s].
    """
    states = np.empty((jerk.size + 1, 3))
    states[0] = start
    for k in range(jerk.size):
        s, v, a = states[k]
        j = jerk[k]
        states[k + 1, 0] = s + dt * (v + dt * (0.5 * a + dt * j / 6.0))
        states[k + 1, 1] = v + dt * (a + 0.5 * dt * j)
        states[k + 1, 2] = a + dt * j
    states[-1, 0] = target
    states[-1, 1:] = 0.0
    return states


SHARES = (0.97, 0.92, 0.85, 0.75, 0.6, 0.45, 0.3)
"""Shares of the limits, tried in turn: rounding to the grid needs some room."""
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
    tip: tuple[float, float],
    acceleration_limit: Floats,
    jerk_limit: Floats,
    dt: float,
) -> Floats:
    """Return states (m, 3) on the grid from a state to rest at a target; none if it cannot be.

    The fastest motion that keeps all limits at every point and between them; where its shape does
    not fit the grid, the smoothest that does.

    Args:
        coefficients: Coefficients of the joint path, see `normal_path.derivatives`.
        centre: Middle of its range [m].
        half: Half its width [m].
        start: Position [m], velocity [m/s], acceleration [m/s2] (3,).
        target: Position to end at [m].
        motion: Largest speed [m/s], acceleration [m/s2] and jerk [m/s3] of the coordinate; the
            smoothest motion may exceed the last two where the joints allow it.
        tip: Acceleration [m/s2] and jerk [m/s3] that the coordinate must never exceed.
        acceleration_limit: Acceleration limits of the joints (n,) [rad/s2].
        jerk_limit: Jerk limits of the joints (n,) [rad/s3].
        dt: Time between points [s].
    """
    V, A, J = motion
    rates = (V, tip[0], tip[1])
    limits = acceleration_limit, jerk_limit
    shortest = 0
    for share in SHARES:
        phases = fastest(target - start[0], start[1], start[2], V * share, A * share, J * share)
        jerk = jerks(phases, start[2], dt)
        if share == SHARES[0]:
            shortest = jerk.size
            # Where rounding up to the grid leaves time, the smoothest motion is as early.
            states: Floats = _smooth(shortest, start, target, dt)
            if _fits(states, coefficients, centre, half, rates, limits, dt):
                return states
        land(jerk, start, target, dt)
        states = integrate(jerk, start, target, dt)
        if _fits(states, coefficients, centre, half, rates, limits, dt):
            return states
    for cells in range(shortest, LONGEST):
        states = _smooth(cells, start, target, dt)
        if _fits(states, coefficients, centre, half, rates, limits, dt):
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
    rates: tuple[float, float, float],
    limits: tuple[Floats, Floats],
    dt: float,
) -> bool:
    V, A, J = rates
    for k in range(states.shape[0]):
        s, v, a = states[k]
        if not (abs(s - centre) <= half and abs(v) <= V and abs(a) <= A):
            return False
        if k > 0 and not abs(a - states[k - 1, 2]) <= J * dt:
            return False
    joints = joint_states(coefficients, centre, half, states)
    return not exceeds(joints, limits[1], limits[0], dt)
