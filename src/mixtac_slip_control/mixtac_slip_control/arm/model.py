# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arm that the parameters name, with planner and checks, and what drives it.

The parameter `arm_backend` names the backend: `trajectory` and `libfranka` are built in, others are
entry points of the group `mixtac.arm_backends`. An entry point is called with the parameters of
slip control and the kinematics of the arm, and returns an `ArmBackend`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import BoxWorkspace, JointLimits, StateChecks
from mixtac_slip_control.arm.normal_path import DEGREE, MotionLimits, NormalPath
from mixtac_slip_control.arm.planner import AdvancePlanner, StreamSettings
from mixtac_slip_control.arm.trajectory import ArmState, PlannedTrajectory
from mixtac_slip_control.errors import BackendError, SlipControlError
from mixtac_slip_control.parameters import LIBFRANKA, SlipControlParameters

Floats = NDArray[np.float64]


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
    direction: Floats

    def normal(self, q: Floats) -> Floats:
        """Return the contact normal (3,) in the base frame at joint positions [rad]."""
        if not self.in_tool:
            return self.direction
        return np.asarray(self.arm.pose(q)[:3, :3] @ self.direction)

    def check(self, q: Sequence[float]) -> str | None:
        """Return what is wrong with joint positions [rad], or None."""
        return self.checks.check(np.asarray(q, np.float64))

    def warm_up(self) -> None:
        """Compile (or load) what runs in real time, so that the first trajectory is not late."""
        # On a path on which no joint moves: a posture from which any arm can advance is not known.
        rest = np.zeros(self.arm.dof)
        path = NormalPath(self.direction, -1e-2, 1e-2, np.zeros((DEGREE + 1, self.arm.dof)))
        path.derivatives(0.0)
        planner = AdvancePlanner(self.arm, self.limits, self.planner.settings)
        planner.reset(rest)
        planner.path, planner.motion_limits = path, MotionLimits(0.1, 1.0, 100.0)
        planner.plan(1.0, 1e-3, self.direction)
        planner.stop(1.01)


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


GROUP: Final = 'mixtac.arm_backends'
"""Entry point group of arm backends from other packages."""
TRAJECTORY: Final = 'trajectory'
"""The backend that publishes trajectories; the node makes it, because it owns the publisher."""


class ArmBackend(Protocol):
    """Drives an arm along planned trajectories."""

    def state(self) -> ArmState | None:
        """Return the latest state, or None before the first.

        Raises:
            BackendError: The arm or the connection to it reports a fault.
        """

    def send(self, trajectory: PlannedTrajectory) -> None:
        """Replace the trajectory being carried out by another, at once.

        Raises:
            BackendError: The arm or the connection to it reports a fault.
        """

    def stop(self) -> None:
        """Bring the arm to rest and release it."""


class TrajectoryBackend:
    """An `ArmBackend` for a joint_trajectory_controller, by topics.

    Args:
        names: Names of the arm's joints, in its order.
        publish: Publishes a trajectory.
    """

    def __init__(self, names: Sequence[str], publish: Callable[[PlannedTrajectory], None]) -> None:
        self._names = tuple(names)
        self._publish = publish
        self._state: ArmState | None = None

    def ordered(self, names: Sequence[str], positions: Sequence[float]) -> Floats | None:
        """Return the joint positions of a message in the arm's order, None if one is missing.

        Args:
            names: Names of the joints, among them those of the arm.
            positions: Their positions [rad].
        """
        found = dict(zip(names, positions, strict=False))
        if not found.keys() >= set(self._names):
            return None
        return np.array([found[name] for name in self._names], np.float64)

    def on_joint_state(
        self, names: Sequence[str], positions: Sequence[float], stamp_s: float
    ) -> bool:
        """Take the joint positions of a `JointState`, in any order.

        Args:
            names: Names of the joints, among them those of the arm.
            positions: Their positions [rad].
            stamp_s: Time of the measurement, on the clock of trajectories [s].

        Returns:
            Whether all joints of the arm were among them.
        """
        q = self.ordered(names, positions)
        if q is not None:
            self._state = ArmState(stamp_s, q, np.zeros_like(q))
        return q is not None

    def state(self) -> ArmState | None:
        """Return the latest state, without velocities, or None before the first."""
        return self._state

    def send(self, trajectory: PlannedTrajectory) -> None:
        """Publish a trajectory."""
        self._publish(trajectory)

    def stop(self) -> None:
        """Leave the arm alone: every trajectory ends at rest."""


def open_backend(parameters: SlipControlParameters, arm: SerialArm) -> ArmBackend:
    """Return the backend that the parameters name, connected to its arm.

    Args:
        parameters: `backend`, and what that backend needs.
        arm: The arm.

    Raises:
        BackendError: No such backend, or the arm does not answer or is not ready.
    """
    name = parameters.backend
    if name == LIBFRANKA:
        from mixtac_slip_control.arm.libfranka import open_libfranka

        return open_libfranka(parameters, arm)
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name not in found:
        known = ', '.join((TRAJECTORY, LIBFRANKA, *sorted(found)))
        raise BackendError(f'arm_backend {name!r} is unknown', remedy=f'choose one of {known}')
    backend: ArmBackend = found[name].load()(parameters, arm)
    return backend
