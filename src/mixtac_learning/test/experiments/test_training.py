# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training and test trials never meet."""

from __future__ import annotations

import numpy as np

from mixtac_learning.experiments.harness import FULL
from mixtac_learning.experiments.training import (
    PROFILES,
    load_estimate,
    save_estimate,
    test_trials,
    training_data,
)
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_learning.train.run import training_sources

test_trials.__test__ = False


def test_tests_are_other_days_of_the_sensor_that_was_trained_on():
    sensors = set()
    for seed in range(3):
        trained = [source.spec for source in training_sources(training_data(FULL, seed))]
        tested = [spec for name in PROFILES for spec in test_trials(FULL, seed, name)]
        (device,) = {spec.device_seed for spec in trained}
        assert {spec.device_seed for spec in tested} == {device}
        days = [spec.trial_seed for spec in tested]
        assert len(set(days)) == len(days)
        assert not set(days) & {spec.trial_seed for spec in trained}
        sensors.add(device)
    assert len(sensors) == 3


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
