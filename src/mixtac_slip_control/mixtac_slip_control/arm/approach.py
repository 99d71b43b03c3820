# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Motions from rest to rest before slip control: to the object, and onto the commanded state."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mixtac_slip_control.arm.errors import ArmError, UnreachableError
from mixtac_slip_control.arm.planned_trajectory import PlannedTrajectory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_slip_control.arm.joint_limits import JointLimits
    from mixtac_slip_control.arm.serial_arm import SerialArm

    Floats = NDArray[np.float64]

# Largest derivatives of the quintic from rest to rest over a unit distance in a unit time.
PEAK_VELOCITY = 1.875
PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
PEAK_JERK = 60.0


def approach_trajectory(
    arm: SerialArm,
    limits: JointLimits,
    start: Floats,
    goal: Floats,
    share: float = 0.3,
    spacing_s: float = 0.02,
) -> PlannedTrajectory:
    """Return a quintic in joint space from rest to rest, all joints together.

    The stamp is zero: it begins when the controller takes it up. It serves as the trajectory of a
    FollowJointTrajectory goal.

    Args:
        arm: The arm, for the names of its joints.
        limits: Of its joints.
        start: Joint positions at the start (n,) [rad].
        goal: Joint positions at the end (n,) [rad].
        share: Of the velocity, acceleration and jerk limits that may be used.
        spacing_s: Time between points [s].

    Raises:
        ArmError: Positions or a share that are none.
        UnreachableError: Start or goal outside the joints' ranges.
    """
    a, b = arm.checked(start), arm.checked(goal)
    for name, q in (('start', a), ('goal', b)):
        problem = limits.violation(q, arm.names)
        if problem is not None:
            raise UnreachableError(f'the {name} of the approach: {problem}')
    if not 0.0 < share <= 1.0 or not spacing_s > 0.0:
        raise ArmError(
            f'share = {share}, spacing_s = {spacing_s}: give 0 < share <= 1, spacing > 0'
        )
    duration = max(_duration(limits, np.abs(b - a), np.linspace(a, b, 50), share), spacing_s)
    count = math.ceil(duration / spacing_s)
    return _quintic(a, b, duration, np.arange(1, count + 1) / count, arm.names)


def settling_trajectory(
    arm: SerialArm, q: Floats, now_s: float, duration_s: float = 0.5
) -> PlannedTrajectory:
    """Return a trajectory of one point that leads a controller from its last command to rest at q.

    A controller's command differs from the measured positions by what the arm sags. The planner
    must start from the command: send this with the measured positions, wait until it ends, then
    reset the planner with the same positions. At 2 mrad and 0.5 s it takes 0.05 rad/s2.

    Args:
        arm: The arm.
        q: Joint positions to settle at (n,) [rad].
        now_s: Present time [s], on the controller's clock.
        duration_s: Time until it is there [s].

    Raises:
        ArmError: Joint positions or a duration that are none.
    """
    if not 0.05 <= duration_s <= 10.0:
        raise ArmError(f'settling in {duration_s} s: give 0.05 to 10 s')
    goal, rest = arm.checked(q)[None], np.zeros((1, arm.dof))
    return PlannedTrajectory(
        stamp_ns=round(now_s * 1e9),
        times_s=np.array([duration_s]),
        q=goal.copy(),
        dq=rest,
        ddq=rest.copy(),
        names=arm.names,
    )


def _duration(limits: JointLimits, distance: Floats, line: Floats, share: float) -> float:
    """Return the shortest time [s] of the quintic within a share of the limits."""
    bounds = [limits.velocity_bounds(q) for q in line]
    speed = share * np.min([np.minimum(-low, high) for low, high in bounds], axis=0)
    moving = distance > 0.0
    if (speed[moving] <= 0.0).any():
        raise UnreachableError(
            'the approach starts or ends where the velocity limit of a joint is zero: keep away '
            'from the ends of the joints'
        )
    times = (
        PEAK_VELOCITY * distance[moving] / speed[moving],
        np.sqrt(PEAK_ACCELERATION * distance[moving] / (share * limits.acceleration[moving])),
        np.cbrt(PEAK_JERK * distance[moving] / (share * limits.jerk[moving])),
    )
    return max((float(t.max()) for t in times if t.size), default=0.0)


def _quintic(
    start: Floats, goal: Floats, duration: float, u: Floats, names: tuple[str, ...]
) -> PlannedTrajectory:
    """Return points at shares u (m,) of the duration [s]."""
    x = u[:, None]
    step = goal - start
    return PlannedTrajectory(
        stamp_ns=0,
        times_s=u * duration,
        q=start + step * x**3 * (10.0 + x * (6.0 * x - 15.0)),
        dq=step * 30.0 * x**2 * (1.0 - x) ** 2 / duration,
        ddq=step * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / duration**2,
        names=names,
    )
