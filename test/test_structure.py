# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The structure check finds each fault that it is there for, and accepts imports downwards."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'tools'))
TOOL = runpy.run_path(str(ROOT / 'tools' / 'check_house.py'))
HEADER = '# SPDX-FileCopyrightText: 2026 A\n# SPDX-License-Identifier: Apache-2.0\n'
NO_CODE = ('mixtac_msgs', 'event_camera_msgs', 'mixtac_bringup')


def faults(root: Path) -> list[str]:
    return TOOL['check'](root, TOOL['read_modules'](root))


def write_package(root: Path, package: str, declared: tuple[str, ...] = (), **modules: str) -> Path:
    """Write a package whose modules have these texts; `__` in a name stands for a folder."""
    folder = root / 'src' / package
    for name, text in modules.items():
        path = folder / package / f'{name.replace("__", "/")}.py'
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text.removeprefix('!') if text.startswith('!') else HEADER + text)
    depends = ''.join(f'<exec_depend>{each}</exec_depend>' for each in declared)
    head = f'<name>{package}</name><version>1.0.0</version><description/><maintainer/>'
    text = f'<package format="3">{head}<license>MIT</license>{depends}</package>'
    (folder / 'package.xml').write_text(text)
    return root


@pytest.mark.parametrize(
    ('package', 'module', 'text', 'complaint'),
    [
        ('mixtac_fger', 'core', 'import mixtac_driver\n', 'not on a lower floor'),
        ('mixtac_driver', 'core', 'from mixtac.main import x\n', 'not on a lower floor'),
        ('mixtac_sim', 'core', 'def f():\n    import rclpy.qos\n', 'only *_node.py'),
        ('mixtac_fger', 'core', 'def f():\n    import torch\n', 'not installed on robots'),
        ('mixtac_driver', 'core', 'import matplotlib.pyplot\n', 'not installed on robots'),
        ('mixtac_core', 'core', 'import mixtac_sim.device\n', 'not installed on robots'),
        ('mixtac_sim', 'core', 'x = 1\n' * 401, 'code lines'),
        ('mixtac_sim', 'core', 'import pickle\npickle.load(f)\n', 'can run code'),
        ('mixtac_sim', 'a_node', 'import mixtac_core\n', 'not declared'),
        ('mixtac_sim', 'core', 'A, B = 1, 2\n', 'sentence of its own'),
        ('mixtac_sim', 'core', 'A = 1, 2\n', 'sentence of its own'),
        ('mixtac_sim', 'core', '!x = 1\n', 'SPDX'),
        ('mixtac_sim', 'a_node', 'async def f(): ...\n', 'use a timer'),
        ('Mixtac', 'core', '', 'is not valid'),
    ],
)
def test_each_fault_is_found(tmp_path, package, module, text, complaint):
    found = faults(write_package(tmp_path, package, **{module: text}))
    assert any(complaint in fault for fault in found), found


@pytest.mark.parametrize('text', ['', '<url/><version/>', '<export/><depend>a</depend>'])
def test_a_manifest_against_the_schema_is_found(tmp_path, text):
    path = write_package(tmp_path, 'mixtac_sim', core='') / 'src' / 'mixtac_sim' / 'package.xml'
    assert TOOL['check_schema'](path) == []
    whole = path.read_text().replace('</package>', f'{text}</package>')
    path.write_text(whole if text else whole.replace('<maintainer/>', ''))
    assert any('package_format3' in fault for fault in TOOL['check_schema'](path))


def test_a_package_above_its_ceiling_is_found(tmp_path):
    root = write_package(tmp_path, 'mixtac_sim', core='x = 1\n' * 3)
    modules = TOOL['read_modules'](root)
    assert TOOL['check_ceilings'](modules, {'mixtac_sim': 3}) == []
    assert len(TOOL['check_ceilings'](modules, {'mixtac_sim': 2})) == 1
    listed = TOOL['project_file']()['tool']['mixtac']['ceilings']
    assert set(listed) == {name for name in TOOL['FLOORS'] if name not in NO_CODE}


CIRCLE_FOR_TYPES = (
    'from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from mixtac_sim.b import B\n'
)


@pytest.mark.parametrize(
    'modules',
    [
        {'a': 'import mixtac_sim.b\n', 'b': 'import mixtac_sim.a\n'},
        {'a': CIRCLE_FOR_TYPES, 'b': 'import mixtac_sim.a\n'},
        # No circle of modules, but one of folders.
        {
            'one__a': 'import mixtac_sim.two.b\n',
            'two__b': '',
            'two__c': 'import mixtac_sim.one.d\n',
            'one__d': '',
        },
    ],
    ids=['run', 'types', 'folders'],
)
def test_a_circle_is_found(tmp_path, modules):
    found = faults(write_package(tmp_path, 'mixtac_sim', **modules))
    assert any('circle' in fault for fault in found), found


def test_imports_downwards_are_accepted(tmp_path):
    modules = {'one__a': 'import mixtac_sim.two.b\n', 'two__b': 'import mixtac_core.node.files\n'}
    assert faults(write_package(tmp_path, 'mixtac_sim', ('mixtac_core',), **modules)) == []
