# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How the arm follows its commands: a transport delay and a first-order lag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.arm.fr3 import flange_place
from mixtac_sim.errors import SimulationError

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Tracking:
    """Constants of the arm's own position control.

    Attributes:
        lag_s: Time constant [s]; 3 to 4 ms were seen on libfranka's wire protocol in simulation,
            40 ms with the effort controller that franka_ros2 ships.
    """

    lag_s: float = 3.5e-3

    def __post_init__(self) -> None:
        """Refuse a negative lag.

        Raises:
            SimulationError: As above.
        """
        if self.lag_s < 0.0:
            msg = f'tracking lag of {self.lag_s} s; give 0 or more'
            raise SimulationError(msg)


class JointLag:
    """Joints that follow their commands with a first-order lag.

    Args:
        q: Joint positions at the start [7] [rad].
        tracking: Of the arm.
        period_s: Of the commands [s].
    """

    def __init__(self, q: NDArray[np.float64], tracking: Tracking, period_s: float = 1e-3) -> None:
        self._q = np.array(q, np.float64)
        self._keep = float(np.exp(-period_s / tracking.lag_s)) if tracking.lag_s > 0.0 else 0.0

    @property
    def q(self) -> NDArray[np.float64]:
        """Return the joint positions [7] [rad]."""
        return self._q.copy()

    def track(self, command: NDArray[np.float64]) -> None:
        """Go on by one period towards commanded joint positions [7] [rad]."""
        self._q = command + self._keep * (self._q - command)


class FingertipAdvance:
    """The fingertip's place along the contact normal while joints follow their commands.

    Args:
        q: Joint positions at the start [7] [rad].
        normal: Direction of the advance in the base frame [3], of length 1.
        tracking: Of the arm.
        period_s: Of the commands [s].
    """

    def __init__(
        self,
        q: NDArray[np.float64],
        normal: NDArray[np.float64],
        tracking: Tracking,
        period_s: float = 1e-3,
    ) -> None:
        self._joints = JointLag(q, tracking, period_s)
        self._normal = normal
        self._start = flange_place(self._joints.q)
        self._last_mm = 0.0

    @property
    def q(self) -> NDArray[np.float64]:
        """Return the joint positions [7] [rad]."""
        return self._joints.q

    def follow(self, command: NDArray[np.float64], points: int) -> NDArray[np.float64]:
        """Go on by one period of the commands.

        Args:
            command: Commanded joint positions [7] [rad].
            points: How many places to return.

        Returns:
            Places of the fingertip at the ends of as many equal parts of the period [mm].
        """
        self._joints.track(command)
        place_mm = 1e3 * float((flange_place(self._joints.q) - self._start) @ self._normal)
        way = np.linspace(self._last_mm, place_mm, points + 1)[1:]
        self._last_mm = place_mm
        return way
