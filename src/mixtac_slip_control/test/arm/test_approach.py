# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_sim.arm.controller import JointTrajectoryController
from mixtac_sim.arm.fr3 import READY, violations
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.trajectory import approach_trajectory, settling_trajectory
from mixtac_slip_control.errors import ArmError, UnreachableError

ARM, LIMITS = SerialArm.fr3(), JointLimits.fr3()


def commands(start, trajectory, now_s, duration_s):
    controller = JointTrajectoryController()
    controller.reset(start, now_s)
    assert controller.accept(trajectory, now_s) is None
    return np.array([controller.sample(now_s + k * 1e-3)[0] for k in range(int(duration_s * 1e3))])


@settings(max_examples=15, deadline=None)
@given(st.tuples(*[st.floats(-0.4, 0.4)] * 7), st.floats(0.2, 1.0))
def test_an_approach_keeps_the_limits_and_arrives(step, share):
    goal = READY + np.array(step)
    trajectory = approach_trajectory(ARM, LIMITS, READY, goal, share)
    q = commands(READY, trajectory, 1.0, trajectory.times_s[-1] + 0.05)
    assert violations(q, 1e-3) == 0
    assert np.allclose(q[-1], goal, atol=1e-12)
    assert np.diff(q, axis=0)[-1] == pytest.approx(0.0, abs=1e-12)


def test_a_full_share_is_used():
    """One joint, far: the speed is what limits it."""
    goal = READY.copy()
    goal[0] += 2.0
    trajectory = approach_trajectory(ARM, LIMITS, READY, goal, 1.0)
    bounds = np.array([LIMITS.velocity_bounds(q)[1][0] for q in trajectory.q])
    assert np.abs(trajectory.dq[:, 0]).max() == pytest.approx(bounds.min(), rel=0.02)


def test_where_the_arm_is_already_is_an_approach_too():
    trajectory = approach_trajectory(ARM, LIMITS, READY, READY)
    assert (trajectory.q == READY).all()
    assert (trajectory.times_s > 0).all()


def test_goals_out_of_range_are_refused():
    with pytest.raises(UnreachableError, match='goal of the approach: fr3_joint4'):
        approach_trajectory(ARM, LIMITS, READY, np.zeros(7))
    with pytest.raises(ArmError, match='share'):
        approach_trajectory(ARM, LIMITS, READY, READY, 0.0)


def test_settling_leads_a_sagging_command_onto_the_measured_positions():
    sagged = READY + 2e-3
    trajectory = settling_trajectory(ARM, sagged, 1.0)
    q = commands(READY, trajectory, 1.0, 0.6)
    assert violations(q, 1e-3) == 0
    assert np.allclose(q[-1], sagged, atol=1e-12)
    with pytest.raises(ArmError, match='settling'):
        settling_trajectory(ARM, READY, 1.0, 0.0)
