# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every name that users rely on is still there: `interface.json` lists them.

Names may be added. A name that goes is taken out, and CHANGELOG.md says what to use instead.
"""

from __future__ import annotations

import importlib
import json
import re
import runpy
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_core.node.parameters import specs
from mixtac_core.node.topics import TOPICS

ROOT = Path(__file__).resolve().parents[1]
INTERFACE = json.loads((ROOT / 'test' / 'interface.json').read_text())


def options_of(command) -> set[str]:
    """Return the options and, in capitals, the arguments of a command."""
    found = set()
    for each in command.params:
        option = each.param_type_name == 'option'
        found |= {*each.opts, *each.secondary_opts} if option else {each.name.upper()}
    return found


@pytest.mark.parametrize('name', INTERFACE['commands'])
def test_every_command_is_there_with_its_options(commands, name):
    assert set(INTERFACE['commands'][name]) <= options_of(commands[name])


def table(heading: str) -> list[list[str]]:
    """Return the rows of a table of docs/reference.md, without backquotes and head."""
    page = (ROOT / 'docs' / 'reference.md').read_text()
    section = page.partition(f'\n## {heading}\n')[2].partition('\n## ')[0].replace('`', '')
    rows = [line for line in section.splitlines() if line.startswith('|')][2:]
    return [[cell.strip() for cell in row.split('|')[1:-1]] for row in rows]


def test_topics_and_services_keep_names_and_types():
    topics = {(each.name, each.type_name) for each in TOPICS}
    assert {tuple(each) for each in INTERFACE['topics']} <= topics
    services = {(name, kind) for name, kind, _ in table('Services')}
    assert {tuple(each) for each in INTERFACE['services']} <= services


def test_the_page_lists_every_topic_with_its_qos():
    assert [row[:3] for row in table('Topics')] == [
        [
            each.name,
            each.type_name,
            f'depth {each.depth}{", transient local" if each.latched else ""}',
        ]
        for each in TOPICS
    ]
    assert all(row[-1] for heading in ('Topics', 'Services') for row in table(heading))


@pytest.mark.parametrize('node', INTERFACE['parameters'])
def test_every_parameter_of_a_node_is_there(node):
    schema = runpy.run_path(str(ROOT / 'tools' / 'write_reference.py'))['SCHEMAS'][node]
    assert set(INTERFACE['parameters'][node]) <= {spec.name for spec in specs(schema)}


@pytest.mark.parametrize('file', INTERFACE['launch_arguments'])
def test_every_launch_argument_is_there(launch_arguments, file):
    wanted = set(INTERFACE['launch_arguments'][file])
    assert wanted <= set(launch_arguments(ROOT / 'launch' / file))


def test_every_executable_is_there_and_every_entry_point_can_be_loaded():
    text = ''.join(path.read_text() for path in ROOT.glob('src/*/setup.py'))
    assert set(INTERFACE['executables']) <= set(re.findall(r"'(\w+) = [\w.]+:main'", text))
    for module, name in re.findall(r"'[\w.:-]+ = ([\w.]+):(\w+)'", text):
        assert hasattr(importlib.import_module(module), name), f'{module}:{name}'
