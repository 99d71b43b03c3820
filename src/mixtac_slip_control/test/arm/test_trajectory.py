# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0


import numpy as np
import pytest

from mixtac_sim.arm import READY, JointTrajectoryController, violations
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.trajectory import (
    PlannedTrajectory,
    serialised,
    settling_time,
    settling_trajectory,
)
from mixtac_slip_control.errors import ArmError


def trajectory(count, names):
    q = np.arange(count * len(names), dtype=np.float64).reshape(count, len(names))
    times = 0.999 + 0.001 * np.arange(count)
    return PlannedTrajectory(1_700_000_000_123_456_789, times, q, q + 0.1, q + 0.2, names)


@pytest.mark.parametrize('names', [('a', 'b'), ('a', 'bc', 'defgh'), ('abcd',) * 3, ('é', 'ab')])
@pytest.mark.parametrize('count', [1, 2, 3, 50])
def test_ros_reads_every_field(count, names):
    from rclpy.serialization import deserialize_message
    from trajectory_msgs.msg import JointTrajectory

    given = trajectory(count, names)
    read = deserialize_message(serialised(given), JointTrajectory)
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert read.header.frame_id == ''
    assert read.joint_names == list(names)
    assert [p.positions.tolist() for p in read.points] == given.q.tolist()
    assert [p.velocities.tolist() for p in read.points] == given.dq.tolist()
    assert [p.accelerations.tolist() for p in read.points] == given.ddq.tolist()
    assert all(len(p.effort) == 0 for p in read.points)
    since = [(p.time_from_start.sec, p.time_from_start.nanosec) for p in read.points]
    assert since == [divmod(999_000_000 + 1_000_000 * k, 1_000_000_000) for k in range(count)]


def test_settling_leads_a_sagging_command_onto_the_measured_positions_within_the_limits():
    arm, sag = SerialArm.fr3(), 5e-3
    seconds = settling_time(sag, 2.0, 9.5, 4750.0)
    controller = JointTrajectoryController()
    controller.reset(READY, 1.0)
    assert controller.accept(settling_trajectory(arm, READY + sag, 1.0, seconds), 1.0) is None
    q = np.array([controller.sample(1.0 + k * 1e-3)[0] for k in range(600)])
    assert violations(q, 1e-3) == 0
    assert np.allclose(q[-1], READY + sag, atol=1e-12)
    # Twice the sag in this time breaks a limit: the time is no longer than it must be.
    controller.reset(READY, 1.0)
    controller.accept(settling_trajectory(arm, READY + 2.0 * sag, 1.0, seconds), 1.0)
    q = np.array([controller.sample(1.0 + k * 1e-3)[0] for k in range(600)])
    assert violations(q, 1e-3) > 0


def test_settling_at_positions_of_another_arm_is_refused():
    with pytest.raises(ArmError):
        settling_trajectory(SerialArm.fr3(), np.zeros(6), 1.0, 0.1)
