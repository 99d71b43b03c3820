# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Named data sets: their numbers, their seeds, their splits, and the file beside the bags."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import combinations

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.errors import MixtacError
from mixtac_core.recordings.dataset import FILE_NAME, DatasetDescription
from mixtac_sim import SimulationError
from mixtac_sim.world.plans import DATASETS, describe, plan_dataset, plan_profile, split_groups


@pytest.mark.parametrize(
    ('name', 'trials', 'seconds'),
    [('static', 30, 25.0), ('long_term', 10, 25.0), ('dynamic', 30, 25.0), ('impact', 30, 4.25)],
)
def test_numbers_of_the_paper(name, trials, seconds):
    planned = plan_dataset(name)
    assert [spec.seconds for spec in planned] == [seconds] * trials
    assert Counter(spec.split for spec in planned) == {
        'train': trials * 8 // 10,
        'test': trials * 2 // 10,
    }
    assert len({spec.device_seed for spec in planned}) == 1
    assert len({spec.trial_seed for spec in planned}) == trials


def test_new_gel_is_split_by_device():
    planned = plan_dataset('new_gel')
    devices = {
        split: {spec.device_seed for spec in planned if spec.split == split}
        for split in ('train', 'test')
    }
    assert (len(devices['train']), len(devices['test'])) == (8, 2)
    assert not devices['train'] & devices['test']
    for device in devices['train'] | devices['test']:
        profiles = {spec.profile for spec in planned if spec.device_seed == device}
        assert profiles == set(DATASETS['new_gel'].profiles)


def test_seeds_of_data_sets_never_meet():
    used = [
        {spec.trial_seed for spec in plan_dataset(name, seed)}
        for name in DATASETS
        for seed in (0, 1, 899)
    ]
    used.append({spec.trial_seed for spec in plan_profile('dynamic', 1000, 25.0)})
    assert all(not one & other for one, other in combinations(used, 2))
    devices = [{spec.device_seed for spec in plan_dataset('new_gel', seed)} for seed in (0, 1, 899)]
    assert all(not one & other for one, other in combinations(devices, 2))
    assert max(max(each) for each in devices) < 10_000_000


@given(st.integers(2, 500), st.integers(0, 2**32))
def test_a_split_is_eight_to_two(count, seed):
    tests = Counter(split_groups(count, seed))['test']
    assert abs(tests - 0.2 * count) <= 0.5 or tests == 1
    assert split_groups(count, seed) == split_groups(count, seed)


@pytest.mark.parametrize(
    'call',
    [
        lambda: plan_dataset('no_such'),
        lambda: plan_dataset('static', 900),
        lambda: plan_dataset('static', -1),
        lambda: plan_profile('no_such', 1, 5.0),
        lambda: plan_profile('press', 0, 5.0),
        lambda: plan_profile('press', 1001, 5.0),
    ],
)
def test_what_cannot_be_planned_is_refused(call):
    with pytest.raises(SimulationError):
        call()


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
        'schema: mixtac-dataset\nschema_version: 2',
        'schema: mixtac-dataset\nschema_version: 1\ntrials: [{name: a}]',
        'schema: mixtac-dataset\nschema_version: 1\ntrials: 3',
    ],
)
def test_other_files_are_refused(tmp_path, text):
    (tmp_path / FILE_NAME).write_text(text)
    with pytest.raises(MixtacError):
        DatasetDescription.read(tmp_path)
