# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The rolling error of long holds, against its plain definition."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_lab.experiments.paper.forces import rolling_bins
from mixtac_learning.judge.estimators import TrialEstimate


def estimate(seconds, seed=0, error=0.1, held=1):
    random = np.random.default_rng(seed)
    t_us = 500_000 + 2000 * np.arange(round(500 * seconds))
    known = np.sin(1e-6 * t_us) ** 2
    force = known + random.normal(0.0, error, len(t_us))
    force = np.repeat(force[::held], held)[: len(t_us)]
    return TrialEstimate('trial', 'long_term', '7', t_us, force, known, None)


def test_rolling_error_is_the_mean_over_half_a_second_around_each_window():
    trial = estimate(12.0)
    bins = rolling_bins(trial)
    assert [len(each) for each in bins] == [2500, 3500]  # two seconds left join the bin before
    error = np.abs(trial.force - trial.known)
    for index in (1000, 2499, 2500, 4100):
        plain = error[index - 125 : index + 125].mean()
        bin_index, place = min(index // 2500, 1), index - 2500 * min(index // 2500, 1)
        assert bins[bin_index][place] == pytest.approx(plain, rel=1e-9)


def test_a_remainder_of_more_than_half_a_bin_stands_alone():
    assert [len(each) for each in rolling_bins(estimate(8.0))] == [2500, 1500]
