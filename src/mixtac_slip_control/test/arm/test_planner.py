# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest

from mixtac_sim.arm.fr3 import READY, flange_place
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.errors import ArmError, UnreachableError

ARM, LIMITS = SerialArm.fr3(), JointLimits.fr3()
X = np.array([1.0, 0.0, 0.0])


@pytest.fixture
def planner():
    planner = AdvancePlanner(ARM, LIMITS)
    planner.reset(READY, X)
    return planner


def test_the_flange_moves_straight_along_the_normal_without_turning(planner):
    trajectory = planner.plan(5.0, 0.01, np.array([2.0, 0.0, 0.0]))
    start, turn = flange_place(READY), ARM.pose(READY)[:3, :3]
    for t, q in zip(trajectory.times_s, trajectory.q, strict=True):
        advance = planner.advance_at(trajectory.stamp_s + t)
        assert np.allclose(flange_place(q) - start, advance * X, atol=1e-9)
        assert np.allclose(ARM.pose(q)[:3, :3], turn, atol=1e-9)
    assert advance == pytest.approx(0.01, abs=1e-12)


def test_velocities_and_accelerations_are_the_derivatives(planner):
    trajectory = planner.plan(5.0, 0.003, X)
    h = trajectory.times_s[1] - trajectory.times_s[0]
    assert np.allclose(
        np.diff(trajectory.q, axis=0) / h,
        (trajectory.dq[1:] + trajectory.dq[:-1]) / 2 - h / 12 * np.diff(trajectory.ddq, axis=0),
        atol=1e-7,
    )
    mean = (trajectory.ddq[1:] + trajectory.ddq[:-1]) / 2
    assert np.allclose(np.diff(trajectory.dq, axis=0) / h, mean, atol=2e-3)
    assert not trajectory.dq[-1].any()
    assert not trajectory.ddq[-1].any()


def test_a_new_trajectory_repeats_the_committed_part_exactly(planner):
    first = planner.plan(5.0, 0.002, X)
    second = planner.plan(5.0043, 0.004, X)
    times = {first.stamp_ns + round(t * 1e9): k for k, t in enumerate(first.times_s)}
    branch = second.stamp_ns + round(second.branch_s * 1e9)
    assert branch >= 5.0043e9 + 6e6
    shared = 0
    for k, t in enumerate(second.times_s):
        at = second.stamp_ns + round(t * 1e9)
        if at <= branch and at in times:
            shared += 1
            for name in ('q', 'dq', 'ddq'):
                assert (getattr(second, name)[k] == getattr(first, name)[times[at]]).all()
    assert shared >= 6
    assert second.stamp_s + second.times_s[0] < 5.0043 - 1e-3


def test_nothing_new_is_sent_for_the_same_target_or_too_soon(planner):
    assert planner.plan(5.0, 0.0, X) is None
    assert planner.plan(5.0, 1e-4, X) is not None
    assert planner.plan(5.001, 2e-4, X) is None
    assert planner.plan(5.002, 2e-4, X) is not None
    assert planner.plan(5.004, 2e-4, X) is None
    assert planner.plan(5.2, 1e-4, X) is not None


def test_the_first_tenth_of_a_millimetre_takes_what_the_arm_allows(planner):
    """Against the optimum in closed form for the acceleration and jerk of the worst joint."""
    slope = np.abs(planner.path.derivatives(0.0)[1]).max()
    A, J = 9.5 / slope, 4750.0 / slope
    optimum = A / J + np.sqrt((A / J) ** 2 + 4 * 1e-4 / A)
    trajectory = planner.plan(5.0, 1e-4, X)
    moving = trajectory.times_s[-1] - trajectory.branch_s
    assert optimum - 1e-9 <= moving <= optimum + 2e-3


def test_the_tip_keeps_its_own_limits_where_the_joints_allow_more():
    limits = JointLimits.from_arm(ARM, 10.0, 5000.0, tip=(1.0, 1.0, 400.0))
    planner, rng = AdvancePlanner(ARM, limits), np.random.default_rng(1)
    planner.reset(READY, X)
    now, worst, h = 5.0, 0.0, 1e-4
    for _ in range(300):
        now += rng.choice([2e-3, 5e-3, 0.03])
        trajectory = planner.plan(now, float(rng.uniform(0.0, 1e-3)), X)
        if trajectory is not None:
            t = trajectory.stamp_s + trajectory.times_s
            places = np.array(
                [[planner.advance_at(each + k * h) for k in (-1, 0, 1)] for each in t]
            )
            worst = max(worst, np.abs(places @ (1.0, -2.0, 1.0)).max() / h**2)
    assert 0.8 < worst < 0.96


def test_stop_brakes_within_the_limits_and_comes_to_rest(planner):
    planner.plan(5.0, 0.02, X)
    speed = (planner.advance_at(5.0505) - planner.advance_at(5.0495)) / 1e-3
    trajectory = planner.stop(5.05)
    assert speed > 0.05
    assert planner.target < 0.02
    assert np.abs(trajectory.ddq).max() <= 10.0
    assert not trajectory.dq[-1].any()
    assert trajectory.end_s - 5.05 < 0.006 + 2 * speed / planner.motion_limits.acceleration + 0.01
    assert planner.stop(6.0) is None


def test_the_commanded_advance_is_that_of_the_trajectory(planner):
    trajectory = planner.plan(1.7e9, 0.001, X)
    for t, q in zip(trajectory.times_s, trajectory.q, strict=True):
        advance = planner.advance_at(trajectory.stamp_s + t)
        assert np.allclose(planner.path.derivatives(advance)[0], q, atol=1e-6)
    assert planner.advance_at(1.7e9 - 10) == 0.0
    assert planner.advance_at(1.7e9 + 10) == pytest.approx(0.001)


def test_without_a_plan_nothing_is_commanded(planner):
    assert planner.advance_at(1.0) == 0.0
    assert planner.stop(1.0) is None


@pytest.mark.parametrize(
    ('now', 'advance', 'normal', 'error'),
    [
        (5.0, np.nan, X, ArmError),
        (np.inf, 1e-4, X, ArmError),
        (5.0, -1e-4, X, UnreachableError),
        (5.0, 0.03, X, UnreachableError),
        (5.0, 1e-4, -X, ArmError),
        (5.0, 1e-4, np.full(3, np.nan), ArmError),
        (4.0, 1e-4, X, ArmError),
    ],
)
def test_what_cannot_be_followed_is_refused(planner, now, advance, normal, error):
    planner.plan(4.5, 1e-5, X)
    with pytest.raises(error):
        planner.plan(now, advance, normal)


def test_a_planner_must_be_reset_first():
    with pytest.raises(ArmError):
        AdvancePlanner(ARM, LIMITS).plan(1.0, 1e-4, X)


def test_an_advance_beyond_the_reach_is_refused_at_the_reset():
    stretched = np.array([0.0, 1.5, 0.0, -0.16, 0.0, 1.7, 0.0])
    planner, outwards = AdvancePlanner(ARM, LIMITS), ARM.pose(stretched)[:3, 3]
    with pytest.raises(UnreachableError):
        planner.reset(stretched, outwards)
    with pytest.raises(ArmError):
        planner.reset(READY, X, 1.0)


def test_an_advance_to_where_the_elbow_is_nearly_stretched_is_refused_at_the_reset():
    """The joints reach it, but bend more than the path can hold: the tip would leave the line."""
    q = np.array([0.0, 0.6, 0.0, -0.95, 0.0, 1.7, 0.785])
    planner, outwards = AdvancePlanner(ARM, LIMITS), ARM.pose(q)[:3, 3] - (0.0, 0.0, 0.333)
    with pytest.raises(UnreachableError):
        planner.reset(q, outwards, 0.02)
    planner.reset(q, outwards, 0.002)


def test_the_largest_advance_is_that_of_the_reset(planner):
    planner.reset(READY, X, 2e-3)
    with pytest.raises(UnreachableError):
        planner.plan(5.0, 3e-3, X)
    assert planner.plan(5.0, 2e-3, X) is not None


def test_it_moves_until_the_last_point(planner):
    assert not planner.moving(5.0)
    trajectory = planner.plan(5.0, 5e-3, X)
    assert planner.moving(5.0)
    assert planner.moving(trajectory.end_s - 2e-3)
    assert not planner.moving(trajectory.end_s + 2e-3)
    braking = planner.stop(5.02)
    assert braking.end_s < trajectory.end_s
    assert planner.moving(braking.end_s - 2e-3)
    assert not planner.moving(braking.end_s + 2e-3)
    # A clock that was set back by a day does not keep it moving.
    assert not planner.moving(braking.end_s - 86400.0)


@pytest.mark.parametrize('back_s', [0.012, 0.1, 3600.0])
def test_a_clock_that_was_set_back_is_no_obstacle_to_braking(planner, back_s):
    for k in range(10):
        planner.plan(5.0 + 4e-3 * k, 2e-3 * (k + 1), X)
    braking = planner.stop(5.04 - back_s)
    step = np.abs(np.diff(braking.q, axis=0)).max()
    assert step < 0.25e-3 * 5
    assert not braking.dq[-1].any()
    assert np.abs(braking.ddq).max() <= 10.0
