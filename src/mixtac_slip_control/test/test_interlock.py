# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random enablings, slips and faults against an emulated controller: limits are kept, faults stop.

The whole slip controller drives an emulated joint_trajectory_controller in lock-step. Within the
contract no command may break a limit of the arm, and nothing may stop without a cause; a fault must
end in a latched stop, after which nothing but one braking trajectory is sent. A long search:

    MIXTAC_RUNS=10000 python -m pytest src/mixtac_slip_control/test/test_interlock.py
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_core.events.arrays import Events
from mixtac_sim.arm import READY, RULES, JointTrajectoryController, Trajectory, violations
from mixtac_slip_control.arm.following import MAX_SAG_RAD
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.model import make_arm
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.arm.trajectory import settling_trajectory
from mixtac_slip_control.controller import SlipController
from mixtac_slip_control.detectors import LEARNING_WINDOWS
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters
from mixtac_slip_control.safety import InterlockState

FAULTS = ('none', 'frozen', 'displaced', 'late', 'joints', 'heartbeat', 'clock', 'force', 'invalid')
ARM, LIMITS = SerialArm.fr3(), JointLimits.fr3()
START_S = 1000.0
RUNS = int(os.environ.get('MIXTAC_RUNS', '12'))
QUIET = 30
"""Events of a window at rest."""


class Cell:
    """An arm with its controller, a contact, and slip control, in steps of a millisecond."""

    def __init__(self, seed: int, rule: str, *, reports: bool) -> None:
        self.rng = rng = np.random.default_rng(seed)
        self.parameters = SlipControlParameters(
            arm='fr3', law='paper', max_force=30.0, gain=float(10.0 ** rng.uniform(-9.0, -7.0))
        )
        self.parts = make_arm(self.parameters)
        self.planner = AdvancePlanner(ARM, LIMITS, self.parameters.lead)
        self.slip = SlipController(self.parameters, self.planner, rng.normal(size=3).tolist())
        for _ in range(LEARNING_WINDOWS):
            self.slip.detectors.count.learn(QUIET)
        self.reports = reports
        self.arm = JointTrajectoryController(rule)
        self.phase_s = float(rng.random()) * 1e-3
        self.arm.reset(READY, START_S + self.phase_s)
        self.tip, self.sag = READY.copy(), rng.normal(0.0, 1e-3, 7).clip(-2e-3, 2e-3)
        self.keep = float(np.exp(-1e-3 / rng.uniform(5e-4, 5e-3)))
        self.transport_s = float(rng.uniform(0.0, 3.9e-3))
        self.under_way: list[tuple[float, Any]] = []
        self.commands: list[np.ndarray] = []
        self.sent: list[int] = []
        self.cycle, self.fault, self.moving, self.back_s = 0, 'none', False, 0.0
        self.offset = np.zeros(7)

    @property
    def now_s(self) -> float:
        return START_S + 1e-3 * self.cycle + 4e-4 - self.back_s

    def post(self, plan: Any) -> None:
        if plan is not None:
            late_s = 9e-3 if self.fault == 'late' else self.transport_s
            self.under_way.append((START_S + 1e-3 * self.cycle + 4e-4 + late_s, plan))
            self.sent.append(self.cycle)

    def step(self, *, slipping: bool = False) -> None:
        true_s = START_S + 1e-3 * self.cycle
        for arrival_s, t in [each for each in self.under_way if each[0] <= true_s]:
            self.arm.accept(Trajectory(t.stamp_s, t.times_s, t.q, t.dq, t.ddq), arrival_s)
        self.under_way = [each for each in self.under_way if each[0] > true_s]
        command = self.arm.sample(true_s)[0]
        self.commands.append(command)
        if self.fault != 'frozen':
            self.tip = command + self.keep * (self.tip - command)
        self.cycle += 1
        self.inputs(command)
        number = int(self.rng.integers(400, 3000)) if slipping else QUIET
        place = np.zeros(number, np.uint16)
        t = 1000 * (self.cycle - 1) + np.arange(number) * 1000 // number
        events = Events(t.astype(np.int64), place, place, np.arange(number) % 2 == 0)
        self.slip.on_events(events, 1000 * self.cycle, self.now_s)
        self.post(self.slip.plan(self.now_s))
        if self.moving and not self.slip.enabled:
            self.moving = False
            self.post(self.slip.braking(self.now_s))

    def inputs(self, command: np.ndarray) -> None:
        slip, now_s = self.slip, self.now_s
        if self.fault != 'heartbeat':
            slip.on_heartbeat(now_s)
        if self.fault != 'joints':
            slip.on_joint_state((self.tip + self.sag + self.offset).tolist(), now_s)
        if self.reports:
            # The stamp is the time of the cycle, which may be the one before.
            cycle_s = START_S + self.phase_s + 1e-3 * (self.cycle - 2) - self.back_s
            slip.on_commanded(command.tolist(), cycle_s, now_s)
        if self.fault != 'force':
            slip.on_force(1.0 + self.rng.normal(0.0, 0.02), 1000 * self.cycle, now_s)
        if self.fault == 'invalid':
            slip.on_quality('stale', now_s)

    def play(self, cycles: int, slips: float = 0.0) -> None:
        left = 0
        for _ in range(cycles):
            if left == 0 and self.rng.random() < slips:
                left = int(self.rng.integers(1, 40))
            self.step(slipping=left > 0)
            left = max(left - 1, 0)

    def enable(self) -> None:
        """Ask at random moments, until it is allowed."""
        for _ in range(400):
            following = self.slip.following
            commanded = None if following is None else following.commanded(self.now_s)
            assert self.parts is not None
            wait_s = self.parts.settling_s(MAX_SAG_RAD, 0.95) + self.parameters.lead
            settling_s = 0.0 if commanded is not None else wait_s
            try:
                self.slip.enable(self.now_s, commanded=commanded, settling_s=settling_s)
            except SlipControlError:
                self.play(int(self.rng.integers(1, 8)))
                continue
            if commanded is None:
                start = self.planner.start
                self.post(settling_trajectory(ARM, start, self.now_s, settling_s))
            self.moving = True
            return
        raise AssertionError(self.slip.reason(self.now_s))

    def begin(self, fault: str) -> None:
        self.fault = fault
        if fault == 'displaced':
            self.offset = self.rng.choice([-1.0, 1.0], 7) * 0.05
        elif fault == 'clock':
            self.back_s = float(10.0 ** self.rng.uniform(-2.0, 0.0))


@settings(max_examples=RUNS)
@given(
    seed=st.integers(0, 2**31),
    fault=st.sampled_from(FAULTS),
    rule=st.sampled_from(list(RULES)),
    reports=st.booleans(),
)
def test_limits_are_kept_and_faults_stop(seed: int, fault: str, rule: str, reports: bool) -> None:
    cell = Cell(seed, rule, reports=reports)
    cell.play(int(cell.rng.integers(10, 30)))
    cell.enable()
    cell.play(int(cell.rng.integers(70, 150)), slips=0.05)
    assert cell.slip.enabled, cell.slip.interlock.reason
    cell.slip.disable()
    cell.play(int(cell.rng.integers(1, 60)))
    cell.enable()
    cell.play(int(cell.rng.integers(70, 150)), slips=0.05)
    assert violations(np.stack(cell.commands), 1e-3) == 0
    if fault == 'none':
        return
    cell.begin(fault)
    lock = cell.slip.interlock
    for _ in range(60):
        if lock.state is not InterlockState.STOPPED:
            cell.play(10, slips=0.2)
    if lock.state is not InterlockState.STOPPED:
        # A late or frozen arm shows only where the plan has left it behind.
        assert fault in {'late', 'frozen'}
        return
    before = len(cell.sent)
    cell.play(100, slips=0.2)
    assert len(cell.sent) == before
    assert lock.state is InterlockState.STOPPED
    cell.fault = 'none'
    cell.play(20)
    try:
        cell.slip.enable(cell.now_s)
    except SlipControlError:
        return
    raise AssertionError('a stop must be reset before it can be enabled')
