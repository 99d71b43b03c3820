# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_sim.arm import flange_place
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.errors import ArmError

ARM = SerialArm.fr3()
LIMITS = JointLimits.fr3()
states = st.tuples(
    *(st.floats(low, high) for low, high in zip(LIMITS.lower, LIMITS.upper, strict=True))
).map(np.array)


@given(states)
def test_the_flange_is_where_the_denavit_hartenberg_parameters_put_it(q):
    assert np.allclose(ARM.pose(q)[:3, 3], flange_place(q), atol=1e-12)


@given(states)
def test_the_jacobian_is_the_derivative_of_the_pose(q):
    h = 1e-6
    jacobian = ARM.jacobian(q)
    for i in range(7):
        step = h * np.eye(7)[i]
        after, before = ARM.pose(q + step), ARM.pose(q - step)
        linear = (after - before)[:3, 3] / (2 * h)
        spin = (after - before)[:3, :3] / (2 * h) @ ARM.pose(q)[:3, :3].T
        angular = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        assert np.allclose(jacobian[:, i], np.concatenate([linear, angular]), atol=1e-8)


def test_prismatic_and_fixed_joints_and_tools_count():
    text = """<robot name="r">
      <joint name="turn" type="continuous"><parent link="a"/><child link="b"/>
        <axis xyz="0 0 1"/></joint>
      <joint name="bend" type="fixed"><parent link="b"/><child link="c"/>
        <origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/></joint>
      <joint name="slide" type="prismatic"><parent link="c"/><child link="d"/>
        <axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint>
      <joint name="tool" type="fixed"><parent link="d"/><child link="e"/>
        <origin xyz="0 0 0.5"/></joint></robot>"""
    arm = SerialArm.from_urdf(text)
    assert arm.names == ('turn', 'slide')
    pose = arm.pose(np.array([np.pi / 2, 0.25]))
    assert np.allclose(pose[:3, 3], [-0.25, 1.0, 0.5])
    assert np.allclose(arm.jacobian(np.array([np.pi / 2, 0.25]))[:, 1], [-1, 0, 0, 0, 0, 0])


@pytest.mark.parametrize('q', [np.zeros(6), np.full(7, np.nan), np.full(7, np.inf)])
def test_joint_positions_that_are_none_are_refused(q):
    with pytest.raises(ArmError):
        ARM.pose(q)


def test_an_arm_needs_a_joint_that_moves():
    text = (
        '<robot name="r"><joint name="a" type="fixed"><parent link="a"/><child link="b"/></joint>'
        '</robot>'
    )
    with pytest.raises(ArmError):
        SerialArm.from_urdf(text)
