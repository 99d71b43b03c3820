# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0

from types import SimpleNamespace

import numpy as np
import pytest

from mixtac_sim.arm.controller import JointTrajectoryController
from mixtac_sim.arm.fr3 import READY, violations
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.trajectory import (
    PlannedTrajectory,
    TrajectoryMessage,
    settling_trajectory,
)
from mixtac_slip_control.errors import ArmError


def message():
    stamp = SimpleNamespace(sec=0, nanosec=0)
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp), joint_names=[], points=[])


def point():
    return SimpleNamespace(
        positions=[],
        velocities=[],
        accelerations=[],
        time_from_start=SimpleNamespace(sec=0, nanosec=0),
    )


def trajectory(count):
    q = np.arange(count * 2, dtype=np.float64).reshape(count, 2)
    times = 0.999 + 0.001 * np.arange(count)
    return PlannedTrajectory(1_700_000_000_123_456_789, times, q, q + 0.1, q + 0.2, ('a', 'b'))


def test_every_field_is_filled():
    filled = TrajectoryMessage(message, point).fill(trajectory(3))
    assert (filled.header.stamp.sec, filled.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert filled.joint_names == ['a', 'b']
    assert [list(p.positions) for p in filled.points] == [[0, 1], [2, 3], [4, 5]]
    assert list(filled.points[1].velocities) == [2.1, 3.1]
    assert list(filled.points[2].accelerations) == [4.2, 5.2]
    since = [(p.time_from_start.sec, p.time_from_start.nanosec) for p in filled.points]
    assert since == [(0, 999_000_000), (1, 0), (1, 1_000_000)]


def test_points_are_used_again_and_a_shorter_trajectory_is_shorter():
    filler = TrajectoryMessage(message, point)
    first = list(filler.fill(trajectory(5)).points)
    again = filler.fill(trajectory(2))
    assert [id(p) for p in again.points] == [id(p) for p in first[:2]]


def test_it_fills_the_messages_of_ros():
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    filled = TrajectoryMessage(JointTrajectory, JointTrajectoryPoint).fill(trajectory(3))
    assert filled.points[2].positions.tolist() == [4.0, 5.0]
    assert filled.points[2].time_from_start.nanosec == 1_000_000


def test_settling_leads_a_sagging_command_onto_the_measured_positions():
    arm, sagged = SerialArm.fr3(), READY + 2e-3
    controller = JointTrajectoryController()
    controller.reset(READY, 1.0)
    assert controller.accept(settling_trajectory(arm, sagged, 1.0), 1.0) is None
    q = np.array([controller.sample(1.0 + k * 1e-3)[0] for k in range(600)])
    assert violations(q, 1e-3) == 0
    assert np.allclose(q[-1], sagged, atol=1e-12)
    with pytest.raises(ArmError):
        settling_trajectory(arm, READY, 1.0, 0.0)
