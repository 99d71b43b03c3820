# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Values that the parts could not use are refused; the launch file names existing parameters."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import pytest

from mixtac_core.node.parameters import ParameterError, build, specs
from mixtac_slip_control.parameters import LAWS, SlipControlParameters

ROOT = Path(__file__).resolve().parents[3]
TREE = ast.parse((ROOT / 'launch' / 'slip_control.launch.py').read_text())


@pytest.mark.parametrize(
    'bad',
    [
        {'gain': -1.0},
        {'min_flow': 0.0},
        {'max_force': 0.0},
        {'force_share': 1.1},
        {'slip_force': math.nan},
        {'grip_margin': 0.9},
        {'max_total': 3e-3},
        {'lead': 5e-3},
        {'law': 'both'},
        {'gripper': 'suction'},
        {'normal': '0 0 0'},
        {'normal': '0 0'},
        {'normal': '0 0 up'},
        {'workspace': '1 2 3'},
        {'contact': '120'},
        {'controller': '/'},
    ],
)
def test_unusable_values_are_refused(bad: dict[str, object]) -> None:
    for make in (
        lambda: SlipControlParameters(**bad),  # type: ignore[arg-type]
        lambda: build(SlipControlParameters, bad),
    ):
        with pytest.raises(ParameterError) as caught:
            make()
        assert any(name in str(caught.value) for name in bad)


def test_text_gives_numbers() -> None:
    p = SlipControlParameters(normal='0 1.5 -2e-1', contact='120 90.5')
    assert p.normal_vector == (0.0, 1.5, -0.2)
    assert p.contact_place == (120.0, 90.5)
    assert SlipControlParameters().contact_place is None
    assert p.workspace_limits == (-0.8, 0.8, -0.8, 0.8, 0.0, 1.2)


def test_the_launch_file_leaves_the_parameters_as_they_are() -> None:
    found = [node for node in ast.walk(TREE) if isinstance(node, ast.Call)]
    arguments = {
        call.args[0].value: {k.arg: ast.literal_eval(k.value) for k in call.keywords}
        for call in found
        if isinstance(call.func, ast.Name)
        and call.func.id == 'DeclareLaunchArgument'
        and isinstance(call.args[0], ast.Constant)
    }
    assert {'arm', 'arm_backend', 'law', 'device'} == set(arguments)
    # Empty: the value of the parameter file, or else the default of the parameter.
    assert {each['default_value'] for each in arguments.values()} == {''}
    assert arguments['law']['choices'] == ['', *LAWS]


def test_the_other_arguments_of_the_launch_file_are_parameters() -> None:
    (names,) = (
        ast.literal_eval(node.value)
        for node in ast.walk(TREE)
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'PARAMETERS'
    )
    assert {'lead', 'joint_state_topic', 'normal_frame', 'max_force'} <= set(names)
    assert set(names) <= {spec.name for spec in specs(SlipControlParameters)}
