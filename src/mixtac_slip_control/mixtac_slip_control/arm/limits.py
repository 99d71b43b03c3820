# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Limits of the joints of an arm, and checks of a joint state against them.

Limits of position, velocity, acceleration and jerk of each joint; checks of ranges, workspace and
distance to singularities.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mixtac_core.events.arrays import Floats
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.errors import ArmError


@dataclass(frozen=True, slots=True, eq=False)
class JointLimits:
    r"""Limits of each joint (n,), and of the tip's translation.

    The envelope holds c [rad/s], k [rad/s2], :math:`q^+` and :math:`q^-` [rad] of each joint: the
    velocity is at most :math:`\max(0, -c + \sqrt{\max(0, k (q^+ - q))})`, and mirrored below.

    Attributes:
        lower: Smallest position [rad].
        upper: Largest position [rad].
        velocity: Largest speed [rad/s].
        acceleration: Largest acceleration [rad/s2].
        jerk: Largest jerk [rad/s3].
        envelope: Velocity limits that depend on the position (4, n); None without.
        tip: Largest speed [m/s], acceleration [m/s2] and jerk [m/s3] of the tip.
    """

    lower: Floats
    upper: Floats
    velocity: Floats
    acceleration: Floats
    jerk: Floats
    envelope: Floats | None = None
    tip: tuple[float, float, float] = (math.inf, math.inf, math.inf)

    def __post_init__(self) -> None:
        """Refuse limits that allow nothing.

        Raises:
            ArmError: A range is empty or a limit is not positive.
        """
        rates = (self.velocity, self.acceleration, self.jerk)
        if not (self.lower < self.upper).all() or not all((rate > 0.0).all() for rate in rates):
            raise ArmError('a joint has no range, or a limit that is not > 0: give lower < upper')

    @classmethod
    def fr3(cls) -> JointLimits:
        """Return the limits of the Franka Research 3.

        Positions and speeds: franka_description 1.0; rates and the velocity envelope:
        libfranka's rate_limiting.h, for system versions from 5.9 on.
        """
        envelope = np.array(
            [
                [0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35],
                [12.0, 5.17, 7.00, 8.00, 34.0, 11.0, 34.0],
                [2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196],
                [-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196],
            ]
        )
        limits = cls.from_arm(SerialArm.fr3(), acceleration=10.0, jerk=5000.0)
        return replace(limits, envelope=envelope, tip=(3.0, 9.0, 4500.0))

    @classmethod
    def from_arm(cls, arm: SerialArm, acceleration: float, jerk: float) -> JointLimits:
        """Return the limits in an arm's URDF, with the rates that a URDF does not hold.

        Args:
            arm: Arm read from a URDF.
            acceleration: Of every joint [rad/s2].
            jerk: Of every joint [rad/s3].

        Raises:
            ArmError: A limit is missing in the URDF or makes no sense.
        """
        velocity = np.array([joint.velocity for joint in arm.joints])
        if not np.isfinite(velocity).all():
            raise ArmError(
                f'the URDF gives no velocity limit for a joint of {", ".join(arm.names)}: add '
                '<limit velocity="..."/>'
            )
        return cls(
            lower=np.array([joint.lower for joint in arm.joints]),
            upper=np.array([joint.upper for joint in arm.joints]),
            velocity=velocity,
            acceleration=np.full(arm.dof, acceleration),
            jerk=np.full(arm.dof, jerk),
        )

    def velocity_bounds(self, q: Floats) -> tuple[Floats, Floats]:
        """Return the lowest and the highest velocity (n,) [rad/s] at joint positions (n,)."""
        if self.envelope is None:
            return -self.velocity, self.velocity
        offset, slope, upper, lower = self.envelope
        high = np.sqrt(np.maximum(0.0, slope * (upper - q))) - offset
        low = np.sqrt(np.maximum(0.0, slope * (q - lower))) - offset
        return -np.clip(low, 0.0, self.velocity), np.clip(high, 0.0, self.velocity)

    def violation(self, q: Floats, names: tuple[str, ...]) -> str | None:
        """Return which joint is less than `JOINT_MARGIN` inside its range, in words, or None.

        Args:
            q: Joint positions (n,) [rad].
            names: Names of the joints.
        """
        outside = ~((q >= self.lower + JOINT_MARGIN) & (q <= self.upper - JOINT_MARGIN))
        if not outside.any():
            return None
        i = int(np.argmax(outside))
        return (
            f'{names[i]} at {q[i]:.4f} rad is outside {self.lower[i]:.4f} to {self.upper[i]:.4f} '
            f'rad less {JOINT_MARGIN:g}'
        )


JOINT_MARGIN = 0.02
"""Distance to the ends of the joints' ranges that positions and paths keep [rad]."""
RADIAN_M = 0.3
"""What one radian of the tip's orientation counts as in the distance to singularities [m]."""
MIN_SINGULAR = 0.05
"""Smallest singular value of the Jacobian allowed, with angles scaled by `RADIAN_M`: below it small
motions of the tip need large motions of the joints. The FR3 has 0.18 in its ready pose and 0.04
with the elbow stretched."""
SAME_PLACE_RAD = 1e-4
"""Joint positions nearer than this to good ones are good: small beside every margin here, and an
arm that rests reports its positions hundreds of times a second."""


class StateChecks:
    """Finds what is wrong with joint positions.

    Args:
        arm: The arm.
        limits: Limits of its joints.
        workspace: Limits of the tip along x, y and z of the base frame, lower and upper in turn
            (6,) [m]; None: anywhere.
    """

    def __init__(
        self, arm: SerialArm, limits: JointLimits, workspace: Sequence[float] | None = None
    ) -> None:
        self._arm = arm
        self._limits = limits
        self._workspace = None if workspace is None else np.reshape(workspace, (3, 2))
        if self._workspace is not None and not (np.diff(self._workspace) > 0.0).all():
            raise ArmError(f'workspace {list(workspace or ())} m: give lower < upper on each axis')
        self._good: Floats | None = None

    def check(self, q: Floats | Sequence[float]) -> str | None:
        """Return what is wrong with joint positions (n,) [rad], in words, or None."""
        try:
            values = self._arm.checked(np.asarray(q, np.float64))
        except ArmError as error:
            return str(error)
        if self._good is not None and np.abs(values - self._good).max() < SAME_PLACE_RAD:
            return None
        reason = self._limits.violation(values, self._arm.names)
        if reason is None and self._workspace is not None:
            place = self._arm.pose(values)[:3, 3]
            if not ((place >= self._workspace[:, 0]) & (place <= self._workspace[:, 1])).all():
                reason = f'tip at {place.round(4).tolist()} m is outside the workspace'
        reason = reason or self._singular(values)
        self._good = values.copy() if reason is None else None
        return reason

    def _singular(self, q: Floats) -> str | None:
        jacobian = self._arm.jacobian(q)
        jacobian[3:] *= RADIAN_M
        value = float(np.linalg.svd(jacobian, compute_uv=False)[-1])
        if value >= MIN_SINGULAR:
            return None
        return (
            f'the arm is near a singularity: smallest singular value {value:.4f}, at least '
            f'{MIN_SINGULAR:g} wanted; choose another posture'
        )
