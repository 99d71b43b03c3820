# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Following and transport, on an emulated controller and an arm that lags."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_sim.arm import READY, JointTrajectoryController, LaggingArm, Trajectory
from mixtac_slip_control.arm.following import FollowingWatch
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.errors import ArmError
from mixtac_slip_control.parameters import SlipControlParameters

SIDEWAYS = np.array([0.0, 1.0, 0.0])
START_S = 100.0


class Chain:
    """Planner, controller and arm in steps of a millisecond; plans arrive late by `transport_s`."""

    def __init__(
        self, *, transport_s: float = 2e-3, lag_s: float = 3.5e-3, **changes: float
    ) -> None:
        p = SlipControlParameters(**changes)
        self.planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3(), p.lead)
        self.planner.reset(READY, SIDEWAYS, 1e-3)
        self.watch = FollowingWatch(p, self.planner)
        self.controller = JointTrajectoryController()
        self.controller.reset(READY, START_S)
        self.arm = LaggingArm(READY, SIDEWAYS, lag_s)
        self.transport_s, self.cycle = transport_s, 0
        self.under_way: list[tuple[float, Trajectory]] = []
        self.sag = 1e-3

    @property
    def now_s(self) -> float:
        return START_S + 1e-3 * self.cycle

    @property
    def measured(self) -> np.ndarray:
        return self.arm.q + self.sag

    def step(self, target_m: float, *, frozen: bool = False) -> None:
        while self.under_way and self.under_way[0][0] <= self.now_s:
            arrival_s, trajectory = self.under_way.pop(0)
            assert self.controller.accept(trajectory, arrival_s) is None
        command = self.controller.sample(self.now_s)[0]
        if not frozen:
            self.arm.track(command)
        self.watch.on_measured(self.measured, self.now_s)
        self.watch.on_commanded(command, self.now_s)
        plan = self.planner.plan(self.now_s + 2e-4, target_m)
        if plan is not None:
            t = Trajectory(plan.stamp_s, plan.times_s, plan.q, plan.dq, plan.ddq)
            self.under_way.append((self.now_s + 2e-4 + self.transport_s, t))
        self.cycle += 1

    def knock(self, **how: bool) -> str:
        """Rest, advance by 0.9 mm in ever new plans, rest; return the fault."""
        for k in range(150):
            self.step(min(max(k - 30, 0) * 4.5e-5, 9e-4), **how)
        return self.watch.lost


@pytest.mark.parametrize('lag_s', [0.0, 4e-3])
def test_an_arm_that_follows_with_its_lag_and_sag_is_where_it_should_be(lag_s: float) -> None:
    chain = Chain(lag_s=lag_s)
    chain.watch.start(START_S + 0.01, chain.measured, None)
    assert chain.knock() == ''
    assert chain.planner.target == pytest.approx(9e-4)
    assert chain.watch.fault(chain.now_s) is None


def test_the_advance_at_the_time_of_a_force_is_the_measured_one() -> None:
    # An arm that lags by more than is usual, and sags.
    chain = Chain(lag_s=15e-3)
    chain.watch.start(START_S, chain.measured, READY)
    assert chain.watch.advance_at(chain.now_s, 4e-3) == (0.0, 0.0)
    slope, places = chain.planner.line.slope, []
    for k in range(60):
        chain.step(min(max(k - 30, 0) * 2e-5, 5e-4))
        places.append(float(slope @ (chain.arm.q - READY)) / float(slope @ slope))
    latest_s = START_S + 0.059
    for back in (0, 4, 10, 20):
        place, spread = chain.watch.advance_at(latest_s - 1e-3 * back, 4e-3)
        assert place == pytest.approx(places[-1 - back], abs=1e-9)
        assert spread == pytest.approx(0.5 * (places[-1 - back] - places[-5 - back]), abs=1e-9)
    # A time that is known less well leaves the place as open as the arm has moved in between.
    place, spread = chain.watch.advance_at(latest_s, 0.02)
    assert place == pytest.approx(places[-1], abs=1e-9)
    assert spread == pytest.approx(0.5 * (places[-1] - places[-21]), abs=1e-9)
    # The plan is far ahead of this arm.
    assert chain.planner.advance_at(latest_s) - places[-1] > 5e-5
    assert chain.watch.advance_at(latest_s + 3e-3, 4e-3)[0] == pytest.approx(places[-1], abs=1e-9)
    # Without fresh joint states the plan is all that is known.
    assert chain.watch.advance_at(latest_s + 1.0, 4e-3) == (chain.planner.target, 0.0)
    chain.watch.start(latest_s, chain.measured, READY)
    assert chain.watch.advance_at(latest_s, 4e-3) == (chain.planner.advance_at(latest_s), 0.0)


def test_a_frozen_arm_is_found_before_half_a_millimetre_was_commanded() -> None:
    chain = Chain()
    chain.watch.start(START_S, chain.measured, None)
    assert 'does not follow' in chain.knock(frozen=True)


@pytest.mark.parametrize('joint', range(7))
def test_a_displaced_arm_is_found(joint: int) -> None:
    chain = Chain()
    chain.watch.start(START_S, chain.measured, READY)
    chain.step(0.0)
    chain.watch.on_measured(chain.measured + 0.2 * np.eye(7)[joint], chain.now_s)
    assert chain.watch.lost
    # It stays found until the next start.
    chain.watch.on_measured(chain.measured, chain.now_s)
    assert chain.watch.lost
    chain.watch.start(START_S, chain.measured, READY)
    assert not chain.watch.lost


def test_an_arm_far_from_its_command_is_not_started() -> None:
    chain = Chain()
    with pytest.raises(ArmError):
        chain.watch.start(START_S, READY + 0.1, READY)


def test_a_plan_that_comes_later_than_its_lead_is_found() -> None:
    chain = Chain(transport_s=9e-3)
    chain.watch.start(START_S, chain.measured, READY)
    assert 'lead' in chain.knock()


def test_a_controller_that_moves_cannot_be_taken_over() -> None:
    chain = Chain()
    chain.watch.on_commanded(READY, START_S)
    assert chain.watch.reason_not_to_enable(START_S, START_S) is None
    later_s = START_S + 1e-3
    chain.watch.on_commanded(READY + 1e-4, later_s)
    assert chain.watch.reason_not_to_enable(later_s, later_s) is not None
    # Positions measured soon after the motion do not show where the arm comes to rest.
    assert chain.watch.reason_not_to_enable(later_s + 0.01, later_s + 0.1) is not None
    assert chain.watch.reason_not_to_enable(later_s + 0.1, later_s + 0.1) is None
    assert chain.watch.commanded(START_S + 1.0) is None


def test_a_controller_whose_commands_are_needed_must_report() -> None:
    chain = Chain()
    chain.watch.needs_commands = True
    assert chain.watch.reason_not_to_enable(chain.now_s, chain.now_s) is not None
    chain.step(0.0)
    assert chain.watch.reason_not_to_enable(chain.now_s, chain.now_s) is None
    chain.watch.start(chain.now_s, chain.measured, READY)
    assert chain.watch.fault(chain.now_s) is None
    assert chain.watch.fault(chain.now_s + 0.1) is not None
