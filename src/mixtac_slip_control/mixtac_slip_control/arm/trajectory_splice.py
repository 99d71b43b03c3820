# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Carries out a stream of trajectories cycle by cycle, for arms without a trajectory controller."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Times = NDArray[np.int64]

SAME_POSITION = 1e-7
"""[rad] by which a trajectory may differ from the one before it where it takes over; then [rad/s]
and [rad/s2] likewise."""
SAME_VELOCITY = 1e-5
SAME_ACCELERATION = 0.05


class TrajectorySplice:
    """Joint states over time, of which the future is replaced by each new trajectory.

    Unlike joint_trajectory_controller it refuses a trajectory that arrived too late to continue
    the motion without a step: the arm then comes to rest at the end of the one before.

    Attributes:
        late: Trajectories refused.

    Args:
        q: Joint positions held at first (n,) [rad].
    """

    def __init__(self, q: Floats) -> None:
        rest = np.zeros_like(q)
        self.late = 0
        self._times: Times = np.zeros(1, np.int64)
        self._states: Floats = np.stack([q, rest, rest])[None]

    def replace(self, now_ns: int, times_ns: Times, states: Floats) -> bool:
        """Take over a trajectory from its first point, or from now if that is earlier.

        Args:
            now_ns: Time of the last cycle [ns].
            times_ns: Times of its points (m,) [ns], rising.
            states: Positions, velocities, accelerations (m, 3, n).

        Returns:
            Whether it continues the motion; otherwise nothing changes.
        """
        kept = int(np.searchsorted(self._times, times_ns[0]))
        oldest = max(int(np.searchsorted(self._times, now_ns, side='right')) - 1, 0)
        if kept == 0 or times_ns[0] > self._times[-1]:
            # At rest before the first point: hold until one spacing before it.
            held_ns = min(int(times_ns[0]) - 1_000_000, now_ns)
            times = np.concatenate([[held_ns], times_ns])
            joined = np.concatenate([self._states[-1:], states])
        else:
            times = np.concatenate([self._times[oldest:kept], times_ns])
            joined = np.concatenate([self._states[oldest:kept], states])
        before, after = self.at(now_ns), interpolate(times, joined, now_ns)
        step = np.abs(after - before).max(axis=1)
        if not (step <= (SAME_POSITION, SAME_VELOCITY, SAME_ACCELERATION)).all():
            self.late += 1
            return False
        self._times, self._states = times, joined
        return True

    def at(self, t_ns: int) -> Floats:
        """Return positions, velocities, accelerations (3, n) at a time [ns]."""
        return interpolate(self._times, self._states, t_ns)

    def still(self, start_ns: int, end_ns: int) -> bool:
        """Tell whether the arm stays at one place between two times [ns]."""
        first, last = np.searchsorted(self._times, [start_ns, end_ns], side='right')
        between = self._states[first:last]
        states = np.concatenate([[self.at(start_ns)], between, [self.at(end_ns)]])
        return not states[:, 1:].any() and bool((states[:, 0] == states[0, 0]).all())

    def ended(self, t_ns: int) -> bool:
        """Tell whether nothing follows a time [ns] but rest."""
        return bool(t_ns >= self._times[-1])


def interpolate(times: Times, states: Floats, t_ns: int) -> Floats:
    """Return the state (3, n) of quintics through states (m, 3, n) at a time [ns]; ends are held.

    Args:
        times: Times of the states (m,) [ns], rising.
        states: Positions, velocities, accelerations.
        t_ns: Time wanted [ns].
    """
    k = int(np.searchsorted(times, t_ns, side='right'))
    if k == 0 or k == len(times):
        return np.asarray(states[max(k - 1, 0)])
    T = float(times[k] - times[k - 1]) * 1e-9
    t = float(t_ns - times[k - 1]) * 1e-9
    (q0, v0, a0), (q1, v1, a1) = states[k - 1], states[k]
    # Taylor coefficients from the first state; the rest brings it to the second one.
    dq = q1 - q0 - T * (v0 + 0.5 * T * a0)
    dv = v1 - v0 - T * a0
    da = a1 - a0
    c3 = (10.0 * dq - 4.0 * T * dv + 0.5 * T * T * da) / T**3
    c4 = (-15.0 * dq + 7.0 * T * dv - T * T * da) / T**4
    c5 = (6.0 * dq - 3.0 * T * dv + 0.5 * T * T * da) / T**5
    return np.stack(
        [
            q0 + t * (v0 + t * (0.5 * a0 + t * (c3 + t * (c4 + t * c5)))),
            v0 + t * (a0 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
            a0 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
        ]
    )
