# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arm that the parameters name; backends by name, built in or from another package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from mixtac_core.events.errors import MixtacError
from mixtac_slip_control.arm.kinematics import SerialArm, fr3_urdf
from mixtac_slip_control.arm.model import (
    TrajectoryBackend,
    make_arm,
    open_backend,
    unsafe_setting,
)
from mixtac_slip_control.errors import BackendError
from mixtac_slip_control.parameters import SlipControlParameters

READY = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])


def test_none_is_no_arm() -> None:
    assert make_arm(SlipControlParameters()) is None


def test_the_normal_turns_with_the_tool() -> None:
    tool = make_arm(SlipControlParameters(arm='fr3', normal='0 0 2'))
    base = make_arm(SlipControlParameters(arm='fr3', normal_frame='base', normal='1 0 0'))
    assert tool is not None
    assert base is not None
    # In its ready pose the flange of the FR3 looks straight down.
    assert tool.normal(READY) == pytest.approx([0.0, 0.0, -1.0], abs=1e-9)
    assert base.normal(READY) == pytest.approx([1.0, 0.0, 0.0])


def test_an_arm_from_a_file_plans(tmp_path: Path) -> None:
    path = tmp_path / 'arm.urdf'
    path.write_text(fr3_urdf())
    parts = make_arm(SlipControlParameters(arm=str(path)))
    assert parts is not None
    parts.planner.reset(READY, parts.normal(READY))
    planned = parts.planner.plan(10.0, 1e-4)
    assert planned is not None
    moved = parts.arm.pose(planned.q[-1])[:3, 3] - parts.arm.pose(READY)[:3, 3]
    assert moved == pytest.approx([0.0, 0.0, -1e-4], abs=1e-7)


@pytest.mark.parametrize(
    'bad',
    [
        {'arm': '/no/such/file.urdf'},
        {'arm': 'fr3', 'normal': '0 0 0'},
        {'arm': 'fr3', 'workspace': '1 2 3'},
        {'arm': 'fr3', 'workspace': '1 0 0 1 0 1'},
    ],
)
def test_what_is_no_arm_is_refused(bad: dict[str, object]) -> None:
    with pytest.raises(MixtacError):
        make_arm(SlipControlParameters(**bad))


FOREIGN = """
from mixtac_slip_control.arm.model import ArmBackend

class Arm(ArmBackend):
    def __init__(self, parameters, arm):
        self.lead, self.joints = parameters.lead, arm.names
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
    parameters = SlipControlParameters(arm='fr3', arm_backend='foreign', lead=8e-3)
    backend = open_backend(parameters, arm)
    assert (backend.lead, backend.joints) == (8e-3, arm.names)
    backend.stop()
    with pytest.raises(BackendError) as caught:
        open_backend(SlipControlParameters(arm_backend='other'), arm)
    for name in ('trajectory', 'foreign'):
        assert name in caught.value.remedy


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


SAFE = {
    'interpolate_from_desired_state': True,
    'allow_trajectory_replacement': False,
    'positions_upsampling.enable': False,
    'set_last_command_interface_value_as_state_on_activation': False,
    'interpolation_method': 'splines',
}


@pytest.mark.parametrize(
    ('change', 'named'),
    [
        ({}, ''),
        ({'allow_trajectory_replacement': True}, 'allow_trajectory_replacement'),
        ({'positions_upsampling.enable': True}, 'positions_upsampling.enable'),
        ({'interpolation_method': 'none'}, 'interpolation_method'),
        ({'interpolate_from_desired_state': False}, 'interpolate_from_desired_state'),
        # Kilted and Jazzy have no replacement and no upsampling; Jazzy has the last name, too.
        ({'allow_trajectory_replacement': None, 'positions_upsampling.enable': None}, ''),
        ({'interpolate_from_desired_state': None, 'open_loop_control': True}, ''),
        ({'interpolate_from_desired_state': None}, 'interpolate_from_desired_state'),
        (
            {'set_last_command_interface_value_as_state_on_activation': True},
            'set_last_command_interface_value_as_state_on_activation',
        ),
    ],
)
def test_an_unsafe_parameter_of_the_controller_is_named(
    change: dict[str, object], named: str
) -> None:
    found = unsafe_setting(SAFE | change)
    assert bool(found) == bool(named)
    assert named in found


def test_the_shipped_yaml_has_the_safe_settings() -> None:
    path = Path(__file__).resolve().parents[4] / 'config' / 'franka' / 'fr3_controllers.yaml'
    shipped = yaml.safe_load(path.read_text())['/**']['fr3_arm_controller']['ros__parameters']
    flat = {'positions_upsampling.enable': shipped['positions_upsampling']['enable'], **shipped}
    assert {name: flat[name] for name in SAFE} == SAFE
    assert unsafe_setting(flat) == ''
