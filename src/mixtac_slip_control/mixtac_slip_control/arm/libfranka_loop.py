# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The 1 kHz loop that drives a Franka arm through pylibfranka, in a process of its own.

Started by `LibfrankaBackend`. Trajectories come on standard input, states go to standard output,
both as in `libfranka_wire`; a fault ends the process with one line on standard error. pylibfranka
waits for the robot with the interpreter locked, which no other thread of a node would survive.

Commands are taken from the trajectory at the robot's own time, which moves on by the period that
the robot reports, so that they keep their distance in time however late this process wakes up. It
is set to the host's clock only while the arm rests, when that changes no command.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import sys
import time
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mixtac_slip_control.arm.gap_bridge import GapBridge
from mixtac_slip_control.arm.libfranka_wire import JOINTS, STATE, Receiver
from mixtac_slip_control.arm.trajectory_splice import TrajectorySplice

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import ModuleType

FAULT_STATUS = 3
FIFO_PRIORITY = 50
READ_BYTES = 1 << 16
CYCLE_NS = 1_000_000
LOST_NS = 1_500_000
"""Periods above this mean that the robot went on without a command of ours."""
ACCELERATION = 9.5
JERK = 4750.0
"""Of the way back to the trajectory then [rad/s2], [rad/s3]: libfranka's limits less a reserve."""


class _State(Protocol):
    q: Sequence[float]
    dq: Sequence[float]
    q_d: Sequence[float]
    dq_d: Sequence[float]
    ddq_d: Sequence[float]


class _Period(Protocol):
    def to_sec(self) -> float: ...


class _Command(Protocol):
    motion_finished: bool


class _Control(Protocol):
    def readOnce(self) -> tuple[_State, _Period]: ...  # noqa: N802

    def writeOnce(self, command: _Command) -> None: ...  # noqa: N802


class ControlLoop:
    """Follows the trajectories it is sent until it is told to stop.

    Args:
        control: Active joint position control.
        command: Makes a joint position command from seven positions [rad].
        read: Returns the bytes that have arrived; empty: none; None: nobody is left to send.
        write: Takes the bytes of a state, or drops them.
        clock_ns: The host's clock [ns].
    """

    def __init__(
        self,
        control: _Control,
        command: Callable[[list[float]], _Command],
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
        self._bridge = GapBridge(ACCELERATION, JERK)

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
        return trajectory is not None and self._plan.replace(
            now_ns, trajectory.times_ns, trajectory.states
        )


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


def _drive(franka: ModuleType, address: str, *, realtime: bool) -> None:
    config = franka.RealtimeConfig
    robot = franka.Robot(address, config.kEnforce if realtime else config.kIgnore)
    control = robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
    ControlLoop(control, franka.JointPositions, _read_input, _write_output).run()
    robot.stop()


def main() -> int:
    """Drive the arm at the address given until standard input ends."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('address', help='of the Franka control unit')
    parser.add_argument('--realtime', action='store_true', help='refuse to run without PREEMPT_RT')
    arguments = parser.parse_args()
    os.set_blocking(0, False)
    os.set_blocking(1, False)
    try:
        import pylibfranka
    except ImportError as error:
        print(f'pylibfranka is missing ({error}): pip install pylibfranka', file=sys.stderr)
        return FAULT_STATUS
    faults = tuple(getattr(pylibfranka, n) for n in dir(pylibfranka) if n.endswith('Exception'))
    gc.disable()
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    try:
        _drive(pylibfranka, arguments.address, realtime=arguments.realtime)
    except faults as error:
        print(f'{error}', file=sys.stderr)
        return FAULT_STATUS
    return 0


if __name__ == '__main__':
    sys.exit(main())
