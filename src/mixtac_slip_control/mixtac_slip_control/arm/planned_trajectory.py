# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A trajectory of stamped joint states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PlannedTrajectory:
    """Joint states of the n joints of an arm at m times, ending at rest.

    Times are on the clock of the `now_s` that the planner was given: the host's ROS time.

    Attributes:
        stamp_ns: Time that `times_s` counts from [ns].
        times_s: Times of the points (m,) [s], above zero and rising.
        q: Joint positions (m, n) [rad].
        dq: Joint velocities (m, n) [rad/s].
        ddq: Joint accelerations (m, n) [rad/s2].
        names: Of the joints.
        branch_s: From here on, in seconds since the stamp, it differs from the trajectory before
            it: it must be in effect by then.
    """

    stamp_ns: int
    times_s: Floats
    q: Floats
    dq: Floats
    ddq: Floats
    names: tuple[str, ...]
    branch_s: float = 0.0

    @property
    def stamp_s(self) -> float:
        """Time that `times_s` counts from [s]."""
        return self.stamp_ns * 1e-9

    @property
    def end_s(self) -> float:
        """Time at which the arm is at rest [s], on the planner's clock."""
        return self.stamp_s + float(self.times_s[-1])
