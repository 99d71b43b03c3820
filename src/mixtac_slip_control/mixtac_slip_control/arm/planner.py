# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The planner that streams an advance along the contact normal as jerk-limited trajectories.

The advance is one coordinate on a straight line in joint space. `ruckig` plans its time-optimal
motion; the points of a trajectory are the times at which the jerk changes. Between two of them
every joint moves by a cubic, and a controller that joins points with quintics reproduces that
cubic.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig
from ruckig import Trajectory as Motion

from mixtac_core.events.arrays import Floats
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.trajectory import PlannedTrajectory
from mixtac_slip_control.errors import ArmError, UnreachableError
from mixtac_slip_control.parameters import CONTROLLER_PERIOD_S

OVERLAP_S: Final = 3.0 * CONTROLLER_PERIOD_S
"""Time before the call at which a trajectory begins [s]: at least two cycles, so that the
controller never joins its own last command to the first point."""
INTERVAL_S: Final = 2e-3
"""Least time between two trajectories [s]."""
MIN_CHANGE_M: Final = 1e-7
"""Smaller changes of the target are not sent [m]."""
HISTORY_S: Final = 0.25
"""Time for which past advances are kept [s]."""
MAX_SPEED: Final = 0.25
"""Largest speed of the tip [m/s]."""
MAX_ADVANCE: Final = 2e-3
"""Largest advance [m]: a straight line in joint space then leaves the normal by 10 um at most."""
SAME_NORMAL: Final = 1e-3
"""Largest difference between unit normals that count as the same."""
SHORTEST_S: Final = 1e-6
"""Shorter phases of a motion get no point of their own [s]."""
GRID_NS: Final = 1_000_000
"""Grid of the times at which trajectories begin and branch off [ns]."""


@dataclass(frozen=True, slots=True, eq=False)
class JointLine:
    """A straight line in joint space along which the tip advances at constant orientation.

    Attributes:
        normal: Unit direction of the advance (3,) in the base frame.
        start: Joint positions at advance zero (n,) [rad].
        slope: Joint motion per advance (n,) [rad/m].
    """

    normal: Floats
    start: Floats
    slope: Floats

    def at(self, advance: float) -> Floats:
        """Return the joint positions (n,) [rad] at an advance [m]."""
        return self.start + advance * self.slope

    def limits(self, limits: JointLimits, share: float, most: float) -> tuple[float, float, float]:
        """Return speed, acceleration and jerk of the advance at which no joint exceeds its share.

        Args:
            limits: Limits of joints and tip.
            share: Share of each rate limit that may be used, 0 to 1.
            most: Largest advance [m].

        Returns:
            [m/s, m/s2, m/s3].
        """
        slope = np.maximum(np.abs(self.slope), 1e-9)
        bounds = [limits.velocity_bounds(self.at(s)) for s in (0.0, most)]
        speeds = np.min([np.minimum(-low, high) for low, high in bounds], axis=0)
        tip_speed, tip_acceleration, tip_jerk = limits.tip
        return (
            min(MAX_SPEED, share * min(tip_speed, float((speeds / slope).min()))),
            share * min(tip_acceleration, float((limits.acceleration / slope).min())),
            share * min(tip_jerk, float((limits.jerk / slope).min())),
        )


def joint_line(
    arm: SerialArm, limits: JointLimits, q: Floats, normal: Floats, most: float
) -> JointLine:
    """Return the line from joint positions along a direction.

    Args:
        arm: The arm.
        limits: Limits of its joints; positions stay `JOINT_MARGIN` inside.
        q: Joint positions at advance zero (n,) [rad].
        normal: Direction of the advance (3,) in the base frame, of any length.
        most: Largest advance [m].

    Raises:
        ArmError: `normal` is not a direction, or `q` are not joint positions of the arm.
        UnreachableError: The advance leaves the ranges of the joints, or the arm cannot move along
            the direction at constant orientation.
    """
    start = arm.checked(q).copy()
    direction = np.asarray(normal, np.float64)
    length = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not 1e-6 < length < 1e6:
        raise ArmError(f'contact normal {direction.tolist()}: give three numbers, not all zero')
    direction = direction / length
    jacobian = arm.jacobian(start)
    # The least joint motion; the one with the least acceleration is 6 % faster in the median.
    slope = np.linalg.lstsq(jacobian, np.concatenate([direction, np.zeros(3)]), rcond=1e-6)[0]
    if np.abs(jacobian[:3] @ slope - direction).max() > SAME_NORMAL:
        raise UnreachableError(
            'the arm cannot advance along the contact normal from here: choose another posture'
        )
    line = JointLine(direction, start, slope)
    problem = limits.violation(line.at(most), arm.names)
    if problem is not None:
        raise UnreachableError(
            f'an advance of {most * 1e3:.2f} mm needs {problem}: choose another posture or a '
            'smaller max_total'
        )
    return line


@dataclass(frozen=True, slots=True)
class Knot:
    """State of the advance at a time at which its jerk changes.

    Attributes:
        t_ns: Time [ns].
        s: Advance [m].
        v: Velocity [m/s].
        a: Acceleration [m/s2].
        j: Jerk until the next knot [m/s3].
    """

    t_ns: int
    s: float
    v: float
    a: float
    j: float

    def after(self, t_ns: int) -> Knot:
        """Return the state at a later time before the next knot [ns]."""
        t = 1e-9 * (t_ns - self.t_ns)
        s = self.s + t * (self.v + t * (0.5 * self.a + t * self.j / 6.0))
        v = self.v + t * (self.a + 0.5 * t * self.j)
        return Knot(t_ns, s, v, self.a + t * self.j, self.j)


class AdvancePlanner:
    """Plans the advance since the last reset as trajectories, each continuing the one before.

    A new trajectory repeats the motion already sent until `lead_s` after the call. From there it
    continues with the same velocity and acceleration, and ends at rest at the new target. If the
    controller receives it before that time, the motion continues without a step. If no further
    trajectory arrives, the arm stops at the target.

    All times are on the clock of `now_s`, which the controller uses as well.

    Attributes:
        line: Joint line of this reset; None before the first reset.
        refused: Number of plans that ruckig could not compute; the last trajectory stays valid.

    Args:
        arm: The arm.
        limits: Limits of its joints.
        lead_s: Time from the call to the first point that may differ from the last trajectory [s].
            It must cover the longest transport to the controller and two cycles of the controller:
            one until it reads the trajectory, and one by which it commands ahead.
        share: Share of the rate limits that may be used; the rest is reserve.
    """

    def __init__(
        self, arm: SerialArm, limits: JointLimits, lead_s: float = 6e-3, share: float = 0.95
    ) -> None:
        self._arm, self._limits = arm, limits
        self._lead_ns, self._share = round(lead_s * 1e9), share
        self.refused = 0
        self.line: JointLine | None = None
        self._most, self._now_ns = 0.0, 0
        self._ruckig, self._motion, self._input = Ruckig(1), Motion(1), InputParameter(1)
        self._clear()

    @property
    def target(self) -> float:
        """Advance at which the last trajectory ends [m]."""
        return self._knots[-1].s

    @property
    def start(self) -> Floats:
        """Joint positions at advance zero (n,) [rad].

        Raises:
            ArmError: The planner was not reset yet.
        """
        return self._ready().start

    def reset(self, q: Floats, normal: Floats, max_advance: float = MAX_ADVANCE) -> None:
        """Start over with advance zero, at rest.

        Args:
            q: Joint positions that the controller holds (n,) [rad]: the commanded ones, not the
                measured. `settling_trajectory` makes the two equal.
            normal: Direction of the advance (3,) in the base frame.
            max_advance: Largest advance that will be requested [m].

        Raises:
            ArmError: An argument is not valid.
            UnreachableError: `max_advance` leaves the ranges of the joints.
        """
        if not 0.0 <= max_advance <= MAX_ADVANCE:
            raise ArmError(f'max_advance = {max_advance} m: give 0 to {MAX_ADVANCE} m')
        self.line = joint_line(self._arm, self._limits, q, normal, max_advance)
        speed, acceleration, jerk = self.line.limits(self._limits, self._share, max_advance)
        self._most = max_advance
        self._input.max_velocity = [speed]
        self._input.max_acceleration = [acceleration]
        self._input.max_jerk = [jerk]
        self._clear()

    def plan(self, now_s: float, advance_m: float) -> PlannedTrajectory | None:
        """Return the trajectory to a new target, or None if there is nothing new to send.

        None means that the target is as before, that the last trajectory was sent less than
        `INTERVAL_S` ago (ask again with the next window), or that no motion was found.

        Args:
            now_s: Present time [s].
            advance_m: Advance to reach, since the reset [m].

        Raises:
            ArmError: The planner was not reset, a value is not finite, or time runs backwards.
            UnreachableError: An advance below zero or above `max_advance`.
        """
        line = self._ready()
        if not math.isfinite(advance_m) or not math.isfinite(now_s):
            raise ArmError(f'advance {advance_m} m at {now_s} s: give finite numbers')
        if not -1e-9 <= advance_m <= self._most + 1e-9:
            raise UnreachableError(
                f'an advance of {advance_m * 1e3:.3f} mm is outside 0 to '
                f'{self._most * 1e3:g} mm: limit it, or reset the planner for more'
            )
        now_ns = round(now_s * 1e9)
        if now_ns < self._now_ns:
            raise ArmError(
                f'time ran back by {(self._now_ns - now_ns) * 1e-9:.6f} s: reset the planner'
            )
        self._now_ns = now_ns
        # A caller at exactly this interval must not miss its turn by rounding.
        early = self._sent_ns is not None and now_ns - self._sent_ns < 1e9 * INTERVAL_S - 1000
        if early or abs(advance_m - self.target) < MIN_CHANGE_M:
            return None
        return self._continue(now_ns, self._solved(self._branch(now_ns), advance_m), line)

    def stop(self, now_s: float) -> PlannedTrajectory | None:
        """Return the trajectory that brakes as soon and as fast as the limits allow.

        None if the arm rests, or if the last trajectory brings it to rest as early. After the clock
        was set back, the motion is ended from where the arm is by the new time, or from the oldest
        time that is kept.

        Args:
            now_s: Present time [s].

        Raises:
            ArmError: A time that is not finite.
        """
        if not math.isfinite(now_s):
            raise ArmError(f'time {now_s} s: give a finite number')
        if self.line is None or len(self._knots) == 1:
            return None
        now_ns = round(now_s * 1e9)
        if now_ns < self._now_ns:
            oldest_ns = self._knots[0].t_ns + round(1e9 * OVERLAP_S)
            now_ns = min(max(now_ns, oldest_ns), self._now_ns)
        self._now_ns = now_ns
        branch = self._branch(now_ns)
        if branch.t_ns >= self._knots[-1].t_ns:
            return None
        solved = self._solved(branch, None)
        if solved is not None and solved[-1].t_ns >= self._knots[-1].t_ns:
            return None
        return self._continue(now_ns, solved, self.line)

    def advance_at(self, t_s: float) -> float:
        """Return the advance [m] that is commanded at a time [s]."""
        last, t_ns = self._knots[-1], round(t_s * 1e9)
        return last.s if t_ns >= last.t_ns else self._state(t_ns).s

    def moving(self, now_s: float) -> bool:
        """Return whether the arm is commanded to move, now or later [s]."""
        first, last = self._knots[0].t_ns, self._knots[-1].t_ns
        return len(self._knots) > 1 and first <= now_s * 1e9 < last

    def _ready(self) -> JointLine:
        if self.line is None:
            raise ArmError('the advance has no start: reset the planner with joint positions')
        return self.line

    def _clear(self) -> None:
        self._knots = [Knot(0, 0.0, 0.0, 0.0, 0.0)]
        self._now_ns = 0
        self._sent_ns: int | None = None

    def _state(self, t_ns: int) -> Knot:
        """Return the state at a time [ns]; at rest before the first and after the last knot."""
        k = bisect.bisect_right(self._knots, t_ns, key=lambda knot: knot.t_ns) - 1
        if k < 0 or k == len(self._knots) - 1:
            return Knot(t_ns, self._knots[max(k, 0)].s, 0.0, 0.0, 0.0)
        return self._knots[k].after(t_ns)

    def _branch(self, now_ns: int) -> Knot:
        """Return the state at the first time of the grid at least the lead after a time [ns]."""
        return self._state(-(-(now_ns + self._lead_ns) // GRID_NS) * GRID_NS)

    def _solved(self, start: Knot, target: float | None) -> list[Knot] | None:
        """Return the fastest motion to rest at a target, or to rest anywhere; None if not found."""
        given = self._input
        kind = ControlInterface.Velocity if target is None else ControlInterface.Position
        given.control_interface = kind
        given.current_position = [start.s]
        given.current_velocity = [start.v]
        given.current_acceleration = [start.a]
        given.target_position = [target if target is not None else start.s]
        try:
            done = self._ruckig.calculate(given, self._motion)
        except RuntimeError:
            return None
        if done not in {Result.Working, Result.Finished}:
            return None
        return self._knots_of(start)

    def _knots_of(self, start: Knot) -> list[Knot]:
        """Return the states at which the jerk of the planned motion changes, the last at rest."""
        profile = self._motion.profiles[0][0]
        phases = [*zip(profile.brake.t, profile.brake.j, strict=True)]
        phases += [*zip(profile.t, profile.j, strict=True)]
        knots, t = [Knot(start.t_ns, start.s, start.v, start.a, 0.0)], 0.0
        for duration, jerk in phases:
            if duration >= SHORTEST_S:
                (s,), (v,), (a,) = self._motion.at_time(t)
                knots.append(Knot(start.t_ns + round(1e9 * t), s, v, a, jerk))
            t += duration
        if len(knots) > 1:
            knots.pop(0)
            knots[0] = Knot(start.t_ns, start.s, start.v, start.a, knots[0].j)
        (s,), _, _ = self._motion.at_time(self._motion.duration)
        end_ns = start.t_ns + max(round(1e9 * self._motion.duration), 1000)
        knots.append(Knot(end_ns, s, 0.0, 0.0, 0.0))
        return knots

    def _continue(
        self, now_ns: int, new: list[Knot] | None, line: JointLine
    ) -> PlannedTrajectory | None:
        if new is None:
            self.refused += 1
            return None
        branch_ns = new[0].t_ns
        begin_ns = (now_ns // GRID_NS) * GRID_NS - round(1e9 * OVERLAP_S)
        oldest_ns = begin_ns - round(1e9 * HISTORY_S)
        begin = self._state(begin_ns + GRID_NS)
        kept = [knot for knot in self._knots if knot.t_ns < branch_ns]
        sent = [begin, *(knot for knot in kept if knot.t_ns > begin.t_ns), *new]
        old = [knot for knot in kept if knot.t_ns > oldest_ns]
        self._knots = [self._state(oldest_ns), *old, *new]
        self._sent_ns = now_ns
        states = np.array([(knot.s, knot.v, knot.a) for knot in sent])
        return PlannedTrajectory(
            stamp_ns=begin_ns,
            times_s=np.array([1e-9 * (knot.t_ns - begin_ns) for knot in sent]),
            q=line.start + states[:, :1] * line.slope,
            dq=states[:, 1:2] * line.slope,
            ddq=states[:, 2:] * line.slope,
            names=self._arm.names,
            branch_s=1e-9 * (branch_ns - begin_ns),
        )
