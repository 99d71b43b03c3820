# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The structure check accepts the tree and finds each fault it is there for."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HEADER = '# SPDX-FileCopyrightText: 2026 A\n# SPDX-License-Identifier: Apache-2.0\n'


def checker(root: Path = ROOT):
    tool = runpy.run_path(str(ROOT / 'tools' / 'check_layers.py'))
    for function in ('main', 'check_module', 'check_manifest'):
        tool[function].__globals__['ROOT'] = root
    return tool['main']


def test_the_tree_is_in_order(capsys: pytest.CaptureFixture[str]):
    assert checker()() == 0, capsys.readouterr().out


@pytest.mark.parametrize(
    ('name', 'text', 'complaint'),
    [
        ('core.py', 'import mixtac_driver\n', 'not on a lower floor'),
        ('core.py', 'from mixtac_node.graph import x\n', 'not on a lower floor'),
        ('core.py', 'def f():\n    import rclpy.qos\n', 'only *_node.py'),
        ('core.py', 'x = 1\n' * 301, 'split it'),
        ('core.py', 'import pickle\npickle.load(f)\n', 'can run code'),
        ('a_node.py', 'import mixtac_node\n', 'not declared'),
    ],
)
def test_each_fault_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, text: str, complaint: str
):
    package = tmp_path / 'src' / 'mixtac_sim'
    (package / 'mixtac_sim').mkdir(parents=True)
    (package / 'package.xml').write_text('<package/>')
    (package / 'mixtac_sim' / name).write_text(HEADER + text)
    assert checker(tmp_path)() == 1
    assert complaint in capsys.readouterr().out


def test_a_missing_header_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    package = tmp_path / 'src' / 'mixtac_sim'
    (package / 'mixtac_sim').mkdir(parents=True)
    (package / 'package.xml').write_text('<package/>')
    (package / 'mixtac_sim' / 'core.py').write_text('x = 1\n')
    assert checker(tmp_path)() == 1
    assert 'SPDX' in capsys.readouterr().out


def test_a_circle_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    package = tmp_path / 'src' / 'mixtac_sim'
    (package / 'mixtac_sim').mkdir(parents=True)
    (package / 'package.xml').write_text('<package/>')
    for one, other in (('a', 'b'), ('b', 'a')):
        text = f'{HEADER}import mixtac_sim.{other}\n'
        (package / 'mixtac_sim' / f'{one}.py').write_text(text)
    assert checker(tmp_path)() == 1
    assert 'circle' in capsys.readouterr().out
