# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The controller on arrays, without ROS: enabling, advancing, and every way to stop."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.controller import SlipController
from mixtac_slip_control.errors import ArmError, SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters
from mixtac_slip_control.safety import InterlockState

from .slip_windows import FakePlanner

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_slip_control.controller import SlipStep

READY = (0.0, -0.8, 0.0, -2.3, 0.0, 1.6, 0.8)
T0 = 1_700_000_000.0
LEARNING = 1020


def chosen(**changes: object) -> SlipControlParameters:
    """By counts, which need no frames."""
    return SlipControlParameters(**{'law': 'paper', **changes})


class Rig:
    """A controller by counts, and time that goes on a millisecond per step."""

    def __init__(self, **changes: object) -> None:
        self.planner = FakePlanner()
        self.controller = SlipController(chosen(**changes), self.planner, (0.0, 0.0, -1.0))
        self.ms = 0
        self.rng = np.random.default_rng(0)
        self.force = 0.5

    @property
    def now(self) -> float:
        return T0 + 1e-3 * self.ms

    def gap(self, packets: int) -> None:
        """Lose packets, and continue with the next one."""
        self.ms += packets
        self.step(lost=True)

    def step(
        self, count: int | None = None, *, inputs: bool = True, lost: bool = False
    ) -> SlipStep:
        number = int(self.rng.poisson(30)) if count is None else count
        start = 1000 * self.ms
        self.ms += 1
        place = np.zeros(number, np.uint16)
        t = start + np.arange(number) * 1000 // max(number, 1)
        events = Events(t.astype(np.int64), place, place, np.arange(number) % 2 == 0)
        if inputs:
            self.controller.on_force(self.force, 1000 * self.ms, self.now)
            self.controller.on_joint_state(READY, self.now)
            self.controller.on_heartbeat(self.now)
        return self.controller.on_events(events, start + 1000, self.now, lost=lost)[-1]

    def steps(self, number: int) -> None:
        for _ in range(number):
            self.step()

    def learned(self) -> Rig:
        self.steps(LEARNING)
        return self

    def enabled(self) -> Rig:
        self.learned().controller.enable(self.now)
        return self


def test_it_starts_disabled_and_nothing_is_planned() -> None:
    rig = Rig().learned()
    assert not rig.step().enabled
    assert rig.step(800).slipping
    assert rig.controller.law.total == 0.0
    assert rig.controller.plan(rig.now) is None
    assert rig.planner.targets == []


def test_slip_advances_by_the_law_and_is_planned_at_once() -> None:
    rig = Rig(gain=2e-8).enabled()
    assert rig.planner.resets == [(READY, (0.0, 0.0, -1.0))]
    step = rig.step(800)
    assert step.advance == pytest.approx(2e-8 * (800 - step.threshold))
    assert rig.controller.plan(rig.now) == (rig.now, step.total_advance)


def test_the_law_of_steps_presses_after_enabling() -> None:
    rig = Rig()
    parameters = SlipControlParameters(law='step')
    rig.controller = SlipController(parameters, rig.planner, (0.0, 0.0, -1.0))
    image = np.kron(rig.rng.integers(50, 250, (65, 87)), np.ones((4, 4))).astype(np.uint8)
    for k in range(LEARNING):
        if k % 40 == 0:
            rig.controller.on_frame(image, 1000 * rig.ms, rig.now)
        rig.step()
    rig.controller.enable(rig.now)
    step = rig.step()
    assert step.total_advance > 0.0
    assert step.wanted_force == pytest.approx(1.3 * 0.5, rel=0.01)


def test_it_cannot_be_enabled_unlearned_while_slipping_or_without_an_arm() -> None:
    rig = Rig()
    rig.step()
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    rig.learned().step(800)
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    with pytest.raises(SlipControlError):
        SlipController(chosen()).enable(T0)


def test_it_cannot_be_enabled_on_a_controller_with_unsafe_parameters() -> None:
    rig = Rig().learned()
    rig.controller.unsafe = 'the controller has allow_trajectory_replacement true'
    with pytest.raises(SlipControlError, match='allow_trajectory_replacement'):
        rig.controller.enable(rig.now)
    assert 'allow_trajectory_replacement' in rig.step().reason
    rig.controller.unsafe = ''
    rig.controller.enable(rig.now)


STOPS: dict[str, Callable[[Rig], object]] = {
    'force is nan': lambda r: r.controller.on_force(math.nan, 1000 * r.ms + 1, r.now),
    'above max_force': lambda r: r.controller.on_force(1.7, 1000 * r.ms + 1, r.now),
    'joint positions are': lambda r: r.controller.on_joint_state((math.nan,) * 7, r.now),
    'saturated': lambda r: [r.step(9000) for _ in range(2)],
    'missing': lambda r: r.gap(6),
    'force 5': lambda r: [r.step(inputs=False) for _ in range(52)],
    'events': lambda r: [r.step(), r.controller.tick(r.now + 0.021)],
    'force and events': lambda r: r.controller.on_force(0.5, 1000 * r.ms - 200_000, r.now),
}


@pytest.mark.parametrize('reason', STOPS)
def test_each_fault_stops_for_good(reason: str) -> None:
    rig = Rig().enabled()
    STOPS[reason](rig)
    lock = rig.controller.interlock
    assert lock.state is InterlockState.STOPPED
    assert reason in lock.reason
    targets = len(rig.planner.targets)
    for _ in range(60):
        step = rig.step(500)
    assert step.advance == 0.0
    assert step.state == InterlockState.STOPPED
    assert rig.controller.plan(rig.now) is None
    assert len(rig.planner.targets) == targets
    rig.steps(240)
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    rig.controller.reset(rig.now)
    rig.controller.enable(rig.now)
    assert rig.controller.enabled
    assert rig.controller.law.total == 0.0


def test_a_force_that_is_not_valid_stops_and_prevents_enabling() -> None:
    rig = Rig().enabled()
    rig.controller.on_quality('zero unknown', rig.now)
    lock = rig.controller.interlock
    assert lock.state is InterlockState.STOPPED
    assert 'zero unknown' in lock.reason
    with pytest.raises(SlipControlError):
        rig.controller.reset(rig.now)
    rig.controller.on_quality('', rig.now)
    rig.controller.reset(rig.now)
    rig.controller.on_quality('stale', rig.now)
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    rig.controller.on_quality('', rig.now)
    rig.controller.enable(rig.now)
    assert rig.controller.enabled


def test_it_waits_a_moment_after_a_slip_before_it_is_enabled() -> None:
    rig = Rig().learned()
    assert rig.step(800).slipping
    rig.steps(100)
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    rig.steps(150)
    rig.controller.enable(rig.now)
    assert rig.controller.enabled


def test_a_planner_that_refuses_stops() -> None:
    rig = Rig().enabled()
    rig.step(800)
    rig.planner.error = ArmError('joint 4 would leave its range')
    assert rig.controller.plan(rig.now) is None
    assert rig.controller.interlock.reason == 'joint 4 would leave its range'


def test_slip_is_not_answered_while_the_arm_settles() -> None:
    rig = Rig().learned()
    rig.controller.enable(rig.now, settling_s=0.02)
    steps = [rig.step(800) for _ in range(25)]
    assert {s.advance for s in steps[:19]} == {0.0}
    assert steps[-1].total_advance > 0.0


def test_disabling_ends_the_motion() -> None:
    rig = Rig().enabled()
    rig.step(800)
    rig.controller.disable()
    assert rig.controller.plan(rig.now) is None
    assert rig.controller.braking(rig.now) == (rig.now, 'stop')
    assert rig.controller.interlock.state is InterlockState.DISABLED


def test_taring_needs_it_disabled_and_learns_anew() -> None:
    rig = Rig().enabled()
    with pytest.raises(SlipControlError):
        rig.controller.tare()
    rig.controller.disable()
    rig.controller.tare()
    assert not rig.controller.detectors.count.learned


def test_it_starts_from_commanded_positions_where_they_are_reported() -> None:
    rig = Rig(max_total=5e-4).learned()
    commanded = np.array(READY) + 1e-3
    rig.controller.enable(rig.now, commanded=commanded)
    assert rig.planner.resets[0][0] == tuple(commanded)
    assert rig.planner.max_advance == 5e-4
    rig.controller.disable()
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now, commanded=commanded + 0.2)
    assert not rig.controller.enabled


def test_enabling_waits_until_the_arm_rests() -> None:
    rig = Rig().enabled()
    rig.controller.disable()
    rig.planner.moves = True
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    rig.planner.moves = False
    rig.controller.enable(rig.now, settling_s=0.05)
    rig.controller.disable()
    rig.step()
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    rig.steps(60)
    rig.controller.enable(rig.now)


def moving_rig(**changes: object) -> Rig:
    """Return a rig with the FR3's planner."""
    rig = Rig(**changes)
    planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3())
    rig.controller = SlipController(chosen(**changes), planner, (0.0, 1.0, 0.0))
    rig.planner = planner
    return rig.enabled()


def test_a_clock_that_is_set_back_stops_and_brakes() -> None:
    """12 ms, less than any age allows: the motion still ends."""
    rig = moving_rig(gain=2e-9)
    for _ in range(12):
        rig.step(800)
        rig.controller.plan(rig.now)
    assert rig.planner.moving(rig.now)
    back = rig.now - 0.012
    assert rig.controller.plan(back) is None
    assert rig.controller.interlock.state is InterlockState.STOPPED
    before = rig.planner.advance_at(back + 0.006)
    braking = rig.controller.braking(back)
    assert braking is not None
    assert not braking.dq[-1].any()
    # It continues the motion by the clock as it is now.
    assert rig.planner.advance_at(back + 0.006) == pytest.approx(before, abs=1e-12)
    assert rig.planner.target < rig.controller.law.total


def test_parameters_are_fixed_while_it_is_enabled() -> None:
    rig = Rig().enabled()
    with pytest.raises(SlipControlError):
        rig.controller.configure(chosen(max_force=50.0))
    rig.controller.disable()
    rig.controller.configure(chosen(max_force=50.0))


def test_an_arm_that_was_moved_by_others_stops_and_is_left_alone() -> None:
    rig = moving_rig()
    rig.step()
    rig.controller.on_joint_state((READY[0] + 0.2, *READY[1:]), rig.now)
    assert rig.controller.interlock.state is InterlockState.STOPPED
    # A braking trajectory would begin with a step back.
    assert rig.controller.braking(rig.now) is None
    rig.controller.reset(rig.now)
    rig.controller.enable(rig.now)
    assert rig.controller.enabled


def test_a_state_names_why_it_stopped_or_cannot_be_enabled() -> None:
    rig = Rig()
    assert 'learned' in rig.step().reason
    rig.enabled()
    assert rig.step().reason == ''
    rig.controller.on_force(1.7, 1000 * rig.ms + 1, rig.now)
    assert 'max_force' in rig.step().reason
    assert SlipController(chosen()).reason(rig.now)


def test_nothing_moves_before_the_arm_was_seen_where_the_plan_begins() -> None:
    rig = moving_rig()
    rig.controller.disable()
    rig.step()
    rig.controller.enable(rig.now, settling_s=0.01)
    rig.steps(9)
    for _ in range(5):
        # The joint states after the settling are lost.
        rig.controller.on_heartbeat(rig.now)
        assert rig.step(800, inputs=False).advance == 0.0
    assert rig.step(800).advance > 0.0
