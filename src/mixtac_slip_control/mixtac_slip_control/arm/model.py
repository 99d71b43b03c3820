# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arm selected by the parameters, with its planner, its checks and its backend.

The parameter `arm_backend` names the backend: `trajectory` is built in, others are entry points of
the group `mixtac.arm_backends`. An entry point is called with the parameters of slip control and
the kinematics of the arm, and returns an `ArmBackend`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final

import numpy as np

from mixtac_core.events.arrays import Floats
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits, StateChecks
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.arm.trajectory import ArmState, PlannedTrajectory, settling_time
from mixtac_slip_control.errors import BackendError, SlipControlError
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
    direction: Floats

    def normal(self, q: Floats) -> Floats:
        """Return the contact normal (3,) in the base frame at joint positions [rad]."""
        if not self.in_tool:
            return self.direction
        return np.asarray(self.arm.pose(q)[:3, :3] @ self.direction)

    def settling_s(self, sag: float, share: float) -> float:
        """Return the time in which the arm settles from a sag within a share of its limits [s].

        Args:
            sag: Largest difference of a joint from its command [rad].
            share: Share of the limits that may be used.
        """
        rates = (self.limits.velocity, self.limits.acceleration, self.limits.jerk)
        return settling_time(sag, *(share * float(rate.min()) for rate in rates))


def make_arm(parameters: SlipControlParameters) -> ArmParts | None:
    """Return the arm, ready to plan, or None for `none`.

    Raises:
        SlipControlError: A file that cannot be read or holds no usable arm, or no normal.
    """
    if parameters.arm == 'none':
        return None
    direction = np.array(parameters.normal_vector)
    arm, limits = _model(parameters)
    planner = AdvancePlanner(arm, limits, parameters.lead, parameters.limit_share)
    in_tool = parameters.normal_frame == 'tool'
    checks = StateChecks(arm, limits, parameters.workspace_limits)
    direction = direction / np.linalg.norm(direction)
    return ArmParts(arm, limits, planner, checks, in_tool, direction)


def _model(parameters: SlipControlParameters) -> tuple[SerialArm, JointLimits]:
    if parameters.arm == 'fr3':
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


class ArmBackend:
    """Drives an arm along planned trajectories; the base class of backends."""

    def state(self) -> ArmState | None:
        """Return the latest state, or None before the first.

        Raises:
            BackendError: The arm or the connection to it reports a fault.
        """
        raise NotImplementedError

    def send(self, trajectory: PlannedTrajectory) -> None:
        """Replace the trajectory being carried out by another, at once.

        Raises:
            BackendError: The arm or the connection to it reports a fault.
        """
        raise NotImplementedError

    def stop(self) -> None:
        """Bring the arm to rest and release it; by default nothing, as trajectories end at rest."""


class TrajectoryBackend(ArmBackend):
    """The backend for a joint_trajectory_controller, by topics.

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
            self._state = ArmState(stamp_s, q)
        return q is not None

    def state(self) -> ArmState | None:
        """Return the latest state, or None before the first."""
        return self._state

    def send(self, trajectory: PlannedTrajectory) -> None:
        """Publish a trajectory."""
        self._publish(trajectory)


SAFE_SETTINGS: Final = {
    'allow_trajectory_replacement': False,
    'positions_upsampling.enable': False,
    'set_last_command_interface_value_as_state_on_activation': False,
    'interpolation_method': 'splines',
}
"""Parameters of a joint_trajectory_controller with the values that the stream needs. A version
without one of them behaves as with this value."""
CONTINUES: Final = ('interpolate_from_desired_state', 'open_loop_control')
"""Names of the parameter by which a trajectory continues from the last command; Jazzy has both. One
of them must be true."""


def unsafe_setting(values: Mapping[str, object]) -> str:
    """Return which parameter of a controller makes the stream unsafe; empty if none does.

    Args:
        values: Parameters of the controller; None for one that it does not have.
    """
    wrong = [name for name, safe in SAFE_SETTINGS.items() if values.get(name) not in {None, safe}]
    if not any(values.get(name) for name in CONTINUES):
        wrong.insert(0, CONTINUES[0])
    if not wrong:
        return ''
    value = values.get(wrong[0])
    safe = SAFE_SETTINGS.get(wrong[0], True)
    return (
        f'the controller of the arm has {wrong[0]} {str(value).lower()}: set it to '
        f'{str(safe).lower()}, as in config/franka/fr3_controllers.yaml, and restart it'
    )


def open_backend(parameters: SlipControlParameters, arm: SerialArm) -> ArmBackend:
    """Return the backend that the parameters name, connected to its arm.

    Args:
        parameters: `arm_backend`, and what that backend needs.
        arm: The arm.

    Raises:
        BackendError: No such backend, or the arm does not answer or is not ready.
    """
    name = parameters.arm_backend
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name not in found:
        known = ', '.join((TRAJECTORY, *sorted(found)))
        raise BackendError(f'arm_backend {name!r} is unknown', remedy=f'choose one of {known}')
    backend: ArmBackend = found[name].load()(parameters, arm)
    return backend
