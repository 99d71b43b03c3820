# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training and test trials never meet."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from mixtac_core.recordings.recording import RecordingError
from mixtac_learning.experiments.harness import FULL
from mixtac_learning.experiments.training import (
    PROFILES,
    BagTrials,
    SimulatedTrials,
    load_estimate,
    save_estimate,
)
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_learning.train.run import training_sources


def test_simulated_tests_are_other_days_of_the_sensor_that_was_trained_on():
    sets = SimulatedTrials(FULL)
    for seed in range(3):
        trained = [source.origin for source in training_sources(sets.training(seed))]
        tested = [s.origin for profile in PROFILES for s in sets.tests(seed, profile)]
        devices = {origin['device_seed'] for origin in trained}
        assert len(devices) == 1
        assert devices == {origin['device_seed'] for origin in tested}
        days = [origin['trial_seed'] for origin in tested]
        assert len(set(days)) == len(days)
        assert not set(days) & {origin['trial_seed'] for origin in trained}


def test_seeds_are_other_sensors():
    sets = SimulatedTrials(FULL)
    assert len({sets.tests(seed, 'static')[0].origin['device_seed'] for seed in range(3)}) == 3


def bags(folder, profile, count):
    for k in range(count):
        bag = folder / profile / f'trial_{k:02d}'
        bag.mkdir(parents=True)
        (bag / 'metadata.yaml').write_text('rosbag2_bagfile_information: {}\n')


def test_a_users_bags_are_split_eight_to_two_by_trial(tmp_path):
    bags(tmp_path, 'static', 10)
    bags(tmp_path, 'impact', 5)
    sets = BagTrials(tmp_path)
    held = [source.name for source in sets.tests(0, 'static')]
    assert held == ['trial_04', 'trial_09']
    assert sets.tests(0, 'static')[0].origin['profile'] == 'static'
    trained = sets.training(0).bags
    assert len(trained) == 8 + 4
    assert not any(name in path for name in held for path in trained if 'static' in path)
    assert not sets.simulated
    with pytest.raises(RecordingError) as refused:
        sets.tests(0, 'dynamic')
    assert str(tmp_path / 'dynamic') in str(refused.value)


def test_splits_of_a_described_data_set_are_kept(tmp_path):
    bags(tmp_path, 'static', 5)
    trials = [
        {'name': f'trial_{k:02d}', 'split': 'val' if k == 1 else 'train', 'trial_seed': k}
        for k in range(5)
    ]
    (tmp_path / 'static' / 'dataset.yaml').write_text(yaml.safe_dump({'trials': trials}))
    sets = BagTrials(tmp_path)
    assert [source.name for source in sets.tests(0, 'static')] == ['trial_01']
    assert sets.simulated


def test_estimates_survive_the_disk(tmp_path):
    t_us = 2000 * np.arange(500)
    known = np.sin(1e-6 * t_us) ** 2
    trial = TrialEstimate('trial', 'long_term', '7', t_us, known + 0.1, known, None)
    save_estimate(tmp_path / 'a.npz', trial)
    found = load_estimate(tmp_path / 'a.npz')
    assert (found.name, found.profile, found.device) == ('trial', 'long_term', '7')
    np.testing.assert_array_equal(found.force, trial.force)
    assert found.reference is None
    assert found.deviation is None
