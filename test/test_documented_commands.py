# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every command that the README and the docs show exists, with the options it is shown with."""

from __future__ import annotations

import itertools
import json
import re
import shlex
from functools import partial
from pathlib import Path

import pytest
import typer
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_core.node.topics import TOPICS
from mixtac_slip_control.parameters import SlipControlParameters

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    *(
        ROOT / name
        for name in ('README.md', 'CONTRIBUTING.md', 'models/README.md', 'examples/README.md')
    ),
    *sorted((ROOT / 'docs').glob('*.md')),
]
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
    """Return (page, command) of every line of every shell block."""
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


@pytest.mark.parametrize('words', [['up', '--fly'], ['up', '--seconds', 'banana'], ['levitate']])
def test_a_wrong_command_or_option_would_be_found(commands, words):
    with pytest.raises((typer.BadParameter.__base__, AssertionError)):
        check_mixtac(commands, words)


@pytest.mark.parametrize('text', of('make'))
def test_the_makefile_has_it(text):
    targets = re.findall(r'^(\w+):', (ROOT / 'Makefile').read_text(), re.MULTILINE)
    for word in words_of(text)[1:]:
        assert '=' in word or word in targets


def check_launch(launch_arguments, words: list[str]) -> None:
    package, file, *arguments = words
    if not package.startswith('mixtac'):
        return
    assert package == 'mixtac_bringup'
    known = launch_arguments(ROOT / 'launch' / file)
    for argument in arguments:
        name, found, _ = argument.partition(':=')
        assert name in known if found else argument in {'-s', '--show-args'}


def check_run(words: list[str]) -> None:
    package, executable, *_ = words
    if not package.startswith('mixtac'):
        return
    text = (ROOT / 'src' / package / 'setup.py').read_text()
    assert f"'{executable} = " in text


def check_topic(words: list[str]) -> None:
    verb, *rest = words
    assert verb in {'echo', 'hz', 'bw', 'info', 'list', 'delay', 'pub'}
    if verb == 'pub':
        name, kind = [each for each in rest if '/' in each][:2]
        assert SUBSCRIBED[name] == kind
        return
    topics = [each for each in rest if each.startswith('/')]
    assert all(each in TOPIC_NAMES or each.startswith(OF_THE_ARM) for each in topics)


def check_bag(words: list[str]) -> None:
    assert words[0] in {'record', 'info', 'play'}
    if words[0] == 'record':
        assert all(each in TOPIC_NAMES for each in words if each.startswith('/'))


def check_service(words: list[str]) -> None:
    verb, name, kind, *_ = words
    assert verb == 'call'
    assert SERVICE_TYPES.get(name) == kind


def check_param(words: list[str]) -> None:
    verb, node, name, *_ = words
    assert verb in {'set', 'get', 'describe'}
    file = ROOT / 'config' / f'{node.rpartition("/")[2]}.yaml'
    (parameters,) = yaml.safe_load(file.read_text()).values()
    assert name in parameters['ros__parameters']


@pytest.mark.parametrize('text', of('ros2'))
def test_ros2_finds_what_it_is_asked_for(text, launch_arguments):
    _, verb, *rest = words_of(text)
    checks = {
        'launch': partial(check_launch, launch_arguments),
        'run': check_run,
        'topic': check_topic,
        'bag': check_bag,
        'service': check_service,
        'param': check_param,
    }
    if verb not in ('lifecycle', 'security'):
        checks[verb](rest)


@pytest.mark.parametrize('text', of('docker'))
def test_docker_is_given_files_and_profiles_that_exist(text):
    words = words_of(text)
    for option, value in itertools.pairwise(words):
        if option == '-f':
            assert (ROOT / value).is_file()
        if option == '--profile':
            services = yaml.safe_load((ROOT / 'docker' / 'compose.yaml').read_text())['services']
            assert value in {each for one in services.values() for each in one['profiles']}


@pytest.mark.parametrize('text', of('cp', 'sudo', 'source', '.'))
def test_files_of_the_repository_exist(text):
    for word in words_of(text)[1:]:
        if re.match(r'^(src|tools|docker|config|launch)/', word):
            assert (ROOT / word).exists(), word
