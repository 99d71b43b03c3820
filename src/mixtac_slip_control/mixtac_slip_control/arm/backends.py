# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What drives the arm: the interface, the backend for ros2_control, and how others are found.

The parameter `arm_backend` names the backend: `trajectory` and `libfranka` are built in, others are
entry points of the group `mixtac.arm_backends`. An entry point is called with the parameters of
slip control and the kinematics of the arm, and returns an `ArmBackend`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.trajectory import ArmState, PlannedTrajectory
from mixtac_slip_control.errors import BackendError
from mixtac_slip_control.parameters import LIBFRANKA, SlipControlParameters

Floats = NDArray[np.float64]

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
