# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Kinematics of a serial arm: pose and Jacobian of its tip, and the inverse by damped steps."""

from __future__ import annotations

import math
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from mixtac_slip_control.arm.errors import ArmError, RobotDescriptionError, UnreachableError
from mixtac_slip_control.arm.kinematics import inverse, pose_and_jacobian
from mixtac_slip_control.arm.urdf import MOVING, UrdfJoint, read_chain

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

FR3_READY = (0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4)
"""Ready pose of the FR3 [rad], from libfranka's examples."""


class SerialArm:
    """A chain of revolute and prismatic joints from a base link to a tip link.

    All vectors are in the frame of the base link unless said otherwise; the Jacobian's rows are
    the linear velocity of the tip's origin [m/s], then the angular velocity [rad/s].

    Attributes:
        joints: The moving joints, in order.
        names: Their names.
        dof: Their number n.

    Args:
        joints: Chain with fixed joints, as `read_chain` returns it.

    Raises:
        RobotDescriptionError: No joint moves.
    """

    def __init__(self, joints: tuple[UrdfJoint, ...]) -> None:
        self.joints = tuple(joint for joint in joints if joint.kind in MOVING)
        if not self.joints:
            raise RobotDescriptionError('no joint of the chain moves: name other links')
        self.names = tuple(joint.name for joint in self.joints)
        self.dof = len(self.joints)
        self._axes = np.array([joint.axis for joint in self.joints])
        self._prismatic = np.array([joint.kind == 'prismatic' for joint in self.joints])
        self._origins = np.empty((self.dof, 4, 4))
        pending = np.eye(4)
        moving = 0
        for joint in joints:
            pending = pending @ _origin(joint)
            if joint.kind in MOVING:
                self._origins[moving] = pending
                pending = np.eye(4)
                moving += 1
        self._tool = pending

    @classmethod
    def from_urdf(cls, text: str, base: str = '', tip: str = '') -> SerialArm:
        """Read an arm from a URDF.

        Args:
            text: The URDF, for example from `/robot_description`.
            base: First link; empty: the root.
            tip: Last link; empty: the only leaf.

        Raises:
            RobotDescriptionError: See `read_chain`.
        """
        return cls(read_chain(text, base, tip))

    @classmethod
    def fr3(cls) -> SerialArm:
        """Return a Franka Research 3 up to its flange, from the description shipped here."""
        return cls.from_urdf(fr3_urdf())

    def pose(self, q: Floats) -> Floats:
        """Return the pose of the tip (4, 4), translation in m.

        Args:
            q: Joint positions (n,) [rad or m].

        Raises:
            ArmError: `q` has another length or is not finite.
        """
        return self._pose_and_jacobian(q)[0]

    def jacobian(self, q: Floats) -> Floats:
        """Return the Jacobian of the tip (6, n) at joint positions (n,).

        Raises:
            ArmError: `q` has another length or is not finite.
        """
        return self._pose_and_jacobian(q)[1]

    def solve(self, pose: Floats, q: Floats, tolerance: float = 1e-12) -> Floats:
        """Return joint positions (n,) that bring the tip to a pose, near the given ones.

        Redundant joints stay as near to `q` as the pose allows. Limits are not looked at.

        Args:
            pose: Wanted pose of the tip (4, 4).
            q: Where to start, and the posture to stay near (n,).
            tolerance: Largest error of position [m] and orientation [rad].

        Raises:
            UnreachableError: The pose is out of reach or behind a singularity.
            ArmError: `q` has another length or is not finite.
        """
        start = self.checked(q)
        target = np.ascontiguousarray(pose, dtype=np.float64)
        solution, error = inverse(
            self._origins, self._axes, self._prismatic, self._tool, target, start, tolerance
        )
        if not error <= tolerance:
            x, y, z = target[:3, 3]
            raise UnreachableError(
                f'the arm cannot bring its tip to ({x:.4f}, {y:.4f}, {z:.4f}) m from joint '
                f'positions {np.round(start, 3).tolist()}: error {error:.3g} remains; choose a '
                'nearer target or another posture'
            )
        return np.asarray(solution)

    def checked(self, q: Floats) -> Floats:
        """Return joint positions as a contiguous array (n,).

        Raises:
            ArmError: Another length, or not finite.
        """
        values = np.ascontiguousarray(q, dtype=np.float64)
        if values.shape != (self.dof,) or not np.isfinite(values).all():
            raise ArmError(
                f'joint positions {values.tolist()}: give {self.dof} finite numbers, for '
                f'{", ".join(self.names)}'
            )
        return values

    def _pose_and_jacobian(self, q: Floats) -> tuple[Floats, Floats]:
        pose, jacobian = pose_and_jacobian(
            self._origins, self._axes, self._prismatic, self._tool, self.checked(q)
        )
        return pose, jacobian


def fr3_urdf() -> str:
    """Return the mesh-free URDF of the Franka Research 3 that is shipped here."""
    return (resources.files(__package__) / 'models' / 'fr3.urdf').read_text(encoding='utf-8')


def _origin(joint: UrdfJoint) -> Floats:
    """Return the transform of a joint's origin (4, 4): translation, then fixed-axis r, p, y."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(joint.rpy), np.sin(joint.rpy)
    transform = np.eye(4)
    transform[:3, :3] = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    transform[:3, 3] = joint.xyz
    return transform
