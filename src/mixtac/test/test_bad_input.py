# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bad values for every parameter of every command: one line on stderr, no traceback, no process."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac.main import main
from mixtac_core.node.process import GraphError
from mixtac_core.recordings.bag import blank_message, typestore
from mixtac_core.recordings.bag_writer import McapBag

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

TOPICS = {
    '/mixtac/events': 'event_camera_msgs/msg/EventPacket',
    '/mixtac/image_raw': 'sensor_msgs/msg/Image',
    '/mixtac/camera_clock': 'sensor_msgs/msg/TimeReference',
    '/ft_sensor/wrench': 'geometry_msgs/msg/WrenchStamped',
}
NOT_UTF8 = b'no\xff\xfe'.decode('utf8', 'surrogateescape')
PATHS = ('nowhere', 'empty', 'junk', 'folder', 'deep.yaml', 'latin.yaml', 'list.yaml', 'typo.yaml')
PATHS += ('x.mcap', 'x.db3', 'x.aedat4', 'x.safetensors', 'short', 'wild', 'a' * 300, NOT_UTF8, '')
OPTIONS = ('nowhere', 'empty', 'folder', 'deep.yaml', 'latin.yaml', 'typo.yaml', NOT_UTF8, '')
OUTPUTS = ('empty/below', 'folder', 'a' * 300, '')
COMPUTING = ('experiments', 'train', 'evaluate', 'simulate', 'demo')
"""Commands that work without a recording: values that they take would start the work."""


def bag(path: Path, change: Any) -> None:
    types = typestore()
    with McapBag(path) as writer:
        handles = {t: writer.add_connection(t, k, typestore=types) for t, k in TOPICS.items()}
        for number in range(20):
            for topic, kind in TOPICS.items():
                data = bytes(types.serialize_cdr(blank_message(kind), kind))
                writer.write(handles[topic], 10**18 + number, change(data))


@pytest.fixture(scope='module')
def inputs(tmp_path_factory) -> Path:
    folder: Path = tmp_path_factory.mktemp('inputs')
    rng = np.random.default_rng(0)
    contents = {
        'empty': b'',
        'junk': rng.bytes(3000),
        'deep.yaml': b'[' * 3000,
        'latin.yaml': 'größe: 1'.encode('latin1'),
        'list.yaml': b'- 1',
        'typo.yaml': b'/**/fger:\n  ros__parameters:\n    force_scal: 2.0\n',
        'x.mcap': b'\x89MCAP0\r\n' + rng.bytes(500),
        'x.db3': b'SQLite format 3\0' + rng.bytes(5000),
        'x.aedat4': rng.bytes(2000),
        'x.safetensors': (1 << 62).to_bytes(8, 'little') + b'{}',
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    (folder / 'folder').mkdir()
    bag(folder / 'short', lambda data: data[: int(rng.integers(len(data)))])
    bag(folder / 'wild', lambda data: data[:4] + rng.bytes(len(data) - 4))
    return folder


def kind(parameter: Any) -> str:
    annotation = str(parameter.type_descriptor.annotation)
    return next((name for name in ('Path', 'int', 'float', 'bool') if name in annotation), 'str')


def calls(words: str, command: Any) -> Iterator[list[str]]:
    """Yield command lines of a command, each with one bad value."""
    required = [p for p in command.params if p.required]

    def line(parameter: Any, value: str) -> list[str]:
        found = words.split()
        for each in [*required, *([] if parameter in required else [parameter])]:
            text = value if each is parameter else 'wild' if kind(each) == 'Path' else 'csv'
            text = 'new' if each is not parameter and each.name == 'out' else text
            found += [text] if each.param_type_name == 'argument' else [each.opts[-1], text]
        return found

    computing = words.partition(' ')[0] in COMPUTING
    for parameter in command.params:
        if parameter.name == 'help' or kind(parameter) == 'bool':
            continue
        if kind(parameter) in {'int', 'float'}:
            yield line(parameter, 'abc')
        elif computing and parameter.name != 'json':
            continue
        elif kind(parameter) == 'Path':
            values = PATHS if parameter.param_type_name == 'argument' else OPTIONS
            if parameter.name in {'out', 'json', 'figures', 'figure'}:
                values = OUTPUTS
            yield from (line(parameter, value) for value in values)
        else:
            yield from (line(parameter, value) for value in ('', '/no such', NOT_UTF8))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_no_command_ends_in_a_traceback(commands, inputs, tmp_path, monkeypatch, capsys):
    def refuse(*_: object, **__: object) -> None:
        raise GraphError('no process in this test')

    monkeypatch.setattr('mixtac_core.node.process.ProcessGroup.start', refuse)
    monkeypatch.setattr('rclpy.init', refuse)
    monkeypatch.setenv('MIXTAC_HOME', str(tmp_path / 'home'))
    work = tmp_path / 'work'
    shutil.copytree(inputs, work)
    monkeypatch.chdir(work)
    count = 0
    for words, command in commands.items():
        for line in calls(words, command):
            shutil.rmtree(work / 'new', ignore_errors=True)
            try:
                status = main(line)
            except SystemExit as leave:
                status = leave.code
            errors = capsys.readouterr().err
            assert status in {0, 1, 2}, line
            assert 'Traceback' not in errors, line
            count += 1
    assert count > 300
