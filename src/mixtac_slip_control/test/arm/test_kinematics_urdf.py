# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0

import pytest

from mixtac_slip_control.arm.kinematics import fr3_urdf, read_chain
from mixtac_slip_control.errors import ArmError

JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>'
    '<axis xyz="{4}"/><limit lower="-1" upper="1" velocity="2" effort="3"/></joint>'
)
TURNING = JOINT.format('a', 'revolute', 'l0', 'l1', '0 0 1')


def robot(*joints):
    return f'<robot name="r">{"".join(joints)}</robot>'


def test_the_fr3_has_seven_joints_with_limits_and_a_flange():
    chain = read_chain(fr3_urdf())
    assert [joint.kind for joint in chain] == ['revolute'] * 7 + ['fixed']
    assert (chain[3].lower, chain[3].upper) == (-3.0421, -0.1518)
    assert chain[4].velocity == 5.26


def test_a_chain_is_read_from_root_to_leaf_and_branches_are_refused():
    joints = (
        JOINT.format('b', 'revolute', 'l1', 'l2', '0 0 2'),
        JOINT.format('a', 'prismatic', 'l0', 'l1', '0 1 0'),
    )
    chain = read_chain(robot(*joints))
    assert [joint.name for joint in chain] == ['a', 'b']
    assert chain[1].axis == (0.0, 0.0, 1.0)
    with pytest.raises(ArmError):
        read_chain(robot(*joints, JOINT.format('finger', 'prismatic', 'l1', 'f', '0 1 0')))


@pytest.mark.parametrize(
    'text',
    [
        '<robot',
        '<urdf/>',
        '<!DOCTYPE r [<!ENTITY a "b">]><robot/>',
        robot(),
        robot(JOINT.format('a', 'floating', 'l0', 'l1', '0 0 1')),
        robot(JOINT.format('a', 'revolute', 'l0', 'l1', '0 0 0')),
        robot(JOINT.format('a', 'revolute', 'l0', 'l1', '0 nan 0')),
        robot(JOINT.format('a', 'revolute', 'l0', 'l1', '1 0')),
        robot('<joint name="a" type="fixed"/>'),
        robot(TURNING.replace('</joint>', '<mimic joint="b" multiplier="-1"/></joint>')),
        robot(JOINT.format('a', 'revolute', 'l0', 'l1', '0 0 1').replace('"2"', '"x"')),
    ],
)
def test_what_is_no_serial_arm_is_refused(text):
    with pytest.raises(ArmError):
        read_chain(text)
