# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Leads an arm back to its trajectory after cycles in which it heard nothing.

A Franka arm that misses commands goes on with constant acceleration. A command from the trajectory
would then be a step from where the arm has got to; a quintic from there to a later point of the
trajectory is none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_slip_control.arm.trajectory_splice import interpolate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_slip_control.arm.trajectory_splice import TrajectorySplice

    Floats = NDArray[np.float64]

DURATIONS_MS = (4, 7, 10, 15, 20, 30, 40, 60, 80, 120, 160, 240, 320, 480, 640)
"""Of the way back, tried in turn."""
CHECKED = np.linspace(0.0, 1.0, 21)
"""Parts of the way at which the limits are checked."""


class GapBridge:
    """A way back to the trajectory, while there is one.

    Attributes:
        bridged: Ways back that were begun.

    Args:
        acceleration: Largest acceleration of a joint [rad/s2].
        jerk: Largest jerk of a joint [rad/s3].
    """

    def __init__(self, acceleration: float, jerk: float) -> None:
        self.bridged = 0
        self._acceleration = acceleration
        self._jerk = jerk
        self._times = np.zeros(2, np.int64)
        self._states: Floats | None = None

    def start(self, t_ns: int, state: Floats, plan: TrajectorySplice) -> None:
        """Begin the shortest way back within the limits.

        Args:
            t_ns: Time of the state [ns].
            state: Position, velocity, acceleration that the arm has been commanded last (3, n).
            plan: Trajectory to get back to.
        """
        self.bridged += 1
        for duration_ms in DURATIONS_MS:
            times = np.array([t_ns, t_ns + duration_ms * 1_000_000])
            states = np.stack([state, plan.at(int(times[1]))])
            if self._fits(states, duration_ms * 1e-3):
                break
        self._times, self._states = times, states

    def at(self, t_ns: int) -> Floats | None:
        """Return the state (3, n) on the way at a time [ns], or None when it is over."""
        if self._states is None or t_ns >= self._times[1]:
            self._states = None
            return None
        return interpolate(self._times, self._states, t_ns)

    def _fits(self, states: Floats, duration_s: float) -> bool:
        times = np.array([0, round(duration_s * 1e9)])
        way = np.array([interpolate(times, states, int(u * times[1])) for u in CHECKED])
        way[-1] = states[1]
        jerk = np.diff(way[:, 2], axis=0) / (duration_s / (len(CHECKED) - 1))
        return bool(
            np.abs(way[:, 2]).max() <= max(self._acceleration, np.abs(states[0, 2]).max())
            and np.abs(jerk).max() <= self._jerk
        )
