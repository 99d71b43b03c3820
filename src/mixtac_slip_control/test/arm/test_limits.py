# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0

import dataclasses

import numpy as np
import pytest

from mixtac_sim.arm import DQ_MAX, Q_LOWER, Q_UPPER, READY
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits, StateChecks
from mixtac_slip_control.errors import ArmError

ARM, LIMITS = SerialArm.fr3(), JointLimits.fr3()
REST = np.zeros(7)


def test_the_limits_are_those_written_down_elsewhere():
    assert (LIMITS.lower == Q_LOWER).all()
    assert (LIMITS.upper == Q_UPPER).all()
    assert (LIMITS.velocity == DQ_MAX).all()


def test_the_velocity_envelope_closes_towards_the_ends():
    low, high = LIMITS.velocity_bounds(LIMITS.upper)
    assert (high < 0.5).all()
    assert (low == -LIMITS.velocity).all()
    q = READY.copy()
    q[3] = -0.1458 - 0.5  # by hand: -0.30 + sqrt(8 * 0.5) = 1.7
    assert LIMITS.velocity_bounds(q)[1][3] == pytest.approx(1.7)


def test_a_good_state_passes():
    checks = StateChecks(ARM, LIMITS, (0, 0.6, -0.5, 0.5, 0.2, 0.9))
    assert checks.check(READY) is None


@pytest.mark.parametrize('joint', range(7))
def test_a_joint_near_its_end_trips(joint):
    for end, sign in ((Q_UPPER, -1), (Q_LOWER, 1)):
        q = READY.copy()
        q[joint] = end[joint] + sign * 0.01
        assert f'fr3_joint{joint + 1}' in StateChecks(ARM, LIMITS).check(q)


def test_a_slow_drift_to_an_end_trips():
    checks, q = StateChecks(ARM, LIMITS), READY.copy()
    q[6] = Q_UPPER[6] - 0.02 - 2e-3
    steps = 0
    while checks.check(q) is None:
        q[6] += 3e-5
        steps += 1
        assert steps < 200
    assert q[6] == pytest.approx(Q_UPPER[6] - 0.02, abs=2e-4)
    # What is wrong stays wrong, however near to the last good state.
    q[6] += 1e-6
    assert 'fr3_joint7' in checks.check(q)


def test_leaving_the_workspace_trips():
    box = (0, 0.3, -0.5, 0.5, 0.2, 0.9)
    assert '0.3069' in StateChecks(ARM, LIMITS, box).check(READY)


def test_a_singularity_trips():
    checks = StateChecks(ARM, LIMITS)
    for q in ([0, 0, np.pi / 2, -1.5, 0, np.pi, 0], [0, 0, 0, -0.18, 0, 1.6, 0]):
        assert 'singularity' in checks.check(np.array(q, np.float64))


@pytest.mark.parametrize('bad', [np.full(7, np.nan), np.zeros(6)])
def test_what_is_no_state_trips(bad):
    checks = StateChecks(ARM, LIMITS)
    assert '7 finite numbers' in checks.check(bad)


def test_empty_workspaces_and_limits_are_refused():
    with pytest.raises(ArmError):
        StateChecks(ARM, LIMITS, (0, 1, 0, 0, 0, 1))
    with pytest.raises(ArmError):
        dataclasses.replace(LIMITS, lower=LIMITS.upper)
    with pytest.raises(ArmError):
        dataclasses.replace(LIMITS, jerk=REST)
