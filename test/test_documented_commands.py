# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every command that the README and the docs show exists, with the options it is shown with."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_core.node.topics import TOPICS
from mixtac_slip_control.parameters import SlipControlParameters

ROOT = Path(__file__).resolve().parents[1]
PAGES = [p for folder in ('.', 'docs', 'models', 'examples') for p in ROOT.glob(f'{folder}/*.md')]
FENCE = re.compile(r'^( *)```(?:bash|sh|shell|console)\n(.*?)^\1```', re.DOTALL | re.MULTILINE)
TOPIC_NAMES = {each.resolved('mixtac') for each in TOPICS}
OF_THE_ARM = ('/franka/', '/fr3_arm_controller/')
"""Where franka_ros2 publishes: its topics are not ours."""
SUBSCRIBED = {
    f'/mixtac/{SlipControlParameters().heartbeat_topic.replace("~", "slip_control")}': (
        'std_msgs/msg/Empty'
    )
}
"""What our nodes listen to and others publish, with its type."""
SERVICE_TYPES = {
    f'/mixtac/{name}': kind
    for name, kind in json.loads((ROOT / 'test' / 'interface.json').read_text())['services']
}


def commands() -> list[tuple[str, str]]:
    """Return page and text of each command of a shell block."""
    found = []
    for page in PAGES:
        for _, block in FENCE.findall(page.read_text()):
            for line in block.replace('\\\n', ' ').splitlines():
                text = re.sub(r'(^|\s)#.*', '', line).strip().removeprefix('$ ')
                parts = re.split(r'\s(?:&&|\||&)(?:\s|$)', text)
                found += [(page.name, part.strip()) for part in parts if part.strip()]
    return found


COMMANDS = commands()


def of(*starts: str) -> list:
    chosen = dict.fromkeys(each for each in COMMANDS if words_of(each[1])[0] in starts)
    return [pytest.param(text, id=f'{page}: {text}'[:90]) for page, text in chosen]


def words_of(text: str) -> list[str]:
    words = shlex.split(text)
    while words and re.match(r'^[A-Z_]+=', words[0]):
        words = words[1:]
    return words or ['export']


def check_mixtac(commands, words: list[str]) -> None:
    """Find the command and parse its options; numbers within their limits as well."""
    count = next((n for n in (2, 1) if ' '.join(words[:n]) in commands), 0)
    if not count:
        assert set(words[1:]) <= {'--help'}, f'no command {words}'
        assert any(name.startswith(f'{words[0]} ') for name in commands), f'no command {words}'
        return
    name, rest = ' '.join(words[:count]), words[count:]
    command = commands[name]
    context = command.context_class(command, info_name=name)
    values, _, _ = command.make_parser(context).parse_args(rest)
    for parameter in command.params:
        # Files need not exist here; numbers have to be numbers within their limits.
        if parameter.name in values and parameter.bare_type() in {'int', 'float'}:
            parameter.process_value(context, values[parameter.name])


@pytest.mark.parametrize('text', of('./mixtac', 'mixtac'))
def test_mixtac_takes_it(commands, text):
    check_mixtac(commands, [each for each in words_of(text)[1:] if each != '...'])


@pytest.mark.parametrize('text', of('make'))
def test_the_makefile_has_it(text):
    targets = re.findall(r'^(\w+):', (ROOT / 'Makefile').read_text(), re.MULTILINE)
    for word in words_of(text)[1:]:
        assert '=' in word or word in targets


def check_ros2(verb: str, words: list[str], launch_arguments) -> None:
    """Find the launch file, executable, topic, service or parameter that a command names."""
    if verb in {'launch', 'run'} and words[0].startswith('mixtac'):
        package, name, *arguments = words
        if verb == 'run':
            assert f"'{name} = " in (ROOT / 'src' / package / 'setup.py').read_text()
        else:
            given = {each.partition(':=')[0] for each in arguments}
            assert given <= {*launch_arguments(ROOT / 'launch' / name), '-s', '--show-args'}
    elif verb == 'topic' and words[0] == 'pub':
        name, kind = [each for each in words if '/' in each][:2]
        assert SUBSCRIBED[name] == kind
    elif verb == 'topic':
        topics = [each for each in words if each.startswith('/')]
        assert all(each in TOPIC_NAMES or each.startswith(OF_THE_ARM) for each in topics)
    elif verb == 'service':
        assert SERVICE_TYPES.get(words[1]) == words[2]
    elif verb == 'param':
        _, node, name, *_ = words
        (parameters,) = yaml.safe_load(
            (ROOT / 'config' / f'{node.rpartition("/")[2]}.yaml').read_text()
        ).values()
        assert name in parameters['ros__parameters']


@pytest.mark.parametrize('text', of('ros2'))
def test_ros2_finds_what_it_is_asked_for(text, launch_arguments):
    _, verb, *words = words_of(text)
    check_ros2(verb, words, launch_arguments)


@pytest.mark.parametrize('text', of('cp', 'sudo', 'source', '.', 'docker'))
def test_files_of_the_repository_exist(text):
    for word in words_of(text)[1:]:
        if re.match(r'^(src|tools|docker|config|launch)/', word):
            assert (ROOT / word).exists(), word
