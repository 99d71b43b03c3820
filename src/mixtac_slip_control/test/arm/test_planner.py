# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The planner: straight, within every limit, and continued without a step."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_sim.arm import (
    READY,
    SIDEWAYS,
    JointTrajectoryController,
    Trajectory,
    flange_place,
    violations,
)
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits, StateChecks
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.errors import ArmError, UnreachableError

ARM, LIMITS = SerialArm.fr3(), JointLimits.fr3()
CHECKS = StateChecks(ARM, LIMITS)
X = np.array([1.0, 0.0, 0.0])
positions = st.tuples(
    *(st.floats(low, high) for low, high in zip(LIMITS.lower, LIMITS.upper, strict=True))
).map(np.array)


@pytest.fixture
def planner():
    planner = AdvancePlanner(ARM, LIMITS)
    planner.reset(READY, X)
    return planner


def test_the_flange_moves_straight_along_the_normal_without_turning(planner):
    planner.reset(READY, 2.0 * X)
    trajectory = planner.plan(5.0, 1e-3)
    start, turn = flange_place(READY), ARM.pose(READY)[:3, :3]
    for t, q in zip(trajectory.times_s, trajectory.q, strict=True):
        advance = planner.advance_at(trajectory.stamp_s + t)
        assert np.allclose(flange_place(q) - start, advance * X, atol=3e-6)
        assert np.allclose(ARM.pose(q)[:3, :3], turn, atol=1e-5)
    assert advance == pytest.approx(1e-3, abs=1e-12)


def test_between_points_the_motion_is_a_cubic_so_that_quintics_reproduce_it(planner):
    planner.plan(5.0, 1e-3)
    trajectory = planner.plan(5.0123, 2e-4)
    states = zip(trajectory.times_s, trajectory.q, trajectory.dq, trajectory.ddq, strict=True)
    for (t0, q0, v0, a0), (t1, q1, v1, a1) in pairwise(states):
        h = t1 - t0
        assert np.allclose(v1, v0 + 0.5 * h * (a0 + a1), atol=1e-7)
        assert np.allclose(q1, q0 + h * v0 + h * h / 6.0 * (2.0 * a0 + a1), atol=1e-10)
    assert not trajectory.dq[-1].any()
    assert not trajectory.ddq[-1].any()


def test_a_new_trajectory_repeats_the_committed_motion(planner):
    controllers = [JointTrajectoryController() for _ in range(2)]
    first = planner.plan(5.0, 5e-4)
    second = planner.plan(5.0143, 1e-3)
    branch_s = second.stamp_s + second.branch_s
    assert branch_s >= 5.0143 + 6e-3
    assert second.stamp_s + second.times_s[0] < 5.0143 - 1e-3
    for controller, plan in zip(controllers, (first, second), strict=True):
        controller.reset(READY, 4.99)
        t = Trajectory(plan.stamp_s, plan.times_s, plan.q, plan.dq, plan.ddq)
        controller.accept(t, 4.995)
    for k in range(1, int(1e3 * (branch_s - 5.0))):
        now = 5.0 + 1e-3 * k
        if now > second.stamp_s + second.times_s[0]:
            old, new = (controller.sample(now)[0] for controller in controllers)
            assert np.allclose(old, new, atol=1e-12)


def test_nothing_new_is_sent_for_the_same_target_or_too_soon(planner):
    assert planner.plan(5.0, 0.0) is None
    assert planner.plan(5.0, 1e-4) is not None
    assert planner.plan(5.001, 2e-4) is None
    assert planner.plan(5.002, 2e-4) is not None
    assert planner.plan(5.004, 2e-4) is None
    assert planner.plan(5.2, 1e-4) is not None


def test_the_first_tenth_of_a_millimetre_takes_the_optimal_time(planner):
    """Against the optimum in closed form for the acceleration and jerk of the worst joint."""
    slope = np.abs(planner.line.slope).max()
    A, J = min(9.5 / slope, 0.95 * 9.0), min(4750.0 / slope, 0.95 * 4500.0)
    optimum = A / J + np.sqrt((A / J) ** 2 + 4 * 1e-4 / A)
    trajectory = planner.plan(5.0, 1e-4)
    assert trajectory.times_s[-1] - trajectory.branch_s == pytest.approx(optimum, abs=1e-6)


class Stream:
    """A planner that streams to an emulated controller, cycle by cycle, late by some transport."""

    def __init__(self, q, normal, transport_s=2e-3, phase_s=3e-4, *, replaces=False):
        self.replaces, self.active = replaces, False
        self.planner = AdvancePlanner(ARM, LIMITS)
        self.planner.reset(q, normal, 1e-3)
        self.controller = JointTrajectoryController()
        self.now, self.transport_s, self.phase_s = 5.0, transport_s, phase_s
        self.controller.reset(q, self.now)
        self.under_way, self.commands = [], []

    def step(self, target, *, stop=False):
        while self.under_way and self.under_way[0][0] <= self.now:
            arrival, plan = self.under_way.pop(0)
            start_s = plan.stamp_s
            if self.replaces and self.active:  # a stamp in the past becomes the next cycle's
                start_s = max(start_s, float(np.ceil(1e3 * arrival - 1e-6)) * 1e-3)
            t = Trajectory(start_s, plan.times_s, plan.q, plan.dq, plan.ddq)
            assert self.controller.accept(t, arrival) is None
            self.active = True
        self.commands.append(self.controller.sample(self.now)[0])
        now = self.now + self.phase_s
        plan = self.planner.stop(now) if stop else self.planner.plan(now, target)
        if plan is not None:
            self.under_way.append((now + self.transport_s, plan))
        self.now += 1e-3


@settings(max_examples=40, deadline=None)
@given(
    q=positions.filter(lambda q: CHECKS.check(q) is None),
    normal=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda n: np.linalg.norm(n) > 0.1),
    transport=st.floats(0.0, 3.9e-3),
    phase=st.floats(0.0, 9.9e-4),
    seed=st.integers(0, 10_000),
)
def test_no_stream_of_targets_breaks_a_limit_of_the_arm(q, normal, transport, phase, seed):
    """Random targets and stops, judged by differences of what the controller commands."""
    rng = np.random.default_rng(seed)
    try:
        stream = Stream(q, np.array(normal), transport, phase)
    except UnreachableError:
        return
    target = 0.0
    for _ in range(400):
        if rng.random() < 0.1:
            target = float(rng.uniform(0.0, 1e-3))
        stop = rng.random() < 0.01
        stream.step(target, stop=stop)
        target = stream.planner.target if stop else target
    for _ in range(300):
        stream.step(target)
    assert violations(np.stack(stream.commands), 1e-3) == 0
    assert stream.planner.refused == 0
    reached = stream.planner.line.at(stream.planner.target)
    assert np.allclose(stream.commands[-1], reached, atol=1e-9)


@pytest.mark.parametrize('replaces', [False, True])
def test_only_a_controller_that_keeps_the_stamps_can_follow_the_stream(replaces):
    """As Jazzy and Kilted do; from ros2_controllers 6.8.0 on, `allow_trajectory_replacement` lets a
    trajectory that is stamped in the past begin at the time of playback, and is refused."""
    stream, rng, target = Stream(READY, SIDEWAYS, replaces=replaces), np.random.default_rng(0), 1e-4
    for k in range(400):
        target = float(rng.uniform(0.0, 1e-3)) if k % 12 == 0 else target
        stream.step(target)
    assert (violations(np.stack(stream.commands), 1e-3) > 0) == replaces


def test_the_tip_keeps_its_own_limits_where_the_joints_allow_more():
    limits = replace(JointLimits.from_arm(ARM, 10.0, 5000.0), tip=(1.0, 1.0, 400.0))
    planner, rng = AdvancePlanner(ARM, limits), np.random.default_rng(1)
    planner.reset(READY, X)
    now, worst, h = 5.0, 0.0, 1e-4
    for _ in range(300):
        now += rng.choice([2e-3, 5e-3, 0.03])
        trajectory = planner.plan(now, float(rng.uniform(0.0, 1e-3)))
        if trajectory is not None:
            t = trajectory.stamp_s + trajectory.times_s
            places = np.array(
                [[planner.advance_at(each + k * h) for k in (-1, 0, 1)] for each in t]
            )
            worst = max(worst, np.abs(places @ (1.0, -2.0, 1.0)).max() / h**2)
    assert 0.8 < worst < 0.96


def test_stop_brakes_within_the_limits_and_comes_to_rest(planner):
    end = planner.plan(5.0, 2e-3).end_s
    trajectory = planner.stop(5.008)
    assert trajectory.end_s < end
    assert 0.0 < planner.target < 2e-3
    assert np.abs(trajectory.ddq).max() <= 10.0
    assert not trajectory.dq[-1].any()
    assert planner.stop(6.0) is None


@pytest.mark.parametrize(
    ('now', 'advance', 'error'),
    [
        (5.0, np.nan, ArmError),
        (np.inf, 1e-4, ArmError),
        (5.0, -1e-4, UnreachableError),
        (5.0, 3e-3, UnreachableError),
        (4.0, 1e-4, ArmError),
    ],
)
def test_targets_that_cannot_be_reached_are_refused(planner, now, advance, error):
    planner.plan(4.5, 1e-5)
    with pytest.raises(error):
        planner.plan(now, advance)


def test_a_planner_must_be_reset_first():
    with pytest.raises(ArmError):
        AdvancePlanner(ARM, LIMITS).plan(1.0, 1e-4)


@pytest.mark.parametrize('normal', [np.zeros(3), np.full(3, np.nan), np.ones(2)])
def test_a_normal_without_a_direction_is_refused(planner, normal):
    with pytest.raises(ArmError):
        planner.reset(READY, normal)


def test_an_advance_that_the_arm_cannot_make_is_refused_at_the_reset():
    stretched = np.array([0.0, 0.0, 0.0, -0.0698, 0.0, 1.57, 0.0])
    planner = AdvancePlanner(ARM, LIMITS)
    with pytest.raises(UnreachableError):
        planner.reset(stretched, np.array([0.0, 0.0, 1.0]))
    with pytest.raises(ArmError):
        planner.reset(READY, X, 1.0)
