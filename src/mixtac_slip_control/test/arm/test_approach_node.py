# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The action itself needs control_msgs, which the wheels lack: its types are stood in for here."""

import sys
from types import ModuleType, SimpleNamespace

import pytest

from mixtac_sim.arm.fr3 import READY
from mixtac_slip_control.arm.approach_node import ApproachClient
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.trajectory import approach_trajectory
from mixtac_slip_control.errors import BackendError


class Done:
    """A future that is done at once."""

    def __init__(self, value):
        self._value = value

    def result(self):
        return self._value

    def add_done_callback(self, callback):
        callback(self)


class FakeClient:
    ready, accepted, code = True, True, 0

    def __init__(self, node, kind, name):
        self.goals = node

    def server_is_ready(self):
        return self.ready

    def send_goal_async(self, goal):
        self.goals.append(goal)
        result = SimpleNamespace(error_code=self.code, error_string='path tolerance')
        answer = Done(SimpleNamespace(result=result))
        return Done(SimpleNamespace(accepted=self.accepted, get_result_async=lambda: answer))


@pytest.fixture
def client(monkeypatch):
    kind = SimpleNamespace(Goal=SimpleNamespace, Result=SimpleNamespace(SUCCESSFUL=0))
    module = ModuleType('control_msgs.action')
    module.FollowJointTrajectory = kind
    monkeypatch.setitem(sys.modules, 'control_msgs', ModuleType('control_msgs'))
    monkeypatch.setitem(sys.modules, 'control_msgs.action', module)
    fake = type('Client', (FakeClient,), {})
    monkeypatch.setattr('rclpy.action.ActionClient', fake)
    return fake


@pytest.fixture
def trajectory():
    return approach_trajectory(SerialArm.fr3(), JointLimits.fr3(), READY, READY + 0.1)


@pytest.mark.parametrize(
    ('accepted', 'code', 'words'),
    [(True, 0, None), (True, -4, 'path tolerance (code -4)'), (False, 0, 'rejected')],
)
def test_the_outcome_of_an_approach_is_told(client, trajectory, accepted, code, words):
    client.accepted, client.code = accepted, code
    goals, outcomes = [], []
    ApproachClient(goals, '/a').go(trajectory, outcomes.append)
    assert len(goals[0].trajectory.points) == len(trajectory.times_s)
    assert goals[0].trajectory.header.stamp.sec == 0
    assert len(outcomes) == 1
    assert outcomes[0] is None if words is None else words in outcomes[0]


def test_a_missing_controller_is_named(client, trajectory):
    client.ready = False
    with pytest.raises(BackendError, match='/a'):
        ApproachClient([], '/a').go(trajectory, print)


def test_missing_control_msgs_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, 'control_msgs', None)
    with pytest.raises(BackendError, match='control-msgs'):
        ApproachClient([], '/a')
