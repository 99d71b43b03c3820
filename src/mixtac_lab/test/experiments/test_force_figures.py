# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors over time and over seeds, against the plain definitions."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_lab.experiments.harness import constant_row, error_rows, peak_row, rate_hz
from mixtac_lab.experiments.paper.stability import rolling_bins
from mixtac_lab.experiments.training import load_estimate, save_estimate
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


def test_rows_spread_over_seeds():
    by_seed = {seed: [estimate(3.0, 10 * seed + k) for k in range(2)] for seed in range(3)}
    mae, rmse, r2 = error_rows('m', by_seed, {'mae': 0.04}, 'p', 'c', simulated=True)
    values = [
        np.mean(np.abs(np.concatenate([e.force - e.known for e in trials])))
        for trials in by_seed.values()
    ]
    assert mae.ours.mean == pytest.approx(np.mean(values))
    assert mae.ours.spread == pytest.approx(np.std(values, ddof=1))
    assert (mae.paper, mae.place, rmse.paper, rmse.place) == (0.04, 'p', None, '')
    assert r2.unit == ''
    known = np.concatenate([e.known for e in by_seed[0]])
    constant = constant_row({0: by_seed[0]}, 'c', simulated=True)
    assert constant.ours.mean == pytest.approx(np.abs(known - np.median(known)).mean())


def test_peak_row_is_relative():
    trial = estimate(4.0, error=0.0)
    low = TrialEstimate('t', 'p', 'd', trial.t_us, 0.75 * trial.known, trial.known, None)
    assert peak_row('m', {0: [low]}, 'c', simulated=True).ours.mean == pytest.approx(0.25)


def test_rate_counts_different_forces():
    assert rate_hz([estimate(4.0)]) == pytest.approx(500.0, rel=0.01)
    assert rate_hz([estimate(4.0, held=20)]) == pytest.approx(25.0, rel=0.03)


def test_estimates_survive_the_disk(tmp_path):
    trial = estimate(1.0)
    save_estimate(tmp_path / 'a.npz', trial)
    found = load_estimate(tmp_path / 'a.npz')
    assert (found.name, found.profile, found.device) == ('trial', 'long_term', '7')
    np.testing.assert_array_equal(found.force, trial.force)
    assert found.reference is None
