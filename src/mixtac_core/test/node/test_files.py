# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files written whole or not at all, and read into checked dataclasses."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from mixtac_core.node.files import (
    FileError,
    new_folder,
    read_dataclass,
    replacing,
    state_file,
    structure,
    writable,
    write_json,
    write_text,
)


@dataclass(frozen=True)
class Part:
    count: int = 1
    mode: str = 'fast'


@dataclass(frozen=True)
class Config:
    rate: float
    part: Part = field(default_factory=Part)
    steps: tuple[float, ...] = ()
    limit: int | None = None
    parts: list[Part] = field(default_factory=list)
    gains: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.rate < 0:
            raise ValueError(f'rate {self.rate} is negative')


def test_a_file_appears_whole_with_its_folder(tmp_path):
    path = tmp_path / 'new' / 'data.json'
    write_json(path, {'a': [1, 2]})
    assert json.loads(path.read_text()) == {'a': [1, 2]}
    assert [each.name for each in path.parent.iterdir()] == ['data.json']
    with replacing(tmp_path / 'x.npz') as scratch:
        assert scratch.suffix == '.npz'
        scratch.touch()


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / 'data.txt'
    write_text(path, 'old')
    with pytest.raises(TypeError), replacing(path) as scratch:
        scratch.write_text(3)
    assert [each.read_text() for each in tmp_path.iterdir()] == ['old']


def test_a_link_stays_one_and_its_file_is_replaced(tmp_path):
    (tmp_path / 'shared').mkdir()
    link, file = tmp_path / 'data.txt', tmp_path / 'shared' / 'kept.txt'
    link.symlink_to(file)
    for text in ('new', 'newer'):
        write_text(link, text)
        assert link.is_symlink()
        assert file.read_text() == text
    assert list(file.parent.iterdir()) == [file]


def fill_and_stop(path):
    with new_folder(path) as made:
        made.mkdir()
        raise KeyboardInterrupt


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / 'new' / 'folder'
    with new_folder(path) as made:
        made.mkdir()
        (made / 'file').write_text('content')
        assert not path.exists()
    assert (path / 'file').read_text() == 'content'
    with pytest.raises(KeyboardInterrupt):
        fill_and_stop(path.parent / 'other')
    assert list(path.parent.iterdir()) == [path]
    with pytest.raises(FileError) as caught, new_folder(path):
        pass
    assert caught.value.remedy


def test_an_unwritable_place_is_named(tmp_path):
    (tmp_path / 'file').touch()
    path = tmp_path / 'file' / 'below.json'
    with pytest.raises(FileError) as caught:
        write_json(path, {})
    assert str(path) in str(caught.value)
    assert caught.value.remedy
    with pytest.raises(FileError):
        read_dataclass(tmp_path / 'none.yaml', Config)


def test_yaml_becomes_a_dataclass(tmp_path):
    path = tmp_path / 'config.yaml'
    path.write_text(
        'rate: 2\npart: {count: 3, mode: slow}\nsteps: [1, 2.5]\nlimit: 4\n'
        'parts: [{count: 5}]\ngains: {a: 1}\n'
    )
    assert read_dataclass(path, Config) == Config(
        2.0, Part(3, 'slow'), (1.0, 2.5), 4, [Part(5)], {'a': 1.0}
    )


@pytest.mark.parametrize(
    ('data', 'named'),
    [
        ({'rat': 1.0}, ('rat', 'rate')),
        ({}, ('rate',)),
        ({'rate': '1'}, ('rate', "'1'")),
        ({'rate': True}, ('rate', 'True')),
        ({'rate': -1.0}, ('-1.0',)),
        ({'rate': 1.0, 'part': {'count': 2.5}}, ('part', 'count', '2.5')),
        ({'rate': 1.0, 'part': {'cuont': 2}}, ('part', 'cuont', 'count')),
        ({'rate': 1.0, 'parts': [{'other': 1}]}, ('parts', 'other')),
        ({'rate': 1.0, 'gains': [1]}, ('gains',)),
        ({'rate': 1.0, 'steps': 3}, ('steps',)),
        ([], ('[]',)),
        (None, ('None',)),
    ],
)
def test_wrong_content_is_refused_with_its_place(data, named):
    with pytest.raises(FileError) as caught:
        structure(data, Config, 'config.yaml')
    assert all(each in str(caught.value) for each in ('config.yaml', *named))


@pytest.mark.parametrize('content', [b'a: [', b'\xe9: 1', b'[' * 3000, b'a: b: c'])
def test_a_file_that_is_not_yaml_is_refused(tmp_path, content):
    path = tmp_path / 'config.yaml'
    path.write_bytes(content)
    with pytest.raises(FileError) as caught:
        read_dataclass(path, Config)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize('name', ['', 'folder', 'file/below', 'a' * 300, 'pipe', 'device'])
def test_what_cannot_be_written_is_refused_before_the_work(tmp_path, name):
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'file').touch()
    os.mkfifo(tmp_path / 'pipe')
    (tmp_path / 'device').symlink_to(os.devnull)
    with pytest.raises(FileError):
        writable(tmp_path / name)
    path = tmp_path / 'new' / 'x.json'
    assert writable(path) == path
    assert not path.parent.exists()


def test_plain_names_lie_in_the_state_folder(tmp_path, monkeypatch):
    monkeypatch.setenv('MIXTAC_HOME', str(tmp_path))
    assert state_file('left.npz') == tmp_path / 'left.npz'
    assert state_file(str(tmp_path / 'left.npz')) == tmp_path / 'left.npz'


def test_the_folder_is_that_of_the_user(monkeypatch):
    monkeypatch.delenv('MIXTAC_HOME', raising=False)
    monkeypatch.setenv('XDG_STATE_HOME', '/var/state')
    assert state_file('a') == Path('/var/state/mixtac/a')
    monkeypatch.delenv('XDG_STATE_HOME')
    assert state_file('a') == Path.home() / '.local/state/mixtac/a'


@pytest.mark.parametrize(
    'name', ['', '.', '..', '../a', '/etc/passwd', 'a/b', '.hidden', 'a b', 'a\n']
)
def test_other_names_are_refused(tmp_path, monkeypatch, name):
    monkeypatch.setenv('MIXTAC_HOME', str(tmp_path))
    with pytest.raises(FileError) as caught:
        state_file(name)
    assert caught.value.remedy
