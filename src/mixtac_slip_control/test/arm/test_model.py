# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arm that the parameters name; backends by name, built in or from another package."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from mixtac_node.parameters import ParameterError
from mixtac_slip_control.arm import planner as planning
from mixtac_slip_control.arm.kinematics import SerialArm, fr3_urdf
from mixtac_slip_control.arm.model import TrajectoryBackend, make_arm, open_backend
from mixtac_slip_control.errors import BackendError, SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters

if TYPE_CHECKING:
    from pathlib import Path

READY = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])


def stretched(kind: str) -> str:
    """Return the URDF of an arm that is singular in the middle of its joints' ranges."""
    text = '<robot name="r">'
    for i, axis in enumerate(('0 0 1', '0 1 0', '0 1 0', '0 1 0', '0 0 1')):
        text += (
            f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<origin xyz="0 0 0.2"/><axis xyz="{axis}"/>'
            '<limit lower="-6.28" upper="6.28" velocity="2"/></joint>'
        )
    return text + '</robot>'


def test_none_is_no_arm() -> None:
    assert make_arm(SlipControlParameters()) is None


def test_libfranka_is_an_fr3_with_that_backend() -> None:
    chosen = SlipControlParameters(arm='libfranka')
    assert (chosen.model, chosen.backend) == ('fr3', 'libfranka')
    assert SlipControlParameters(arm='fr3').backend == 'trajectory'
    assert make_arm(chosen) is not None
    with pytest.raises(ParameterError):
        SlipControlParameters(arm='libfranka', arm_backend='my_arm')


def test_the_planner_takes_its_settings_from_the_parameters() -> None:
    parts = make_arm(SlipControlParameters(arm='fr3', lead=4e-3, interval=3e-3, max_speed=0.01))
    assert parts is not None
    settings = parts.planner.settings
    assert (settings.lead_s, settings.interval_s, settings.max_speed) == (4e-3, 3e-3, 0.01)
    with pytest.raises(ParameterError):
        SlipControlParameters(lead=3e-3, controller_period=2e-3)


def test_the_normal_turns_with_the_tool() -> None:
    tool = make_arm(SlipControlParameters(arm='fr3', normal_z=2.0))
    base = make_arm(SlipControlParameters(arm='fr3', normal_frame='base', normal_x=1.0, normal_z=0))
    assert tool is not None
    assert base is not None
    # In its ready pose the flange of the FR3 looks straight down.
    assert tool.normal(READY) == pytest.approx([0.0, 0.0, -1.0], abs=1e-9)
    assert base.normal(READY) == pytest.approx([1.0, 0.0, 0.0])


def test_states_outside_ranges_workspace_or_near_singularities_are_reported() -> None:
    parts = make_arm(SlipControlParameters(arm='fr3', workspace='0 0.5 -0.5 0.5 0 1'))
    assert parts is not None
    assert parts.check(READY) is None
    far = READY.copy()
    far[3] = -0.1
    assert 'fr3_joint4' in str(parts.check(far))
    turned = READY.copy()
    turned[0] = 2.5
    assert 'outside' in str(parts.check(turned))
    stretched = np.array([0.0, 0.0, 0.0, -0.2, 0.0, 0.6, 0.0])
    assert parts.check(stretched) is not None


def test_an_arm_from_a_file_plans(tmp_path: Path) -> None:
    path = tmp_path / 'arm.urdf'
    path.write_text(fr3_urdf())
    parts = make_arm(SlipControlParameters(arm=str(path)))
    assert parts is not None
    parts.planner.reset(READY, parts.normal(READY))
    planned = parts.planner.plan(10.0, 1e-4, parts.normal(READY))
    assert planned is not None
    moved = parts.arm.pose(planned.q[-1])[:3, 3] - parts.arm.pose(READY)[:3, 3]
    assert moved == pytest.approx([0.0, 0.0, -1e-4], abs=1e-7)


@pytest.mark.parametrize('kind', ['fr3', 'revolute', 'continuous'])
def test_what_plans_and_stops_has_run_once_before_it_is_needed(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = set()

    def noted(name: str) -> None:
        kernel = getattr(planning, name)

        def run(*given: object) -> object:
            ran.add(name)
            return kernel(*given)

        monkeypatch.setattr(planning, name, run)

    kernels = {'replan', 'joint_states', 'stopping_distance'}
    for name in kernels:
        noted(name)
    path = tmp_path / 'arm.urdf'
    path.write_text(fr3_urdf() if kind == 'fr3' else stretched(kind))
    parts = make_arm(SlipControlParameters(arm=str(path), joint_acceleration=0.1, lead=0.2))
    assert parts is not None
    assert ran == kernels
    assert parts.planner.path is None


@pytest.mark.parametrize(
    'bad',
    [
        {'arm': '/no/such/file.urdf'},
        {'arm': 'fr3', 'normal_z': 0.0},
        {'arm': 'fr3', 'workspace': '1 2 3'},
        {'arm': 'fr3', 'workspace': '1 0 0 1 0 1'},
    ],
)
def test_what_is_no_arm_is_refused(bad: dict[str, object]) -> None:
    with pytest.raises(SlipControlError):
        make_arm(SlipControlParameters(**bad))


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
def foreign_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install a package with a backend, as pip would."""
    (tmp_path / 'foreign_arm.py').write_text(FOREIGN)
    info = tmp_path / 'foreign_arm-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: foreign-arm\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text('[mixtac.arm_backends]\nforeign = foreign_arm:Arm\n')
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures('foreign_package')
def test_a_backend_of_another_package_is_found_by_its_entry_point() -> None:
    arm = SerialArm.fr3()
    parameters = SlipControlParameters(arm='fr3', arm_backend='foreign', arm_address='10.0.0.7')
    backend = open_backend(parameters, arm)
    assert (backend.address, backend.joints) == ('10.0.0.7', arm.names)
    with pytest.raises(BackendError) as caught:
        open_backend(SlipControlParameters(arm_backend='other'), arm)
    for name in ('trajectory', 'libfranka', 'foreign'):
        assert name in caught.value.remedy


def test_libfranka_asks_for_an_address() -> None:
    parameters = SlipControlParameters(arm='fr3', arm_backend='libfranka')
    with pytest.raises(BackendError) as caught:
        open_backend(parameters, SerialArm.fr3())
    assert 'arm_address' in caught.value.remedy


def test_joints_are_picked_by_name() -> None:
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


def test_trajectories_are_published() -> None:
    sent = []
    TrajectoryBackend(('a',), sent.append).send('trajectory')
    assert sent == ['trajectory']
