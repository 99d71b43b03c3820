# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The controller on arrays, without ROS: enabling, advancing, and every way to stop."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.controller import SlipController
from mixtac_slip_control.errors import ArmError, SlipControlError
from mixtac_slip_control.safety import HEARTBEAT, InterlockState

from .slip_windows import FakePlanner, parameters, window

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_slip_control.controller import SlipStep
    from mixtac_slip_control.parameters import SlipControlParameters

READY = (0.0, -0.8, 0.0, -2.3, 0.0, 1.6, 0.8)
T0 = 1_700_000_000.0


def chosen(**changes: float) -> SlipControlParameters:
    """By counts, learned in 100 windows, without a probe."""
    values = {'learning_time': 0.1, 'settle_time': 0.005, 'probe_advance': 0.0}
    return parameters(detector='count', **{**values, **changes})


class Rig:
    """A controller by counts, and time that goes on a millisecond per step."""

    def __init__(self, **changes: float) -> None:
        self.planner = FakePlanner()
        self.controller = SlipController(chosen(**changes), self.planner, (0.0, 0.0, -1.0))
        self.ms = 0
        self.rng = np.random.default_rng(0)
        self.force, self.pull = 0.5, 0.0

    @property
    def now(self) -> float:
        return T0 + 1e-3 * self.ms

    def gap(self, packets: int) -> None:
        """Lose packets, and go on with the one after them."""
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
        events = Events(t.astype(np.int64), place, place, np.ones(number, np.bool_))
        if inputs:
            force = self.force, 1000 * self.ms, self.now
            self.controller.on_force(*force, pull_n=self.pull)
            self.controller.on_joint_state(READY, self.now)
            self.controller.on_heartbeat(self.now)
        return self.controller.on_events(events, start + 1000, self.now, lost=lost)[-1]

    def steps(self, number: int) -> None:
        """Go on for so many steps."""
        for _ in range(number):
            self.step()

    def learned(self) -> Rig:
        self.steps(120)
        return self

    def enabled(self) -> Rig:
        self.learned().controller.enable(self.now)
        return self


def test_it_starts_disabled_and_nothing_is_planned() -> None:
    rig = Rig()
    for _ in range(120):
        step = rig.step()
    assert not step.enabled
    assert rig.step(800).slipping
    assert rig.controller.total_advance == 0.0
    assert rig.controller.plan(rig.now) is None
    assert rig.planner.targets == []


def test_slip_advances_by_the_law_and_is_planned_at_once() -> None:
    rig = Rig().enabled()
    assert rig.planner.resets == [(READY, (0.0, 0.0, -1.0))]
    step = rig.step(800)
    wanted = 0.7 / 1e7 * (800 - step.threshold)
    limit = rig.controller.advance_limit
    assert step.advance == pytest.approx(min(wanted, limit))
    assert rig.controller.plan(rig.now) == (rig.now, step.total_advance)


def test_it_cannot_be_enabled_unlearned_while_slipping_or_without_an_arm() -> None:
    rig = Rig()
    rig.step()
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    rig.steps(120)
    rig.step(800)
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    with pytest.raises(SlipControlError):
        SlipController(chosen()).enable(T0)


def test_it_cannot_be_enabled_without_a_heartbeat() -> None:
    rig = Rig()
    rig.steps(120)
    for _ in range(10):
        rig.ms += 100
        rig.controller.on_force(0.5, 1000 * rig.ms, rig.now)
        rig.controller.on_joint_state(READY, rig.now)
        rig.controller.watch.on_window(window(0), rig.now)
    with pytest.raises(SlipControlError, match=HEARTBEAT):
        rig.controller.enable(rig.now)
    assert rig.planner.resets == []


def test_the_first_advance_is_capped_as_for_the_stiffest_contact() -> None:
    rig = Rig()
    rig.force = 0.9
    rig.enabled()
    room = 0.9 * 1.5 - 0.9
    assert 0.5 * room / 2e4 < rig.controller.advance_limit < room / 2e4
    for _ in range(50):
        step = rig.step(5000)
    assert step.total_advance <= room / 2e4


def test_near_the_force_ceiling_it_stays_where_the_arm_is() -> None:
    rig = Rig().enabled()
    assert rig.step(800).total_advance > 1e-5
    rig.force = 1.45
    rig.planner.velocity = 4e-6 / rig.now
    step = rig.step(800)
    assert step.advance < 0.0
    assert step.total_advance == pytest.approx(4e-6)
    assert rig.step(800).total_advance == pytest.approx(4e-6)
    assert rig.controller.enabled


def test_a_force_near_the_ceiling_cannot_be_enabled() -> None:
    rig = Rig()
    rig.force = 1.4
    rig.steps(120)
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    assert not rig.controller.enabled


def test_enabling_probes_the_stiffness_and_slip_ends_the_probe() -> None:
    rig = Rig(probe_advance=1e-5, probe_speed=1e-3).enabled()
    places = [rig.step().total_advance for _ in range(15)]
    assert rig.controller.probing
    assert max(places) == pytest.approx(1e-5)
    before = places[-1]
    step = rig.step(800)
    assert not rig.controller.probing
    assert step.total_advance > before
    assert rig.step().total_advance == pytest.approx(step.total_advance)


@pytest.mark.parametrize('pull', [0.0, 0.4])
def test_the_probe_returns_unless_the_margin_needs_its_press(pull: float) -> None:
    rig = Rig(probe_advance=1e-5, probe_speed=1e-3)
    rig.pull = pull
    rig.enabled()
    places = [rig.step().total_advance for _ in range(200)]
    assert not rig.controller.probing
    if pull:
        assert min(places[20:]) == pytest.approx(1e-5)
        assert places[-1] > 1e-5  # and the force is raised at once
    else:
        assert max(places) == pytest.approx(1e-5)
        assert places[-1] == 0.0


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
    assert rig.controller.total_advance == 0.0


def test_a_force_that_is_not_valid_stops_and_cannot_be_enabled_on() -> None:
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


@pytest.mark.parametrize('deviation', [math.inf, math.nan])
def test_a_deviation_that_is_no_number_stops_and_leaves_the_bounds_alone(deviation: float) -> None:
    rig = Rig().enabled()
    before = rig.controller.advance_limit
    rig.controller.on_force(0.5, 1000 * rig.ms + 1, rig.now, deviation=deviation)
    assert rig.controller.interlock.state is InterlockState.STOPPED
    rig.step()
    rig.controller.reset(rig.now)
    rig.controller.enable(rig.now)
    rig.step()
    assert rig.controller.advance_limit == pytest.approx(before, rel=0.1)
    rig.controller.on_force(3.0, 1000 * rig.ms + 1, rig.now, deviation=0.05)
    assert 'above max_force' in rig.controller.interlock.reason


def test_a_force_that_is_not_valid_teaches_nothing() -> None:
    rig = Rig()
    rig.pull = 0.2
    rig.steps(1000)
    before = rig.controller.grip.wanted(0.0)
    rig.controller.on_quality('stale', rig.now)
    rig.force, rig.pull = 0.1, 0.3
    rig.steps(300)
    assert rig.controller.grip.wanted(0.0) == before
    assert rig.controller.grip.normal == pytest.approx(0.5)


def test_changed_wishes_reach_the_grip() -> None:
    rig = Rig()
    rig.pull = 0.3
    rig.steps(1000)
    before = rig.controller.grip.wanted(0.0)
    rig.controller.configure(chosen(grip_margin=2.0, max_grip_force=5.0, max_force=6.0))
    assert rig.controller.grip.wanted(0.0) == pytest.approx(before * 2.0 / 1.3)


def test_it_waits_a_moment_after_a_slip_before_it_is_enabled() -> None:
    rig = Rig().learned()
    assert rig.step(800).slipping
    rig.steps(100)
    with pytest.raises(SlipControlError):
        rig.controller.enable(rig.now)
    rig.steps(150)
    rig.controller.enable(rig.now)
    assert rig.controller.enabled


def test_a_slip_before_the_clock_started_anew_holds_nothing_up() -> None:
    rig = Rig()
    rig.ms = 10_000
    rig.learned()
    assert rig.step(800).slipping
    rig.ms = 0
    rig.force, rig.pull = 0.9, 0.5
    rig.steps(1000)
    assert rig.controller.grip.normal == pytest.approx(0.9, abs=0.01)
    assert rig.controller.reason(rig.now) == ''


def test_a_stop_is_not_reset_while_its_cause_lasts() -> None:
    rig = Rig().enabled()
    rig.controller.on_force(2.0, 1000 * rig.ms + 1, rig.now)
    with pytest.raises(SlipControlError):
        rig.controller.reset(rig.now)


def test_saturation_does_not_advance_before_it_stops() -> None:
    rig = Rig().enabled()
    assert rig.step(9000).advance == 0.0
    assert rig.step(900).advance > 0.0
    assert [rig.step(9000).advance for _ in range(2)] == [0.0, 0.0]
    assert not rig.controller.enabled


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
    assert steps[-1].advance > 0.0


def test_disabling_ends_the_motion() -> None:
    rig = Rig().enabled()
    rig.step(800)
    rig.controller.disable()
    assert rig.controller.plan(rig.now) is None
    assert rig.controller.braking(rig.now) == (rig.now, 'stop')
    assert rig.controller.interlock.state is InterlockState.DISABLED


def test_the_threshold_rises_with_the_arms_own_motion_and_the_background_waits() -> None:
    rig = Rig().enabled()
    before = rig.step().threshold
    rig.planner.velocity = 0.01
    step = rig.step()
    assert step.threshold == pytest.approx(before + 2.5e7 * 1e-5, rel=0.05)
    assert not rig.step(int(before) + 200).slipping


def test_taring_needs_it_disabled_and_learns_anew() -> None:
    rig = Rig().enabled()
    with pytest.raises(SlipControlError):
        rig.controller.tare()
    rig.controller.disable()
    rig.controller.tare()
    assert not rig.controller.detectors.learned


def test_the_normal_may_follow_from_the_joints() -> None:
    rig = Rig()
    rig.controller = SlipController(chosen(), rig.planner, lambda q: np.array([q[1], 0.0, 1.0]))
    rig.enabled()
    assert rig.planner.resets[0][1] == (-0.8, 0.0, 1.0)


def test_inputs_that_waited_for_the_enabling_do_not_stop() -> None:
    rig = Rig().enabled()
    planned_s = 0.045
    rig.controller.on_joint_state(READY, rig.now + planned_s)
    for _ in range(100):
        end_us = 1000 * (rig.ms + 1)
        place = np.zeros(30, np.uint16)
        t = end_us - 1000 + 30 * np.arange(30, dtype=np.int64)
        events = Events(t, place, place, np.ones(30, np.bool_))
        rig.ms += 1
        # A packet takes half a millisecond until all that waited are done.
        late_s = max(planned_s - 5e-4 * (rig.ms - 120), 0.0)
        rig.controller.on_events(events, end_us, rig.now + late_s)
        rig.controller.on_force(0.5, end_us, rig.now + late_s)
        rig.controller.on_joint_state(READY, rig.now + late_s)
        rig.controller.on_heartbeat(rig.now + late_s)
        assert rig.controller.enabled, rig.controller.interlock.reason


def test_whatever_fails_while_it_is_enabled_leaves_it_disabled() -> None:
    rig = Rig()
    normals = iter([np.array([0.0, 0.0, 1.0])])
    rig.controller = SlipController(chosen(), rig.planner, lambda _q: next(normals))
    rig.enabled()
    rig.controller.disable()
    with pytest.raises(StopIteration):
        rig.controller.enable(rig.now)
    assert rig.controller.interlock.state is InterlockState.DISABLED
    assert not rig.step(800).enabled


def test_it_starts_from_commanded_positions_where_they_are_known() -> None:
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


def test_a_planner_that_cannot_brake_leaves_the_last_trajectory_to_end() -> None:
    rig = Rig().enabled()
    rig.controller.disable()
    rig.planner.error = ArmError('time ran back')
    assert rig.controller.braking(rig.now) is None


def test_a_clock_that_is_set_back_stops_and_brakes() -> None:
    """12 ms, less than any age allows: the planner notices, and must end the motion still."""
    rig = Rig()
    planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3())
    rig.controller = SlipController(chosen(), planner, (0.0, 1.0, 0.0))
    rig.enabled()
    for _ in range(12):
        rig.step(800)
        rig.controller.plan(rig.now)
    assert planner.moving(rig.now)
    back = rig.now - 0.012
    assert rig.controller.plan(back) is None
    assert rig.controller.interlock.state is InterlockState.STOPPED
    before = planner.advance_at(back + 0.006)
    braking = rig.controller.braking(back)
    assert braking is not None
    assert not braking.dq[-1].any()
    # It continues what the arm does by the clock as it is now.
    assert planner.advance_at(back + 0.006) == before
    assert planner.target < rig.controller.total_advance


def test_a_reset_needs_a_stop_or_nothing_to_do() -> None:
    rig = Rig().enabled()
    with pytest.raises(SlipControlError):
        rig.controller.reset(rig.now)
    assert rig.controller.enabled
    rig.controller.disable()
    rig.controller.reset(rig.now)
    assert rig.controller.interlock.state is InterlockState.DISABLED


def test_only_gains_change_while_it_is_enabled() -> None:
    rig = Rig().enabled()
    rig.controller.configure(chosen(gain=0.1, hold_time=1.0))
    for change in ({'max_total': 1e-4}, {'slow_time': 0.01}, {'max_force': 50.0}):
        with pytest.raises(SlipControlError):
            rig.controller.configure(chosen(**change))
    rig.controller.disable()
    rig.controller.configure(chosen(max_total=1e-4))


def moving_rig(**changes: float) -> Rig:
    """Return a rig with the FR3's planner that has advanced."""
    rig = Rig(**changes)
    planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3())
    rig.controller = SlipController(chosen(**changes), planner, (0.0, 1.0, 0.0))
    return rig.enabled()


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


def test_an_arm_that_does_not_follow_stops() -> None:
    rig = moving_rig(stiffest_contact=500.0)
    for _ in range(60):
        rig.step(800)
        rig.controller.plan(rig.now)
    assert rig.controller.interlock.state is InterlockState.STOPPED
    assert 'does not follow' in rig.controller.interlock.reason


def test_the_reason_of_a_state_is_that_of_its_stop_or_why_it_cannot_be_enabled() -> None:
    rig = Rig()
    assert 'learned' in rig.step().reason
    rig.enabled()
    assert rig.step().reason == ''
    rig.controller.on_force(1.7, 1000 * rig.ms + 1, rig.now)
    assert 'max_force' in rig.step().reason
    assert SlipController(chosen()).reason(rig.now)


def test_without_frames_the_flow_detector_is_not_enabled_and_stops() -> None:
    rig = Rig()
    rig.controller = SlipController(chosen(), rig.planner, (0.0, 0.0, -1.0))
    rig.learned()
    # The count needs none; the flow detector does.
    rig.controller.configure(dataclasses.replace(chosen(), detector='flow'))
    assert 'frames' in str(rig.controller.fault(rig.now))


def test_a_clock_that_goes_back_at_all_stops() -> None:
    rig = Rig().enabled()
    rig.controller.tick(rig.now - 1e-4)
    assert rig.controller.interlock.state is InterlockState.STOPPED
    rig.controller.reset(rig.now)
    rig.step()
    rig.controller.enable(rig.now)
    rig.step()
    assert rig.controller.enabled


def test_nothing_moves_before_the_arm_was_seen_where_the_plan_begins() -> None:
    rig = moving_rig()
    rig.controller.disable()
    rig.step()
    rig.controller.enable(rig.now, settling_s=0.01)
    rig.steps(9)
    for _ in range(5):
        # The joint states of after the settling are lost.
        rig.controller.on_heartbeat(rig.now)
        assert rig.step(800, inputs=False).advance == 0.0
    assert rig.step(800).advance > 0.0
