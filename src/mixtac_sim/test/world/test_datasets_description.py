# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The file beside the bags."""

from __future__ import annotations

from dataclasses import replace

import pytest
import yaml

from mixtac_recordings.dataset import FILE_NAME, DatasetDescription, DatasetError
from mixtac_sim.world.plans import describe, plan_dataset


@pytest.fixture
def description() -> DatasetDescription:
    return describe('static', 3, 'hard', 'trial', plan_dataset('static', 3, 'hard'))


def test_what_is_written_is_read(tmp_path, description):
    written = replace(description, complete=True)
    written.write(tmp_path)
    assert DatasetDescription.read(tmp_path) == written
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]


def test_the_file_says_everything_that_the_trials_depend_on(tmp_path, description):
    description.write(tmp_path)
    document = yaml.safe_load((tmp_path / FILE_NAME).read_text())
    assert document['schema'] == 'mixtac-dataset'
    assert document['schema_version'] == 1
    assert document['simulated'] is True
    assert document['complete'] is False
    assert len(document['generator']['digest']) == 16
    assert document['trials'][0] == {
        'name': 'trial_000',
        'profile': 'static',
        'seconds': 25.0,
        'device_seed': 1_003_000,
        'trial_seed': 1_003_000,
        'preset': 'hard',
        'split': document['trials'][0]['split'],
    }


def test_splits_are_disjoint_and_whole(description):
    train, test = description.split('train'), description.split('test')
    assert (len(train), len(test)) == (24, 6)
    assert {each.name for each in (*train, *test)} == {each.name for each in description.trials}


def test_other_trials_or_another_simulator_are_told_apart(description):
    assert description.same_trials_as(replace(description, complete=True))
    fewer = replace(description, trials=description.trials[1:])
    assert not description.same_trials_as(fewer)
    other = replace(description, generator={**description.generator, 'digest': '0'})
    assert not description.same_trials_as(other)


@pytest.mark.parametrize(
    'text',
    [
        '{',
        'a: 1',
        'schema: mixtac-dataset\nschema_version: 2',
        'schema: mixtac-dataset\nschema_version: 1',
        'schema: mixtac-dataset\nschema_version: 1\ntrials: [{name: a}]',
        'schema: mixtac-dataset\nschema_version: 1\ntrials: 3',
    ],
)
def test_other_files_are_refused(tmp_path, text):
    (tmp_path / FILE_NAME).write_text(text)
    with pytest.raises(DatasetError):
        DatasetDescription.read(tmp_path)


def test_no_file_is_refused(tmp_path):
    with pytest.raises(DatasetError, match=FILE_NAME):
        DatasetDescription.read(tmp_path)
