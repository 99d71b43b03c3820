# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arm backends by name: built in, or from another package; joint states in any order."""

import pytest

from mixtac_slip_control.arm.backends import TrajectoryBackend, open_backend
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.errors import BackendError
from mixtac_slip_control.parameters import SlipControlParameters

FOREIGN = """
class Arm:
    def __init__(self, parameters, arm):
        self.address, self.joints = parameters.arm_address, arm.names

    def state(self):
        return None

    def send(self, trajectory):
        pass

    def stop(self):
        pass
"""


@pytest.fixture
def foreign_package(tmp_path, monkeypatch):
    """Install a package with a backend, as pip would."""
    (tmp_path / 'foreign_arm.py').write_text(FOREIGN)
    info = tmp_path / 'foreign_arm-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: foreign-arm\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text('[mixtac.arm_backends]\nforeign = foreign_arm:Arm\n')
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures('foreign_package')
def test_a_backend_of_another_package_is_found_by_its_entry_point():
    arm = SerialArm.fr3()
    parameters = SlipControlParameters(arm='fr3', arm_backend='foreign', arm_address='10.0.0.7')
    backend = open_backend(parameters, arm)
    assert (backend.address, backend.joints) == ('10.0.0.7', arm.names)
    with pytest.raises(BackendError) as caught:
        open_backend(SlipControlParameters(arm_backend='other'), arm)
    for name in ('trajectory', 'libfranka', 'foreign'):
        assert name in caught.value.remedy


def test_libfranka_asks_for_an_address():
    parameters = SlipControlParameters(arm='fr3', arm_backend='libfranka')
    with pytest.raises(BackendError) as caught:
        open_backend(parameters, SerialArm.fr3())
    assert 'arm_address' in caught.value.remedy


def test_joints_are_picked_by_name():
    backend = TrajectoryBackend(('a', 'b'), print)
    assert backend.state() is None
    assert backend.on_joint_state(['finger', 'b', 'a'], [9.0, 2.0, 1.0], 5.0)
    assert backend.state().q.tolist() == [1.0, 2.0]
    assert backend.state().stamp_s == 5.0
    assert backend.state().commanded is None
    assert backend.on_joint_state(['a', 'b'], [3.0, 4.0], 6.0)
    assert backend.state().q.tolist() == [3.0, 4.0]
    assert not backend.on_joint_state(['a', 'finger'], [3.0, 4.0], 7.0)
    assert not backend.on_joint_state(['a', 'b'], [], 8.0)
    assert backend.state().stamp_s == 6.0


def test_trajectories_are_published():
    sent = []
    TrajectoryBackend(('a',), sent.append).send('trajectory')
    assert sent == ['trajectory']
