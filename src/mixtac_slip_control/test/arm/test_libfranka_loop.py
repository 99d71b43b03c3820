# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The control loop against a fake robot that extrapolates lost cycles as Franka documents it."""

import os
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from mixtac_sim.arm.fr3 import READY
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.libfranka_loop import (
    STATE,
    STOP,
    ControlLoop,
    Receiver,
    TrajectorySplice,
    pack,
)
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner, StreamSettings

ARM, LIMITS = SerialArm.fr3(), JointLimits.fr3()
X = np.array([1.0, 0.0, 0.0])
EPOCH_NS = 1_700_000_000_000_000_000


class FakeRobot:
    """Takes a command a millisecond; in lost cycles it goes on with constant acceleration."""

    def __init__(self, lost):
        self.q = [READY.copy()] * 4
        self.cycle = 0
        self._lost = set(lost)
        self._missed = 1

    @property
    def now_ns(self):
        return EPOCH_NS + self.cycle * 1_000_000

    def readOnce(self):  # noqa: N802
        while self.cycle in self._lost:
            a = (self.q[-1] - 2 * self.q[-2] + self.q[-3]) / 1e-6
            v = (self.q[-1] - self.q[-2]) / 1e-3 + 1e-3 * a
            self.q.append(self.q[-1] + v * 1e-3)
            self.cycle += 1
            self._missed += 1
        period, self._missed = self._missed * 1e-3, 1
        dq = (self.q[-1] - self.q[-2]) / 1e-3
        ddq = (self.q[-1] - 2 * self.q[-2] + self.q[-3]) / 1e-6
        state = SimpleNamespace(q=self.q[-1], dq=dq, q_d=self.q[-1], dq_d=dq, ddq_d=ddq)
        return state, SimpleNamespace(to_sec=lambda: period)

    def writeOnce(self, command):  # noqa: N802
        self.q.append(np.array(command.q))
        self.cycle += 1


def command(q):
    return SimpleNamespace(q=q, motion_finished=False)


def drive(lost=(), cycles=400, advances=None):
    """Run the loop; every 4 ms another advance is asked for."""
    robot = FakeRobot(lost)
    planner = AdvancePlanner(ARM, LIMITS, StreamSettings(lead_s=0.012))
    planner.reset(READY, X)
    rng = np.random.default_rng(3)
    states = []

    def read():
        if robot.cycle >= cycles:
            return STOP
        if robot.cycle % 4 or robot.cycle > 150:
            return b''
        advance = float(rng.uniform(0, 2e-3)) if advances is None else advances(robot.cycle)
        trajectory = planner.plan(robot.now_ns * 1e-9, advance, X)
        return b'' if trajectory is None else pack(trajectory)

    loop = ControlLoop(robot, command, read, states.append, lambda: robot.now_ns)
    loop.run()
    return robot, planner, [STATE.unpack(state) for state in states]


def rates(robot):
    q = np.array(robot.q)
    return [np.abs(np.diff(q, n, axis=0)).max() / 1e-3**n for n in (2, 3)]


def test_the_stream_is_followed_within_the_limits_to_its_end():
    robot, planner, states = drive()
    acceleration, jerk = rates(robot)
    assert 5.0 < acceleration <= 10.0
    assert jerk <= 5000.0 * (1 + 1e-6)
    assert np.allclose(robot.q[-1], planner.path.derivatives(planner.target)[0], atol=1e-9)
    assert states[-1][1] == 0


@pytest.mark.parametrize('lost', [range(60, 63), range(100, 112), [*range(40, 44), *range(50, 58)]])
def test_after_lost_cycles_it_returns_to_the_trajectory_without_a_step(lost):
    robot, planner, _ = drive(lost)
    acceleration, jerk = rates(robot)
    assert acceleration <= 10.0
    assert jerk <= 5000.0
    assert np.allclose(robot.q[-1], planner.path.derivatives(planner.target)[0], atol=1e-9)


def test_a_trajectory_that_comes_too_late_is_not_followed():
    splice = TrajectorySplice(READY)
    planner = AdvancePlanner(ARM, LIMITS)
    planner.reset(READY, X)
    receiver = Receiver()
    wire = receiver.push(pack(planner.plan(EPOCH_NS * 1e-9, 1e-3, X)))
    assert not splice.replace(EPOCH_NS + 15_000_000, *wire)
    assert splice.late == 1
    assert splice.still(EPOCH_NS, EPOCH_NS + 40_000_000)
    assert splice.replace(EPOCH_NS + 3_000_000, *wire)
    assert splice.still(EPOCH_NS, EPOCH_NS + 5_000_000)
    # At rest before and after, with the whole motion in between.
    assert not splice.still(EPOCH_NS, EPOCH_NS + 1_000_000_000)


def test_bytes_are_cut_into_trajectories_wherever_they_are_split():
    planner = AdvancePlanner(ARM, LIMITS)
    planner.reset(READY, X)
    trajectory = planner.plan(EPOCH_NS * 1e-9, 1e-4, X)
    data, receiver = pack(trajectory), Receiver()
    assert all(receiver.push(data[k : k + 1]) is None for k in range(len(data) - 1))
    times_ns, states = receiver.push(data[-1:])
    assert (states[:, 1] == trajectory.dq).all()
    assert times_ns[0] == trajectory.stamp_ns + round(trajectory.times_s[0] * 1e9)
    assert not receiver.stopped
    assert receiver.push(STOP) is None
    assert receiver.stopped


# What the loop uses of pylibfranka, for an arm that stands where it is commanded.
LIBRARY = """
import time
from types import SimpleNamespace

RealtimeConfig = ControllerMode = SimpleNamespace(kEnforce=1, kIgnore=0, JointImpedance=0)

def JointPositions(q):
    return SimpleNamespace(q=q, motion_finished=False)

class Robot:
    def __init__(self, address, checked):
        self.q = [0.0] * 7

    def start_joint_position_control(self, mode):
        return self

    def readOnce(self):
        time.sleep(1e-3)
        rest = [0.0] * 7
        state = SimpleNamespace(q=self.q, dq=rest, q_d=self.q, dq_d=rest, ddq_d=rest)
        return state, SimpleNamespace(to_sec=lambda: 1e-3)

    def writeOnce(self, command):
        self.q = command.q

    def stop(self):
        pass
"""


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_all_processes_of_a_terminal_cuts_no_motion_off(tmp_path, number):
    (tmp_path / 'pylibfranka.py').write_text(LIBRARY)
    path = os.pathsep.join([str(tmp_path), os.environ.get('PYTHONPATH', '')])
    loop = subprocess.Popen(
        [sys.executable, '-m', 'mixtac_slip_control.arm.libfranka_loop', 'somewhere'],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, 'PYTHONPATH': path},
    )
    with loop:
        loop.stdout.read(STATE.size)
        loop.send_signal(number)
        before_ns = STATE.unpack(loop.stdout.read(STATE.size))[0]
        while STATE.unpack(loop.stdout.read(STATE.size))[0] < before_ns + 100_000_000:
            pass
        loop.stdin.write(STOP)
        loop.stdin.flush()
        loop.stdout.read()
    assert loop.returncode == 0
