# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The planner that streams an advance along the contact normal as jerk-limited trajectories."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.normal_path import (
    MotionLimits,
    NormalPath,
    fit_normal_path,
    joint_states,
)
from mixtac_slip_control.arm.profile import replan, stopping_distance
from mixtac_slip_control.arm.trajectory import PlannedTrajectory
from mixtac_slip_control.errors import ArmError, UnreachableError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """Settings of the advance planner.

    Attributes:
        lead_s: From the call to the first point that may differ from what was sent before [s]. It
            must cover the worst transport to the controller and two of its cycles, one until it
            looks and one by which it commands ahead.
        overlap_s: How far before the call a trajectory begins [s]: at least two cycles, so that
            the controller never joins its own last command to our first point.
        interval_s: Least time between two trajectories [s].
        spacing_s: Time between points [s].
        share: Share of the joints' rate limits that may be used; the rest is reserve.
        max_speed: Largest speed of the tip [m/s].
        min_change: Smaller changes of the target are not sent [m].
        history_s: How long past advances are remembered [s].
    """

    lead_s: float = 6e-3
    overlap_s: float = 3e-3
    interval_s: float = 2e-3
    spacing_s: float = 1e-3
    share: float = 0.95
    max_speed: float = 0.25
    min_change: float = 1e-7
    history_s: float = 0.25


MAX_ADVANCE: Final = 0.02
"""Largest advance since a reset where none is given [m]; the largest `max_total`."""
PATH_MARGIN: Final = 1e-3
"""By which the path is longer than any target at both ends [m]: room to reverse."""
SAME_NORMAL: Final = 1e-3
"""Largest difference between unit normals that count as the same."""


class AdvancePlanner:
    """Plans the advance since the last reset as trajectories, each continuing the one before.

    All trajectories of one reset lie on one grid of points in time. A new one repeats the points
    already sent up to `lead_s` after the call, leaves them there with their velocity and
    acceleration, and ends at rest at its target. Whenever the controller takes it up before that,
    it continues without a step; if no further one comes, the arm stops at the target.

    All times are on the clock of `now_s`, the one the controller reads.

    Attributes:
        path: Joint path of the present normal; None before it is known.
        motion_limits: Limits of the advance along the path; None before the normal is known.
        refused: Plans that would have broken a limit and were not made; the last one stands.

    Args:
        arm: The arm.
        limits: Limits of its joints.
        settings: Lead, spacing, reserves.
    """

    def __init__(
        self, arm: SerialArm, limits: JointLimits, settings: StreamSettings | None = None
    ) -> None:
        self._arm = arm
        self._limits = limits
        self.settings = settings or StreamSettings()
        self._dt_ns = round(self.settings.spacing_s * 1e9)
        self._dt = self._dt_ns * 1e-9
        self._lead = math.ceil(self.settings.lead_s / self._dt - 1e-9)
        self._overlap = math.ceil(self.settings.overlap_s / self._dt - 1e-9)
        self._history = math.ceil(self.settings.history_s / self._dt) + self._overlap
        self.refused = 0
        self._q: Floats | None = None
        self.path: NormalPath | None = None
        self.motion_limits: MotionLimits | None = None
        self._max_advance = MAX_ADVANCE
        self._now_ns = 0
        self._clear()

    @property
    def target(self) -> float:
        """Advance at which the last trajectory ends [m]."""
        return float(self._states[-1, 0])

    def reset(
        self, q: Floats, normal: Floats | None = None, max_advance: float = MAX_ADVANCE
    ) -> None:
        """Start over with advance zero, at rest.

        Args:
            q: Joint positions that the controller holds (n,) [rad]: the commanded ones, not the
                measured. `settling_trajectory` makes the two equal.
            normal: Direction of the advance (3,) in the base frame; given here, the first `plan`
                need not compute the path.
            max_advance: Largest advance that will be asked for [m].

        Raises:
            ArmError: Joint positions, a normal or a largest advance that are none.
            UnreachableError: `max_advance` leaves the arm's reach or its joints' ranges.
        """
        if not 0.0 <= max_advance <= 0.1:
            raise ArmError(f'max_advance = {max_advance} m: give 0 to 0.1 m')
        self._max_advance = max_advance
        self._q = self._arm.checked(q).copy()
        self.path = self.motion_limits = None
        self._clear()
        if normal is not None:
            self._prepare(self._q, normal)

    @property
    def start(self) -> Floats:
        """Joint positions at advance zero (n,) [rad].

        Raises:
            ArmError: Not reset yet.
        """
        if self._q is None:
            raise ArmError('the advance has no start: reset the planner with joint positions')
        return self._q

    def restart(self) -> None:
        """Start over from the joint positions and with the path of the last reset."""
        self._clear()

    def plan(self, now_s: float, advance_m: float, normal: Floats) -> PlannedTrajectory | None:
        """Return the trajectory to a new target, or None where nothing new is to be sent.

        None means that the target is as before, that the last trajectory was sent less than
        `interval_s` ago (ask again with the next window), or that it was refused.

        Args:
            now_s: Present time [s].
            advance_m: Advance to reach, since the reset [m].
            normal: Direction of the advance (3,) in the base frame.

        Raises:
            ArmError: Not reset; a value that is not finite; time that runs backwards; a normal
                other than that of this reset.
            UnreachableError: An advance below zero or above `max_advance`.
        """
        path, motion = self._ready(normal)
        if not math.isfinite(advance_m) or not math.isfinite(now_s):
            raise ArmError(f'advance {advance_m} m at {now_s} s: give finite numbers')
        if not -1e-9 <= advance_m <= self._max_advance + 1e-9:
            raise UnreachableError(
                f'an advance of {advance_m * 1e3:.3f} mm is outside 0 to '
                f'{self._max_advance * 1e3:g} mm: limit it, or reset the planner for more'
            )
        now_ns = self._advance_clock(now_s)
        # A caller at exactly this interval must not miss its turn by rounding.
        interval_ns = round(self.settings.interval_s * 1e9) - 1000
        early = self._sent_ns is not None and now_ns - self._sent_ns < interval_ns
        if early or abs(advance_m - self.target) < self.settings.min_change:
            return None
        return self._continue(now_ns, advance_m, path, motion)

    def stop(self, now_s: float) -> PlannedTrajectory | None:
        """Return the trajectory that brakes as soon and as fast as the limits allow.

        None where the arm rests or the last trajectory brings it to rest as soon. A clock that was
        set back is no obstacle: the motion is ended from where the arm is by the new time, or, if
        that is no longer remembered, from the oldest time that is.

        Args:
            now_s: Present time [s].

        Raises:
            ArmError: A time that is not finite.
        """
        path, motion = self.path, self.motion_limits
        if path is None or motion is None or self._epoch_ns is None:
            return None
        now_ns = self._checked_ns(now_s)
        if now_ns < self._now_ns:
            oldest_ns = self._epoch_ns + (self._first + self._overlap) * self._dt_ns
            now_ns = min(max(now_ns, oldest_ns), self._now_ns)
        self._now_ns = now_ns
        start = self._at(self._branch(now_ns))
        if not (self._rows(self._branch(now_ns), self._first + len(self._states))[:, 1:]).any():
            return None
        target = start[0] + stopping_distance(start, motion.acceleration, motion.jerk)
        ahead = self.target - start[0]
        if ahead * (target - start[0]) > 0.0 and abs(target - start[0]) >= abs(ahead):
            return None
        return self._continue(now_ns, float(target), path, motion)

    def advance_at(self, t_s: float) -> float:
        """Return the advance [m] that is commanded at a time [s]."""
        if self._epoch_ns is None:
            return 0.0
        cells = (t_s - self._epoch_ns * 1e-9) / self._dt - self._first
        if cells <= 0.0 or cells >= len(self._states) - 1:
            return float(self._states[0 if cells <= 0.0 else -1, 0])
        k = int(cells)
        t = (cells - k) * self._dt
        s, v, a = self._states[k]
        j = (self._states[k + 1, 2] - a) / self._dt
        return float(s + t * (v + t * (0.5 * a + t * j / 6.0)))

    def moving(self, now_s: float) -> bool:
        """Return whether the arm is commanded to move, now or later [s]."""
        if self._epoch_ns is None:
            return False
        start_s = (self._epoch_ns + self._first * self._dt_ns) * 1e-9
        return start_s <= now_s < start_s + (len(self._states) - 1) * self._dt

    def _clear(self) -> None:
        self._epoch_ns: int | None = None
        self._first = 0
        self._states = np.zeros((1, 3))
        self._now_ns = 0
        self._sent_ns: int | None = None

    def _prepare(self, q: Floats, normal: Floats) -> tuple[NormalPath, MotionLimits]:
        high = self._max_advance + PATH_MARGIN
        path = fit_normal_path(self._arm, self._limits, q, normal, -PATH_MARGIN, high)
        motion = path.limits(self._limits, self.settings.share, self.settings.max_speed)
        self.path, self.motion_limits = path, motion
        return path, motion

    def _ready(self, normal: Floats) -> tuple[NormalPath, MotionLimits]:
        if self.path is None or self.motion_limits is None:
            return self._prepare(self.start, normal)
        n = self.path.normal
        x, y, z = float(normal[0]), float(normal[1]), float(normal[2])
        length = math.sqrt(x * x + y * y + z * z)
        if not abs(x * n[0] + y * n[1] + z * n[2] - length) <= 0.5 * SAME_NORMAL**2 * length:
            raise ArmError(
                f'the contact normal changed from {n.tolist()} to {[x, y, z]} during an advance: '
                'reset the planner first'
            )
        return self.path, self.motion_limits

    def _advance_clock(self, now_s: float) -> int:
        now_ns = self._checked_ns(now_s)
        if self._epoch_ns is None:
            self._epoch_ns = now_ns // self._dt_ns * self._dt_ns
        elif now_ns < self._now_ns:
            raise ArmError(
                f'time ran back by {(self._now_ns - now_ns) * 1e-9:.6f} s: reset the planner'
            )
        self._now_ns = now_ns
        return now_ns

    @staticmethod
    def _checked_ns(now_s: float) -> int:
        if not math.isfinite(now_s):
            raise ArmError(f'time {now_s} s: give a finite number')
        return round(now_s * 1e9)

    def _index(self, t_ns: int) -> int:
        return (t_ns - (self._epoch_ns or 0)) // self._dt_ns

    def _branch(self, now_ns: int) -> int:
        """Return the first point of the grid at least the lead after a time."""
        return self._index(now_ns + self._dt_ns - 1) + self._lead

    def _rows(self, first: int, last: int) -> Floats:
        """Return the states at points first to last, both included; at rest past the end."""
        indices = np.clip(np.arange(first, last + 1) - self._first, 0, len(self._states) - 1)
        return np.ascontiguousarray(self._states[indices])

    def _at(self, index: int) -> Floats:
        return np.asarray(self._rows(index, index)[0])

    def _continue(
        self, now_ns: int, target: float, path: NormalPath, motion: MotionLimits
    ) -> PlannedTrajectory | None:
        branch = self._branch(now_ns)
        shape = (path.coefficients, path.centre, path.half)
        _, tip_acceleration, tip_jerk = self._limits.tip
        new = replan(
            *shape,
            self._at(branch),
            target,
            (motion.speed, motion.acceleration, motion.jerk),
            (self.settings.share * tip_acceleration, self.settings.share * tip_jerk),
            self._limits.acceleration * self.settings.share,
            self._limits.jerk * self.settings.share,
            self._dt,
        )
        if new.shape[0] == 0:
            self.refused += 1
            return None
        now = self._index(now_ns)
        begin = now - self._overlap
        oldest = min(max(self._first, now - self._history), begin)
        self._states = np.concatenate([self._rows(oldest, branch), new[1:]])
        self._first = oldest
        self._sent_ns = now_ns
        states = self._states[begin + 1 - oldest :]
        joints = joint_states(*shape, np.ascontiguousarray(states))
        return PlannedTrajectory(
            stamp_ns=(self._epoch_ns or 0) + begin * self._dt_ns,
            times_s=np.arange(1, len(states) + 1, dtype=np.float64) * self._dt,
            q=joints[:, 0],
            dq=joints[:, 1],
            ddq=joints[:, 2],
            names=self._arm.names,
            branch_s=(branch - begin) * self._dt,
        )
