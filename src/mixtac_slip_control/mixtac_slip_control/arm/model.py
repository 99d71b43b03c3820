# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arm that the parameters name: its kinematics, limits, planner and checks."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import BoxWorkspace, JointLimits, StateChecks
from mixtac_slip_control.arm.planner import AdvancePlanner, StreamSettings
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters


@dataclass(frozen=True, slots=True, eq=False)
class ArmParts:
    """Everything about an arm that slip control uses.

    Attributes:
        arm: Its kinematics.
        limits: Limits of its joints.
        planner: Turns advances into trajectories.
        checks: Checks ranges, workspace and singularities.
        in_tool: Whether `direction` is in the frame of the last link.
        direction: Unit vector of the contact normal (3,).
    """

    arm: SerialArm
    limits: JointLimits
    planner: AdvancePlanner
    checks: StateChecks
    in_tool: bool
    direction: NDArray[np.float64]

    def normal(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the contact normal (3,) in the base frame at joint positions [rad]."""
        if not self.in_tool:
            return self.direction
        return np.asarray(self.arm.pose(q)[:3, :3] @ self.direction)

    def check(self, q: Sequence[float]) -> str | None:
        """Return what is wrong with joint positions [rad], or None."""
        return self.checks.check(np.asarray(q, np.float64))

    def warm_up(self) -> None:
        """Compile (or load) what runs in real time, so that the first trajectory is not late."""
        middle = 0.5 * (self.limits.lower + self.limits.upper)
        # Advancing from the middle of the joints' ranges may be impossible; only the compilation
        # matters.
        with contextlib.suppress(SlipControlError):
            normal = self.normal(middle)
            self.planner.reset(middle, normal)
            for step in range(1, 3):
                self.planner.plan(1.0 + 0.01 * step, 1e-5 * step, normal)
            self.planner.advance_at(1.0)
            self.planner.stop(1.04)


def make_arm(parameters: SlipControlParameters) -> ArmParts | None:
    """Return the arm, ready to plan, or None for `none`.

    Raises:
        SlipControlError: A file that cannot be read or holds no usable arm, or no normal.
    """
    if parameters.model == 'none':
        return None
    direction = np.array(parameters.normal)
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        raise SlipControlError('normal_x, normal_y and normal_z are all 0: give a direction')
    try:
        x0, x1, y0, y1, z0, z1 = (float(number) for number in parameters.workspace.split())
    except ValueError as error:
        raise SlipControlError(
            f'workspace {parameters.workspace!r}: give six numbers, the limits along x, y and z [m]'
        ) from error
    arm, limits = _model(parameters)
    stream = StreamSettings(
        lead_s=parameters.lead,
        overlap_s=3.0 * parameters.controller_period,
        interval_s=parameters.interval,
        share=parameters.limit_share,
        max_speed=parameters.max_speed,
    )
    planner = AdvancePlanner(arm, limits, stream)
    in_tool = parameters.normal_frame == 'tool'
    checks = StateChecks(arm, limits, BoxWorkspace((x0, y0, z0), (x1, y1, z1)))
    parts = ArmParts(arm, limits, planner, checks, in_tool, direction / length)
    parts.warm_up()
    return parts


def _model(parameters: SlipControlParameters) -> tuple[SerialArm, JointLimits]:
    if parameters.model == 'fr3':
        return SerialArm.fr3(), JointLimits.fr3()
    try:
        text = Path(parameters.arm).read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise SlipControlError(
            f'arm {parameters.arm!r} cannot be read ({error}): give none, fr3 or a URDF file'
        ) from error
    arm = SerialArm.from_urdf(text)
    acceleration, jerk = parameters.joint_acceleration, parameters.joint_jerk
    return arm, JointLimits.from_arm(arm, acceleration, jerk)
