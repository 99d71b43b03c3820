# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What slip control asks of an arm, whatever drives it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixtac_slip_control.arm.planned_trajectory import PlannedTrajectory

    Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ArmState:
    """Where an arm is.

    Attributes:
        stamp_s: Time of the measurement [s], on the host's clock.
        q: Measured joint positions (n,) [rad].
        dq: Measured joint velocities (n,) [rad/s].
        commanded: Commanded joint positions (n,) [rad]; None where the backend cannot tell.
    """

    stamp_s: float
    q: Floats
    dq: Floats
    commanded: Floats | None = None


class ArmBackend(Protocol):
    """Drives an arm along planned trajectories.

    Implementations: the node's publisher of `trajectory_msgs/JointTrajectory`, and
    `LibfrankaBackend`, which needs no ros2_control.
    """

    def state(self) -> ArmState | None:
        """Return the latest state, or None before the first.

        Raises:
            BackendError: The arm or the way to it reports a fault.
        """

    def send(self, trajectory: PlannedTrajectory) -> None:
        """Replace the trajectory being carried out by another, at once.

        Raises:
            BackendError: The arm or the way to it reports a fault.
        """

    def stop(self) -> None:
        """Bring the arm to rest and let go of it."""
