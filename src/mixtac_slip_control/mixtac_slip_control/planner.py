# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What slip control needs of whatever plans the motion of the arm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixtac_slip_control.arm.planned_trajectory import PlannedTrajectory


class Planner(Protocol):
    """What the controller needs of `arm.advance_planner.AdvancePlanner`."""

    def reset(self, q: NDArray[np.float64], normal: NDArray[np.float64] | None = None) -> None:
        """Start over with advance zero at joint positions [rad]."""

    def plan(
        self, now_s: float, advance_m: float, normal: NDArray[np.float64]
    ) -> PlannedTrajectory | None:
        """Return the trajectory to an advance [m], or None where nothing is to be sent."""

    def stop(self, now_s: float) -> PlannedTrajectory | None:
        """Return the trajectory that brakes, or None at rest."""

    def advance_at(self, t_s: float) -> float:
        """Return the advance commanded at a time [m]."""
