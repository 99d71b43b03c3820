# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibrations by known weights, sound and spoiled."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_lab.experiments.studies.adaptation import SPOILED, calibrate_by_weights, spoiled_weights
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_sim.world.profiles import make_profile


def test_known_weights_give_the_gain_within_their_error():
    t_us = np.arange(300_000, 18_000_001, 2000)
    true = np.zeros(len(t_us))
    for segment in make_profile('weights', 3, 18.0).segments:
        inside = (t_us > 1e6 * segment.start_s) & (t_us <= 1e6 * segment.end_s)
        true[inside] = np.interp(
            1e-6 * t_us[inside] - segment.start_s, segment.times_s, segment.values
        )
    noise = np.random.default_rng(1).normal(0.0, 0.004, len(t_us))
    estimate = TrialEstimate('w', 'weights', 'd', t_us, true / 1.4 + noise, true, None)
    # The 100 g weight, wrong by 1 g at most, counts most.
    assert calibrate_by_weights(estimate, 5).gain == pytest.approx(1.4, rel=0.02)
    for seed in range(8):
        found = spoiled_weights(estimate, seed)
        assert set(found) == set(SPOILED)
        assert 'accepted' not in found.values()
