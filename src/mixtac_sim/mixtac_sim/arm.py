# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The simulated Franka Research 3: its geometry and limits, its controller, and its lag.

Geometry and limits are written independently of those of the slip controller. Modified
Denavit-Hartenberg parameters and positions: Franka's documentation and franka_description; speeds:
joint speed at mid range; acceleration and jerk: libfranka.

The controller is a joint_trajectory_controller of ros2_control, written from the behaviour of
ros2_controllers' source and its issues 697, 780 and 1306 (Jazzy and later): a message takes effect
at the next cycle and replaces the one before; before its first point the motion goes from the last
command; quintics join the points, which give position, velocity and acceleration; after the last
point that point is held. Each joint follows its command with a lag.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit

from mixtac_core.events.arrays import Floats

JOINT_NAMES = tuple(f'fr3_joint{k}' for k in range(1, 8))
A_M = (0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088)
D_M = (0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0)
ALPHA = (0.0, -0.5 * np.pi, 0.5 * np.pi, 0.5 * np.pi, -0.5 * np.pi, 0.5 * np.pi, 0.5 * np.pi)
FLANGE_M = 0.107
READY = np.radians([0.0, -45.0, 0.0, -135.0, 0.0, 90.0, 45.0])
"""Ready pose [rad]."""
Q_LOWER = np.array([-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159])
Q_UPPER = np.array([2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159])
"""Positions [rad]."""
SIDEWAYS = np.array([0.0, 1.0, 0.0])
"""Direction in the base frame along which the fingertip advances."""
DQ_MAX = np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])
"""Speeds [rad/s]; near the ends of a joint's range less is allowed."""
DDQ_MAX = 10.0
"""Acceleration of every joint [rad/s2]."""
DDDQ_MAX = 5000.0
"""Jerk of every joint [rad/s3]."""


def flange_place(q: Floats) -> Floats:
    """Return the place of the flange [3] [m] in the base frame.

    Args:
        q: Joint positions [7] [rad].
    """
    pose = np.eye(4)
    for a, d, alpha, angle in zip(A_M, D_M, ALPHA, q, strict=True):
        pose = pose @ _link(a, d, alpha, float(angle))
    return np.asarray(pose[:3, 3] + FLANGE_M * pose[:3, 2])


def _link(a: float, d: float, alpha: float, angle: float) -> Floats:
    """Return one modified Denavit-Hartenberg transform."""
    ct, st, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st, 0.0, a],
            [st * ca, ct * ca, -sa, -d * sa],
            [st * sa, ct * sa, ca, d * ca],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def violations(q: Floats, period_s: float) -> int:
    """Return how many samples of a commanded motion break a limit.

    Args:
        q: Joint positions [n, 7] [rad], one per control cycle.
        period_s: Period of the control cycle [s].
    """
    dq = np.diff(q, axis=0) / period_s
    ddq = np.diff(dq, axis=0) / period_s
    dddq = np.diff(ddq, axis=0) / period_s
    # Rounding may exceed a limit by a thousandth.
    room = 1.0 + 1e-3
    broken = [
        np.any((q < Q_LOWER) | (q > Q_UPPER), axis=1),
        np.any(np.abs(dq) > room * DQ_MAX, axis=1),
        np.any(np.abs(ddq) > room * DDQ_MAX, axis=1),
        np.any(np.abs(dddq) > room * DDDQ_MAX, axis=1),
    ]
    return int(sum(np.count_nonzero(each) for each in broken))


@njit(cache=True, nogil=True)
def interpolate(start: Floats, end: Floats, span_s: float, since_s: float) -> Floats:
    """Return the state between two states on the quintic that joins them.

    Args:
        start: Position, velocity, acceleration [3, joint] [rad, rad/s, rad/s2].
        end: The same at the end.
        span_s: Time between them [s], positive.
        since_s: Time since the start [s].

    Returns:
        State [3, joint].
    """
    state = np.zeros_like(start)
    u = since_s / span_s
    for j in range(start.shape[1]):
        step = end[0, j] - start[0, j]
        # In units of the span: p(u) = p0 + v0 u + a2 u^2 + ... + a5 u^5.
        v0, v1 = span_s * start[1, j], span_s * end[1, j]
        a2 = 0.5 * span_s * span_s * start[2, j]
        gap, turn, bend = step - v0 - a2, v1 - v0 - 2.0 * a2, 0.5 * span_s**2 * end[2, j] - a2
        a3 = 10.0 * gap - 4.0 * turn + bend
        a4 = -15.0 * gap + 7.0 * turn - 2.0 * bend
        a5 = 6.0 * gap - 3.0 * turn + bend
        state[0, j] = start[0, j] + u * (v0 + u * (a2 + u * (a3 + u * (a4 + u * a5))))
        slope = v0 + u * (2.0 * a2 + u * (3.0 * a3 + u * (4.0 * a4 + u * 5.0 * a5)))
        bent = 2.0 * a2 + u * (6.0 * a3 + u * (12.0 * a4 + u * 20.0 * a5))
        state[1, j] = slope / span_s
        state[2, j] = bent / (span_s * span_s)
    return state


def warm_up() -> None:
    """Compile what the first trajectory would otherwise wait for."""
    rest = np.zeros((3, len(READY)))
    interpolate(rest, rest, 1.0, 0.0)


CYCLE_S = 1e-3
"""Period of the controller and of its commands [s]."""
RULES = {'4.0': (0.0, CYCLE_S), '4.17': (CYCLE_S, CYCLE_S), '4.21': (CYCLE_S, 0.0)}
"""Times that a controller adds to that of its cycle, by the first version of ros2_controllers: for
which it computes the command, and which it counts as the command's own time [s]."""
START_EPSILON_S = 1e-12
"""Time by which a trajectory may be asked for before its start [s]: rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """What matters here of a JointTrajectory, with the joints in the arm's order.

    Attributes:
        stamp_s: Start [s] on the controller's clock; 0 means when it is first sampled.
        times_s: Times of the points since the start [n] [s], increasing.
        q: Joint positions [n, joint] [rad].
        dq: Joint velocities [n, joint] [rad/s].
        ddq: Joint accelerations [n, joint] [rad/s2].
    """

    stamp_s: float
    times_s: Floats
    q: Floats
    dq: Floats
    ddq: Floats


class JointTrajectoryController:
    """A controller with a position command interface, cycle by cycle.

    New trajectories start from the last command (``interpolate_from_desired_state``), and those
    that end in motion are rejected.

    Args:
        rule: First version of ros2_controllers that times commands like it. The last one holds for
            today's Jazzy, Kilted and Lyrical, without ``allow_trajectory_replacement``.
    """

    def __init__(self, rule: str = '4.21') -> None:
        self._ahead_s, self._counted_s = RULES[rule]
        self.reset(READY, 0.0)

    def reset(self, q: Floats, now_s: float) -> None:
        """Hold still at a position, as after activation.

        Args:
            q: Joint positions [joint] [rad].
            now_s: Time of the first cycle after this [s].
        """
        self._command = np.stack([q, np.zeros(len(q)), np.zeros(len(q))])
        self._command_s = now_s
        self._first_cycle_s = now_s
        self._cycles = 0
        self._pending: Trajectory | None = None
        # The trajectory being carried out: times [point] [s] and states [point, 3, joint],
        # the first one before it.
        self._times, self._states = np.empty(0), np.empty((0, 3, len(q)))

    def accept(self, trajectory: Trajectory, now_s: float) -> str | None:
        """Receive a message; it takes effect at the next cycle, unless another overtakes it.

        Args:
            trajectory: The message.
            now_s: Time of its arrival [s].

        Returns:
            Why it is rejected; None if it is accepted.
        """
        reason = self._reason_against(trajectory, now_s)
        if reason is None:
            self._pending = trajectory
        return reason

    def sample(self, t_s: float) -> tuple[Floats, Floats, Floats]:
        """Run the cycles up to a time and return the last command.

        Args:
            t_s: Time [s]; cycles at or before it are run.

        Returns:
            Position [rad], velocity [rad/s] and acceleration [rad/s2] of the joints [joint].
        """
        for _ in self.cycles(t_s):
            pass
        return self._command[0].copy(), self._command[1].copy(), self._command[2].copy()

    def cycles(self, t_s: float) -> Iterator[Floats]:
        """Run the cycles up to a time, one by one, and yield the position [joint] [rad] of each.

        Args:
            t_s: Time [s]; cycles at or before it are run.
        """
        while self.next_cycle_s <= t_s + 1e-9:
            self._cycle(self.next_cycle_s)
            self._cycles += 1
            yield self._command[0].copy()

    @property
    def next_cycle_s(self) -> float:
        """Time of the next cycle [s]."""
        return self._first_cycle_s + self._cycles * CYCLE_S

    def _cycle(self, now_s: float) -> None:
        """Run one control cycle."""
        t_s = now_s + self._ahead_s
        if self._pending is not None:
            new = self._pending
            start_s = new.stamp_s if new.stamp_s != 0.0 else now_s
            self._times = np.append(self._command_s, start_s + new.times_s)
            states = np.stack([new.q, new.dq, new.ddq], axis=1)
            self._states = np.concatenate([self._command[None], states])
            self._pending = None
        times, states = self._times, self._states
        if len(times) and t_s < times[0] - START_EPSILON_S:
            return
        if len(times) and t_s >= times[-1]:
            self._command = np.array(states[-1])
        elif len(times):
            # Before its first point the motion starts from the last command.
            k = int(np.searchsorted(times[1:], t_s, side='right'))
            span_s, since_s = times[k + 1] - times[k], t_s - times[k]
            self._command = interpolate(states[k], states[k + 1], span_s, since_s)
        # Since its activation it holds a position, which is a trajectory like any other.
        self._command_s = now_s + self._counted_s

    def _reason_against(self, trajectory: Trajectory, now_s: float) -> str | None:
        """Return why the controller would reject a message."""
        times, shape = trajectory.times_s, (len(trajectory.times_s), self._command.shape[1])
        if shape[0] == 0:
            return 'empty trajectory'
        for name, values in (('q', trajectory.q), ('dq', trajectory.dq), ('ddq', trajectory.ddq)):
            if values.shape != shape:
                return f'{name} has the shape {values.shape}, not {shape}'
            if not np.isfinite(values).all():
                return f'{name} is not finite'
        if np.any(np.diff(times) <= 0.0):
            return 'times of the points do not increase'
        if trajectory.stamp_s != 0.0 and trajectory.stamp_s + times[-1] < now_s:
            return f'ends at {trajectory.stamp_s + times[-1]:.6f} s, in the past of {now_s:.6f} s'
        moving = np.any(np.abs(trajectory.dq[-1]) > 1e-6)
        return 'velocity at the end is not zero' if moving else None


TRACKING_LAG_S = 3.5e-3
"""Time constant of the arm's own position control [s]: 3 to 4 ms were seen on libfranka's wire
protocol in simulation, 40 ms with the effort controller that franka_ros2 ships."""


class LaggingArm:
    """Joints that follow their commands with a first-order lag.

    Args:
        q: Joint positions at the start [7] [rad].
        normal: Direction of the fingertip's advance in the base frame [3], of length 1.
        lag_s: Time constant of the lag [s].
    """

    def __init__(self, q: Floats, normal: Floats, lag_s: float = TRACKING_LAG_S) -> None:
        self._q = np.array(q, np.float64)
        self._keep = float(np.exp(-CYCLE_S / lag_s)) if lag_s > 0.0 else 0.0
        self._normal = normal
        self._start = flange_place(self._q)
        self._last_mm = 0.0

    @property
    def q(self) -> Floats:
        """Return the joint positions [7] [rad]."""
        return self._q.copy()

    def track(self, command: Floats) -> None:
        """Advance one period towards commanded joint positions [7] [rad]."""
        self._q = command + self._keep * (self._q - command)

    def follow(self, command: Floats, points: int) -> Floats:
        """Advance one period of the commands.

        Args:
            command: Commanded joint positions [7] [rad].
            points: Number of positions to return.

        Returns:
            Positions of the fingertip along the normal, relative to the start [mm]: one at the end
            of each of `points` equal parts of the period.
        """
        self.track(command)
        place_mm = 1e3 * float((flange_place(self._q) - self._start) @ self._normal)
        way = np.linspace(self._last_mm, place_mm, points + 1)[1:]
        self._last_mm = place_mm
        return way
