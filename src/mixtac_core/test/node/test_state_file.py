# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files that nodes may write by the name in a parameter lie in one folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from mixtac_core.node.files import FileError, state_file


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
