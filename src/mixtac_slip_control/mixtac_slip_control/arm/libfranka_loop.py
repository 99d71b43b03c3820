# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The 1 kHz loop that drives a Franka arm through pylibfranka, in a process of its own.

Started by `LibfrankaBackend`. Trajectories arrive on standard input and states leave on standard
output, as `pack` and `STATE` define them; a fault ends the process with one line on standard error.
pylibfranka waits for the robot while it holds the interpreter lock, which would stall every other
thread of a node. This module needs NumPy only, so that any interpreter with pylibfranka can run it.

Commands are taken from the trajectory at the robot's own time, which advances by the period that
the robot reports, so that they keep their distance in time however late this process wakes up. That
time is set to the host's clock only while the arm rests, when this changes no command.

A Franka arm that misses commands goes on with constant acceleration. The next command from the
trajectory would then be a step from where the arm has got to, so `GapBridge` leads it back to a
later point of the trajectory by a quintic.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import signal
import struct
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from mixtac_slip_control.arm.trajectory import PlannedTrajectory

    Floats = NDArray[np.float64]
    Times = NDArray[np.int64]


JOINTS = 7
HEADER = struct.Struct('<qI')
"""Stamp [ns] and number of points; no points: come to rest and end."""
POINT_BYTES = 8 * (1 + 3 * JOINTS)
STATE = struct.Struct(f'<qI{3 * JOINTS}d')
"""Time [ns], trajectories refused as late, q, dq, commanded q."""
MAX_POINTS = 100_000
STOP = HEADER.pack(0, 0)


def pack(trajectory: PlannedTrajectory) -> bytes:
    """Return the bytes of a trajectory of seven joints with at least one point."""
    states = np.stack([trajectory.q, trajectory.dq, trajectory.ddq], axis=1)
    header = HEADER.pack(trajectory.stamp_ns, len(trajectory.times_s))
    times = np.round(trajectory.times_s * 1e9).astype('<i8') + trajectory.stamp_ns
    return header + times.tobytes() + states.astype('<f8').tobytes()


class Receiver:
    """Cuts a stream of bytes into trajectories, dropping all but the latest.

    Attributes:
        stopped: Whether a stop was received, or bytes that are none of ours.
    """

    def __init__(self) -> None:
        self.stopped = False
        self._pending = bytearray()

    def push(self, data: bytes) -> tuple[Times, Floats] | None:
        """Take in bytes; return the latest complete trajectory among them, if any.

        Returns:
            Times of the points (m,) [ns], and positions, velocities, accelerations (m, 3, 7).
        """
        self._pending += data
        latest = None
        while not self.stopped and len(self._pending) >= HEADER.size:
            _, points = HEADER.unpack_from(self._pending)
            end = HEADER.size + points * POINT_BYTES
            if points == 0 or points > MAX_POINTS:
                self.stopped = True
            elif len(self._pending) < end:
                break
            else:
                body = bytes(self._pending[HEADER.size : end])
                states = np.frombuffer(body, '<f8', offset=8 * points).reshape(points, 3, JOINTS)
                times = np.frombuffer(body, '<i8', points)
                latest = times.astype(np.int64), states.astype(np.float64)
                del self._pending[:end]
        return latest


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


DURATIONS_MS = (4, 7, 10, 15, 20, 30, 40, 60, 80, 120, 160, 240, 320, 480, 640)
"""Durations of the way back that are tried in turn [ms]."""
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


FAULT_STATUS = 3
FIFO_PRIORITY = 50
READ_BYTES = 1 << 16
CYCLE_NS = 1_000_000
LOST_NS = 1_500_000
"""Periods above this mean that the robot went on without a command of ours."""
BRIDGE_ACCELERATION = 9.5
BRIDGE_JERK = 4750.0
"""Jerk limit of the way back to the trajectory [rad/s3]; like `BRIDGE_ACCELERATION` [rad/s2], the
limit of libfranka less a reserve."""


class ControlLoop:
    """Follows the trajectories it is sent until it is asked to stop.

    Args:
        control: Active joint position control.
        command: Makes a joint position command from seven positions [rad].
        read: Returns the bytes that have arrived; empty: none; None: nobody is left to send.
        write: Takes the bytes of a state, or drops them.
        clock_ns: The host's clock [ns].
    """

    def __init__(
        self,
        control: Any,  # noqa: ANN401
        command: Callable[[list[float]], Any],
        read: Callable[[], bytes | None],
        write: Callable[[bytes], None],
        clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._control = control
        self._command = command
        self._read = read
        self._write = write
        self._clock_ns = clock_ns
        self._receiver = Receiver()
        self._plan = TrajectorySplice(np.zeros(JOINTS))
        self._bridge = GapBridge(BRIDGE_ACCELERATION, BRIDGE_JERK)

    def run(self) -> None:
        """Hold the commanded state, follow trajectories, and end at rest."""
        state, _ = self._control.readOnce()
        self._plan = TrajectorySplice(np.array(state.q_d))
        now_ns = before_ns = self._clock_ns()
        commanded = self._plan.at(now_ns)
        stopping = False
        while True:
            if self._receive(now_ns) and self._bridge.at(before_ns) is not None:
                self._bridge.start(before_ns, commanded, self._plan)
            stopping |= self._receiver.stopped
            way = self._bridge.at(now_ns)
            commanded = self._plan.at(now_ns) if way is None else way
            q = commanded[0].tolist()
            self._write(STATE.pack(now_ns, self._plan.late, *state.q, *state.dq, *q))
            command = self._command(q)
            command.motion_finished = stopping and way is None and self._plan.ended(now_ns)
            self._control.writeOnce(command)
            if command.motion_finished:
                return
            state, period = self._control.readOnce()
            before_ns, now_ns = now_ns, now_ns + round(period.to_sec() * 1e9)
            host_ns = self._clock_ns()
            if way is None and self._plan.still(before_ns, max(now_ns, host_ns)):
                now_ns = max(host_ns, before_ns)
            elif now_ns - before_ns > LOST_NS:
                before_ns = now_ns - CYCLE_NS
                commanded = np.array([state.q_d, state.dq_d, state.ddq_d])
                # The robot differences backwards: its velocity is that of half a cycle ago.
                commanded[1] += 0.5 * CYCLE_NS * 1e-9 * commanded[2]
                self._bridge.start(before_ns, commanded, self._plan)

    def _receive(self, now_ns: int) -> bool:
        """Take in what has arrived; return whether the trajectory is another now."""
        data = self._read()
        if data is None:
            self._receiver.stopped = True
        trajectory = self._receiver.push(data) if data else None
        return trajectory is not None and self._plan.replace(now_ns, *trajectory)


def _read_input() -> bytes | None:
    """Return all that has arrived: one pipe's buffer may hold less than one trajectory."""
    parts = []
    with contextlib.suppress(BlockingIOError):
        while part := os.read(0, READ_BYTES):
            parts.append(part)
        return b''.join(parts) or None
    return b''.join(parts)


def _write_output(data: bytes) -> None:
    # Nobody reads: a state less, the next one comes in a millisecond.
    with contextlib.suppress(BlockingIOError, BrokenPipeError):
        os.write(1, data)


def main() -> int:
    """Drive the arm at the address given until standard input ends."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('address', help='of the Franka control unit')
    parser.add_argument('--realtime', action='store_true', help='refuse to run without PREEMPT_RT')
    arguments = parser.parse_args()
    os.set_blocking(0, False)
    os.set_blocking(1, False)
    try:
        import pylibfranka as franka
    except ImportError as error:
        print(f'pylibfranka is missing ({error}): pip install pylibfranka', file=sys.stderr)
        return FAULT_STATUS
    faults = tuple(getattr(franka, n) for n in dir(franka) if n.endswith('Exception'))
    gc.disable()
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    try:
        config = franka.RealtimeConfig
        checked = config.kEnforce if arguments.realtime else config.kIgnore
        robot = franka.Robot(arguments.address, checked)
        # They reach every process of a terminal or service, and would cut a motion off. The process
        # that sends trajectories asks for the end, or standard input ends with it.
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        control = robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
        ControlLoop(control, franka.JointPositions, _read_input, _write_output).run()
        robot.stop()
    except faults as error:
        print(f'{error}', file=sys.stderr)
        return FAULT_STATUS
    return 0


if __name__ == '__main__':
    sys.exit(main())
