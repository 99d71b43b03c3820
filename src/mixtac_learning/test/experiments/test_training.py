# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training and test trials never meet."""

from __future__ import annotations

from mixtac_learning.experiments.harness import FULL
from mixtac_learning.experiments.training import (
    PROFILES,
    test_trials,
    training_data,
)
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
