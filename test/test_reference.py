# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameter files hold the defaults, and every parameter is described."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
import yaml

from mixtac_core.node.parameters import build, specs

pytest.importorskip('diagnostic_msgs', reason='needs ROS 2')
ROOT = Path(__file__).resolve().parents[1]
TOOL = runpy.run_path(str(ROOT / 'tools' / 'write_reference.py'))


@pytest.mark.parametrize('node', TOOL['SCHEMAS'])
def test_parameter_files_hold_the_defaults(node: str):
    content = yaml.safe_load((ROOT / 'config' / f'{node}.yaml').read_text())
    schema = TOOL['SCHEMAS'][node]
    assert build(schema, content[f'/**/{node}']['ros__parameters']) == schema()


@pytest.mark.parametrize('node', TOOL['SCHEMAS'])
def test_every_parameter_is_described(node: str):
    assert all(spec.description for spec in specs(TOOL['SCHEMAS'][node]))
