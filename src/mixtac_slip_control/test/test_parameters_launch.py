# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The launch file names what exists; read as text, so that it is held to it without ROS."""

from __future__ import annotations

import ast
from pathlib import Path

from mixtac_node.graph import slip_control
from mixtac_node.parameters import specs
from mixtac_slip_control.parameters import DETECTORS, SlipControlParameters

ROOT = Path(__file__).resolve().parents[3]
TREE = ast.parse((ROOT / 'launch' / 'slip_control.launch.py').read_text())


def calls(name: str) -> list[ast.Call]:
    found = [node for node in ast.walk(TREE) if isinstance(node, ast.Call)]
    return [node for node in found if isinstance(node.func, ast.Name) and node.func.id == name]


def keywords(call: ast.Call) -> dict[str | None, object]:
    return {
        k.arg: ast.literal_eval(k.value)
        for k in call.keywords
        if isinstance(k.value, (ast.Constant, ast.List))
        and all(isinstance(e, ast.Constant) for e in getattr(k.value, 'elts', []))
    }


def test_the_node_that_it_starts_exists() -> None:
    node = slip_control({'arm': 'none', 'detector': 'flow'})
    assert node.package == 'mixtac_slip_control'
    setup = (ROOT / 'src' / 'mixtac_slip_control' / 'setup.py').read_text()
    assert f"'{node.executable} = mixtac_slip_control.slip_control_node:main'" in setup


def test_its_arguments_leave_the_parameters_as_they_are() -> None:
    calls_by_name = [
        c for c in calls('DeclareLaunchArgument') if isinstance(c.args[0], ast.Constant)
    ]
    arguments = {c.args[0].value: keywords(c) for c in calls_by_name}
    assert {'arm', 'arm_backend', 'detector', 'device'} == set(arguments)
    # Empty: what the parameter file says, or else the parameter's own default.
    assert {each['default_value'] for each in arguments.values()} == {''}
    assert arguments['detector']['choices'] == ['', *DETECTORS]


def test_its_other_arguments_are_parameters() -> None:
    (names,) = (
        ast.literal_eval(node.value)
        for node in ast.walk(TREE)
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'PARAMETERS'
    )
    assert {'lead', 'joint_state_topic', 'normal_frame', 'max_force'} <= set(names)
    assert set(names) <= {spec.name for spec in specs(SlipControlParameters)}
