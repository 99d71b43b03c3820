# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rows over seeds, against the plain definitions, and experiments of other packages."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_lab.experiments.harness import (
    ExperimentError,
    constant_row,
    error_rows,
    peak_row,
    rate_hz,
    select,
)
from mixtac_learning.judge.estimators import TrialEstimate


def estimate(seconds, seed=0, error=0.1, held=1):
    random = np.random.default_rng(seed)
    t_us = 500_000 + 2000 * np.arange(round(500 * seconds))
    known = np.sin(1e-6 * t_us) ** 2
    force = known + random.normal(0.0, error, len(t_us))
    force = np.repeat(force[::held], held)[: len(t_us)]
    return TrialEstimate('trial', 'long_term', '7', t_us, force, known, None)


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


NAMES = ['vibration', 'stability', 'inputs', 'fusion', 'impact', 'slip', 'model', 'comparison']


def test_experiments_are_selected_once_and_in_the_order_of_the_paper():
    assert [name for name in select(['all']) if name in NAMES] == NAMES
    assert list(select(['slip', 'inputs', 'slip'])) == ['inputs', 'slip']
    with pytest.raises(ExperimentError) as refused:
        select(['smell'])
    assert "'smell'" in str(refused.value)
    assert all(name in refused.value.remedy for name in NAMES)
