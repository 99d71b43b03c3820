# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""dataset.yaml beside recorded bags."""

from __future__ import annotations

import multiprocessing
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from mixtac_core.events.errors import MixtacError
from mixtac_core.recordings.dataset import add_recording

if TYPE_CHECKING:
    from pathlib import Path

LACKING = 'schema: mixtac-recordings\nschema_version: 1\n'
FIGURES = {'seconds': 2.0, 'simulated': True, 'not_written': 1, 'not_arrived': 3}


def test_each_recording_is_one_entry_and_the_same_name_replaces(tmp_path: Path):
    for name, split in (('a', 'train'), ('b', 'test'), ('a', 'test')):
        path = add_recording(tmp_path / name, FIGURES, profile='static', split=split)
    document = yaml.safe_load(path.read_text())
    assert [(each['name'], each['split']) for each in document['trials']] == [
        ('b', 'test'),
        ('a', 'test'),
    ]
    first = document['trials'][0]
    assert (first['simulated'], first['not_written'], first['not_arrived']) == (True, 1, 3)


def _record(path: Path, barrier: Any) -> None:
    barrier.wait()
    add_recording(path, FIGURES, profile='', split='')


@pytest.mark.parametrize('linked', [False, True])
def test_recordings_that_end_together_are_all_kept(tmp_path: Path, linked: bool):
    context = multiprocessing.get_context('fork')
    barrier, names = context.Barrier(4), [f'bag{k}' for k in range(4)]
    bags = [tmp_path / name / name if linked else tmp_path / name for name in names]
    for bag in bags if linked else ():
        bag.parent.mkdir()
        (bag.parent / 'dataset.yaml').symlink_to(tmp_path / 'dataset.yaml')
    ended = [context.Process(target=_record, args=(bag, barrier)) for bag in bags]
    for each in ended:
        each.start()
    for each in ended:
        each.join()
    document = yaml.safe_load((tmp_path / 'dataset.yaml').read_text())
    assert sorted(each['name'] for each in document['trials']) == names


@pytest.mark.parametrize(
    'text', ['schema: mixtac-dataset', '[1', 'schema: mixtac-recordings', LACKING]
)
def test_another_file_of_that_name_is_left_alone(tmp_path: Path, text: str):
    path = tmp_path / 'dataset.yaml'
    path.write_text(text)
    with pytest.raises(MixtacError) as caught:
        add_recording(tmp_path / 'a', FIGURES, profile='', split='')
    assert str(path) in str(caught.value)
    assert path.read_text() == text
