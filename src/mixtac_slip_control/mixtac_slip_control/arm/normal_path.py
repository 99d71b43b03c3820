# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The joint path that moves the tip along a straight line with its orientation held.

The path is a polynomial of the advance; its evaluation is compiled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray

from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JOINT_MARGIN, JointLimits
from mixtac_slip_control.errors import ArmError, UnreachableError

Floats = NDArray[np.float64]


@njit(cache=True)
def derivatives(coefficients: Floats, centre: float, half: float, s: float) -> Floats:
    """Return joint positions and their first three derivatives by the advance (4, n).

    Args:
        coefficients: Coefficients of the powers of (s - centre) / half, lowest first (m, n).
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


DEGREE = 8
NODES = 13
SAMPLES = 25
PATH_RAD = 2e-5
"""Largest difference of a joint on the path from where the advance needs it [rad]: about 10 um."""
MAX_CURVE_SHARE = 0.25
"""Share of acceleration and jerk that the curvature of the path may take at full speed."""
TYPICAL_SPEED = 0.06
"""Peak speed of an advance of 1 mm [m/s], at which the curvature of the path is accounted for."""


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of the advance along a path that keep every joint within its own.

    Attributes:
        speed: [m/s].
        acceleration: [m/s2].
        jerk: [m/s3].
    """

    speed: float
    acceleration: float
    jerk: float


@dataclass(frozen=True, slots=True, eq=False)
class NormalPath:
    """Joint positions as a polynomial of the advance along a direction.

    Attributes:
        normal: Unit direction of the advance (3,) in the base frame.
        lower: Start of the fitted range [m], at most 0.
        upper: End of the fitted range [m].
        coefficients: Coefficients of the powers of the advance, scaled to -1..1 over the range
            (m, n).
    """

    normal: Floats
    lower: float
    upper: float
    coefficients: Floats

    @property
    def centre(self) -> float:
        """Middle of the range [m]."""
        return 0.5 * (self.lower + self.upper)

    @property
    def half(self) -> float:
        """Half the width of the range [m]."""
        return 0.5 * (self.upper - self.lower)

    def derivatives(self, advance: float) -> Floats:
        """Return joint positions and their first three derivatives by the advance (4, n)."""
        return np.asarray(derivatives(self.coefficients, self.centre, self.half, advance))

    def limits(self, limits: JointLimits, share: float, max_speed: float) -> MotionLimits:
        """Return limits of the advance under which no joint exceeds a share of its own.

        Above `TYPICAL_SPEED` the bending of the path may need more than is left for it here;
        the planner checks every joint and lowers its limits where it does.

        Args:
            limits: Limits of the joints.
            share: Of each rate limit that may be used, 0 to 1.
            max_speed: Largest speed wanted [m/s].
        """
        p = np.array([self.derivatives(s) for s in np.linspace(self.lower, self.upper, SAMPLES)])
        slope, bend, twist = (np.maximum(np.abs(p[:, k]), 1e-9) for k in (1, 2, 3))
        bounds = [limits.velocity_bounds(q) for q in p[:, 0]]
        speeds = np.array([np.minimum(-low, high) for low, high in bounds])
        acceleration = share * limits.acceleration
        jerk = share * limits.jerk
        tip_speed, tip_acceleration, tip_jerk = (share * value for value in limits.tip)
        speed = min(max_speed, tip_speed, float((share * speeds / slope).min()))
        speed = min(speed, float(np.sqrt(MAX_CURVE_SHARE * acceleration / bend).min()))
        a = min(tip_acceleration, float((acceleration / slope).min()))
        # 3 q'' v a and q''' v^3, each within its share of the jerk.
        speed = min(speed, float((MAX_CURVE_SHARE * jerk / (3.0 * bend * a)).min()))
        speed = min(speed, float(np.cbrt(MAX_CURVE_SHARE * jerk / twist).min()))
        v = min(speed, TYPICAL_SPEED)
        a = min(tip_acceleration, float(((acceleration - bend * v**2) / slope).min()))
        j = ((jerk - 3.0 * bend * v * a - twist * v**3) / slope).min()
        return MotionLimits(speed, a, min(tip_jerk, float(j)))


def fit_normal_path(
    arm: SerialArm, limits: JointLimits, q: Floats, normal: Floats, lower: float, upper: float
) -> NormalPath:
    """Return the path from joint positions along a direction, orientation held.

    Where the arm has one joint more than the pose needs, the path leaves along the direction in
    joint space that moves the fastest joint least: it allows the largest acceleration of the tip.

    Args:
        arm: The arm.
        limits: Limits of its joints; positions stay `JOINT_MARGIN` inside.
        q: Joint positions at advance zero (n,) [rad].
        normal: Direction of the advance (3,) in the base frame, of any length.
        lower: Start of the range [m], at most 0.
        upper: End of the range [m], more than 0.

    Raises:
        ArmError: A direction or joint positions that are none.
        UnreachableError: The range leaves the arm's reach or its joints' ranges.
    """
    start = arm.checked(q)
    direction = np.asarray(normal, np.float64)
    length = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not 1e-6 < length < 1e6:
        raise ArmError(f'contact normal {direction.tolist()}: give three numbers, not all zero')
    direction = direction / length
    tangent = fastest_tangent(arm.jacobian(start), direction, limits.acceleration)
    pose = arm.pose(start)
    nodes = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    advances = 0.5 * (lower + upper) + 0.5 * (upper - lower) * nodes
    solutions = np.empty((NODES, arm.dof))
    for k, advance in enumerate(advances):
        target = pose.copy()
        target[:3, 3] += advance * direction
        solutions[k] = arm.solve(target, start + advance * tangent)
        problem = limits.violation(solutions[k], arm.names, JOINT_MARGIN)
        if problem is not None:
            raise UnreachableError(
                f'an advance of {advance * 1e3:.2f} mm needs {problem}: choose another posture or '
                'a smaller max_total'
            )
    columns = [
        Chebyshev.fit(nodes, column, DEGREE, domain=[-1, 1]).convert(kind=Polynomial).coef
        for column in solutions.T
    ]
    coefficients = np.zeros((DEGREE + 1, arm.dof))
    for i, column in enumerate(columns):
        coefficients[: len(column), i] = column
    path = NormalPath(direction, lower, upper, coefficients)
    # Advance zero is where the arm stands, to the last bit that the polynomial can hold.
    path.coefficients[0] += start - path.derivatives(0.0)[0]
    places = np.array([path.derivatives(advance)[0] for advance in advances])
    if np.abs(places - solutions).max() > PATH_RAD:
        raise UnreachableError(
            f'an advance of {upper * 1e3:.2f} mm comes too near to a singularity: choose another '
            'posture or a smaller max_total'
        )
    return path


def fastest_tangent(jacobian: Floats, direction: Floats, acceleration: Floats) -> Floats:
    """Return joint motion per advance (n,) that takes the least of the joints' acceleration.

    Args:
        jacobian: Jacobian of the tip (6, n).
        direction: Unit direction of the tip (3,).
        acceleration: Limits of the joints (n,).
    """
    twist = np.concatenate([direction, np.zeros(3)])
    base = np.linalg.lstsq(jacobian, twist, rcond=1e-6)[0]
    if jacobian.shape[1] != 7:
        return np.asarray(base)
    free = np.linalg.svd(jacobian)[2][-1]
    # The maximum over joints of |b_i + m f_i| is convex and bends where two of them are equal.
    b, f = base / acceleration, free / acceleration
    b2, f2 = np.concatenate([b, -b]), np.concatenate([f, -f])
    with np.errstate(divide='ignore', invalid='ignore'):
        candidates = ((b2[:, None] - b2) / (f2 - f2[:, None])).ravel()
    candidates = np.concatenate([[0.0], candidates[np.isfinite(candidates)]])
    worst = np.abs(b + candidates[:, None] * f).max(axis=1)
    return np.asarray(base + candidates[int(np.argmin(worst))] * free)
