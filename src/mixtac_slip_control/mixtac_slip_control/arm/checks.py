# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of a joint state: ranges, speeds, workspace, distance to singularities."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mixtac_slip_control.arm.errors import ArmError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_slip_control.arm.joint_limits import JointLimits
    from mixtac_slip_control.arm.serial_arm import SerialArm

    Floats = NDArray[np.float64]
    Point = tuple[float, float, float]


class Workspace(Protocol):
    """A region of space in the frame of the arm's base."""

    def violation(self, position: Floats) -> str | None:
        """Return why a position (3,) [m] is outside, in words, or None."""


@dataclass(frozen=True, slots=True)
class BoxWorkspace:
    """A box along the axes of the base frame.

    Attributes:
        lower: Corner with the smallest coordinates [m].
        upper: Corner with the largest coordinates [m].
    """

    lower: Point
    upper: Point

    def __post_init__(self) -> None:
        """Refuse an empty box.

        Raises:
            ArmError: A lower coordinate is not below the upper one.
        """
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ArmError(f'workspace from {self.lower} to {self.upper} m: give lower < upper')

    def violation(self, position: Floats) -> str | None:
        """Return why a position (3,) [m] is outside, in words, or None."""
        for axis, value, low, high in zip('xyz', position, self.lower, self.upper, strict=True):
            if not low <= value <= high:
                return f'tip at {axis} = {value:.4f} m is outside {low:g} to {high:g} m'
        return None


@dataclass(frozen=True, slots=True)
class SphereWorkspace:
    """A ball.

    Attributes:
        centre: Its centre [m].
        radius: Its radius [m].
    """

    centre: Point
    radius: float

    def __post_init__(self) -> None:
        """Refuse an empty ball.

        Raises:
            ArmError: The radius is not positive and finite.
        """
        if not 0.0 < self.radius < math.inf:
            raise ArmError(f'workspace radius {self.radius} m: give a positive number')

    def violation(self, position: Floats) -> str | None:
        """Return why a position (3,) [m] is outside, in words, or None."""
        distance = math.dist(position, self.centre)
        if distance <= self.radius:
            return None
        return f'tip is {distance:.4f} m from {self.centre} m, farther than {self.radius:g} m'


SAME_PLACE_RAD = 1e-4
"""Joint positions nearer than this to good ones are good: small beside every margin here, and an
arm that rests reports its positions hundreds of times a second."""


class StateChecks:
    """Finds what is wrong with a joint state.

    Args:
        arm: The arm.
        limits: Of its joints.
        workspace: Where the tip may be; None: anywhere.
        joint_margin: Distance to the ends of the joints' ranges to keep [rad].
        speed_share: Of the velocity limits that a measured speed may reach.
        min_singular: Smallest singular value of the Jacobian allowed, with angles scaled by
            `length`: below it small motions of the tip need large motions of the joints. The FR3
            has 0.18 in its ready pose and 0.04 with the elbow stretched.
        length: What one radian of the tip's orientation counts as [m].
    """

    def __init__(
        self,
        arm: SerialArm,
        limits: JointLimits,
        workspace: Workspace | None = None,
        joint_margin: float = 0.02,
        speed_share: float = 1.0,
        min_singular: float = 0.05,
        length: float = 0.3,
    ) -> None:
        self._arm = arm
        self._limits = limits
        self._workspace = workspace
        self._joint_margin = joint_margin
        self._speed_share = speed_share
        self._min_singular = min_singular
        self._scale = np.array([1.0, 1.0, 1.0, length, length, length])[:, None]
        self._good: Floats | None = None

    def check(self, q: Floats, dq: Floats | None = None) -> str | None:
        """Return what is wrong, in words, or None.

        Args:
            q: Joint positions (n,) [rad].
            dq: Joint velocities (n,) [rad/s]; None: not looked at.
        """
        try:
            values = self._arm.checked(q)
            speeds = None if dq is None else self._arm.checked(dq)
        except ArmError as error:
            return str(error)
        if speeds is None and self._near_good(values):
            return None
        reason = (
            self._limits.violation(values, self._arm.names, self._joint_margin)
            or self._too_fast(values, speeds)
            or self._outside(values)
            or self._singular(values)
        )
        self._good = values.copy() if reason is None else None
        return reason

    def _near_good(self, q: Floats) -> bool:
        return self._good is not None and bool(np.abs(q - self._good).max() < SAME_PLACE_RAD)

    def _too_fast(self, q: Floats, dq: Floats | None) -> str | None:
        if dq is None:
            return None
        # At the ends of the range, where the envelope closes, a resting joint is not too fast.
        low, high = (self._speed_share * b for b in self._limits.velocity_bounds(q))
        excess = np.maximum(dq - high, low - dq)
        i = int(np.argmax(excess))
        if not excess[i] > 0.0:
            return None
        return (
            f'{self._arm.names[i]} moves at {dq[i]:.3f} rad/s, limits {low[i]:.3f}, {high[i]:.3f}'
        )

    def _outside(self, q: Floats) -> str | None:
        return (
            None if self._workspace is None else self._workspace.violation(self._arm.pose(q)[:3, 3])
        )

    def _singular(self, q: Floats) -> str | None:
        value = self.singular_value(q)
        if value >= self._min_singular:
            return None
        return (
            f'the arm is near a singularity: smallest singular value {value:.4f}, at least '
            f'{self._min_singular:g} wanted; choose another posture'
        )

    def singular_value(self, q: Floats) -> float:
        """Return the smallest singular value of the scaled Jacobian at joint positions (n,)."""
        return float(np.linalg.svd(self._scale * self._arm.jacobian(q), compute_uv=False)[-1])
